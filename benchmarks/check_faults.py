"""Simulated sessions and what can go wrong in them, for judging the checks of a capture."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from lightstage.checks import ChecksConfig, Photo, ShotChecks
from lightstage.checks.photo_measures import BAYER, measure_counts
from lightstage.findings import Finding
from lightstage.patterns import pattern_levels
from lightstage.rig import Rig
from lightstage.sequence import Shot
from sim.camera.flaws import PRESETS
from sim.camera.optics import own_rng
from sim.camera.room import even_levels
from sim.camera.sensor import SensorConfig, make_sensor
from sim.camera.shooting import Shooting
from sim.head.modes import EXPRESSIONS
from sim.light.lamps import lamps_of
from sim.light.polarised import behind_polarisers
from sim.light.world import World
from sim.people.person import parametric_subject
from sim.people.traits import Traits

BINARY = ("full", "x+", "x-", "y+", "y-", "z+", "z-")
POLARISED = ("full@parallel", "full@cross", "x+@parallel", "x+@cross")
LAMPS = 6
Make = Callable[[str, str], Photo]


@dataclasses.dataclass(frozen=True)
class Case:
    """A session with one fault.

    Attributes:
        name: of the fault.
        size: of it, with unit.
        make: (camera, pattern) to what the camera delivers.
        culprits: (pattern, camera) of findings that name it; None in the second place is the
            light. Empty: nothing can be named.
        patterns: of the session, in order.
    """

    name: str
    size: str
    make: Make
    culprits: frozenset[tuple[str, str | None]]
    patterns: tuple[str, ...]


class Stage:
    """One person's photographs, before the sensor, with the flaws of a good laboratory.

    Attributes:
        rig: whose cameras took them.
        light: "CAMERA|PATTERN" to (h, w, 3) half floats. Patterns are `BINARY`, dark, single
            lamps as olat-NNN, the polarised ones, and NAME~swap where the banks are swapped.
        drive: (n,) level at which each lamp is driven when it is on.
        seed: of person, lenses, sensors and noise.
    """

    def __init__(
        self,
        rig: Rig,
        light: Mapping[str, np.ndarray],
        drive: np.ndarray,
        peak: np.ndarray,
        seed: int,
    ) -> None:
        self.rig, self.light, self.drive, self.seed = rig, light, drive, seed
        self.peak = peak
        self.cameras = [camera.id for camera in rig.cameras]
        self.sensors = {
            camera: make_sensor(SensorConfig(iso=200), peak, own_rng(seed, camera, b"sensor"))
            for camera in self.cameras
        }
        self.lamps = sorted({key.split("|")[1] for key in light if "|olat-" in key})
        self._kept: dict[tuple[str, str], Photo] = {}

    def levels(self, pattern: str) -> np.ndarray:
        """(n,) what is driven."""
        return pattern_levels(pattern, self.rig) * self.drive

    def see(self, camera: str, pattern: str) -> np.ndarray:
        """(h, w, 3) light of a photograph."""
        return self.light[f"{camera}|{pattern}"].astype(np.float32)

    def expose(self, camera: str, light: np.ndarray, gain: float = 1.0, seed: int = 0) -> Photo:
        """What the camera delivers of this light, measured."""
        sensor = self.sensors[camera].exposed(gain)
        key = [self.seed, self.cameras.index(camera), seed, int(1e3 * float(light.mean()))]
        counts = sensor.expose(light, np.random.default_rng(key))
        size = counts.shape[1], counts.shape[0]
        black, white = float(sensor.config.black_dn), float(sensor.config.white_dn)
        place = Path(camera)
        return measure_counts(counts, BAYER, black, white, size, "raw", place, 192, white - black)

    def photo(self, camera: str, pattern: str) -> Photo:
        """The photograph as it should be."""
        key = camera, pattern
        if key not in self._kept:
            self._kept[key] = self.expose(camera, self.see(*key))
        return self._kept[key]

    def checks(self, patterns: Sequence[str], config: ChecksConfig | None = None) -> ShotChecks:
        """The checks of a session of these patterns."""
        shots = [Shot(name, self.levels(name)) for name in patterns]
        return ShotChecks(self.rig, shots, config)

    def found(self, patterns: Sequence[str], make: Make) -> list[Finding]:
        """All findings of a session, as its shots come in."""
        checks = self.checks(patterns)
        out: list[Finding] = []
        for pattern in patterns:
            for camera in self.cameras:
                out += checks.add(pattern, camera, make(camera, pattern))
            out += checks.shot(pattern)
        return out


def simulate(
    seed: int, rig: Rig, *, sway: float = 1.0, extras: bool = True, texture_rows: int = 768
) -> Stage:
    """Photograph a parametric person: tones, expressions and drives take turns with the seed.

    Args:
        seed: of everything.
        rig: small cameras.
        sway: times that of the set `lab`.
        extras: single lamps, polarised and swapped patterns too.
        texture_rows: of the person.
    """
    flaws = PRESETS["lab"]
    swayed = dataclasses.replace(
        flaws.sway, sway_mm=flaws.sway.sway_mm * sway, sway_deg=flaws.sway.sway_deg * sway
    )
    flaws = dataclasses.replace(flaws, sway=swayed)
    rng = np.random.default_rng([seed, 5])
    sex = ("female", "male")[seed // 6 % 2]
    traits = Traits(sex=sex, age_years=float(rng.uniform(18, 75)), tone=1 + seed % 6)
    faces = ["neutral", *EXPRESSIONS]
    person = parametric_subject(f"p{seed}", seed, faces[seed % len(faces)], texture_rows, traits)
    lamps = lamps_of(rig, flaws.lamps, seed)
    count = len(rig.lights)
    # Even light, as by the solid angle that a lamp represents, in every other session.
    even = even_levels(lamps_of(rig))
    drive = np.ones(count) if seed % 2 else even / even.max()
    world = World(person, rig, lamps=lamps)
    light: dict[str, np.ndarray] = {}
    shooting = Shooting(world, flaws, seed)
    for shot, name in enumerate((*BINARY, "dark")):
        own = pattern_levels(name, rig) * drive
        states = {name: own}
        if extras and name not in ("full", "dark"):
            states[f"{name}~swap"] = pattern_levels(name, rig)[_swapped(rig)] * drive
        _photograph(light, shooting, rig, states, shot)
    if extras:
        chosen = rng.choice(count, LAMPS, replace=False)
        single = {f"olat-{k:03d}": drive[k] * np.eye(count)[k] for k in chosen}
        _photograph(light, shooting, rig, single, 0)
        filtered = Shooting(behind_polarisers(world), flaws, seed)
        banks = {name: pattern_levels(name, rig) * drive for name in POLARISED}
        _photograph(light, filtered, rig, banks, 0)
    return Stage(rig, light, drive, world.skin_peak(), seed)


def _photograph(
    light: dict[str, np.ndarray],
    shooting: Shooting,
    rig: Rig,
    states: Mapping[str, np.ndarray],
    shot: int,
) -> None:
    levels = np.stack(list(states.values()))
    for camera in rig.cameras:
        seen = shooting.light(camera.id, levels, [shot] * len(levels), None)
        for name, picture in zip(states, seen, strict=True):
            light[f"{camera.id}|{name}"] = picture.astype(np.float16)


def _swapped(rig: Rig) -> np.ndarray:
    """(n,) each lamp's partner in the other bank."""
    banks = np.array([light.bank for light in rig.lights])
    out = np.arange(len(banks))
    across, up = np.flatnonzero(banks == "horizontal"), np.flatnonzero(banks == "vertical")
    out[across], out[up] = up, across
    return out
