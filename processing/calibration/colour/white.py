"""What a perfect white reads at a place in the stage, by the rig: chart and ball are read by it."""

from __future__ import annotations

import numpy as np

from lightstage.formats.environment import LightSet

CHUNK = 20_000


def white_at(points_mm: np.ndarray, normals: np.ndarray, lights: LightSet) -> np.ndarray:
    """What a perfect white diffuser reads that sees every light above its horizon.

    Args:
        points_mm: (n, 3) world.
        normals: (n, 3) unit, or (3,) the same for all.
        lights: on the session's scale (formats.environment.stage_lights).

    Returns:
        (n, 3) float64 linear rgb: sum over lights of rgb * max(0, n . l) * (d0 / d)^2, with d the
        distance of the light and d0 its distance from the origin.
    """
    points = np.asarray(points_mm, float).reshape(-1, 3)
    facing = np.broadcast_to(np.asarray(normals, float), points.shape)
    from_origin2 = np.sum(lights.position_mm**2, axis=1)
    out = np.zeros((len(points), 3))
    for first in range(0, len(points), CHUNK):
        part = slice(first, first + CHUNK)
        toward = lights.position_mm - points[part, None]
        far2 = np.sum(toward**2, axis=2)
        cosine = np.einsum("nk,nmk->nm", facing[part], toward) / np.sqrt(far2)
        out[part] = (np.maximum(cosine, 0.0) * from_origin2 / far2) @ lights.rgb
    return out
