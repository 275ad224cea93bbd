"""The light stage itself: lights, cameras, sessions; and the floor that every package stands on."""

__version__ = "0.1.0"
