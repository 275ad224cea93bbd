"""Camera RAW files to linear half floats of the part of the picture that holds the face."""
