"""A measured head under other light: its texture, and its picture."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from learning.errors import MapsError
from learning.maps import TexturedHead, from_batch
from learning.occlusion_run import occlusion_network_for, occlusion_table_for
from learning.render.environments import from_light_set
from learning.render.occlusion import bake_environment
from learning.render.panorama import load_panorama, median_cut
from learning.render.shading import ShadeOptions, shade
from learning.render.view import render_view
from lightstage.commands import ProgressCallback, quiet
from lightstage.errors import ConfigError, FormatError
from lightstage.formats.environment import LightSet, read_lights
from lightstage.formats.exr import write_exr
from lightstage.formats.panorama import SUFFIXES
from lightstage.formats.png import write_png
from lightstage.rig import Camera
from processing.colour import srgb_from_linear

FAR_MM = 100_000.0
"""Lights of a picture are this far away: a head turns them by less than 0.1 degrees."""

LEAST_ALPHA = 1e-3
"""Less of a pixel is none of 255 steps, whatever colour it has."""
NETWORK, TABLE = "network:", "table:"
SHADOWS = ("baked", "table", "none", f"{TABLE}FILE", f"{NETWORK}FILE")
"""Cast shadows: rays to every light; our template's table of them; none; another table's; a
network's."""


def read_light(path: Path, count: int, rotate_deg: float = 0.0, mode: str = "physical") -> LightSet:
    """Read light to render under: a light set, or a picture of light as `count` lights.

    Args:
        path: .json (lightstage.environment/1), or .exr or .hdr (latitude-longitude).
        count: number of lights that replace a picture, by median cut; of few lights, light without
            a direction becomes ambient light.
        rotate_deg: turns the light about +y, from +z toward +x.
        mode: of the shading. In `paper` the ambient intensity multiplies the lights' sum, so that a
            picture, whose lights give all light that has a direction, gets an intensity of 1.

    Raises:
        ConfigError: an angle that is not finite.
        FormatError: a file that cannot be read, of another shape, or with NaN or negative light.
    """
    if not np.isfinite(rotate_deg):
        raise ConfigError("--rotate", found=str(rotate_deg), expected="degrees, a finite number")
    if path.suffix.lower() not in (".json", *SUFFIXES):
        raise FormatError(
            path,
            field="--environment",
            found=f"suffix {path.suffix!r}",
            expected=" or ".join([".json", *SUFFIXES]),
            hint="Light has a wider range than the 8 bits of a PNG or JPEG: take its .exr or .hdr.",
        )
    if path.suffix.lower() not in SUFFIXES:
        return turned_lights(read_lights(path), rotate_deg)
    found = median_cut(load_panorama(path), count, np.zeros(3))
    lights = LightSet(
        path.stem,
        FAR_MM * found.position_mm[0].double().numpy(),
        found.rgb[0].double().numpy(),
        np.ones(3) if mode == "paper" else found.ambient_rgb[0].double().numpy(),
    )
    return turned_lights(lights, rotate_deg)


def notes_of_light(lights: LightSet, mode: str) -> tuple[str, ...]:
    """What a user should know of rendering under a light set in a mode."""
    if mode != "paper" or (lights.ambient_rgb > 0).any():
        return ()
    return (
        "ambient_rgb of the light set is 0, by which mode paper multiplies the lamps' light: "
        "nothing diffuse is left of it; 1 leaves it as it is",
    )


def turned_lights(lights: LightSet, angle_deg: float) -> LightSet:
    """A light set turned about +y, from +z toward +x."""
    turned = lights.position_mm @ about_y(angle_deg).T
    return dataclasses.replace(lights, position_mm=turned)


def about_y(angle_deg: float) -> np.ndarray:
    """(3, 3) rotation about +y, from +z toward +x."""
    a = np.deg2rad(angle_deg)
    return np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])


def turned_camera(camera: Camera, angle_deg: float, centre_mm: np.ndarray) -> Camera:
    """A camera turned round the vertical through a (3,) point, mm, from +z toward +x."""
    turn = about_y(angle_deg)
    rotation, translation = camera.cam_from_world[:, :3], camera.cam_from_world[:, 3]
    moved = rotation @ turn.T
    shift = translation + rotation @ (np.asarray(centre_mm) - turn.T @ np.asarray(centre_mm))
    return dataclasses.replace(camera, cam_from_world=np.column_stack([moved, shift]))


