"""What is odd about a rig that can be read: legal, but seldom what was meant."""

from __future__ import annotations

from collections import Counter

import numpy as np

from lightstage.findings import Finding
from lightstage.rig import Camera, Rig

USUAL_RADIUS_MM = (250.0, 10_000.0)
"""Stages around a head, or around a person, have such radii."""
RADIUS_SPREAD = 0.1
"""Share of the median distance by which a lamp may be nearer or farther."""
CLOSE_SHARE = 0.1
"""Share of the median distance to the nearest neighbour: nearer lamps are in one place."""
ONE_SIDED = 0.5
"""Length of the lights' mean direction above which they do not stand all around."""
GAIN_RATIO = 3.0
"""Gains this far from the median's are odd."""
BANK_SHARE = 0.1
CENTRE_SHARE = 0.15
"""Share of the picture's side by which the principal point may be off the middle."""
FOCAL_RATIO = 1.02
SHORTEST, LONGEST = 0.3, 12.0
"""Focal lengths of usual lenses, by the longer side of the picture."""
FRONT_DEG = 60.0
"""Some camera is within this angle of +z, which is before the face."""
NAMED = 5


def rig_oddities(rig: Rig) -> list[Finding]:
    """What is odd, as warnings; where it is a matter of one camera that is named.

    Args:
        rig: that was read and refused nothing.
    """
    return [*_of_lights(rig), *_of_cameras(rig)]


def odd_lights(rig: Rig) -> np.ndarray:
    """(n,) bool, lights that stand at another distance than most, or in another's place."""
    return np.asarray(_far(rig) | _close(rig))


def _far(rig: Rig) -> np.ndarray:
    """(n,) bool, at another distance from the origin than most."""
    distance = np.linalg.norm(rig.positions_mm, axis=1)
    middle = np.median(distance)
    return np.asarray(np.abs(distance - middle) > RADIUS_SPREAD * middle)


def _close(rig: Rig) -> np.ndarray:
    """(n,) bool, in the place of another light of its colour; two lights alone are never."""
    apart = _apart(rig)
    return np.asarray((apart < CLOSE_SHARE * np.median(apart)) & (len(apart) > 2))


def _apart(rig: Rig) -> np.ndarray:
    """(n,) distance of each light to the nearest of its colour, mm."""
    apart = np.empty(len(rig.lights))
    for which in rig.colours.values():
        apart[which] = _nearest(rig.positions_mm[which])
    return apart


def _nearest(places: np.ndarray) -> np.ndarray:
    """(n,) distance of each of (n, 3) places to its nearest neighbour, mm."""
    apart = np.linalg.norm(places[:, None] - places[None], axis=2)
    np.fill_diagonal(apart, np.inf)
    return np.asarray(apart.min(axis=1))


def _warn(code: str, where: str, found: str, expected: str, hint: str = "") -> Finding:
    return Finding("warn", code, where, found, expected, hint)


def _named(rig: Rig, which: np.ndarray) -> str:
    """Some lights by their names."""
    names = [rig.lights[i].name for i in np.flatnonzero(which)]
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return ", ".join(names[:NAMED]) + more


def _of_lights(rig: Rig) -> list[Finding]:
    found: list[Finding] = []
    distance = np.linalg.norm(rig.positions_mm, axis=1)
    radius = float(np.median(distance))
    if not USUAL_RADIUS_MM[0] <= radius <= USUAL_RADIUS_MM[1]:
        found.append(
            _warn(
                "radius",
                "lights",
                f"a stage of {radius:.4g} mm radius",
                f"{USUAL_RADIUS_MM[0]:g} to {USUAL_RADIUS_MM[1]:g} mm",
                "Positions are in mm; were they in cm or inches?",
            )
        )
    far = _far(rig)
    if far.any():
        found.append(
            _warn(
                "distance",
                _named(rig, far),
                f"{distance[far].min():.4g} to {distance[far].max():.4g} mm from the origin",
                f"about {radius:.4g} mm, as most lamps",
                "The origin is the sphere's centre.",
            )
        )
    close = _close(rig)
    if close.any():
        apart = _apart(rig)
        found.append(
            _warn(
                "close",
                _named(rig, close),
                f"{apart[close].min():.3g} mm from another lamp",
                f"about {np.median(apart):.3g} mm, as most",
                "Is one lamp in the file twice? Emitters of several colours in one place need a "
                "`colour` each.",
            )
        )
    mean = (rig.positions_mm / distance[:, None]).mean(axis=0)
    if np.linalg.norm(mean) > ONE_SIDED:
        axis = int(np.abs(mean).argmax())
        side = f"{'+' if mean[axis] > 0 else '-'}{'xyz'[axis]}"
        found.append(
            _warn(
                "one-sided",
                "lights",
                f"most of them toward {side}",
                "lamps all around the face",
                "Gradients then show little of surfaces that face away from them.",
            )
        )
    found += _of_banks(rig)
    gains = rig.rgb_gains.mean(axis=1)
    usual_of = np.empty(len(gains))
    for which in rig.colours.values():
        usual_of[which] = np.median(gains[which])
    odd = (gains > GAIN_RATIO * usual_of) | (gains < usual_of / GAIN_RATIO)
    if odd.any():
        usual = float(np.median(usual_of[odd]))
        found.append(
            _warn(
                "gain",
                _named(rig, odd),
                f"rgb_gain of {gains[odd].min():.3g} to {gains[odd].max():.3g}",
                f"about {usual:.3g}, as most",
                "A lamp of gain 0 is taken for one that is broken.",
            )
        )
    twice = [name for name, n in Counter(light.name for light in rig.lights).items() if n > 1]
    if twice:
        found.append(_warn("name", ", ".join(twice[:NAMED]), "a name of several lamps", "one each"))
    return found


