"""Light sets: a few point lights and an ambient term that a head is rendered under."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from lightstage.errors import FormatError
from lightstage.formats.fields import MOST
from lightstage.formats.files import read_json, write_json
from lightstage.rig import Rig

SCHEMA = "lightstage.environment/1"


@dataclasses.dataclass(frozen=True)
class LightSet:
    """Point lights.

    Attributes:
        name: what it is called.
        position_mm: (n, 3) world.
        rgb: (n, 3) what a perfect white diffuser at the origin, facing the light, would read
            because of this light alone; it falls off with the square of the distance from there.
        ambient_rgb: (3,) what a white diffuser reads from everywhere.
        camera_mm: (3,) from where textures in this light were photographed; None where it is not
            known.
    """

    name: str
    position_mm: np.ndarray
    rgb: np.ndarray
    ambient_rgb: np.ndarray
    camera_mm: np.ndarray | None = None


def stage_lights(
    rig: Rig, levels: np.ndarray, name: str, full: np.ndarray | None = None
) -> LightSet:
    """The stage's own lights as a light set, on a session's scale.

    A perfect white diffuser at the origin, facing +z, lit by `full` and gains of 1, reads 1.0.

    Args:
        rig: the lights.
        levels: (n,) drive levels, or (n, 3) coloured ones.
        name: of the set.
        full: (n,) levels of the session's `full` (formats.scale); every light at level 1 where
            absent.

    Raises:
        FormatError: no light of `full` before such a diffuser.
    """
    positions, weight, facing = _white(rig)
    whole = facing.sum() if full is None else facing @ np.asarray(full, float)
    if not whole > 0:
        raise FormatError(
            "full", found="no light in front", expected="light on a surface that faces +z"
        )
    level = np.asarray(levels, float)
    rgb = (level if level.ndim == 2 else level[:, None]) * rig.rgb_gains
    rgb = rgb * weight[:, None] / whole
    lit = rgb.max(axis=1) > 0
    return LightSet(name, positions[lit], rgb[lit], np.zeros(3))


def white_reading(rig: Rig, levels: np.ndarray) -> float:
    """What a perfect white diffuser at the origin, facing +z, reads under (n,) levels.

    1.0 is every light at level 1, all gains taken as 1.
    """
    _, _, facing = _white(rig)
    return float(facing @ np.asarray(levels, float) / facing.sum())


def _white(rig: Rig) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(n, 3) lights' positions; (n,) what a diffuser at the origin gets that faces them, or +z."""
    positions = rig.positions_mm
    distance = np.linalg.norm(positions, axis=1)
    weight = (float(np.median(distance)) / distance) ** 2
    return positions, weight, np.clip(positions[:, 2] / distance, 0, None) * weight


def write_lights(lights: LightSet, path: Path) -> Path:
    """Write a light set as JSON; returns `path`."""
    entries = [
        {"position_mm": p, "rgb": c}
        for p, c in zip(lights.position_mm.tolist(), lights.rgb.tolist(), strict=True)
    ]
    value = {
        "schema": SCHEMA,
        "name": lights.name,
        "lights": entries,
        "ambient_rgb": lights.ambient_rgb.tolist(),
    }
    if lights.camera_mm is not None:
        value["camera_mm"] = lights.camera_mm.tolist()
    return write_json(path, value)


def read_lights(path: Path) -> LightSet:
    """Read a light set; FormatError when malformed, negative or at the origin."""
    value = read_json(path, SCHEMA)
    entries = value.get("lights")
    if not isinstance(entries, list) or not all(isinstance(each, dict) for each in entries):
        raise FormatError(
            path,
            field="lights",
            found="none" if entries is None else "something else",
            expected="a list of lights, each an object with position_mm and rgb",
        )
    try:
        lights = LightSet(
            str(value.get("name", path.stem)),
            _threes([e["position_mm"] for e in entries], "position_mm"),
            _threes([e["rgb"] for e in entries], "rgb"),
            _threes([value.get("ambient_rgb", [0, 0, 0])], "ambient_rgb")[0],
        )
    except KeyError as error:
        raise FormatError(
            path,
            field="lights",
            found=f"no {error.args[0]}",
            expected="both position_mm and rgb",
        ) from None
    except ValueError as error:
        raise FormatError(
            path, found=str(error), expected="lights of position_mm and rgb"
        ) from None
    values = np.concatenate([lights.rgb.ravel(), lights.ambient_rgb])
    within = (np.abs(lights.position_mm) <= MOST).all() and (values <= MOST).all()
    if not within or not (values >= 0).all():
        expected = f"places within {MOST:g} mm, light of 0 to {MOST:g}"
        raise FormatError(path, field="lights", found="NaN or negative, or huge", expected=expected)
    if (np.linalg.norm(lights.position_mm, axis=1) < 1.0).any():
        raise FormatError(path, field="lights", found="a light at the origin", expected="mm away")
    if "camera_mm" not in value:
        return lights
    return dataclasses.replace(lights, camera_mm=_camera(value["camera_mm"], path))


def _is_three(value: Any) -> bool:
    plain = isinstance(value, list) and len(value) == 3
    return plain and all(type(c) in (int, float) for c in value)


def _threes(values: list[Any], name: str) -> np.ndarray:
    """(n, 3) of n lists of three numbers; ValueError where one is something else."""
    for index, value in enumerate(values):
        if not _is_three(value):
            raise ValueError(f"{name} {repr(value)[:60]} of entry {index}")
    return np.array(values, float).reshape(-1, 3)


def _camera(value: Any, path: Path) -> np.ndarray:
    if not _is_three(value) or not all(abs(c) <= MOST for c in value):
        raise FormatError(
            path, field="camera_mm", found=repr(value)[:60], expected="three numbers, mm"
        )
    return np.array(value, float)
