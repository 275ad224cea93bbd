"""The devices of a stage, opened together and let go together, lights dark first."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator, Sequence

from lightstage.cameras.binding import (
    CamerasFile,
    Moved,
    close_cameras,
    connect_problems,
    find_cameras,
)
from lightstage.cameras.camera import CameraDevice, Summary
from lightstage.cameras.process import detect_ports
from lightstage.capture.config import CaptureConfig
from lightstage.errors import one_error
from lightstage.findings import Finding
from lightstage.interrupts import raise_once
from lightstage.leds.address import worst_answer_s
from lightstage.leds.opening import open_rig_leds
from lightstage.preflight import PreflightConfig, device_findings, refusals
from lightstage.rig import Rig
from lightstage.safety import SafeLights


@dataclasses.dataclass(frozen=True)
class Stage:
    """Devices that were checked against the rig.

    Attributes:
        rig: with their places.
        lights: dark, and dark again at the end.
        cameras: opened, in the rig's order.
        summaries: each camera's, by its id; it must stay so.
        file: the cameras file's part on them.
        moved: warnings of cameras that are at other ports than in the cameras file.
    """

    rig: Rig
    lights: SafeLights
    cameras: tuple[CameraDevice, ...]
    summaries: dict[str, Summary]
    file: CamerasFile
    moved: Sequence[Finding] = ()


@contextlib.contextmanager
def open_stage(rig: Rig, leds: str, file: CamerasFile, config: CaptureConfig) -> Iterator[Stage]:
    """Open all devices; on every way out the lights go dark, then the cameras are let go.

    Lights that an earlier program left on are put out first. From here on the first signal is the
    stop, and later ones do not cut it short (`raise_once`).

    Args:
        rig: what must be there.
        leds: the LED device's URL, or one of each controller (`open_rig_leds`).
        file: where cameras are, and what may stay unverified.
        config: deadlines and limits.

    Raises:
        DeviceError: every device that is missing or wrong, in one message.
    """
    worst_s = config.worst_shot_s(worst_answer_s(leds))
    raise_once()
    # Cameras are searched for in the dark, and closed when the lights are dark again.
    with (
        open_rig_leds(leds, rig) as device,
        contextlib.ExitStack() as at_last,
        SafeLights(device, config.safety, rig, worst_s) as lights,
    ):
        lights.dark()
        cameras = find_cameras(rig, file, config.deadlines, detect_ports)
        at_last.callback(close_cameras, cameras)
        summaries, moved = _connect(rig, lights, cameras, file, config.preflight)
        yield Stage(rig, lights, tuple(cameras), summaries, file, moved)


def _connect(
    rig: Rig,
    lights: SafeLights,
    cameras: Sequence[CameraDevice],
    file: CamerasFile,
    config: PreflightConfig,
) -> tuple[dict[str, Summary], list[Finding]]:
    """Open all cameras, each of which must be the rig's own; warnings of those that moved."""
    wanted = [rig.camera(camera.id) for camera in cameras]
    moved: list[Moved] = []
    summaries, problems = connect_problems(wanted, cameras, file.allow_unverifiable, moved)
    if problems:
        # The others' settings in the same message: the operator goes to the stage once.
        raise one_error(problems + refusals(device_findings(rig, summaries, file, lights, config)))
    return summaries, [moved_finding(each) for each in moved]


def moved_finding(moved: Moved) -> Finding:
    """A warning of a camera that is at another port than in the cameras file."""
    there = "nothing that answers" if moved.there is None else f"serial {moved.there}"
    return Finding(
        "warn",
        "moved",
        f"camera {moved.camera}, port",
        f"serial {moved.serial} at {moved.found}, and {there} at {moved.port}",
        f"it at {moved.port} (the cameras file)",
        f"It is used where it is. Give port {moved.found} in the cameras file, or no port.",
        camera=moved.camera,
    )
