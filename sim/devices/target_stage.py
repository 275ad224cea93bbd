"""A stage with a calibration target in it, and somebody who holds it: `lightstage calibrate`."""

from __future__ import annotations

import re
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from lightstage.formats.files import write_text
from lightstage.rig import Rig, save_rig
from sim.camera.flaws import CaptureFlaws
from sim.devices.body_folder import NEXT, put
from sim.devices.led_device import SETTLE_TIMEOUT_S, WATCHDOG_S, LedDevice
from sim.devices.simulated_camera import SimulatedCameras
from sim.devices.target_photographer import TargetPhotographer
from sim.devices.wiring import Wires, wires_of

_POSE = re.compile(r"Pose (\d+) of \d+: ")


class TargetStage:
    """Lamps and cameras around a target. Use as a context manager.

    Args:
        desk: a new folder for all that is simulated.
        rig: the stage.
        kind: as of TargetPhotographer.
        seed: of poses, lenses, sensors and noise.
        flaws: what lamps, lens, room and sensor do.
        wires: (n,) channel of each lamp, whatever the rig has; the rig's where absent.

    Attributes:
        rig_path: rig.json.
        cameras_path: the cameras file.
        device: the LED device.
        photographer: what is before the cameras.
    """

    def __init__(
        self,
        desk: Path,
        rig: Rig,
        kind: str,
        seed: int = 0,
        flaws: CaptureFlaws | None = None,
        wires: np.ndarray | None = None,
    ) -> None:
        desk.mkdir(parents=True, exist_ok=True)
        self.rig = rig
        self.photographer = TargetPhotographer(rig, kind, seed, flaws)
        self._cameras = SimulatedCameras(
            desk / "cameras", rig, settings=self.photographer.settings()
        )
        self.rig_path = save_rig(rig, desk / "rig.json")
        self.cameras_path = write_text(desk / "cameras.toml", self._cameras.cameras_file())
        self._lock = threading.Lock()
        self._levels = np.zeros(len(rig.lights))
        self._show(self._levels)
        line = Wires(wires_of(rig) if wires is None else wires)
        self.device = LedDevice(line.count, line.show(self._show), watchdog_s=WATCHDOG_S)

    def __enter__(self) -> TargetStage:
        self.device.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self.device.__exit__()

    def hold(self, pose: int) -> None:
        """Hold the target as pose `pose` (from 0)."""
        self.photographer.pose = pose
        self._show(self._levels)

    def swap(self, kind: str) -> None:
        """Put another target, or ``nothing``, in its place; exposed as before."""
        self.photographer.kind = kind
        self._show(self._levels)

    def arguments(self, lab: Path, kind: str, *more: str) -> list[str]:
        """The command line of `lightstage calibrate` for this stage."""
        return [
            *(sys.executable, "-m", "lightstage", "calibrate", kind),
            *("--rig", str(self.rig_path), "--out", str(lab)),
            *("--leds", self.device.url(SETTLE_TIMEOUT_S), "--cameras", str(self.cameras_path)),
            *more,
        ]

    def calibrate(
        self,
        lab: Path,
        kind: str,
        *more: str,
        answers: Sequence[str] = (),
        echo: Callable[[str], object] = str,
    ) -> subprocess.CompletedProcess[str]:
        """Run `lightstage calibrate` as an operator does: hold what is asked for, press Enter.

        Args:
            lab: the lab's folder.
            kind: what the command is asked to take.
            more: further arguments.
            answers: given in order in place of Enter, at each question; then Enter.
            echo: receives letter by letter what the command prints, and the answers.
        """
        child = subprocess.Popen(
            self.arguments(lab, kind, *more),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert child.stdin is not None
        assert child.stdout is not None
        assert child.stderr is not None
        left = list(answers)
        printed, line = "", ""
        try:
            while letter := child.stderr.read(1):
                echo(letter)
                printed += letter
                line = "" if letter == "\n" else line + letter
                prompt = _POSE.match(line)
                if letter == " " and prompt and not line[prompt.end() :]:
                    self.hold(int(prompt[1]) - 1)
                if line.endswith("q stops: "):
                    answer = (left.pop(0) if left else "") + "\n"
                    child.stdin.write(answer)
                    child.stdin.flush()
                    echo(answer)
                    line = ""  # what is answered here ends no line there
            out = child.stdout.read()
            child.stdin.close()
        except BaseException:  # Ctrl-C too: nobody would answer the command any more
            child.terminate()
            child.wait()
            raise
        return subprocess.CompletedProcess(child.args, child.wait(), out, printed)

    def _show(self, levels: np.ndarray) -> None:
        with self._lock:
            self._levels = np.array(levels)
            for camera in self.rig.cameras:
                data = self.photographer.photograph(camera, self._levels)
                put(self._cameras.folder(camera.id) / NEXT, data)
