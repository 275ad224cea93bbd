"""What the commands do: read files, call the pure function, write files, return the facts."""

from __future__ import annotations

import dataclasses
import time
from pathlib import Path
from typing import Any

import numpy as np

from learning.checkpoint import load_generator
from learning.data import DataConfig
from learning.errors import MapsError
from learning.infer import infer
from learning.maps import TexturedHead, load_head
from learning.presets import preset
from learning.relight import lit_texture, render_head, write_picture
from learning.render.shading import ShadeOptions
from learning.train import train
from lightstage.commands import ProgressCallback
from lightstage.errors import ConfigError
from lightstage.formats.config import make_config, read_toml
from lightstage.formats.environment import read_lights
from lightstage.formats.exr import read_exr, write_exr
from lightstage.formats.mesh import read_mesh
from lightstage.formats.processed import ProcessedFolder, write_map
from lightstage.formats.template import load_template
from lightstage.rig import Camera, default_rig, load_rig
from processing.dataset import open_store, read_head_pose

DEFAULT_RIG_SCALE = 1080 / 6016
"""Without a rig, pictures are 720 x 1080 pixels."""
BACKGROUNDS = {"white": 1.0, "black": 0.0}


def render_command(
    maps: Path,
    mesh: Path | None,
    environment: Path,
    out: Path,
    rig: Path | None,
    camera: str,
    template: Path | None,
    mode: str,
    background: str,
    captured_only: bool,
    progress: ProgressCallback,
) -> dict[str, Any]:
    """Render a head to a picture; returns the facts."""
    began = time.monotonic()
    if background not in BACKGROUNDS:
        raise ConfigError("--background", found=repr(background), expected="white or black")
    if out.suffix.lower() not in (".png", ".exr"):
        raise MapsError(out, found=f"suffix {out.suffix!r}", expected=".png or .exr")
    options = make_config(ShadeOptions, {"mode": mode}, "shading")
    view = _camera(rig, camera)
    # An atlas lies in a processed folder, beside the mesh that it belongs to.
    shape = ProcessedFolder(maps.parent).registered_mesh if mesh is None else mesh
    head, lights = _head(maps, shape, template), read_lights(environment)
    rgb, alpha = render_head(
        head, lights, view, BACKGROUNDS[background], captured_only, options, progress
    )
    write_picture(out, rgb, alpha)
    return {
        "width_px": view.width_px,
        "height_px": view.height_px,
        "lights": len(lights.rgb),
        "surface_percent": 100 * float(alpha.mean()),
        "seconds": time.monotonic() - began,
    }


def bake_command(
    maps: Path,
    mesh: Path,
    environment: Path,
    out: Path,
    rig: Path | None,
    camera: str,
    template: Path | None,
    mode: str,
    progress: ProgressCallback,
) -> dict[str, Any]:
    """Bake light into a texture; returns the facts."""
    began = time.monotonic()
    options = make_config(ShadeOptions, {"mode": mode}, "shading")
    view = _camera(rig, camera)
    head, lights = _head(maps, mesh, template), read_lights(environment)
    texture = lit_texture(head, lights, view.centre_mm, options, progress)
    write_exr(out, texture)
    rows, columns = texture.shape[:2]
    return {
        "rows": rows,
        "columns": columns,
        "lights": len(lights.rgb),
        "seconds": time.monotonic() - began,
    }


def _camera(rig: Path | None, camera: str) -> Camera:
    chosen = default_rig().scaled(DEFAULT_RIG_SCALE) if rig is None else load_rig(rig)
    return chosen.camera(camera)


def _head(maps: Path, mesh: Path, template: Path | None) -> TexturedHead:
    shape = read_mesh(mesh)
    if shape.uvs is None:
        raise MapsError(mesh, field="uv", found="none", expected="the maps' texture coordinates")
    return load_head(maps, shape, load_template(template) if template else None)


def train_command(
    data: Path,
    out: Path,
    preset_name: str,
    config: Path | None,
    seconds: float | None,
    seed: int | None,
    resume: bool,
    progress: ProgressCallback,
) -> dict[str, Any]:
    """Train; returns the facts."""
    overrides = read_toml(config) if config else {}
    if seconds is not None:
        overrides["seconds"] = seconds
    if seed is not None:
        overrides["seed"] = seed
    resolved = preset(preset_name, overrides, str(config) if config else f"preset {preset_name}")
    result = train(open_store(data), out, resolved, resume, progress)
    return {
        "steps": result.steps,
        "patches": result.patches,
        "held_out": ", ".join(result.held_out),
        **dataclasses.asdict(result.score),
        "seconds": result.seconds,
    }


def infer_command(
    texture: Path,
    mesh: Path,
    checkpoint: Path,
    out: Path,
    head_pose: Path | None,
    progress: ProgressCallback,
) -> dict[str, Any]:
    """Infer the maps of a texture; returns the facts."""
    began = time.monotonic()
    generator, about = load_generator(checkpoint)
    image = read_exr(texture, finite=True)
    if image.ndim != 3:
        raise MapsError(texture, found="one channel", expected="R G B")
    if image.shape[0] != about.texture_rows:
        raise MapsError(
            texture,
            found=f"{image.shape[0]} rows",
            expected=f"{about.texture_rows}, as the network was trained on",
            hint="Skin's detail has one size for the network; make the texture that large.",
        )
    head_from_mesh = read_head_pose(head_pose)[:, :3] if head_pose else np.eye(3)
    data = make_config(DataConfig, about.config.get("data", {}), checkpoint)
    found = infer(generator, data, image, read_mesh(mesh), head_from_mesh, progress)
    for name, values in found.maps.items():
        write_map(out / f"{name}.exr", name, values)
    rows, columns = image.shape[:2]
    return {
        "rows": rows,
        "columns": columns,
        "tiles": found.tiles,
        "step": about.step,
        "seconds": time.monotonic() - began,
    }
