"""`lightstage capture` on a stage whose lamps are on two controllers, each at its own URL."""

from __future__ import annotations

import contextlib
import dataclasses
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from lightstage.rig import LightAddress, Rig, save_rig
from lightstage.session import read_journal
from sim.devices.coded_stage import CodedStage, Labels
from sim.devices.faults import Fault, Story
from sim.devices.kill_trial import CONFIG, small_rig
from sim.devices.led_device import LedDevice
from tests.waiting import until

pytestmark = pytest.mark.usefixtures("forked")

ADDRESSES = [
    *(LightAddress(channel, "left") for channel in (3, 2, 1, 0)),
    *(LightAddress(channel, "right") for channel in (5, 0, 2, 1)),
]
"""Of the eight lights; the right controller has a channel too many."""
CHANNELS = {"left": 4, "right": 6}


def two_rig() -> Rig:
    return small_rig().readdressed(ADDRESSES)


class TwoEnds:
    """Two LED devices as one far end, whose lamps are seen in the rig's order.

    Args:
        show: called with the levels of all lamps whenever one device changed.
        story: of the right device.
        log: of what went wrong.
        watchdog_s: of both.
    """

    def __init__(self, show, story, log, watchdog_s) -> None:
        self._show, self._levels = show, np.zeros(8)
        self._lock = threading.Lock()
        self.devices = {
            name: LedDevice(
                count, lambda levels, name=name: self._see(name, levels), 1,
                story if name == "right" else None, log, [""] * count, watchdog_s,
            )
            for name, count in CHANNELS.items()
        }  # fmt: skip

    def _see(self, name: str, levels: np.ndarray) -> None:
        with self._lock:
            for place, address in enumerate(ADDRESSES):
                if address.controller == name:
                    self._levels[place] = levels[address.channel]
            self._show(self._levels.copy())

    @property
    def commanded(self) -> np.ndarray:
        asked = {name: device.commanded for name, device in self.devices.items()}
        return np.array([asked[each.controller][each.channel] for each in ADDRESSES])

    @property
    def dark(self) -> bool:
        return all(device.dark for device in self.devices.values())

    def url(self, *options: float) -> str:
        return ",".join(f"{name}={each.url(*options)}" for name, each in self.devices.items())

    def __enter__(self):
        self._open = contextlib.ExitStack()
        for device in self.devices.values():
            self._open.enter_context(device)
        return self

    def __exit__(self, *_):
        self._open.close()


class TwoStage(CodedStage):
    """The stage of coded photographs, behind two controllers."""

    def _far_end(self, story, watchdog_s):
        # The first state is shown before there is a device.
        return TwoEnds(self._show, story, self.log, watchdog_s)


@contextlib.contextmanager
def two_stage(desk: Path, *faults: Fault):
    story = Story(list(faults)) if faults else None
    with TwoStage(desk / "desk", small_rig(), story, watchdog_s=None) as stage:
        save_rig(two_rig(), stage.rig_path)
        yield stage


def arguments(stage, root: Path, desk: Path, leds: str | None = None) -> list[str]:
    config = desk / "fast.toml"
    config.write_text(CONFIG)
    return [
        *(sys.executable, "-m", "lightstage", "capture", "--out", str(root)),
        *("--leds", leds or stage.device.url(1.0, 2)),
        *("--rig", str(stage.rig_path), "--cameras", str(stage.cameras_path)),
        *("--subject", "P1", "--sequence", "full,x+,x-"),
        *("--config", str(config), "--unattended"),
    ]


def capture(stage, root: Path, desk: Path, leds: str | None = None):
    return subprocess.run(arguments(stage, root, desk, leds), capture_output=True, text=True)


def test_every_photograph_is_of_its_light_and_both_controllers_end_dark(tmp_path) -> None:
    with two_stage(tmp_path) as stage:
        done = capture(stage, tmp_path / "S", tmp_path)
        assert done.returncode == 0, done.stderr
        assert stage.labels(tmp_path / "S") == Labels(3 * 3)
        assert stage.device.dark
        for device in stage.device.devices.values():
            assert any(state.counts.any() for state in device.states)
    begin = read_journal(tmp_path / "S" / "journal.jsonl")[0]
    assert begin["led_device"]["light_count"] == 10
    assert begin["led_device"]["firmware"].startswith("left: ")


def test_where_one_controller_falls_silent_the_other_is_dark_at_the_end(tmp_path) -> None:
    with two_stage(tmp_path, Fault("die", at=6)) as stage:
        done = capture(stage, tmp_path / "S", tmp_path, stage.device.url(0.4, 2))
        assert done.returncode == 2
        assert "right: LED device" in done.stderr
        assert "may still be on" in done.stderr
        assert stage.device.devices["left"].dark


def test_a_killed_capture_leaves_both_controllers_dark(tmp_path) -> None:
    with two_stage(tmp_path) as stage:
        child = subprocess.Popen(arguments(stage, tmp_path / "S", tmp_path))
        ends = stage.device.devices.values()
        until(lambda: all(end.states[-1].counts.any() for end in ends), 60)
        child.kill()
        child.wait()
        until(lambda: stage.device.dark, 30)


@pytest.mark.parametrize(
    ("leds", "part"),
    [
        ("{left}", "2 controllers (left, right), and one URL in --leds"),
        ("left={left}", "and URLs of left in --leds"),
        ("left={left},left={right}", "a name that is there already"),
        ("left={left},right={left}", "a device that is there already"),
        ("left={right},right={left}", "LED device right at"),
        ("left={left},right=pty:///dev/none", "a port that opens"),
    ],
)
def test_urls_that_do_not_fit_the_rig_are_refused_before_a_light_goes_on(
    tmp_path, leds, part
) -> None:
    with two_stage(tmp_path) as stage:
        devices = stage.device.devices
        text = leds.format(**{name: each.url(1.0, 2) for name, each in devices.items()})
        done = capture(stage, tmp_path / "S", tmp_path, text)
        assert done.returncode == 2
        assert part in done.stderr, done.stderr
        assert not (tmp_path / "S").exists()
        assert all(len(device.states) == 1 for device in devices.values())


def test_the_check_of_devices_opens_all_controllers(tmp_path) -> None:
    with two_stage(tmp_path) as stage:
        words = ["devices", "--rig", str(stage.rig_path), "--leds", stage.device.url(1.0, 2)]
        words += ["--cameras", str(stage.cameras_path), "--folder", str(tmp_path)]
        done = subprocess.run(
            [sys.executable, "-m", "lightstage", *words], capture_output=True, text=True
        )
        assert "10 lamps answer" in done.stdout, done.stderr
        assert stage.device.dark


def test_a_rig_keeps_what_others_added_to_an_address() -> None:
    rig = two_rig()
    noted = dataclasses.replace(rig.lights[0].address, more={"cable": "A7"})
    lights = (dataclasses.replace(rig.lights[0], address=noted), *rig.lights[1:])
    changed = dataclasses.replace(rig, lights=lights).readdressed(list(reversed(ADDRESSES)))
    assert changed.addresses[0] == ADDRESSES[-1]
    assert changed.addresses[0].more == {"cable": "A7"}
