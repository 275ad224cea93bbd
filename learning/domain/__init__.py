"""The light that all textures of one source have in common."""
