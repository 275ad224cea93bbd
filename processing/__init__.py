"""Photographs to coarse maps, mesh, exact maps, registered atlas and dataset."""
