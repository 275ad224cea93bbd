"""Sessions with one fault each, made from a simulated person's photographs."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import cv2
import numpy as np

from benchmarks.check_faults import BINARY, POLARISED, Case, Stage
from lightstage.checks import Photo
from sim.camera.optics import defocus

DARK_FIRST = ("dark", *BINARY)
AMBIENT = 0.002
"""Room light that the photographs hold already."""
GAINS = (1.05, 1.1, 1.26, 2.0, 4.0)


def cases(stage: Stage, rng: np.random.Generator) -> Iterator[Case]:
    """Every fault in some sizes; cameras, patterns and lamps are drawn."""
    yield from _files(stage, rng)
    yield from _exposures(stage, rng)
    yield from _lights(stage, rng)
    yield from _room(stage, rng)
    yield from _pictures(stage, rng)
    if f"{stage.cameras[0]}|{POLARISED[0]}" in stage.light:
        yield from _banks(stage)


def _session(
    stage: Stage,
    name: str,
    size: str,
    changed: Callable[[str, str], Photo | None],
    culprits: list[tuple[str, str | None]],
    patterns: tuple[str, ...] = BINARY,
) -> Case:
    def make(camera: str, pattern: str) -> Photo:
        return changed(camera, pattern) or stage.photo(camera, pattern)

    return Case(name, size, make, frozenset(culprits), patterns)


def _draw(stage: Stage, rng: np.random.Generator, first: int = 1) -> tuple[str, int]:
    return str(rng.choice(stage.cameras)), int(rng.integers(first, len(BINARY)))


def _files(stage: Stage, rng: np.random.Generator) -> Iterator[Case]:
    """Pictures that are another shot's."""
    who, at = _draw(stage, rng)
    before, now = BINARY[at - 1], BINARY[at]

    def stale(camera: str, pattern: str) -> Photo | None:
        return stage.photo(who, before) if (camera, pattern) == (who, now) else None

    def late(camera: str, pattern: str) -> Photo | None:
        if (camera, pattern) != (who, now):
            return None
        return stage.expose(who, stage.see(who, before), seed=1)

    yield _session(stage, "stale", "one camera", stale, [(now, who)])
    yield _session(stage, "late-file", "one camera", late, [(now, who)])

    def other(camera: str, pattern: str) -> Photo | None:
        return stage.expose(camera, stage.see(camera, before), seed=1) if pattern == now else None

    yield _session(stage, "other pattern lit", "all cameras", other, [(now, None)])
    black = np.zeros_like(stage.see(who, "dark"))

    def unlit(camera: str, pattern: str) -> Photo | None:
        return stage.expose(camera, black, seed=1) if pattern == now else None

    yield _session(stage, "not lit", "all cameras", unlit, [(now, None), (now, who)])

    def capped(camera: str, pattern: str) -> Photo | None:
        return stage.expose(camera, black) if (camera, pattern) == (who, now) else None

    yield _session(stage, "no light", "one camera", capped, [(now, who)])


def _exposures(stage: Stage, rng: np.random.Generator) -> Iterator[Case]:
    """Settings that drift and stay so, from a drawn shot on, or for one shot."""
    for gain in (*GAINS, *(1 / g for g in GAINS)):
        who, at = _draw(stage, rng)

        def drifted(
            camera: str, pattern: str, who: str = who, at: int = at, gain: float = gain
        ) -> Photo | None:
            if camera != who or BINARY.index(pattern) < at:
                return None
            return stage.expose(camera, stage.see(camera, pattern), gain)

        named = [(pattern, who) for pattern in BINARY[at:]] + ([("full", who)] if at < 2 else [])
        yield _session(stage, "wrong-iso", f"x {gain:.2f}", drifted, list(named))
    for gain in (0.9, 0.95, 1.05, 1.1):
        _, at = _draw(stage, rng)
        lit = BINARY[at]

        def sagged(camera: str, pattern: str, lit: str = lit, gain: float = gain) -> Photo | None:
            if pattern != lit:
                return None
            return stage.expose(camera, stage.see(camera, pattern) * np.float32(gain))

        yield _session(stage, "light level", f"x {gain:.2f}", sagged, [(lit, None)])
    who = str(rng.choice(stage.cameras))
    for gain in (1.2, 1.5, 2.0):
        yield _whole(stage, "clipping", f"x {gain:g}", gain, who)
    for gain in (0.3, 0.1, 0.03):
        yield _whole(stage, "underexposure", f"x {gain:g}", gain, who)


def _whole(stage: Stage, name: str, size: str, gain: float, who: str) -> Case:
    """One camera set otherwise for the whole session."""

    def set_so(camera: str, pattern: str) -> Photo | None:
        return stage.expose(camera, stage.see(camera, pattern), gain) if camera == who else None

    return _session(stage, name, size, set_so, [(pattern, who) for pattern in BINARY])


