"""A whole stage whose photographs hold who took them under which light: for trials by the thousand.

An LED device behind a pseudo-terminal and simulated cameras with a story, before them whatever the
lamps show (`CodedPhotographer`). Afterwards every photograph of a session is asked what it is.
"""

from __future__ import annotations

import collections
import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from lightstage.counting import counted
from lightstage.formats.files import write_text
from lightstage.formats.session import Session, load_session
from lightstage.rig import Rig, save_rig
from sim.devices.body_folder import NEXT, put
from sim.devices.coded_photographer import CodedPhotographer, read_code
from sim.devices.faults import FaultLog, Story
from sim.devices.led_device import WATCHDOG_S, LedDevice
from sim.devices.simulated_camera import SimulatedCameras
from sim.devices.wiring import Wires, wires_of

SETTINGS = {"iso": "100", "shutter": "1/60", "aperture": "f/8"}
"""Settings of every camera, as in its photographs."""
FULL_COUNT = 65535


@dataclasses.dataclass(frozen=True)
class Labels:
    """The labels in a finished session's photographs.

    Attributes:
        right: taken by the camera, under the light, that the session names.
        mislabelled: of another camera, or of a light that was commanded under another name.
        wrong_light: rightly named, but lamps did not shine as they reported.
        unreadable: without a label that can be read.
        doubled: one photograph under two names.
        missing: patterns and cameras without a photograph.
        of_another: taken before the session began, of whoever sat there then.
    """

    right: int = 0
    mislabelled: tuple[str, ...] = ()
    wrong_light: tuple[str, ...] = ()
    unreadable: tuple[str, ...] = ()
    doubled: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()
    of_another: tuple[str, ...] = ()


class LightsEnd(Protocol):
    """The lights' device, as this stage sees it."""

    @property
    def commanded(self) -> np.ndarray:
        """(channels,) uint16 that the host asked for last, whatever shines."""


class CodedStage:
    """Use as a context manager.

    Args:
        desk: a new folder for all that is simulated.
        rig: the stage.
        story: what goes wrong.
        seed: of the photographs.
        shown: called whenever the lamps changed and all cameras see it.
        watchdog_s: the LED device goes dark by itself after so long without a packet; None: never.

    Attributes:
        rig_path: rig.json.
        cameras_path: the cameras file.
        device: the LED device.
        log: what went wrong.
    """

    def __init__(
        self,
        desk: Path,
        rig: Rig,
        story: Story | None = None,
        seed: int = 0,
        shown: Callable[[np.ndarray], None] | None = None,
        watchdog_s: float | None = WATCHDOG_S,
    ) -> None:
        desk.mkdir(parents=True, exist_ok=True)
        self.rig = rig
        self.log = FaultLog(write_text(desk / "faults.jsonl", ""))
        self._photographer = CodedPhotographer(rig, seed)
        settings = {camera.id: SETTINGS for camera in rig.cameras}
        self.cameras = SimulatedCameras(desk / "cameras", rig, story, self.log, settings)
        self.rig_path = save_rig(rig, desk / "rig.json")
        self.cameras_path = write_text(desk / "cameras.toml", self.cameras.cameras_file())
        self._shown = shown
        self._wires = Wires(wires_of(rig))
        self._commanded: list[np.ndarray] = []
        self._device: LightsEnd | None = None
        self._show(np.zeros(self._wires.count))
        self.device = self._device = self._far_end(story, watchdog_s)

    def __enter__(self) -> CodedStage:
        self.device.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self.device.__exit__()

    def _far_end(self, story: Story | None, watchdog_s: float | None) -> Any:
        """The lights' device, a LightsEnd; another one where this is overridden."""
        banks = self._wires.channels([light.bank or "" for light in self.rig.lights])
        return LedDevice(len(banks), self._show, 1, story, self.log, banks, watchdog_s)

    def _show(self, by_channel: np.ndarray) -> None:
        levels = self._wires.lamps(by_channel)
        light = self._photographer.lit(levels)
        commanded = _counts(by_channel) if self._device is None else self._device.commanded
        self._commanded.append(self._wires.lamps(commanded))
        for camera in self.rig.cameras:
            data = self._photographer.photograph(camera, light)
            put(self.cameras.folder(camera.id) / NEXT, data)
        if self._shown is not None:
            self._shown(levels)

    @property
    def lights(self) -> int:
        """How many states the lamps have had."""
        return len(self._photographer.states)

    def labels(self, root: Path, since: int = 0) -> Labels:
        """Ask every photograph of a finished session what it is.

        Args:
            root: the session's folder.
            since: `lights` when its person sat down.
        """
        session = load_session(root)
        found: dict[str, list[str]] = collections.defaultdict(list)
        right = 0
        seen: dict[str, str] = {}
        for frame in session.file.frames:
            own = f"{frame.pattern} by {frame.camera} ({frame.path})"
            first = seen.setdefault(frame.sha256, own)
            if first != own:
                found["doubled"].append(f"{own} is {first}")
            path = root / frame.path
            what, reason = self._what(session, frame.pattern, frame.camera, path, since)
            if what == "right":
                right += 1
            else:
                found[what].append(f"{own}: {reason}")
        there = {(frame.pattern, frame.camera) for frame in session.file.frames}
        for pattern in session.file.sequence:
            for camera in self.rig.cameras:
                if (pattern, camera.id) not in there:
                    found["missing"].append(f"{pattern} by {camera.id}")
        return Labels(right, **{name: tuple(reason) for name, reason in found.items()})

    def _what(
        self, session: Session, pattern: str, camera: str, path: Path, since: int
    ) -> tuple[str, str]:
        """Whether a photograph is what it is called; else which of Labels, and why."""
        code = read_code(path)
        if code is None:
            return "unreadable", "no code in its pixels"
        taken_by = self.rig.cameras[code.camera].id
        if taken_by != camera:
            return "mislabelled", f"taken by {taken_by}"
        if code.light < since:  # the last state of before is what it still shows now
            return "of_another", f"taken under light {code.light}, the session began at {since}"
        wanted = _counts(session.levels(pattern))
        shone = _counts(self._photographer.states[code.light - 1])
        if np.array_equal(shone, wanted):
            return "right", ""
        wrong = int((shone != wanted).sum())
        commanded = self._commanded[code.light - 1]
        if np.array_equal(commanded, wanted):
            return "wrong_light", f"{counted(wrong, 'lamp')} shone otherwise than reported"
        names = [
            name
            for name in session.file.sequence
            if np.array_equal(commanded, _counts(session.levels(name)))
        ]
        lit = counted(int((commanded > 0).sum()), "lamp")
        return "mislabelled", f"taken when {', '.join(names) or lit} was asked for"


def _counts(levels: np.ndarray) -> np.ndarray:
    return np.round(np.asarray(levels, float) * FULL_COUNT).astype(np.uint16)
