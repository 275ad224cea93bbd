"""Diffuse and specular separated without a mesh: the stage `separate` and its methods."""
