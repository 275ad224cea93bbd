"""Differentiable skin renderer in texture space, and the networks that use it."""

from lightstage import __version__

__all__ = ["__version__"]
