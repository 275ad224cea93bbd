"""One capture: light -> acknowledged -> trigger all -> download -> verify -> journal, shot by shot.

Devices arrive as arguments. Whatever happens, the lights end dark.
"""

from __future__ import annotations

import contextlib
import dataclasses
import signal
import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait

import numpy as np

from lightstage.cameras.binding import open_cameras, summary_problems
from lightstage.cameras.camera import CameraDevice, CardFile, Photograph, Summary
from lightstage.commands import ProgressCallback, quiet
from lightstage.errors import CaptureError, DeviceError, LightstageError, one_error
from lightstage.leds.controller import LedController
from lightstage.rig import Rig
from lightstage.safety import SafetyConfig
from lightstage.sequence import Shot
from lightstage.session import SessionWriter

KEEP_AWAKE_S = 0.5
"""A device may go dark by itself when it hears nothing for 2 s."""


@dataclasses.dataclass(frozen=True)
class CaptureConfig:
    """How a capture runs.

    Attributes:
        camera_deadline_s: a camera that has not answered by then is ended.
        trigger_lead_s: time between asking all cameras and the moment at which all trigger.
        safety: limits for person and lights.
    """

    camera_deadline_s: float = 30.0
    trigger_lead_s: float = 0.02
    safety: SafetyConfig = dataclasses.field(default_factory=SafetyConfig)


@dataclasses.dataclass(frozen=True)
class CaptureReport:
    """What a capture did.

    Attributes:
        frames: photographs kept.
        seconds: from the first light to the last journal line.
        overhead_s: of these, what neither the lights' acknowledgement, nor the slowest camera, nor
            the pause between two changes of light took: writing, flushing, hashing, journal.
        max_skew_s: largest time between the first and the last trigger of one shot.
    """

    frames: int
    seconds: float
    overhead_s: float
    max_skew_s: float


def connect(
    rig: Rig,
    lights: LedController,
    cameras: Sequence[CameraDevice],
    allow_unverifiable: Sequence[str],
) -> list[Summary]:
    """Open all cameras and check all devices against the rig, before a light goes on.

    Lights that an earlier program left on are put out first.

    Returns:
        What each camera tells about itself, in order.

    Raises:
        DeviceError: every device that is missing or wrong, in one message.
    """
    lights.dark()
    problems: list[LightstageError] = []
    if lights.hello.light_count != len(rig.lights):
        problems.append(
            DeviceError(
                "LED device",
                field="light count",
                found=str(lights.hello.light_count),
                expected=f"{len(rig.lights)} (rig.json)",
                hint="Is this the rig file of this stage?",
            )
        )
    told, failed = open_cameras(cameras)
    problems += failed
    if not failed:
        by_id = [rig.camera(camera.id) for camera in cameras]
        problems += summary_problems(by_id, told, allow_unverifiable)
    if problems:
        raise one_error(problems)
    return told


def capture(
    shots: Sequence[Shot],
    lights: LedController,
    cameras: Sequence[CameraDevice],
    writer: SessionWriter,
    config: CaptureConfig,
    progress: ProgressCallback = quiet,
) -> CaptureReport:
    """Take all shots with connected devices and finish the session.

    Args:
        shots: in order, checked by sequence.check_shots.
        lights: acknowledged lights.
        cameras: opened cameras.
        writer: the session folder.
        config: deadlines and limits.
        progress: called with photographs kept and wanted.

    Raises:
        DeviceError, CaptureError: what failed; photographs that arrived are kept and journaled.
            The lights are dark when it is raised, or the message says that they may not be.
    """
    total = len(shots) * len(cameras)
    started = time.monotonic()
    busy_s, max_skew_s, done = 0.0, 0.0, 0
    progress(0, total)
    changed_s = started
    kept: dict[str, str] = {}
    with lights_dark_at_end(lights):
        for shot in shots:
            busy_s += _pause(changed_s, config)
            begun_s = time.monotonic()
            driven = lights.light(shot.levels)
            changed_s = time.monotonic()
            photographs = _take(shot.pattern, lights, cameras, writer, config, kept)
            done += len(photographs)
            progress(done, total)
            triggers = [photograph.triggered_s for photograph in photographs]
            skew_s = max(triggers) - min(triggers)
            taken_s = max(photograph.downloaded_s for photograph in photographs) - begun_s
            busy_s += taken_s
            max_skew_s = max(max_skew_s, skew_s)
            writer.shot(
                shot.pattern,
                levels=driven.tolist(),
                acknowledged_after_s=round(changed_s - begun_s, 6),
                trigger_skew_s=round(skew_s, 6),
                taken_after_s=round(taken_s, 6),
            )
        busy_s += _pause(changed_s, config)
    writer.finish()
    writer.end()
    seconds = time.monotonic() - started
    return CaptureReport(done, seconds, seconds - busy_s, max_skew_s)


