"""Preflight of simulated cameras in their own processes."""

import time

import numpy as np
import pytest

from lightstage.cameras.binding import (
    close_cameras,
    connect_problems,
    find_cameras,
    read_cameras_file,
)
from lightstage.leds.controller import Hello
from lightstage.preflight import (
    Plan,
    PreflightConfig,
    clear_privacy,
    drift,
    photograph_findings,
    preflight,
)
from sim.camera.dng import Exif, dng_bytes
from sim.camera.sensor import Sensor, SensorConfig
from sim.devices.faults import Fault, Story
from sim.devices.simulated_camera import SimulatedCameras


class Leds:
    """Lights that are dimmed by current."""

    hello = Hello(1, 8, "test")
    acknowledged = True
    pulse_hz = 0.0


class Bench:
    """Simulated cameras of a rig, opened each in its own process."""

    def __init__(self, rig, folder, story=None, settings=None, expect=""):
        self.rig = rig
        self.out = folder / "session"
        self.bodies = SimulatedCameras(folder / "bodies", rig, story, settings=settings)
        path = folder / "cameras.toml"
        path.write_text(expect + self.bodies.cameras_file())
        self.file = read_cameras_file(path)
        self.cameras = find_cameras(rig, self.file, 20.0, lambda _: [])
        self.summaries, problems = connect_problems(
            rig.cameras, self.cameras, self.file.allow_unverifiable
        )
        assert not problems

    def look(self):
        found = preflight(
            self.rig, self.summaries, self.file, Leds(), self.out, Plan(10), PreflightConfig()
        )
        return [(f.severity, f.code, f.camera) for f in found]

    def photograph(self, index, path):
        """What camera `index` brings home of a shot."""
        sensor = Sensor(SensorConfig(), np.eye(3), 0.03)
        own = self.rig.cameras[index]
        exif = Exif(own.model, own.serial, 16.0, 60.0)
        data = dng_bytes(np.full((48, 32), 1600, np.uint16), sensor, exif)
        self.bodies.put(own.id, data)
        exposure = self.cameras[index].trigger(time.monotonic())
        path.unlink(missing_ok=True)
        self.cameras[index].download(exposure.files[0].name, path)
        return path


@pytest.fixture
def bench(tmp_path, small_rig):
    made = []

    def make(**given):
        made.append(Bench(small_rig, tmp_path, **given))
        return made[-1]

    yield make
    for each in made:
        close_cameras(each.cameras)


def test_cameras_as_they_are_switched_on_are_ready(bench):
    assert bench().look() == []


def test_what_was_changed_on_the_cameras_is_found_by_reading_them(bench):
    settings = {
        "cam0": {"battery_percent": 7, "owner": "Ann Person"},
        "cam1": {"iso": "400", "clock_offset_s": -600.0},
        "cam2": {"mode": "A", "image_format": "RAW+JPEG", "card_bytes": 1000},
    }
    assert bench(settings=settings).look() == [
        ("refuse", "battery", "cam0"),
        ("refuse", "clock", "cam1"),
        ("refuse", "mode", "cam2"),
        ("warn", "two-files", "cam2"),
        ("refuse", "unlike", None),
        ("refuse", "privacy", "cam0"),
        ("refuse", "card-space", "cam2"),
    ]


def test_the_cameras_files_expectations_count(bench):
    expect = '[expect]\naperture = "8"\nshutter = "0.0167"\niso = "200"\n'
    settings = {"cam1": {"iso": "200"}}
    found = bench(expect=expect, settings=settings).look()
    assert found == [("refuse", "iso", "cam0"), ("refuse", "iso", "cam2")]


def test_names_are_cleared_where_that_is_asked(bench):
    names = {"owner": "Ann", "artist": "Ann", "copyright": "(c) Ann", "place": "51.5 N"}
    stage = bench(settings={"cam1": names})
    assert ("refuse", "privacy", "cam1") in stage.look()
    stage.summaries = clear_privacy(stage.cameras)
    assert stage.look() == []
    assert stage.cameras[1].summary().owner == ""


def test_a_setting_that_drifts_shows_in_the_camera_and_in_its_photograph(
    bench, tmp_path, small_rig
):
    story = Story((Fault("wrong-iso", camera="cam1", at=2, value="400"),))
    stage = bench(story=story)
    before = stage.summaries["cam1"]

    def look():
        path = stage.photograph(1, tmp_path / "a.dng")
        found = photograph_findings(path, small_rig.cameras[1], before)
        return [(f.severity, f.code) for f in found]

    assert look() == []
    assert drift(before, stage.cameras[1].summary(), "cam1") == []
    assert look() == [("retake", "drift")]
    (finding,) = drift(before, stage.cameras[1].summary(), "cam1")
    assert (finding.severity, finding.found) == ("refuse", "400")


def test_a_photograph_of_another_camera_is_reported_by_the_serial_in_it(bench, tmp_path, small_rig):
    stage = bench()
    path = stage.photograph(0, tmp_path / "a.dng")
    (finding,) = photograph_findings(path, small_rig.cameras[2], stage.summaries["cam2"])
    assert (finding.severity, finding.code) == ("refuse", "wrong-camera")
