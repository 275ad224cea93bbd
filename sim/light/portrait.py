"""One picture of one person under a pattern of the stage or under an environment."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from lightstage.commands import ProgressCallback, quiet
from lightstage.errors import PatternError
from lightstage.patterns import pattern_levels
from lightstage.rig import Rig
from sim.errors import SimError
from sim.light.lamps import Lamps, lamps_of
from sim.light.polarised import PolarisedWorld, is_polarised
from sim.light.relight import (
    SAMPLES,
    RelightConfig,
    auto_exposure,
    environment_lights,
    environment_names,
    is_environment,
    relit,
    require_picture,
    write_picture,
)
from sim.light.scene import Scene
from sim.light.world import World
from sim.people.subject import Subject


def portrait(
    subject: Subject,
    rig: Rig,
    camera_id: str,
    light: str,
    config: RelightConfig | None = None,
    seed: int = 0,
    progress: ProgressCallback = quiet,
    *,
    reference: bool = False,
) -> np.ndarray:
    """A person's picture.

    Args:
        subject: the person.
        rig: lamps and cameras.
        camera_id: the view.
        light: a pattern's name, or an environment's (`sim.light.relight.environment_lights`).
        config: of an environment.
        seed: of the street's houses.
        progress: of lights; the reference reports none.
        reference: path-traced, with bounces and subsurface scattering, in place of the fast path.

    Returns:
        (h, w, 3) float32, linear, on the session's scale: a white diffuser at the origin reads 1
        under `full`, or under an environment whose radiance is 1 everywhere.

    Raises:
        SimError, RigError: an unknown light or camera, or a file that cannot be used.
    """
    camera = rig.camera(camera_id)
    alone = dataclasses.replace(rig, cameras=(camera,))
    if is_environment(light):
        lights = environment_lights(light, config, seed)
        if not reference:
            return relit(Scene(subject), camera, lights, progress)
        places = lights.position_mm
        toward = -places / np.linalg.norm(places, axis=1, keepdims=True)
        levels = np.ones((1, len(places)))
        lamps = Lamps(places, lights.rgb, toward, exponent=0.0, radius_mm=0.0)
    else:
        levels, lamps = _levels(light, rig)[None], lamps_of(rig)
    if not reference:
        world = World(subject, alone, samples=SAMPLES)
        seen = PolarisedWorld(world) if is_polarised(light) else world
        return seen.photograph(camera_id, levels)[0]
    if not is_environment(light) and is_polarised(light):
        raise SimError(
            f"light {light!r}",
            found="a polarised pattern",
            expected="a plain one with --reference",
            hint="Polarised light is the fast path's; its own reference is in the benchmarks.",
        )
    from sim.reference.world import ReferenceWorld

    return ReferenceWorld(subject, alone, lamps).photograph(camera_id, levels)[0]


def require_light(light: str, rig: Rig) -> None:
    """SimError where a light is neither a pattern of this rig nor named as an environment is."""
    if not is_environment(light):
        _levels(light, rig)


def _levels(light: str, rig: Rig) -> np.ndarray:
    """(m,) levels of a pattern; SimError names environments beside patterns."""
    try:
        return pattern_levels(light, rig)
    except PatternError as error:
        raise SimError(
            f"light {light!r}",
            found=error.found,
            expected=f"{error.expected}; or {', '.join(environment_names())}, or a file "
            ".exr, .hdr, .json",
        ) from None


def write_portrait(picture: np.ndarray, out: Path, exposure_stops: float | None) -> float:
    """Write a portrait as .png or .exr.

    Args:
        picture: (h, w, 3) linear.
        out: .exr holds it as it is; .png is exposed and encoded.
        exposure_stops: of a .png, 0 as it is; None makes the bright skin nearly white.

    Returns:
        The factor that a .png was multiplied by, 1 of an .exr.
    """
    require_picture(out)
    if out.suffix.lower() == ".exr":
        exposure = 1.0
    else:
        exposure = auto_exposure(picture) if exposure_stops is None else 2.0**exposure_stops
    write_picture(picture, out, exposure)
    return exposure
