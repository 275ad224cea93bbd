"""A photograph with fewer pixels than its texture has texels, enlarged by super-resolution.

Pixels are enlarged, not texels: they are square, and the background is in view.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from learning.render.uv import UvRaster
from learning.upscale.infer import SMALLEST_PX, upscale
from learning.upscale.network import Rcan
from lightstage.formats.mesh import Mesh
from lightstage.rig import Camera

FEWEST, MOST = 1.5, 5.0
"""Texels a pixel between which the shipped weights gain: at 1.9 and 3.7 the texture of a simulated
person comes .8 and .5 dB nearer to the true one, and the scanned head's 1.7 and 1.3; at 7.5 the
person's is 2 dB farther, the scanned head's .6 nearer."""
MOST_PIXELS = 2**19
"""Of what is enlarged: larger heads would need more than a gigabyte."""
MARGIN_PX = 4


@dataclasses.dataclass(frozen=True)
class Enlarged:
    """The part of a photograph that shows the head, with more pixels.

    Attributes:
        rgb_linear: (h, w, 3).
        person: (h, w) bool.
        camera: of this picture.
    """

    rgb_linear: np.ndarray
    person: np.ndarray
    camera: Camera


def enlarged(
    rgb_linear: np.ndarray,
    person: np.ndarray,
    mesh: Mesh,
    raster: UvRaster,
    face: np.ndarray,
    camera: Camera,
    network: Rcan,
) -> Enlarged | None:
    """Enlarge the head's part of a photograph; None where it gains nothing, or is too large.

    Args:
        rgb_linear: (h, w, 3).
        person: (h, w) bool, see `foreground`.
        mesh: the fitted head, in the camera's world.
        raster: of the texture.
        face: (n,) bool, vertices of the face.
        camera: of the photograph.
        network: in evaluation mode.
    """
    if not FEWEST <= texels_a_pixel(mesh, raster, face, camera) <= MOST:
        return None
    place, depth = camera.project(mesh.vertices)
    size = np.array([camera.width_px, camera.height_px])
    low = np.clip(np.floor(place[depth > 0].min(axis=0)) - MARGIN_PX, 0, size).astype(int)
    high = np.clip(np.ceil(place[depth > 0].max(axis=0)) + MARGIN_PX, 0, size).astype(int)
    width, height = (int(side) for side in high - low)
    if min(width, height) < SMALLEST_PX or width * height > MOST_PIXELS:
        return None
    here = (slice(low[1], high[1]), slice(low[0], high[0]))
    large = upscale(network, rgb_linear[here])
    times = network.config.times
    shown = np.kron(person[here], np.ones((times, times), bool))
    other = dataclasses.replace(
        camera,
        width_px=times * width,
        height_px=times * height,
        fx_px=times * camera.fx_px,
        fy_px=times * camera.fy_px,
        cx_px=times * (camera.cx_px - low[0]),
        cy_px=times * (camera.cy_px - low[1]),
    )
    return Enlarged(large, shown, other)


def texels_a_pixel(mesh: Mesh, raster: UvRaster, face: np.ndarray, camera: Camera) -> float:
    """How many texels a pixel of the face is wide: the median, mean of both directions."""
    here = raster.covered & (raster.interpolate(face[:, None].astype(float))[..., 0] > 0.5)
    place = np.full((*here.shape, 2), np.nan)
    position = raster.interpolate(mesh.vertices)[here].astype(float)
    place[here], _ = camera.project(position)
    steps = [np.linalg.norm(np.diff(place, axis=axis), axis=2) for axis in (0, 1)]
    known = [step[np.isfinite(step)] for step in steps]
    if not all(step.size for step in known):
        return 0.0
    across = float(np.sqrt(np.prod([np.median(step) for step in known])))
    return 1 / max(across, 1e-9)