@contextlib.contextmanager
def lights_dark_at_end(lights: LedController) -> Iterator[None]:
    """Dark on every way out: return, exception, SIGINT, SIGTERM, SIGHUP (run_app)."""
    failure: BaseException | None = None
    try:
        yield
    except BaseException as error:
        failure = error
    with _signals_held():
        try:
            lights.dark()
        except LightstageError as error:
            warning = "The lights may still be on: switch their power supply off."
            if failure is None:
                raise DeviceError(f"{error} {warning}") from None
            said = str(failure) or type(failure).__name__
            raise CaptureError(f"{said}\n  then: {error} {warning}") from failure
    if failure is not None:
        raise failure


@contextlib.contextmanager
def _signals_held() -> Iterator[None]:
    """Put off signals, so that a second Ctrl-C cannot leave the lights on."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    held: list[int] = []
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = [signal.signal(number, lambda got, _: held.append(got)) for number in numbers]
    try:
        yield
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)
    if held:
        raise KeyboardInterrupt


def _pause(changed_s: float, config: CaptureConfig) -> float:
    """Wait until the light may change again; returns the seconds that it took."""
    left_s = max(0.0, changed_s + config.safety.light_interval_s - time.monotonic())
    time.sleep(left_s)
    return left_s


def _take(
    pattern: str,
    lights: LedController,
    cameras: Sequence[CameraDevice],
    writer: SessionWriter,
    config: CaptureConfig,
    kept: dict[str, str],
) -> list[Photograph]:
    """Trigger all cameras at one time and keep every photograph as it comes.

    `kept` has the hashes of the photographs so far, and whose they are.

    The lights are asked for their state while cameras work, and once more when all are done: only
    then did the acknowledged light last through every exposure.
    """
    pool = ThreadPoolExecutor(len(cameras))
    try:
        at_s = time.monotonic() + config.trigger_lead_s
        pending: dict[Future[Photograph], CameraDevice] = {
            pool.submit(_take_one, pattern, camera, at_s, writer, kept): camera
            for camera in cameras
        }
        photographs: list[Photograph] = []
        failed: dict[str, LightstageError] = {}
        heard_s = time.monotonic()
        while pending:
            ready, _ = wait(pending, timeout=KEEP_AWAKE_S, return_when="FIRST_COMPLETED")
            if time.monotonic() - heard_s >= KEEP_AWAKE_S:
                lights.confirm()
                heard_s = time.monotonic()
            for future in ready:
                camera = pending.pop(future)
                try:
                    photographs.append(future.result())
                except LightstageError as error:
                    writer.note("failed", pattern=pattern, camera=camera.id, said=str(error))
                    failed[camera.id] = error
        lights.confirm()
    finally:
        # Not waited for: on a failure the lights come first; closing the cameras ends the rest.
        pool.shutdown(wait=False)
    if failed:
        # In the rig's order, not in that of their failing.
        first = one_error([failed[camera.id] for camera in cameras if camera.id in failed])
        raise CaptureError(
            f"pattern {pattern}: {len(photographs)} of {len(cameras)} photographs kept in "
            f"{writer.root}; {first}"
        )
    return photographs


def _take_one(
    pattern: str, camera: CameraDevice, at_s: float, writer: SessionWriter, kept: dict[str, str]
) -> Photograph:
    """Take and keep one camera's photograph; what comes back no longer holds its bytes."""
    photograph = camera.capture(at_s)
    own = f"{pattern} by {camera.id}"
    first = kept.setdefault(photograph.sha256, own)
    if first != own:
        raise CaptureError(
            own,
            found=f"the bytes of {first}",
            expected="a new photograph: a sensor's noise never repeats",
            hint="The camera gave an old picture; switch it off and on, then capture again.",
        )
    incoming = writer.incoming(pattern, camera.id, 1)
    incoming.write_bytes(photograph.data)
    writer.keep(
        pattern,
        camera.id,
        1,
        incoming,
        CardFile(photograph.name, len(photograph.data)),
        photograph.sha256,
        camera_name=photograph.name,
        exposure_s=round(photograph.exposed_s - photograph.triggered_s, 6),
        download_s=round(photograph.downloaded_s - photograph.exposed_s, 6),
    )
    return dataclasses.replace(photograph, data=b"")


def worst_shot_s(config: CaptureConfig, acknowledge_s: float) -> float:
    """Longest that a shot can keep its lights on: acknowledgement, cameras, writing.

    Args:
        config: the cameras' deadline.
        acknowledge_s: after which a silent LED device counts as failed.
    """
    return float(np.sum([acknowledge_s, config.trigger_lead_s, config.camera_deadline_s]))
