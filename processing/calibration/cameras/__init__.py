"""Lenses and poses of the stage's cameras, from photographs of boards."""
