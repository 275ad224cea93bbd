"""A rig measured from a lab's boards is the stage that they were taken with, and no other one."""

import dataclasses
import shutil

import pytest
from typer.testing import CliRunner

from lightstage.calibrations.config import CalibrationConfig
from lightstage.calibrations.folder import latest
from lightstage.calibrations.kinds import KINDS
from lightstage.calibrations.run import begin_shots, take_poses
from lightstage.calibrations.stale import use_calibrations
from lightstage.rig import Rig, default_rig, load_rig, rig_sha256
from processing.__main__ import app
from sim.devices.target_photographer import TargetPhotographer

SCALE = 0.2
"""Of the default rig's pixels: markers of the board can be read in pictures of that size."""
CONFIG = CalibrationConfig(wanted=("charuco",))


@pytest.fixture(scope="module")
def stage():
    whole = default_rig().scaled(SCALE)
    return Rig(whole.lights, whole.cameras[:3])


@pytest.fixture(scope="module")
def lab(bench, stage, tmp_path_factory):
    """The stage's shots of boards."""
    lab = tmp_path_factory.mktemp("lab")
    photographer = TargetPhotographer(stage, "charuco", 1)
    summaries = bench.summaries(stage)
    shots = begin_shots(KINDS["charuco"], lab, stage, summaries, bench.leds, CONFIG, bench.now)
    taker, holder = bench.taker(photographer), bench.holder(photographer)
    take_poses(KINDS["charuco"], shots, stage, taker, holder, CONFIG)
    return lab


def test_a_rig_measured_from_a_labs_boards_is_accepted_with_them_and_refused_with_anothers(
    bench, stage, lab, tmp_path
):
    out = tmp_path / "cameras"
    message = CliRunner().invoke(app, ["calibrate-cameras", str(lab), "--out", str(out)])
    assert message.exit_code == 0, message.output
    measured = load_rig(out / "rig.json")
    assert rig_sha256(measured) != rig_sha256(stage)

    def found(rig, lab):
        return use_calibrations(lab, rig, bench.summaries(rig), bench.leds, (), CONFIG, bench.now)

    assert found(measured, lab).findings == []
    # Another stage, one of whose lamps stands elsewhere, with shots of its own.
    moved = dataclasses.replace(stage.lights[0], position_mm=(0.0, 0.0, 901.0))
    another = dataclasses.replace(stage, lights=(moved, *stage.lights[1:]))
    shutil.copytree(lab, tmp_path / "another")
    shots = latest(tmp_path / "another", "charuco")
    shots.file = shots.file.model_copy(update={"rig_sha256": rig_sha256(another)})
    shots.save()
    assert found(another, tmp_path / "another").findings == []
    (refused,) = found(measured, tmp_path / "another").findings
    assert (refused.severity, refused.code) == ("refuse", "rig-changed")
