"""Decoded photographs: mapped half floats of the window that holds the face."""
