"""Photographs to coarse maps, mesh, exact maps, registered atlas and dataset."""

from lightstage import __version__

__all__ = ["__version__"]
