"""A processed folder against truth: errors of maps, meshes and atlas."""
