"""Pores and folds: how they tilt the surface beside the mesh, told by their shading."""
