"""What the commands do: read files, call the pure function, write files, return the facts."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from learning.errors import MapsError
from learning.maps import TexturedHead, load_head
from learning.relight import lit_texture, render_head, write_picture
from learning.render.shading import ShadeOptions
from lightstage.commands import ProgressCallback
from lightstage.errors import ConfigError
from lightstage.formats.config import make_config
from lightstage.formats.environment import read_lights
from lightstage.formats.exr import write_exr
from lightstage.formats.mesh import read_mesh
from lightstage.formats.template import load_template
from lightstage.rig import Camera, default_rig, load_rig

DEFAULT_RIG_SCALE = 1080 / 6016
"""Without a rig, pictures are 720 x 1080 pixels."""
BACKGROUNDS = {"white": 1.0, "black": 0.0}


def render_command(
    maps: Path,
    mesh: Path,
    environment: Path,
    out: Path,
    rig: Path | None,
    camera: str,
    template: Path | None,
    mode: str,
    background: str,
    progress: ProgressCallback,
) -> dict[str, Any]:
    """Render a head to a picture; returns the facts."""
    began = time.monotonic()
    if background not in BACKGROUNDS:
        raise ConfigError("--background", found=repr(background), expected="white or black")
    if out.suffix.lower() not in (".png", ".exr"):
        raise MapsError(out, found=f"suffix {out.suffix!r}", expected=".png or .exr")
    options = make_config(ShadeOptions, {"mode": mode}, "--mode")
    view = _camera(rig, camera)
    head, lights = _head(maps, mesh, template), read_lights(environment)
    rgb, alpha = render_head(head, lights, view, BACKGROUNDS[background], options, progress)
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
    options = make_config(ShadeOptions, {"mode": mode}, "--mode")
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
    return load_head(maps, read_mesh(mesh), load_template(template) if template else None)
