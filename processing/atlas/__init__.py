"""Atlas: the views' maps merged into the template's UV tile."""
