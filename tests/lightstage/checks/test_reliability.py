"""Pictures that cannot carry a measure give no finding of it."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.check_faults import BINARY
from lightstage.checks.noise import fit_noise
from lightstage.checks.photo_measures import BAYER, measure_counts
from lightstage.checks.sharpness import sharpness
from lightstage.checks.shot import ShotChecks
from lightstage.checks.subject_motion import sum_shift
from lightstage.patterns import pattern_levels
from lightstage.sequence import Shot
from sim.camera.optics import defocus

BLACK, WHITE = 512.0, 16383.0


def photo_of(counts):
    size = counts.shape[1], counts.shape[0]
    place = Path("made")
    return measure_counts(counts, BAYER, BLACK, WHITE, size, "raw", place, 192, WHITE - BLACK)


def even(level, rng, shape=(48, 32)):
    """An even picture: counts of a level and noise without structure."""
    return photo_of((BLACK + level + rng.integers(0, 8, shape)).astype(np.uint16))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("shape", [(48, 32), (96, 64), (240, 160)])
def test_even_pictures_of_nothing_but_noise_show_no_motion_and_no_blur(stage, seed, shape):
    rng = np.random.default_rng(seed)
    checks = ShotChecks(stage.rig, [Shot(p, pattern_levels(p, stage.rig)) for p in BINARY])
    codes = set()
    for pattern in BINARY:
        level = 1000 * pattern_levels(pattern, stage.rig).mean()
        for camera in stage.cameras:
            checks.add(pattern, camera, even(level, rng, shape))
        codes |= {finding.code for finding in checks.shot(pattern)}
    assert not codes & {"motion", "camera-moved", "blurred"}


def test_a_shift_is_known_only_where_edges_stand_above_the_noise(stage):
    parts = [stage.photo("cam1", name) for name in ("x+", "x-", "full")]
    shift = sum_shift(*parts)
    assert shift is not None
    assert shift.error_px > 0
    rng = np.random.default_rng(1)
    assert sum_shift(even(400, rng), even(600, rng), even(1000, rng)) is None


def test_noise_of_a_tiny_picture_is_not_underestimated():
    rng = np.random.default_rng(0)
    level = rng.uniform(0.1, 1.0, 400)
    for pairs in (1, 2, 4, 8):
        variance = 3e-4 * rng.chisquare(pairs, 400) / pairs
        line = fit_noise(level, variance, pairs)
        assert line[0] + line[1] * 0.5 == pytest.approx(3e-4, rel=0.3)


def test_a_small_picture_shows_nothing_about_focus(stage):
    light = stage.see("cam1", "full")[100:140, 60:100]
    soft = defocus(light, np.full(light.shape[:2], 3.0))
    assert sharpness(stage.expose("cam1", soft), stage.expose("cam1", light)) is None


def test_a_dim_photograph_is_no_reference_and_is_not_called_blurred_by_its_noise(stage):
    session = ("full", *stage.lamps)
    assert [f for f in stage.found(session, stage.photo) if f.code == "blurred"] == []

    def dim(camera, pattern):
        light = stage.see(camera, "full") * np.float32(0.01 if pattern != "full" else 1.0)
        return stage.expose(camera, light, seed=1)

    assert [f for f in stage.found(session, dim) if f.code == "blurred"] == []


def test_half_a_face_in_the_dark_is_no_blur_and_a_blurred_half_is(stage):
    for pattern in BINARY[1:]:
        ratio = sharpness(stage.photo("cam1", pattern), stage.photo("cam1", "full"))
        assert ratio is None or ratio > 0.9
    light = stage.see("cam1", "x+")
    soft = stage.expose("cam1", defocus(light, np.full(light.shape[:2], 3.0)))
    ratio = sharpness(soft, stage.photo("cam1", "full"))
    assert ratio is not None
    assert ratio < 0.65
