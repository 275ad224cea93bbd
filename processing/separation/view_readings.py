"""What one view's pixels read: all that a method of separation is given of a view."""

from __future__ import annotations

import dataclasses

import numpy as np

from lightstage.rig import Camera


@dataclasses.dataclass(frozen=True)
class Pixels:
    """The n pixels of one view's mask, in row order.

    Attributes:
        rgb: (n, P, 3) readings under P patterns.
        valid: (n,) bool, false where clipped.
        views: (n, 3) unit, toward the camera.
        mask: (h, w) bool with n true pixels.
        px_per_mm: pixels a millimetre at the sphere's centre.
        camera: whose view it is; without it every pixel is at the sphere's centre, and of
            polarisers only the ideal is known.
    """

    rgb: np.ndarray
    valid: np.ndarray
    views: np.ndarray
    mask: np.ndarray
    px_per_mm: float
    camera: Camera | None = None

    @property
    def points_mm(self) -> np.ndarray | None:
        """(n, 3) where the rays pass the sphere's centre; None where the camera is not given.

        A face fills the middle of the stage, so that this is right within some centimetres.
        """
        if self.camera is None:
            return None
        centre_mm, views = self.camera.centre_mm, self.views
        return np.asarray(centre_mm - views * (views @ centre_mm)[:, None])

    @property
    def places_mm(self) -> np.ndarray:
        """(n, 3) `points_mm`, or the sphere's centre where they are not known."""
        points = self.points_mm
        return np.zeros_like(self.views) if points is None else points
