"""A person in a stage whose devices wait for `lightstage capture`."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from lightstage.formats.files import write_json, write_text
from lightstage.patterns import drive_levels
from lightstage.rig import save_rig
from sim.camera.flaws import CaptureFlaws
from sim.camera.shooting import LitSubject
from sim.devices.camera_device import CameraFolders
from sim.devices.faults import FaultLog, Story
from sim.devices.led_device import SETTLE_TIMEOUT_S, WATCHDOG_S, LedDevice
from sim.devices.photographer import Photographer
from sim.devices.story_cameras import ATTEMPTS, TIMEOUT_S, StoryCameras
from sim.devices.wiring import Wires, wires_of
from sim.light.polarised import seen_through


@dataclasses.dataclass(frozen=True)
class StandingStage:
    """Devices that stand ready.

    Attributes:
        desk: folder with rig.json, cameras.toml and colour.json.
        device: the lights.
        leds: their URL.
        photographer: what the cameras see.
        subject: pseudonym and expression of who sits there.
    """

    desk: Path
    device: LedDevice
    leds: str
    photographer: Photographer
    subject: tuple[str, str]

    def command(self, out: Path) -> list[str]:
        """Arguments of `lightstage` that capture this stage into a session folder."""
        return [
            *("capture", "--rig", str(self.desk / "rig.json"), "--out", str(out)),
            *("--leds", self.leds, "--cameras", str(self.desk / "cameras.toml")),
            *("--subject", self.subject[0], "--expression", self.subject[1]),
            *("--colour", str(self.desk / "colour.json")),
        ]


@contextlib.contextmanager
def standing_stage(
    world: LitSubject,
    desk: Path,
    seed: int,
    patterns: Sequence[str],
    flaws: CaptureFlaws | None = None,
    story: Story | None = None,
    log: FaultLog | None = None,
    peak: np.ndarray | None = None,
    wires: np.ndarray | None = None,
) -> Iterator[StandingStage]:
    """A person in a stage whose devices wait for `lightstage capture`.

    Args:
        world: the person in the rig.
        desk: folder for the devices.
        seed: of sensors and noise.
        patterns: that will be shot.
        flaws: as in `Photographer`.
        story: what goes wrong with the devices; an empty one for none. The cameras are simulated
            ones then, whose cards outlive their processes; else libgphoto2's virtual ones.
        log: where what went wrong is noted.
        peak: as in `Photographer`.
        wires: (n,) channel of each lamp, whatever the rig has; the rig's where absent.
    """
    world = seen_through(world, patterns)
    photographer = Photographer(world, seed, flaws, patterns, peak=peak)
    dark = np.zeros(len(world.rig.lights))
    folders: CameraFolders | StoryCameras
    log, timeout_s, attempts = log or FaultLog(), SETTLE_TIMEOUT_S, 1
    if story is None:
        folders = CameraFolders(desk / "cameras", [camera.id for camera in world.rig.cameras])
    else:
        folders = StoryCameras(desk / "cameras", world.rig, story, log, photographer.settings())
        if story.faults:
            timeout_s, attempts = TIMEOUT_S, ATTEMPTS
            for levels in [dark, *(drive_levels(name, world.rig) for name in patterns)]:
                photographer.photographs(levels, folders.shelf(levels))

    def show(levels: np.ndarray) -> None:
        if not (isinstance(folders, StoryCameras) and folders.recall(levels)):
            photographer.photographs(levels, folders)

    show(dark)
    save_rig(world.rig, desk / "rig.json")
    write_json(desk / "colour.json", photographer.colour_calibration())
    write_text(desk / "cameras.toml", folders.cameras_file())
    line = Wires(wires_of(world.rig) if wires is None else wires)
    banks = line.channels([light.bank or "" for light in world.rig.lights])
    subject = (world.subject.name, world.subject.expression)
    with LedDevice(line.count, line.show(show), 1, story, log, banks, WATCHDOG_S) as device:
        url = device.url(timeout_s, attempts)
        yield StandingStage(desk, device, url, photographer, subject)
