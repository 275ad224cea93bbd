"""Diffuse and specular told apart without a mesh: the stage `separate` and its methods."""
