"""The state machine, with devices that record what is asked of them."""

import hashlib
import os
import re
import signal
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from lightstage.cameras.binding import read_cameras_file
from lightstage.cameras.camera import Photograph, Summary
from lightstage.capture import CaptureConfig, capture, connect, worst_shot_s
from lightstage.errors import CaptureError, DeviceError
from lightstage.formats.config import make_config, read_toml
from lightstage.formats.session import load_session, state_hash
from lightstage.leds.controller import Hello
from lightstage.safety import SafetyConfig
from lightstage.sequence import plan_shots
from lightstage.session import SessionWriter, read_journal

FAST = CaptureConfig(trigger_lead_s=0.0, safety=SafetyConfig(light_interval_s=0.0))


class Lights:
    """Lights that acknowledge, or fail at the n-th request of a kind."""

    def __init__(self, log, count=8, fail=None):
        self.log = log
        self.hello = Hello(1, count, "fake")
        self.fail = fail or {}
        self.levels = np.ones(count)

    def _did(self, what):
        self.log.append(what)
        left = self.fail.get(what)
        if left is not None and self.log.count(what) >= left[0]:
            raise left[1]

    def light(self, levels):
        self._did("light")
        self.levels = np.round(levels * 65535) / 65535
        return self.levels

    def confirm(self):
        self._did("confirm")

    def dark(self):
        self._did("dark")
        self.levels = np.zeros_like(self.levels)

    def close(self):
        pass


class FakeCamera:
    def __init__(self, camera_id, log, lights, make_dng, fail_at=None, error=None):
        self.id = camera_id
        self.log = log
        self.lights = lights
        self.make_dng = make_dng
        self.fail_at = fail_at
        self.error = error or DeviceError(f"camera {camera_id}", found="no answer")
        self.shots = 0

    def open(self):
        return Summary(f"60{self.id[-1]}", "Nikon DSC D750", "100", "1/60", "f/8")

    def capture(self, _):
        self.log.append(f"capture {self.id}")
        self.shots += 1
        if self.shots == self.fail_at:
            raise self.error
        noise = 10 * self.shots + int(self.id[-1])
        data = self.make_dng(512 + int(1000 * self.lights.levels.mean()), seed=noise)
        now = time.monotonic()
        sha256 = hashlib.sha256(data).hexdigest()
        return Photograph(data, sha256, f"{self.shots}.NEF", now, now, now)

    def close(self):
        self.log.append("close")


@pytest.fixture
def parts(tmp_path, small_rig, dng):
    log: list[str] = []
    lights = Lights(log)
    cameras = [FakeCamera(c.id, log, lights, dng) for c in small_rig.cameras]
    shots = plan_shots(["full", "x+", "x-"], small_rig)
    names = [shot.pattern for shot in shots]
    writer = SessionWriter(tmp_path / "S", small_rig, names, "subject-1", "neutral", {})
    yield log, lights, cameras, shots, writer
    writer.close()


def test_each_shot_is_lit_acknowledged_taken_confirmed_in_this_order(parts, tmp_path):
    log, lights, cameras, shots, writer = parts
    report = capture(shots, lights, cameras, writer, FAST)
    assert report.frames == 9
    for shot in range(3):
        part = log[5 * shot : 5 * shot + 5]
        assert part[0] == "light"
        assert sorted(part[1:4]) == ["capture cam0", "capture cam1", "capture cam2"]
        assert part[4] == "confirm"
    assert log[15:] == ["dark"]
    session = load_session(tmp_path / "S")
    assert session.file.sequence == ["full", "x+", "x-"]
    assert np.array_equal(session.levels("x+"), shots[1].levels)


def test_the_journal_holds_what_was_acknowledged_taken_and_how_far_apart(parts, tmp_path):
    _, lights, cameras, shots, writer = parts
    report = capture(shots, lights, cameras, writer, FAST)
    events = read_journal(tmp_path / "S" / "journal.jsonl")
    kinds = [event["event"] for event in events]
    assert kinds == ["begin", *(["frame"] * 3 + ["shot"]) * 3, "end"]
    skews = [event["trigger_skew_s"] for event in events if event["event"] == "shot"]
    assert max(skews) == pytest.approx(report.max_skew_s, abs=1e-6)
    driven = next(event for event in events if event.get("pattern") == "x-" and "levels" in event)
    assert state_hash(np.array(driven["levels"])) == state_hash(shots[2].levels)


def test_a_failing_camera_leaves_the_others_photographs_and_darkness(parts, tmp_path):
    log, lights, cameras, shots, writer = parts
    cameras[1].fail_at = 2
    with pytest.raises(
        CaptureError, match=r"pattern x\+: 2 of 3 photographs kept in .*camera cam1"
    ):
        capture(shots, lights, cameras, writer, FAST)
    assert log[-1] == "dark"
    kept = sorted(p.name for p in (tmp_path / "S" / "frames" / "x+").iterdir())
    assert kept == ["cam0.dng", "cam2.dng"]
    assert not (tmp_path / "S" / "session.json").exists()
    events = read_journal(tmp_path / "S" / "journal.jsonl")
    assert [e["pattern"] for e in events if e["event"] == "shot"] == ["full"]
    assert [e["camera"] for e in events if e["event"] == "failed"] == ["cam1"]


