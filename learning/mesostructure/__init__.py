"""Pores and folds: how they tilt the surface beside the mesh, found from their shading."""
