"""Cameras found from the photographs themselves (structure from motion)."""
