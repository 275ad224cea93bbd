"""A lit head from in front, cut as recognisers expect a face."""

from __future__ import annotations

import numpy as np

from learning.render.view import render_view
from lightstage.formats.mesh import Mesh
from lightstage.rig import Camera, look_at
from processing.colour import srgb_from_linear

MIDDLE_MM = np.array([0.0, -15.0, 75.0])
HEIGHT_MM = 187.0
"""Middle and height of the picture in the head frame: eyes and mouth of the template are where the
aligned pictures of [Deng2019] have them, at .46 and .82 of the height."""
DISTANCE_MM = 1100.0
BACKGROUND = 0.2


def portrait(
    lit: np.ndarray,
    covered: np.ndarray,
    mesh: Mesh,
    head_from_world: np.ndarray,
    size: tuple[int, int],
) -> np.ndarray:
    """A picture of a head from in front.

    Args:
        lit: (rows, columns, 3) linear, shaded.
        covered: (rows, columns) bool, texels of the mesh.
        mesh: with UV, world.
        head_from_world: (3, 4) rigid.
        size: rows and columns of the picture.

    Returns:
        (rows, columns, 3) float32 sRGB, 0..1.
    """
    rgb, _ = render_view(lit, covered, mesh, portrait_camera(head_from_world, size), BACKGROUND)
    return np.clip(srgb_from_linear(rgb), 0, 1).astype(np.float32)


def portrait_camera(head_from_world: np.ndarray, size: tuple[int, int]) -> Camera:
    """The camera of `portrait`, in the world.

    Args:
        head_from_world: (3, 4) pose of the head, mm.
        size: rows and columns of the picture.
    """
    from_head = look_at(MIDDLE_MM + np.array([0, 0, DISTANCE_MM]), MIDDLE_MM)
    turn = from_head[:, :3] @ head_from_world[:, :3]
    shift = from_head[:, :3] @ head_from_world[:, 3] + from_head[:, 3]
    focal_px = size[0] * DISTANCE_MM / HEIGHT_MM
    return Camera(
        "portrait",
        "",
        "",
        size[1],
        size[0],
        focal_px,
        focal_px,
        size[1] / 2,
        size[0] / 2,
        (0.0,) * 5,
        np.column_stack([turn, shift]),
    )
