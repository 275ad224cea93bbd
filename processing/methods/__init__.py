"""Ways to separate a view's pixels into diffuse and specular maps, one a file."""