def test_all_failing_cameras_are_told_at_once(parts):
    _, lights, cameras, shots, writer = parts
    cameras[0].fail_at = cameras[2].fail_at = 1
    with pytest.raises(CaptureError, match=r"(?s)2 problems:.*camera cam0.*camera cam2"):
        capture(shots, lights, cameras, writer, FAST)


def test_without_acknowledgement_no_camera_is_triggered(parts):
    log, lights, cameras, shots, writer = parts
    lights.fail = {"light": (1, DeviceError("LED device", found="no answer"))}
    with pytest.raises(DeviceError, match="no answer"):
        capture(shots, lights, cameras, writer, FAST)
    assert log == ["light", "dark"]


def test_a_light_that_did_not_last_makes_no_shot(parts, tmp_path):
    log, lights, cameras, shots, writer = parts
    lights.fail = {"confirm": (2, DeviceError("LED device", found="another state"))}
    with pytest.raises(DeviceError, match="another state"):
        capture(shots, lights, cameras, writer, FAST)
    assert log[-1] == "dark"
    events = read_journal(tmp_path / "S" / "journal.jsonl")
    assert [e["pattern"] for e in events if e["event"] == "shot"] == ["full"]


@pytest.mark.parametrize("error", [KeyboardInterrupt(), RuntimeError("bug"), SystemExit(3)])
def test_every_exception_ends_dark(parts, error):
    log, lights, cameras, shots, writer = parts
    lights.fail = {"confirm": (1, error)}
    with pytest.raises(type(error)):
        capture(shots, lights, cameras, writer, FAST)
    assert log[-1] == "dark"


def test_lights_that_cannot_be_put_out_are_said_beside_the_first_error(parts):
    _, lights, cameras, shots, writer = parts
    gone = DeviceError("LED device", found="the line closed")
    lights.fail = {"confirm": (1, gone), "dark": (1, gone)}
    with pytest.raises(CaptureError, match=r"(?s)line closed.*then.*lights may still be on"):
        capture(shots, lights, cameras, writer, FAST)


def test_a_second_ctrl_c_waits_until_the_lights_are_dark(parts):
    log, lights, cameras, shots, writer = parts

    def press_again():
        os.kill(os.getpid(), signal.SIGINT)
        log.append("dark done")

    lights.fail = {"confirm": (1, KeyboardInterrupt())}
    dark = lights.dark
    lights.dark = lambda: (dark(), press_again())
    with pytest.raises(KeyboardInterrupt):
        capture(shots, lights, cameras, writer, FAST)
    assert log[-2:] == ["dark", "dark done"]


def test_lights_change_no_faster_than_the_flash_limit_allows(parts):
    _, lights, cameras, shots, writer = parts
    times = []
    light = lights.light
    lights.light = lambda levels: (times.append(time.monotonic()), light(levels))[1]
    dark = lights.dark
    lights.dark = lambda: (times.append(time.monotonic()), dark())
    slow = CaptureConfig(trigger_lead_s=0.0, safety=SafetyConfig(light_interval_s=0.15))
    capture(shots, lights, cameras, writer, slow)
    assert len(times) == 4
    assert np.diff(times).min() >= 0.15


def test_the_lights_are_asked_for_their_state_while_cameras_are_slow(parts):
    _, lights, cameras, shots, writer = parts
    release = threading.Event()
    take = cameras[0].capture
    cameras[0].capture = lambda at_s: (release.wait(20), take(at_s))[1]
    confirm = lights.confirm
    asked = []

    def confirm_twice():
        confirm()
        asked.append(1)
        if len(asked) == 2:
            release.set()

    lights.confirm = confirm_twice
    assert capture(shots, lights, cameras, writer, FAST).frames == 9
    assert len(asked) == 2 + 3


def test_connecting_darkens_first_and_tells_all_problems_at_once(parts, small_rig):
    log, lights, cameras, _, _ = parts
    lights.hello = Hello(1, 7, "fake")
    cameras[2].open = lambda: Summary(None, "Other", "100", "1/60", "f/8")
    with pytest.raises(DeviceError) as caught:
        connect(small_rig, lights, cameras, [])
    said = str(caught.value)
    assert log == ["dark"]
    assert "light count: found 7, expected 8" in said
    assert "camera cam2, model: found Other" in said
    assert "camera cam2, serial: found not verifiable" in said


def test_a_shot_lasts_at_most_its_acknowledgement_and_the_cameras_deadline():
    assert worst_shot_s(CaptureConfig(), 6.0) == pytest.approx(36.02)


def test_the_files_in_the_documentation_are_taken_as_they_stand(tmp_path):
    text = (Path(__file__).parents[2] / "docs" / "capture.md").read_text()
    cameras, limits = re.findall(r"```toml\n(.*?)```", text, re.DOTALL)
    (tmp_path / "cameras.toml").write_text(cameras)
    (tmp_path / "limits.toml").write_text(limits)
    file = read_cameras_file(tmp_path / "cameras.toml")
    assert list(file.cameras) == ["cam0", "cam1", "cam2"]
    values = read_toml(tmp_path / "limits.toml")
    assert make_config(CaptureConfig, values, "limits") == CaptureConfig()
