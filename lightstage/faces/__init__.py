"""Faces in pictures: where they are, and 468 points on each."""

from lightstage.faces.detect import Face, detect_faces

__all__ = ["Face", "detect_faces"]
