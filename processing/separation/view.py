"""One view's photographs to its maps, by whichever method."""

from __future__ import annotations

import numpy as np

from lightstage.rig import Camera
from processing.frames.read import Frames
from processing.lighting.lights import PatternLights
from processing.pixels import PixelMaps
from processing.readings import px_per_mm
from processing.separation import colour, linear, polarised
from processing.separation.choice import METHODS
from processing.separation.config import SeparateConfig
from processing.surface import Sight


def separate_view(
    method: str,
    frames: Frames,
    mask: np.ndarray,
    camera: Camera,
    lights: PatternLights,
    config: SeparateConfig,
) -> PixelMaps:
    """Separate one view.

    Args:
        method: of `choice.chosen_method`.
        frames: the view's photographs.
        mask: (h, w) bool of the whole picture, with n true pixels in the frames' window.
        camera: the view's.
        lights: of the frames' patterns.
        config: see there.

    Returns:
        PixelMaps of the mask's pixels in row order.
    """
    if method == "colour" and _plain(config):
        inner = np.ascontiguousarray(mask[frames.window.slices])
        readings = colour.window_readings(
            np.asarray(frames.half),
            frames.scale,
            inner,
            np.asarray(frames.clipped) == 0,
            (frames.window.top, frames.window.left),
            camera,
        )
        return colour.separate_window(readings, lights, config)
    rgb, valid = frames.pixels(mask), frames.valid[mask]
    views = -camera.pixel_rays()[1][mask]
    scale = px_per_mm(camera)
    if method in ("colour", "linear"):
        return linear.separate_pixels(rgb, valid, views, mask, lights, scale, config, camera=camera)
    if method == "polarised":
        return polarised.separate_pixels(
            rgb, valid, views, mask, lights, scale, config, camera=camera
        )
    return METHODS[method](rgb, valid, views, mask, lights, scale, config)


def separate_on_mesh(
    method: str,
    frames: Frames,
    sight: Sight,
    camera: Camera,
    lights: PatternLights,
    config: SeparateConfig,
) -> PixelMaps:
    """Separate one view whose mesh is known, by a method that takes positions and shadows.

    Args:
        method: ``polarised`` or ``linear``; the latter takes any unpolarised patterns.
        frames: the view's photographs.
        sight: what the camera sees of the mesh.
        camera: the view's.
        lights: of the frames' patterns.
        config: see there.

    Returns:
        PixelMaps of the sight's pixels.
    """
    rgb, valid = frames.pixels(sight.mask), frames.valid[sight.mask]
    seen = (rgb, valid, sight.views, sight.mask, lights, px_per_mm(camera), config)
    if method == "polarised":
        return polarised.separate_pixels(*seen, camera=camera, sight=sight)
    return linear.separate_pixels(*seen, sight=sight)


def _plain(config: SeparateConfig) -> bool:
    """Whether `colour` is asked for what its one pass over the frames does."""
    plain = config.specular_normals in ("auto", "diffuse")
    return plain and config.normals in ("auto", "chroma")
