"""One pattern: lit and acknowledged, all cameras at one moment, every photograph kept."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait

from lightstage.cameras.camera import CameraDevice
from lightstage.capture.camera_shot import OldPictureError, Photographer, Taken
from lightstage.capture.config import CaptureConfig
from lightstage.capture.late_cameras import LateCameras
from lightstage.capture.pattern_light import LateCameraError, PatternLight
from lightstage.capture.wishes import Wishes
from lightstage.errors import (
    CaptureError,
    CutPhotographError,
    DeviceError,
    FormatError,
    LightstageError,
    StoppedError,
)
from lightstage.findings import Finding
from lightstage.leds.controller import LightLostError
from lightstage.operator.attendance import NOT_TAKEN
from lightstage.safety import SafeLights
from lightstage.sequence import Shot
from lightstage.session import SessionWriter
from lightstage.steps import step

POLL_S = 0.03
"""How long the operator's wish to abort may wait."""
TAKES_AGAIN = "It answers again. It takes the pattern again alone, or you are asked."


@dataclasses.dataclass(frozen=True)
class ShotTaken:
    """What one try at a pattern gave.

    Attributes:
        taken: photographs kept.
        findings: what was found, photographs that did not come among it.
        lit_s: from asking for the light until it was acknowledged.
        light_lost: the lights are no longer known; they must recover first.
        late: cameras whose light was put out before they had exposed, and that answer again: they
            take the pattern again without a question.
    """

    taken: tuple[Taken, ...]
    findings: tuple[Finding, ...]
    lit_s: float
    light_lost: bool = False
    late: frozenset[str] = frozenset()

    @property
    def skew_s(self) -> float:
        """Time between the first and the last trigger."""
        triggers = [each.triggered_s for each in self.taken]
        return max(triggers) - min(triggers) if triggers else 0.0

    @property
    def exposed_s(self) -> float:
        """From the first trigger until the last picture was there."""
        if not self.taken:
            return 0.0
        last = max(each.exposed_s for each in self.taken)
        return last - min(each.triggered_s for each in self.taken)


def take_shot(
    shot: Shot,
    takes: Mapping[str, int],
    cameras: Sequence[CameraDevice],
    lights: SafeLights,
    photographer: Photographer,
    writer: SessionWriter,
    wishes: Wishes,
    config: CaptureConfig,
) -> ShotTaken:
    """Light a pattern and let these cameras photograph it.

    A camera that fails does not hold the others up: its failure is a finding. One that does not
    answer does not keep the person lit either (`LateCameras`).

    Args:
        shot: what to light.
        takes: number of each camera's take, by camera id.
        cameras: that shall take it.
        lights: the stage's.
        photographer: keeps what they take.
        writer: the session.
        wishes: the operator may abort.
        config: times.

    Raises:
        StoppedError: by the operator.
        CaptureError: this computer's disk failed.
        DeviceError: the lights failed.
    """
    if wishes.aborted():
        raise stopped()
    try:
        light = PatternLight(lights, shot.levels, [c.id for c in cameras], config.dark_after_s)
    except LightLostError as error:
        if wishes.aborted():  # who stopped it put the light out: no device failed
            raise stopped() from None
        unlit = missed(shot.pattern, cameras, {camera.id: error for camera in cameras}, writer)
        return ShotTaken((), tuple(unlit), 0.0, light_lost=True)
    writer.lit(
        shot.pattern,
        light.driven.tolist(),
        acknowledged=lights.acknowledged,
        acknowledged_after_s=round(light.lit_s, 6),
    )
    step("lit", shot.pattern)
    writer.trigger(shot.pattern, takes)
    step("intended", shot.pattern)
    pool = ThreadPoolExecutor(len(cameras))
    taken: list[Taken] = []
    failed: dict[str, LightstageError] = {}
    disk: CaptureError | None = None
    pending: dict[Future[Taken], str] = {}
    try:
        at_s = time.monotonic() + config.trigger_lead_s
        late = LateCameras(shot.pattern, light, photographer.exposure_times, at_s, config, writer)
        for c in cameras:
            taking = pool.submit(photographer.take, shot.pattern, takes[c.id], c, at_s, light)
            pending[taking] = c.id
        while pending:
            ready, _ = wait(pending, timeout=POLL_S, return_when="FIRST_COMPLETED")
            light.dark_when_due()
            late.look()
            if wishes.aborted():
                raise stopped()
            for future in ready:
                camera = pending.pop(future)
                try:
                    taken.append(future.result())
                except (DeviceError, FormatError, OldPictureError, CutPhotographError) as error:
                    failed[camera] = error
                except CaptureError as error:
                    disk = error  # the others' photographs may still find room
    except (StoppedError, KeyboardInterrupt):
        lights.dark()
        _come_home(pending, light, config)
        raise
    finally:
        # Not waited for: on a failure the lights come first; closing the cameras ends the rest.
        pool.shutdown(wait=False)
    if disk is not None:
        raise disk
    findings = [finding for each in taken for finding in each.findings]
    findings += missed(shot.pattern, cameras, failed, writer)
    lost = any(isinstance(error, LightLostError) for error in failed.values())
    hung = frozenset(name for name, error in failed.items() if isinstance(error, LateCameraError))
    return ShotTaken(tuple(taken), tuple(findings), light.lit_s, lost, hung)


def _come_home(
    pending: Mapping[Future[Taken], str], light: PatternLight, config: CaptureConfig
) -> None:
    """After a stop, wait for the photographs of cameras that have exposed.

    One that has not gets the grace of a late camera alone: its picture is of no light that is
    known. It stays on the card, and is found there when the session is resumed.
    """
    begun_s = time.monotonic()
    while True:
        after_s = time.monotonic() - begun_s
        late = light.needed_by if after_s > config.late_camera_grace_s else frozenset()
        left = [taking for taking, camera in pending.items() if camera not in late]
        if not wait(left, timeout=POLL_S).not_done or after_s > config.deadlines.trigger_s:
            return


def stopped() -> StoppedError:
    """What ends a capture at the operator's wish."""
    return StoppedError("Stopped by the operator.")


def missed(
    pattern: str,
    cameras: Sequence[CameraDevice],
    failed: Mapping[str, LightstageError],
    writer: SessionWriter,
) -> list[Finding]:
    """Photographs that did not come, as findings in the journal too.

    Args:
        pattern: what was to be taken.
        cameras: that were to take it.
        failed: why, by camera id, of those that did not.
        writer: the session.
    """
    findings = [
        Finding(
            "retake",
            NOT_TAKEN,
            f"{pattern} by {camera.id}",
            found=str(failed[camera.id]),
            expected="a photograph",
            hint=TAKES_AGAIN if isinstance(failed[camera.id], LateCameraError) else "",
            pattern=pattern,
            camera=camera.id,
        )
        for camera in cameras
        if camera.id in failed
    ]
    for finding in findings:
        writer.finding(finding)
    return findings
