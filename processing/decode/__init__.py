"""Photographs to linear, aligned, checked half-float frames: the stage `decode`."""
