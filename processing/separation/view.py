"""One view's photographs to its maps, by whichever method."""

from __future__ import annotations

import numpy as np

from lightstage.rig import Camera
from processing.frames.read import Frames
from processing.lighting.lights import PatternLights
from processing.readings import px_per_mm
from processing.separation import colour
from processing.separation.choice import METHODS, used_patterns
from processing.separation.config import SeparateConfig
from processing.separation.view_readings import Pixels
from processing.view_maps import PixelMaps


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
    if method == "colour" and colour.in_one_pass(config):
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
    used = used_patterns(method, lights)
    if used != lights.patterns:
        lights = lights.of(used)
    pixels = Pixels(
        rgb=frames.pixels(mask, used),
        valid=frames.valid[mask],
        views=-camera.pixel_rays()[1][mask],
        mask=mask,
        px_per_mm=px_per_mm(camera),
        camera=camera,
    )
    return METHODS[method].separate(pixels, lights, config)
