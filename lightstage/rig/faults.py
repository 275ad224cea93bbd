"""Faults that would make a well-formed rig unusable; one message for each that many lamps share."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from lightstage.counting import counted
from lightstage.errors import LightstageError, RigError
from lightstage.rig.stage import Light, Rig

BANKS = ("horizontal", "vertical")
COLOUR = re.compile(r"[a-z0-9-]{1,32}")
"""What emitters' colours are called: `--emitters` names them with commas between."""
LEAST_MM = 20.0
"""No head fits into a stage of a smaller radius: its positions are in another unit."""

ROTATION_OFF = 1e-4
"""By so much products of a rotation's rows may be off 0 and 1."""


def rig_faults(rig: Rig, where: str | Path) -> list[LightstageError]:
    """Every fault that would make a well-formed rig unusable, not the first alone."""
    problems: list[LightstageError] = []

    def fault(field: str, found: str, expected: str, hint: str = "") -> None:
        problems.append(RigError(where, field=field, found=found, expected=expected, hint=hint))

    seen: dict[int, str] = {}
    radius = float(np.median(np.linalg.norm(rig.positions_mm, axis=1))) if rig.lights else LEAST_MM
    if radius < LEAST_MM:
        fault(
            "lights",
            f"a stage of {radius:.3g} mm radius",
            f"one of at least {LEAST_MM:g} mm: positions are in mm",
            "Are they metres? Then multiply them, and the cameras' translations, by 1000.",
        )
        return problems
    for light in rig.lights:
        field = f"lamp {light.id} ({light.name})"
        if light.id in seen:
            fault(field, f"an id that {seen[light.id]} has too", "an id of its own")
        seen[light.id] = light.name
        distance = float(np.linalg.norm(light.position_mm))
        if distance < 1.0:
            fault(
                f"{field}.position_mm",
                f"{distance:.3g} mm from the origin",
                "a lamp on the sphere",
                "Positions are in mm, the origin is the sphere's centre; is it metres?",
            )
        if light.bank is not None and light.bank not in BANKS:
            fault(
                f"{field}.bank",
                repr(light.bank),
                " or ".join(BANKS),
                "Leave it out where the lamp has no polariser.",
            )
        if light.colour is not None and not COLOUR.fullmatch(light.colour):
            fault(
                f"{field}.colour",
                repr(light.colour),
                "small letters, digits and -",
                "It is the name of an emitter's colour, such as red or warm.",
            )
        if min(light.rgb_gain) < 0:
            fault(f"{field}.rgb_gain", str(light.rgb_gain), "three numbers of at least 0")
    problems += _wiring_faults(rig, where)
    names: set[str] = set()
    for camera in rig.cameras:
        field = f"camera {camera.id}"
        if camera.id in names:
            fault(field, "the same id twice", "an id of its own")
        names.add(camera.id)
        for name, focal in (("fx_px", camera.fx_px), ("fy_px", camera.fy_px)):
            if not focal > 0:
                fault(f"{field}.{name}", f"{focal:g}", "a focal length in pixels, above 0")
        if wrong := _no_rotation(camera.cam_from_world[:, :3]):
            found, hint = wrong
            fault(
                f"{field}.cam_from_world",
                f"no rotation: {found}",
                "a right-handed orthonormal 3 x 3 and a translation in mm",
                hint,
            )
    return problems


def _no_rotation(matrix: np.ndarray) -> tuple[str, str] | None:
    """Why a 3 x 3 is no rotation, and what to try; None where it is one."""
    lengths = np.linalg.norm(matrix, axis=1)
    off = float(np.abs(matrix @ matrix.T - np.eye(3)).max())
    if off > ROTATION_OFF:
        rounded = "Give its numbers with six decimals." if off < 100 * ROTATION_OFF else ""
        if np.abs(lengths - 1).max() > ROTATION_OFF:
            found = f"its rows have lengths of {lengths.min():.6g} to {lengths.max():.6g}"
            return found, rounded or "Divide a scale out of it: it belongs to the world's unit, mm."
        return f"its rows are not at right angles, by {off:.2g}", rounded
    if np.linalg.det(matrix) < 0:
        return "it mirrors", "World and camera are right-handed: x right, y down, z ahead."
    return None


def _wiring_faults(rig: Rig, where: str | Path) -> list[LightstageError]:
    """Lamps that no wire, or another lamp's wire, would light."""
    without = [light for light in rig.lights if light.address is None]
    if not rig.addressed:
        return []
    if without:
        return [
            RigError(
                where,
                field=f"lamp {without[0].id} ({without[0].name}).address",
                found=f"none; {len(without)} of {counted(len(rig.lights), 'lamp')} have none",
                expected="an address of each lamp, or of no lamp",
                hint="Without any, a lamp's channel is its place in the list, counted from 0.",
            )
        ]
    owner: dict[tuple[str, int], Light] = {}
    problems: list[LightstageError] = []
    for light, address in zip(rig.lights, rig.addresses, strict=True):
        other = owner.setdefault((address.controller, address.channel), light)
        if other is not light:
            problems.append(
                RigError(
                    where,
                    field=f"lamp {light.id} ({light.name}).address",
                    found=f"channel {address.channel}, which lamp {other.id} ({other.name}) has",
                    expected="a channel of its own",
                )
            )
    return problems


def folded(problems: list[LightstageError]) -> list[LightstageError]:
    """One error for a mistake that many lights or cameras share; it names the first of them."""
    alike: dict[tuple[str, ...], list[LightstageError]] = {}
    for problem in problems:
        kind, _, rest = problem.field.partition("[" if "[" in problem.field else " ")
        item, dot, part = rest.rpartition(".")
        # A light's name may hold dots: only what follows its bracket is the field.
        key = (
            kind,
            part if dot and item.endswith(("]", ")")) else "",
            problem.expected,
            problem.hint,
        )
        alike.setdefault(key, []).append(problem)
    return [
        each[0]
        if len(each) == 1
        else RigError(
            each[0].where,
            field=f"{each[0].field} and {len(each) - 1} more",
            found=each[0].found,
            expected=each[0].expected,
            hint=each[0].hint,
        )
        for each in alike.values()
    ]
