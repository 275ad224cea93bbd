"""A lab's photographs of a mirror ball to a rig whose lights have their addresses."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from lightstage.commands import ProgressCallback, quiet
from lightstage.counting import counted
from lightstage.rig import Light, Rig
from processing.calibration.ball import Steps, ball_shots
from processing.calibration.folder import Pose, Source
from processing.calibration.lights.config import MirrorBallConfig
from processing.calibration.lights.mirror_ball import Seen
from processing.calibration.lights.mirror_shots import see_highlights, single_lights
from processing.calibration.lights.wiring import Wiring, find_wiring
from processing.errors import ProcessingError

SHOWN = 10
"""Wires that a message names; it counts the others."""
NAMED = 4


@dataclasses.dataclass(frozen=True)
class Located:
    """What was found.

    Attributes:
        rig: with an address of each light.
        sure: how many lights were found.
        moved: how many have another channel than before.
        unsure: what is not sure of the others, in words.
        worst_mm: the farthest that a light's highlights are off on the ball.
    """

    rig: Rig
    sure: int
    moved: int
    unsure: list[str]
    worst_mm: float


def locate_lights(
    source: Source,
    rig: Rig | None,
    config: MirrorBallConfig,
    allow_unsure: bool = False,
    progress: ProgressCallback = quiet,
) -> Located:
    """Find which lamp each wire lights.

    Args:
        source: with shots of a mirror ball, lamp after lamp.
        rig: whose addresses are wanted; None: the shots' own.
        config: the ball.
        allow_unsure: whether wires that are not sure go to the lamps that are left, in order.
        progress: of the photographs.

    Raises:
        ProcessingError: no such shots, another rig's; wires that are not sure, all in one message.
    """
    poses = source.poses.get("mirror", [])
    if not poses:
        raise ProcessingError(
            source.root,
            found=f"shots of {', '.join(source.poses)}",
            expected="shots of a mirror ball, lamp after lamp",
            hint="Take them: `lightstage calibrate mirror --every-light --out LAB`.",
        )
    shot = poses[0].session.rig
    rig = rig or shot
    if [light.id for light in rig.lights] != [light.id for light in shot.lights]:
        raise ProcessingError(
            "--rig",
            field="lights",
            found=f"other ids than the shots' ({poses[0].where})",
            expected="the same lamps in the same order",
        )
    wiring = find_wiring(_seen(poses, config, progress), shot, config.radius_mm)
    channels = [address.channel for address in shot.addresses]
    unsure = [
        f"channel {channels[wire]} (meant for {_name(shot.lights[wire])}): "
        f"{_what(wiring, wire, shot)}"
        for wire in map(int, np.flatnonzero(wiring.lamp < 0))
    ]
    if 2 * len(unsure) > len(channels):
        raise ProcessingError(
            source.root,
            field="mirror",
            found=f"{len(channels) - len(unsure)} of {counted(len(channels), 'lamp')} identified",
            expected="most of them",
            hint="Is it this stage's rig, is the mirror ball in its middle, is its radius right "
            "([lights.mirror] radius_mm), and are the cameras where the rig has them?",
        )
    if unsure and not allow_unsure:
        more = f"; and {len(unsure) - SHOWN} more" if len(unsure) > SHOWN else ""
        raise ProcessingError(
            source.root,
            field="mirror",
            found=f"{counted(len(unsure), 'wire')} whose lamp is not sure: "
            f"{'; '.join(unsure[:SHOWN])}{more}",
            expected="each at one lamp",
            hint="Take the shots again from more cameras or nearer, with lamps that all shine; or "
            "give --allow-unsure, and inspect those with `lightstage lights identify`.",
        )
    wire_of = _completed(wiring.lamp)
    found = rig.readdressed([shot.addresses[wire] for wire in wire_of])
    pairs = zip(rig.addresses, found.addresses, strict=True)
    sure = wiring.lamp >= 0
    return Located(
        found,
        int(sure.sum()),
        sum(was != now for was, now in pairs),
        unsure,
        float(wiring.off_mm[sure].max()),
    )


def _seen(
    poses: Sequence[Pose], config: MirrorBallConfig, progress: ProgressCallback
) -> list[Seen]:
    """Highlights of all poses, of the patterns that light one lamp."""
    seen: list[Seen] = []
    total = sum(len(pose.session.camera_ids()) * len(pose.patterns) for pose in poses)
    steps = Steps(progress, total)
    for number, pose in enumerate(poses):
        singles = single_lights({name: pose.session.levels(name) for name in pose.patterns})
        lit = set(singles.values())
        dark = [light for i, light in enumerate(pose.session.rig.lights) if i not in lit]
        if dark:
            raise ProcessingError(
                pose.where,
                field="patterns",
                found=f"none of {counted(len(dark), 'lamp')} alone, such as {_name(dark[0])}",
                expected="a photograph under each lamp alone",
                hint="Take them: `lightstage calibrate mirror --every-light --out LAB`.",
            )
        seen += see_highlights(
            ball_shots(pose.session, None, tuple(singles)), number, config, steps
        )
    return seen


def _completed(lamp: np.ndarray) -> np.ndarray:
    """(n,) wire of each lamp, from the lamp of each wire; those that are left in their order."""
    wire_of = np.full(len(lamp), -1)
    known = lamp >= 0
    wire_of[lamp[known]] = np.flatnonzero(known)
    wire_of[wire_of < 0] = np.flatnonzero(~known)
    return wire_of


def _what(wiring: Wiring, wire: int, rig: Rig) -> str:
    """Why a wire's lamp is not sure."""
    if not wiring.sightings[wire]:
        return "no highlight in any camera; is its lamp dead or unplugged?"
    maybe = wiring.maybe[wire]
    if not maybe:
        return f"no lamp within {wiring.off_mm[wire]:.1f} mm of its highlights on the ball"
    names = [_name(rig.lights[each]) for each in maybe[:NAMED]]
    if len(names) == 1:
        return f"{names[0]}, as another wire, or too near to its neighbour"
    return f"one of {', '.join(names)}"


def _name(light: Light) -> str:
    return f"lamp {light.id} ({light.name})"