def _of_banks(rig: Rig) -> list[Finding]:
    banks = Counter(light.bank for light in rig.lights)
    if set(banks) == {None}:
        return []
    total = len(rig.lights)
    uneven = abs(banks["horizontal"] - banks["vertical"]) > BANK_SHARE * total
    if not uneven and not banks[None]:
        return []
    counts = ", ".join(f"{n} {bank or 'without'}" for bank, n in banks.most_common())
    return [_warn("bank", "lights, bank", counts, "as many horizontal as vertical, or none")]


def _of_cameras(rig: Rig) -> list[Finding]:
    found: list[Finding] = []
    centres = np.stack([camera.centre_mm for camera in rig.cameras])
    radius = float(np.median(np.linalg.norm(rig.positions_mm, axis=1)))
    for camera, centre in zip(rig.cameras, centres, strict=True):
        found += _of_camera(camera, centre, radius)
    if len(centres) > 1:
        for i in np.flatnonzero(_nearest(centres) < 0.01 * radius):
            found.append(
                _warn(
                    "same-place",
                    f"camera {rig.cameras[i].id}",
                    "the place of another camera",
                    "one of its own",
                )
            )
    serials = Counter(camera.serial for camera in rig.cameras if camera.serial)
    for serial in [serial for serial, n in serials.items() if n > 1]:
        which = ", ".join(c.id for c in rig.cameras if c.serial == serial)
        found.append(_warn("serial", f"cameras {which}", f"one serial, {serial}", "one each"))
    toward = centres / np.maximum(np.linalg.norm(centres, axis=1, keepdims=True), 1e-9)
    if toward[:, 2].max() < np.cos(np.radians(FRONT_DEG)):
        found.append(
            _warn(
                "front",
                "cameras",
                "none before the face (+z)",
                f"one within {FRONT_DEG:g} degrees of +z",
                "+y is up and +z points from the face to the frontal camera.",
            )
        )
    return found


def _of_camera(camera: Camera, centre: np.ndarray, radius: float) -> list[Finding]:
    where = f"camera {camera.id}"
    found: list[Finding] = []
    distance = float(np.linalg.norm(centre))
    if not 0.1 * radius <= distance <= 3 * radius:
        found.append(
            _warn(
                "distance",
                where,
                f"{distance:.4g} mm from the origin",
                f"about the lamps' {radius:.4g} mm",
                "Is its translation in mm? It is that of cam_from_world, not the camera's place.",
            )
        )
    pixel, _ = camera.project(np.zeros((1, 3)))
    x, y = pixel[0]
    if not (0 <= x <= camera.width_px and 0 <= y <= camera.height_px):
        seen = "behind it" if np.isnan(x) else f"at ({x:.0f}, {y:.0f}) px"
        found.append(
            _warn(
                "aim",
                where,
                f"the origin {seen}",
                f"it within {camera.width_px} x {camera.height_px} pixels",
                "cam_from_world takes world to camera, in OpenCV's axes: x right, y down, z ahead.",
            )
        )
    elif camera.cam_from_world[1, 1] > 0:
        found.append(
            _warn(
                "roll",
                where,
                "a picture that is upside down",
                "+y of the world up in it",
                "OpenCV's y points down.",
            )
        )
    off_x = abs(camera.cx_px / camera.width_px - 0.5)
    off_y = abs(camera.cy_px / camera.height_px - 0.5)
    if max(off_x, off_y) > CENTRE_SHARE:
        found.append(
            _warn(
                "centre",
                where,
                f"principal point ({camera.cx_px:.0f}, {camera.cy_px:.0f}) px",
                f"near the middle of {camera.width_px} x {camera.height_px}",
                "Were width and height swapped?",
            )
        )
    side = max(camera.width_px, camera.height_px)
    if not SHORTEST <= camera.fx_px / side <= LONGEST:
        found.append(
            _warn(
                "focal-length",
                where,
                f"fx_px {camera.fx_px:.4g}",
                f"{SHORTEST * side:.4g} to {LONGEST * side:.4g}, as of lenses for {side} px",
                "Focal lengths are in pixels; is it in mm? Then divide it by the width of a pixel.",
            )
        )
    ratio = max(camera.fx_px, camera.fy_px) / min(camera.fx_px, camera.fy_px)
    if ratio > FOCAL_RATIO:
        found.append(
            _warn("focal", where, f"fx and fy apart by {100 * (ratio - 1):.0f} %", "square pixels")
        )
    return found
