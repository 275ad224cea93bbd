"""Targets before the cameras show what the lamps show, in the pose that is held."""

import numpy as np
import pytest
import rawpy

from lightstage.calibrations.config import KIND_NAMES
from lightstage.calibrations.kinds import KINDS
from lightstage.patterns import drive_levels
from lightstage.rig import Rig, default_rig
from sim.devices.target_photographer import TargetPhotographer
from sim.errors import SimError

BLACK, WHITE = 600, 16383


@pytest.fixture(scope="module")
def rig():
    whole = default_rig().scaled(0.05)
    return Rig(whole.lights, whole.cameras[:2])


def counts(photographer, camera, levels, path):
    path.write_bytes(photographer.photograph(camera, levels))
    with rawpy.imread(str(path)) as raw:
        return raw.raw_image_visible.astype(float) - BLACK


@pytest.mark.parametrize("kind", KIND_NAMES)
def test_light_is_the_lamps_and_nothing_clips(rig, tmp_path, kind):
    photographer = TargetPhotographer(rig, kind, 3)
    full, camera = drive_levels("full", rig, KINDS[kind].drive), rig.cameras[0]
    whole = counts(photographer, camera, full, tmp_path / "a.dng")
    half = counts(photographer, camera, full / 2, tmp_path / "b.dng")
    none = counts(photographer, camera, full * 0, tmp_path / "c.dng")
    assert abs(none.mean()) < 1
    if kind == "dark":
        assert abs(whole.mean()) < 1
        return
    assert whole.max() < WHITE - BLACK
    assert whole.max() > 0.3 * (WHITE - BLACK)
    assert abs(half.sum() / whole.sum() - 0.5) < 0.02


@pytest.mark.parametrize("kind", ["charuco", "chart", "mirror"])
def test_another_pose_is_another_picture_and_the_same_one_differs_by_noise(rig, tmp_path, kind):
    photographer = TargetPhotographer(rig, kind, 3)
    full, camera = np.ones(len(rig.lights)), rig.cameras[0]
    first = counts(photographer, camera, full, tmp_path / "a.dng")
    again = counts(photographer, camera, full, tmp_path / "b.dng")
    photographer.pose = 1
    other = counts(photographer, camera, full, tmp_path / "c.dng")
    assert 0 < np.abs(first - again).mean() < 0.1 * np.abs(first - other).mean()


def test_settings_are_those_of_the_photographs(rig, tmp_path):
    photographer = TargetPhotographer(rig, "mirror", 3)
    stated = photographer.settings()["cam1"]
    assert float(stated["shutter"]) > 0
    assert stated["iso"] == "100"
    assert stated["aperture"].startswith("f/")


def test_an_unknown_target_is_refused(rig):
    with pytest.raises(SimError, match="target: found 'cube', expected one of charuco"):
        TargetPhotographer(rig, "cube", 1)


def test_chart_and_dark_are_exposed_alike_as_sessions_need_them(rig):
    chart, dark = (TargetPhotographer(rig, kind, 3) for kind in ("chart", "dark"))
    assert chart.settings() == dark.settings()
    assert chart.settings() != TargetPhotographer(rig, "mirror", 3).settings()
