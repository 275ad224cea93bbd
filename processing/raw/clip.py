"""From where on a pixel of a RAW photograph is clipped, in captures and in calibrations."""

CLIP_SHARE = 0.99
"""Share of the white level (above black): some sensors are full a little before it."""
