"""Faces in pictures: where they are, and 468 points on each."""

from lightstage.faces.detect import SURE, Face, detect_faces, small_faces

__all__ = ["SURE", "Face", "detect_faces", "small_faces"]
