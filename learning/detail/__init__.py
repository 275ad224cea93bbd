"""Pores and folds from a map of normals to heights: a displacement map, and an embossed mesh."""
