"""What `domain-light` does: read textures, find the light in all of them, write it; the facts."""

from __future__ import annotations

import dataclasses
import time
from pathlib import Path
from typing import Any

import numpy as np

from learning.checkpoint import whole_face_of
from learning.domain.closed import find_light
from learning.domain.config import DomainConfig
from learning.domain.descent import descend
from learning.domain.sample import Sample, sample_of
from learning.errors import MapsError
from learning.limits import configured, require_within
from learning.networks.whole_face import WholeFaceNetwork
from learning.render.environments import TargetLight
from learning.whole.refine import CAMERA_MM
from lightstage.commands import ProgressCallback
from lightstage.counting import counted
from lightstage.formats.environment import LightSet, read_lights, write_lights
from lightstage.formats.exr import read_exr
from lightstage.formats.mesh import Mesh, read_mesh
from lightstage.formats.processed import read_map

TEXTURE, MESH, CONFIDENCE = "texture.exr", "registered_mesh.obj", "atlas/confidence.exr"
"""In a fit's folder."""
FEW = 4
"""Textures below which a note states that the people's tone is not averaged out."""


@dataclasses.dataclass(frozen=True)
class Place:
    """The files of a texture: itself, its mesh, and its confidence, 0 where it was filled."""

    texture: Path
    mesh: Path
    confidence: Path | None


def domain_light(
    textures: list[Path],
    out: Path,
    mesh: Path | None,
    checkpoint: Path | None,
    config: Path | None,
    seconds: float | None,
    steps: int | None,
    progress: ProgressCallback,
) -> dict[str, Any]:
    """Find the light that textures of one source have in common; returns the facts.

    Args:
        textures: fits' folders, textures, or folders of either.
        out: light to write, .json.
        mesh: of all textures, where they are no fits.
        checkpoint: a run of a whole-face network; the shipped weights where None.
        config: TOML over the defaults.
        seconds: see `DomainConfig`; the configuration's where None.
        steps: the same.
        progress: called with steps done and their number.

    Raises:
        LightstageError: bad input; nothing is written then.
    """
    began = time.monotonic()
    options = {"seconds": ("--seconds", seconds), "steps": ("--steps", steps)}
    settings = configured(DomainConfig, config, options, "domain")
    network = whole_face_of(checkpoint)
    found = places_of(textures, mesh)
    chosen = [found[i] for i in _evenly(len(found), settings.textures)]
    whole = len(chosen) + settings.rounds + settings.steps
    samples: list[Sample] = []
    for place in chosen:
        samples.append(_read(place, network))
        progress(len(samples), whole)
    closed = find_light(
        samples,
        network,
        CAMERA_MM,
        settings.seconds,
        settings.rounds,
        lambda done, _: progress(len(chosen) + done, whole),
    ).light
    lit = closed.rgb[:-1].max(axis=1) > 0
    if not lit.any():
        raise MapsError(
            textures[0],
            field="light",
            found="no lamp, only light from everywhere",
            expected="textures that a lamp lights",
            hint=f"Are they unlit already? Or were {settings.seconds:g} s too few? Give more by "
            "--seconds.",
        )
    begin = LightSet("domain", np.array(closed.lamps_mm)[lit], closed.rgb[:-1][lit], closed.rgb[-1])
    refined = descend(
        samples,
        begin,
        CAMERA_MM,
        settings.steps,
        settings.rate,
        settings.shadow_steps,
        lambda done, _: progress(len(chosen) + settings.rounds + done, whole),
    )
    write_lights(dataclasses.replace(refined.light, camera_mm=refined.camera_mm), out)
    progress(whole, whole)
    notes = []
    if len(samples) < FEW:
        notes.append(
            f"{counted(len(samples), 'texture')}: what the network gets wrong of a person's tone "
            f"is in the light's strength; {FEW} and more average it out"
        )
    if len(chosen) < len(found):
        notes.append(f"{len(chosen)} of {len(found)} textures were used, evenly among them")
    return {
        "textures": len(samples),
        "lamps": len(refined.light.rgb),
        "position_mm": refined.light.position_mm.tolist(),
        "rgb": refined.light.rgb.tolist(),
        "ambient_rgb": refined.light.ambient_rgb.tolist(),
        "camera_mm": refined.camera_mm.tolist(),
        "difference_before": refined.before,
        "difference_after": refined.after,
        "notes": notes,
        "seconds": time.monotonic() - began,
    }


def read_target_light(path: Path) -> TargetLight:
    """Read a light set as the target of a training; its camera is in front where it has none.

    Raises:
        FormatError: see `read_lights`.
        ConfigError: no lamp, or numbers that no training takes.
    """
    lights = read_lights(path)
    camera = CAMERA_MM if lights.camera_mm is None else lights.camera_mm

    def three(row: Any) -> tuple[float, float, float]:
        return float(row[0]), float(row[1]), float(row[2])

    target = TargetLight(
        tuple(three(row) for row in lights.position_mm),
        tuple(three(row) for row in lights.rgb),
        three(lights.ambient_rgb),
        three(camera),
    )
    require_within(target, path, "lights.target")
    return target


def places_of(textures: list[Path], mesh: Path | None) -> list[Place]:
    """The textures that are meant, each with its mesh.

    Raises:
        MapsError: no texture, or one without a mesh.
    """
    found: list[Place] = []
    for path in textures:
        if path.is_file():
            found.append(_place(path, mesh))
        elif (path / TEXTURE).is_file():
            found.append(_place(path / TEXTURE, mesh))
        elif path.is_dir():
            inside = sorted(path.glob(f"*/{TEXTURE}")) + sorted(path.glob("*.exr"))
            if not inside:
                raise MapsError(
                    path,
                    found="no texture",
                    expected=f"folders with {TEXTURE}, as `fit` writes them, or .exr files",
                )
            found += [_place(each, mesh) for each in inside]
        else:
            raise MapsError(path, found="no such file", expected="a texture, or a fit's folder")
    return found


def _place(texture: Path, mesh: Path | None) -> Place:
    own = texture.parent / MESH
    confidence = texture.parent / CONFIDENCE
    if mesh is None and not own.is_file():
        raise MapsError(
            texture,
            field="mesh",
            found=f"no {MESH} beside it",
            expected="the mesh whose UV the texture has",
            hint="Name one mesh for all textures by --mesh.",
        )
    beside = confidence if mesh is None and confidence.is_file() else None
    return Place(texture, own if mesh is None else mesh, beside)


def _read(place: Place, network: WholeFaceNetwork) -> Sample:
    """A texture as the search takes it: of a fit, what its photographs show."""
    texture = read_exr(place.texture, finite=True)
    if texture.ndim != 3:
        raise MapsError(place.texture, found="one channel", expected="R G B")
    shape: Mesh = read_mesh(place.mesh)
    if shape.uvs is None:
        raise MapsError(place.mesh, field="uv", found="none", expected="the texture's coordinates")
    known = None
    if place.confidence is not None:
        known = read_map(place.confidence, "confidence")
        if known.shape[:2] != texture.shape[:2]:
            raise MapsError(
                place.confidence,
                found=f"{known.shape[0]} x {known.shape[1]} texels",
                expected=f"{texture.shape[0]} x {texture.shape[1]}, as {place.texture.name}",
            )
        known = known.reshape(texture.shape[:2]) > 0
    return sample_of(network, texture, shape, (place.texture, place.mesh), known)


def _evenly(count: int, most: int) -> list[int]:
    """At most `most` of `count` numbers, evenly."""
    return np.unique(np.round(np.linspace(0, count - 1, min(count, most))).astype(int)).tolist()
