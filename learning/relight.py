"""A measured head under other light: its texture, and its picture."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import torch

from learning.errors import MapsError
from learning.maps import TexturedHead, from_batch
from learning.render.environments import from_light_set
from learning.render.occlusion import bake_environment
from learning.render.shading import ShadeOptions, shade
from learning.render.view import render_view
from lightstage.commands import ProgressCallback, quiet
from lightstage.formats.environment import LightSet
from lightstage.formats.exr import write_exr
from lightstage.formats.files import atomic_path
from lightstage.rig import Camera
from processing.colour import srgb_from_linear


def lit_texture(
    head: TexturedHead,
    lights: LightSet,
    camera_mm: np.ndarray,
    options: ShadeOptions | None = None,
    progress: ProgressCallback = quiet,
) -> np.ndarray:
    """The texture that a photograph would give: shaded, with cast shadows.

    Args:
        head: maps and mesh.
        lights: in the axes of the mesh.
        camera_mm: (3,) from where the highlights are seen.
        options: of the shading.
        progress: of the shadow rays.

    Returns:
        (rows, columns, 3) float32 linear; zero where no surface is.
    """
    environment = from_light_set(lights, camera_mm)
    seen = bake_environment(head.mesh, head.raster, environment, progress)
    with torch.inference_mode():
        lit = shade(head.skin, environment, options, torch.from_numpy(seen)[None])
    return from_batch(lit) * head.raster.covered[..., None]


def render_head(
    head: TexturedHead,
    lights: LightSet,
    camera: Camera,
    background: float = 1.0,
    captured_only: bool = False,
    options: ShadeOptions | None = None,
    progress: ProgressCallback = quiet,
) -> tuple[np.ndarray, np.ndarray]:
    """A picture of the head: (h, w, 3) linear rgb before a grey background, and (h, w) alpha.

    Texels that were not captured show what they were filled with, unless `captured_only`.
    """
    texture = lit_texture(head, lights, camera.centre_mm, options, progress)
    shown = head.captured if captured_only else head.raster.covered
    return render_view(texture, shown, head.mesh, camera, background)


def write_picture(path: Path, rgb_linear: np.ndarray, alpha: np.ndarray) -> Path:
    """Write .exr (linear, over the background) or .png (sRGB with alpha), atomically.

    Raises:
        MapsError: another suffix.
    """
    if path.suffix.lower() == ".exr":
        return write_exr(path, rgb_linear)
    if path.suffix.lower() != ".png":
        raise MapsError(path, found=f"suffix {path.suffix!r}", expected=".png or .exr")
    bgra = np.concatenate([srgb_from_linear(rgb_linear)[..., ::-1], alpha[..., None]], axis=2)
    with atomic_path(path) as beside:
        cv2.imwrite(str(beside), np.round(bgra * 255).astype(np.uint8))
    return path
