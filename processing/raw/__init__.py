"""Camera RAW files to linear half floats of the part of the picture that holds the face."""

from processing.raw.picture import demosaic, linear_mosaic, read_raw

__all__ = ["demosaic", "linear_mosaic", "read_raw"]
