"""Exact maps, with the mesh known: the stage `refine`."""