def _lights(stage: Stage, rng: np.random.Generator) -> Iterator[Case]:
    """Lamps that do not do what the device reports."""
    for lamp in stage.lamps[:3]:
        number = int(lamp.split("-")[1])

        def stuck(
            camera: str, pattern: str, lamp: str = lamp, number: int = number
        ) -> Photo | None:
            if stage.levels(pattern)[number] > 0:
                return None
            return stage.expose(camera, stage.see(camera, pattern) + stage.see(camera, lamp))

        yield _session(stage, "stuck-on-hidden", "one lamp", stuck, [])
        yield _session(stage, "stuck-on-hidden, dark shot", "one lamp", stuck, [], DARK_FIRST)
        begin = int(rng.integers(1, 6))

        def dead(
            camera: str,
            pattern: str,
            lamp: str = lamp,
            number: int = number,
            begin: int = begin,
        ) -> Photo | None:
            if stage.levels(pattern)[number] == 0 or BINARY.index(pattern) < begin:
                return None
            left = stage.see(camera, pattern) - stage.see(camera, lamp)
            return stage.expose(camera, np.maximum(left, 0))

        yield _session(stage, "dead-light-hidden, during the session", "one lamp", dead, [])

        def never(
            camera: str, pattern: str, lamp: str = lamp, number: int = number
        ) -> Photo | None:
            if stage.levels(pattern)[number] == 0:
                return None
            left = stage.see(camera, pattern) - stage.see(camera, lamp)
            return stage.expose(camera, np.maximum(left, 0))

        yield _session(stage, "dead-light-hidden, from the start", "one lamp", never, [])


def _room(stage: Stage, rng: np.random.Generator) -> Iterator[Case]:
    """Room light, all the time or from a shot on."""
    for share in (0.005, 0.01, 0.02, 0.05, 0.1):
        times = np.float32(share / AMBIENT - 1)

        def bright(camera: str, pattern: str, times: np.float32 = times) -> Photo | None:
            more = stage.see(camera, "dark") * times
            return stage.expose(camera, stage.see(camera, pattern) + more)

        size = f"{100 * share:g} % of full"
        yield _session(stage, "ambient", size, bright, [])
        yield _session(stage, "ambient, dark shot", size, bright, [], DARK_FIRST)
        at = int(rng.integers(1, len(BINARY)))

        def once(
            camera: str, pattern: str, times: np.float32 = times, lit: str = BINARY[at]
        ) -> Photo | None:
            if pattern != lit:
                return None
            more = stage.see(camera, "dark") * times
            return stage.expose(camera, stage.see(camera, pattern) + more)

        yield _session(stage, "ambient in one shot", size, once, [(BINARY[at], None)])


def _pictures(stage: Stage, rng: np.random.Generator) -> Iterator[Case]:
    """Focus and motion."""
    for radius in (0.5, 1.0, 1.5, 2.0, 3.0):
        who, at = _draw(stage, rng, 0)
        now = BINARY[at]

        def blurred(
            camera: str, pattern: str, who: str = who, now: str = now, radius: float = radius
        ) -> Photo | None:
            if (camera, pattern) != (who, now):
                return None
            light = stage.see(camera, pattern)
            return stage.expose(camera, defocus(light, np.full(light.shape[:2], radius)))

        size = f"radius {radius:g} px"
        yield _session(stage, "defocus", size, blurred, [(now, who)])
    for shift in (0.5, 1.0, 2.0, 4.0, 8.0):
        who, at = _draw(stage, rng)
        now = BINARY[at]
        angle = rng.uniform(0, 2 * np.pi)
        matrix = np.array([[1, 0, shift * np.cos(angle)], [0, 1, shift * np.sin(angle)]])

        def moved(
            camera: str,
            pattern: str,
            who: str | None = None,
            now: str = now,
            matrix: np.ndarray = matrix,
        ) -> Photo | None:
            if pattern != now or (who is not None and camera != who):
                return None
            light = stage.see(camera, pattern)
            size = light.shape[1], light.shape[0]
            turned = cv2.warpAffine(light, matrix, size, flags=cv2.INTER_CUBIC)
            return stage.expose(camera, np.maximum(turned, 0))

        mm = shift * 1100 / stage.rig.camera(who).fx_px
        size = f"{mm:.1f} mm, {shift:g} px"
        yield _session(stage, "motion", size, moved, [(now, None)])

        def bumped(
            camera: str, pattern: str, who: str = who, same: Callable[..., Photo | None] = moved
        ) -> Photo | None:
            return same(camera, pattern, who=who)

        yield _session(stage, "camera moved", size, bumped, [(now, who)])


def _banks(stage: Stage) -> Iterator[Case]:
    """The two polarisation banks plugged in the other way round."""

    def turned(camera: str, pattern: str) -> Photo | None:
        base, _, kind = pattern.partition("@")
        other = "cross" if kind == "parallel" else "parallel"
        return stage.expose(camera, stage.see(camera, f"{base}@{other}"), seed=1)

    named: list[tuple[str, str | None]] = [(name, None) for name in POLARISED]
    yield _session(stage, "swapped-bank", "polarised", turned, named, POLARISED)

    def plain(camera: str, pattern: str) -> Photo | None:
        if pattern == "full":
            return None
        return stage.expose(camera, stage.see(camera, f"{pattern}~swap"))

    yield _session(stage, "swapped-bank", "no polarisers", plain, [])
