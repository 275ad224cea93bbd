"""Light of the stage's lamps on targets that hide nothing from themselves."""

from __future__ import annotations

import dataclasses

import numpy as np

from lightstage.rig import Camera
from sim.light.lamps import Lamps

CHUNK = 20_000
FINER = 4
"""Subpixels along a side with which edges are drawn."""


@dataclasses.dataclass(frozen=True)
class Window:
    """A part of a camera's picture.

    Attributes:
        camera: with the part's own size and centre.
        rows: where it is in the whole picture.
        columns: the same.
    """

    camera: Camera
    rows: slice
    columns: slice


def window(camera: Camera, pixels: np.ndarray) -> Window | None:
    """The part of a picture in which (n, 2) places are, a pixel more on each side; None: outside.

    Places that are NaN (behind the camera) are left out.
    """
    seen = pixels[np.isfinite(pixels).all(axis=1)]
    if not len(seen):
        return None
    size = np.array([camera.width_px, camera.height_px])
    first = np.clip(np.floor(seen.min(axis=0)).astype(int) - 1, 0, size)
    last = np.clip(np.ceil(seen.max(axis=0)).astype(int) + 1, 0, size)
    if (last <= first).any():
        return None
    part = dataclasses.replace(
        camera,
        width_px=int(last[0] - first[0]),
        height_px=int(last[1] - first[1]),
        cx_px=camera.cx_px - first[0],
        cy_px=camera.cy_px - first[1],
    )
    rows = slice(int(first[1]), int(last[1]))
    return Window(part, rows, slice(int(first[0]), int(last[0])))


def corner_rays(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """(3,) origin and (h + 1, w + 1, 3) rays through the corners of all pixels.

    A pixel's own rays are between them: over one pixel a lens is as good as linear.
    """
    grown = dataclasses.replace(
        camera,
        width_px=camera.width_px + 1,
        height_px=camera.height_px + 1,
        cx_px=camera.cx_px + 0.5,
        cy_px=camera.cy_px + 0.5,
    )
    return grown.pixel_rays()


def white_reading(
    points_mm: np.ndarray, normals: np.ndarray, lamps: Lamps, levels: np.ndarray
) -> np.ndarray:
    """What a perfect white diffuser reads at places that see all lamps above their horizon.

    Args:
        points_mm: (n, 3) world.
        normals: (n, 3) unit.
        lamps: what shines.
        levels: (m,) of them.

    Returns:
        (n, 3) float64 on the session's scale: 1 at the origin facing +z under `full`.
    """
    weights = np.asarray(levels)[:, None] * lamps.weights
    reference2 = np.sum(lamps.positions_mm**2, axis=1)
    out = np.zeros((len(points_mm), 3))
    for first in range(0, len(points_mm), CHUNK):
        part = slice(first, first + CHUNK)
        toward = lamps.positions_mm - points_mm[part, None]
        distance2 = np.maximum(np.sum(toward**2, axis=2), 1e-12)
        toward /= np.sqrt(distance2)[..., None]
        cosine = np.maximum(np.einsum("nk,nmk->nm", normals[part], toward), 0.0)
        aside = np.maximum(-np.einsum("mk,nmk->nm", lamps.axes, toward), 0.0)
        fall = aside**lamps.exponent if lamps.exponent else 1.0
        out[part] = (cosine * fall * reference2 / distance2) @ weights
    return out
