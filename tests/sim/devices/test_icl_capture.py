"""`lightstage capture` on ICL's stage: every photograph under the light that its name says."""

from __future__ import annotations

import dataclasses
import json
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from lightstage.formats.session import load_session
from lightstage.rig import LightAddress, Rig
from lightstage.session import read_journal
from sim.devices.coded_stage import CodedStage, Labels
from sim.devices.faults import Fault, Story
from sim.devices.icl_server import IclServer
from sim.devices.icl_stage import ARCS, LIGHTS
from sim.devices.kill_trial import CONFIG, small_rig
from tests.waiting import until

pytestmark = pytest.mark.usefixtures("forked")

PLACES = (0, 3, 14, 30, 78, 92, 123, 167)
"""Of the eight lights: arc * 14 + light."""
UPRIGHT_RGB = (True, False, False, True, True, False, True, False)
"""Whether the rgb emitters are those behind the upright polariser there: even arc, and light one of
0 2 4 6 7 9 11 13, or neither."""


def polarised_rig() -> Rig:
    """Eight lights in eight of the stage's places; a bank is a half of the channels."""
    plain = small_rig()
    lights = [
        dataclasses.replace(light, address=LightAddress(place + 168 * (light.bank == "horizontal")))
        for light, place in zip(plain.lights, PLACES, strict=True)
    ]
    return dataclasses.replace(plain, lights=tuple(lights))


class IclEnd(IclServer):
    """The server, whose emitters are seen as channels; what shines elsewhere is a failure."""

    def __init__(self, count, show, story, log):
        super().__init__(
            lambda levels: show(self._by_channel(levels)), story=story, log=log, at_once=True
        )
        self._count = count

    def _by_channel(self, emitters: np.ndarray) -> np.ndarray:
        seen = np.zeros(self._count, emitters.dtype)
        own = np.zeros((ARCS * LIGHTS, 6), bool)
        for place, upright_rgb, light in zip(PLACES, UPRIGHT_RGB, small_rig().lights, strict=True):
            lying = light.bank == "horizontal"
            group = slice(0, 3) if upright_rgb != lying else slice(3, 6)
            seen[place + 168 * lying] = emitters[place, group].min()
            own[place, group] = True
        assert self.stage.mode == "Demo" or not emitters[~own].any()
        return seen

    @property
    def commanded(self):
        return self._by_channel(self.stage.emitters)


class IclCodedStage(CodedStage):
    """The stage of coded photographs, behind ICL's server."""

    def _far_end(self, story, watchdog_s):  # noqa: ARG002
        return IclEnd(self._wires.count, self._show, story, self.log)


def arguments(stage, root: Path, desk: Path) -> list[str]:
    config = desk / "fast.toml"
    config.write_text(CONFIG)
    url = stage.device.url("lights=polarised&settle_s=0&timeout_s=1&attempts=4")
    return [
        *(sys.executable, "-m", "lightstage", "capture", "--out", str(root), "--leds", url),
        *("--rig", str(stage.rig_path), "--cameras", str(stage.cameras_path)),
        *("--subject", "P1", "--sequence", "full,x+,x-,full@parallel"),
        *("--config", str(config), "--unattended", "--json"),
    ]


def capture(stage, root: Path, desk: Path) -> subprocess.CompletedProcess:
    return subprocess.run(arguments(stage, root, desk), capture_output=True, text=True)


def test_a_capture_is_whole_right_unacknowledged_and_leaves_the_stage_manual_and_black(tmp_path):
    with IclCodedStage(tmp_path / "desk", polarised_rig()) as stage:
        done = capture(stage, tmp_path / "S", tmp_path)
        assert done.returncode == 0, done.stderr
        assert stage.device.dark
        assert stage.device.failure is None
        labels = stage.labels(tmp_path / "S")
    assert labels == Labels(4 * 3)
    session = load_session(tmp_path / "S")
    lines = [
        line for line in read_journal(session.root / "journal.jsonl") if line["event"] == "lit"
    ]
    assert {line["acknowledged"] for line in lines} == {False}
    manifest = json.loads((session.root / "manifest.json").read_text())
    assert len(manifest["unacknowledged"]) == 4
    assert "lsserver, 12 x 14, polarised" in json.dumps(manifest)
    assert "does not acknowledge" in done.stderr or "unacknowledged" in done.stderr


@pytest.mark.parametrize(
    "faults",
    [
        [Fault("delay", at=4, way="answer", seconds=0.2), Fault("wrong-acknowledgement", at=6),
         Fault("other-id", at=9), Fault("reorder", at=12, way="answer"), Fault("drop", at=14)],
        [Fault("hang-up", at=6), Fault("reset", at=15, seconds=0.5), Fault("corrupt", at=18)],
    ],
)  # fmt: skip
def test_a_server_that_misbehaves_loses_and_mislabels_nothing(tmp_path, faults):
    with IclCodedStage(tmp_path / "desk", polarised_rig(), Story(faults)) as stage:
        done = capture(stage, tmp_path / "S", tmp_path)
        assert done.returncode == 0, done.stderr
        assert stage.device.dark
        assert stage.device.failure is None
        assert stage.log.names() == [fault.name for fault in faults]
        assert stage.labels(tmp_path / "S") == Labels(4 * 3)


def lit(device: IclServer) -> bool:
    """Whether a pattern is."""
    last = device.states[-1]
    return last.mode == "Manual" and bool(last.counts.any())


def test_after_ctrl_c_the_stage_is_manual_and_black(tmp_path):
    with IclCodedStage(tmp_path / "desk", polarised_rig()) as stage:
        child = subprocess.Popen(
            arguments(stage, tmp_path / "S", tmp_path),
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        )  # fmt: skip
        until(lambda: lit(stage.device), 60)
        child.send_signal(signal.SIGINT)
        printed = child.communicate(timeout=60)[1]
        assert child.returncode == 130, printed
        assert stage.device.dark
        assert "--resume" in printed
