"""A light stage without the hardware: rendered people with known answers, virtual devices."""

from lightstage import __version__

__all__ = ["__version__"]