def shadows_of(
    head: TexturedHead,
    lights: LightSet,
    how: str = "baked",
    head_from_world: np.ndarray | None = None,
    progress: ProgressCallback = quiet,
) -> Tensor | None:
    """Visibility of every light, (1, L, rows, columns), or None for all seen.

    Args:
        head: maps and mesh.
        lights: in the axes of the mesh.
        how: of `SHADOWS`, FILE being what `occlusion` wrote: a table, or a network's run folder or
            its checkpoint.json. A table fits the texture of the template or head it was made of.
        head_from_world: (3, 4), for table and network; the mesh is in the head frame where None.
        progress: of the rays.

    Raises:
        ConfigError: none of `SHADOWS`.
        CheckpointError, FormatError: a file that holds no network for this head and light, or no
            table for this head.
    """
    kind, _, named = how.partition(":")
    if how not in SHADOWS[:3] and not (named and f"{kind}:" in (TABLE, NETWORK)):
        raise ConfigError("shadows", found=repr(how), expected=", ".join(SHADOWS))
    if how == "none" or not len(lights.rgb):
        return None
    if how == "baked":
        environment = from_light_set(lights, np.zeros(3))
        return torch.from_numpy(bake_environment(head.mesh, head.raster, environment, progress))[
            None
        ]
    pose = np.eye(3, 4) if head_from_world is None else head_from_world
    place = torch.from_numpy(lights.position_mm @ pose[:, :3].T + pose[:, 3]).float()
    size = (head.raster.covered.shape[0], head.raster.covered.shape[1])
    if kind == "table":
        table = occlusion_table_for(Path(named) if named else None, head.mesh)
        return table.for_lights(place, size)[None]
    network = occlusion_network_for(Path(named), head.mesh, len(lights.rgb))
    with torch.inference_mode():
        return network.for_lights(place, torch.from_numpy(lights.rgb).float(), size)[None]


def lit_texture(
    head: TexturedHead,
    lights: LightSet,
    camera_mm: np.ndarray,
    options: ShadeOptions | None = None,
    seen: Tensor | None = None,
) -> np.ndarray:
    """The texture that a photograph would give: shaded, with cast shadows.

    Args:
        head: maps and mesh.
        lights: in the axes of the mesh; none leave the ambient light alone.
        camera_mm: (3,) from where the highlights are seen.
        options: of the shading.
        seen: of `shadows_of`; no shadows where None.

    Returns:
        (rows, columns, 3) float32 linear; zero where no surface is.
    """
    environment = from_light_set(lights, camera_mm)
    with torch.inference_mode():
        lit = shade(head.skin, environment, options, seen)
    return from_batch(lit) * head.raster.covered[..., None]


def render_head(
    head: TexturedHead,
    lights: LightSet,
    camera: Camera,
    background: float = 1.0,
    captured_only: bool = False,
    options: ShadeOptions | None = None,
    seen: Tensor | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """A picture of the head: (h, w, 3) linear rgb before a grey background, and (h, w) alpha.

    Before black, rgb is that of the surface times alpha. Texels that were not captured show what
    they were filled with, unless `captured_only`.
    """
    texture = lit_texture(head, lights, camera.centre_mm, options, seen)
    shown = head.captured if captured_only else head.raster.covered
    return render_view(texture, shown, head.mesh, camera, background)


def write_picture(path: Path, rgb_linear: np.ndarray, alpha: np.ndarray | None = None) -> Path:
    """Write .exr (linear) or .png (sRGB), atomically.

    Args:
        path: of the picture.
        rgb_linear: (h, w, 3), of the surface times `alpha` where that is given.
        alpha: (h, w) of a .png without a background, which has the surface's own colours beside it.

    Raises:
        MapsError: another suffix.
    """
    if path.suffix.lower() == ".exr":
        return write_exr(path, rgb_linear)
    if path.suffix.lower() != ".png":
        raise MapsError(path, found=f"suffix {path.suffix!r}", expected=".png or .exr")
    shown = rgb_linear if alpha is None else rgb_linear / np.maximum(alpha, LEAST_ALPHA)[..., None]
    shown = srgb_from_linear(shown)
    if alpha is not None:
        shown = np.concatenate([shown, alpha[..., None]], axis=2)
    return write_png(path, np.round(shown * 255).astype(np.uint8))
