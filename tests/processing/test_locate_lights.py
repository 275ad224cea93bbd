"""Which lamp is on which wire, found from mirror balls of a stage that is wired by chance."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from lightstage.rig import LightAddress, Rig, default_rig, load_rig, save_rig
from processing.__main__ import app
from processing.calibration.lights.highlights import Highlights
from processing.calibration.lights.mirror_ball import Seen
from processing.calibration.lights.wiring import CLEAR, Wiring, find_wiring, sure_lamps
from sim.devices.target_stage import TargetStage
from sim.devices.wiring import shuffled_wires
from sim.targets.ball import Ball, highlights_mm
from tests.forked import quickly
from tests.processing.balls_in_stage import RADIUS_MM, displaced, small_rig

QUICK = "[safety]\nlight_interval_s = 0.0\nmax_flashes_per_s = 30.0\n"


def turned(camera, degrees, rng):
    """The camera as it really hangs: turned by so much about any axis."""
    axis = rng.normal(size=3)
    x, y, z = np.radians(degrees) * axis / np.linalg.norm(axis)
    turn = np.eye(3) + np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    u, _, v = np.linalg.svd(turn)
    return dataclasses.replace(camera, cam_from_world=(u @ v) @ camera.cam_from_world)


def looked_at(
    rig: Rig,
    seed: int,
    *,
    off_mm: float = 5.0,
    noise_px: float = 0.1,
    missing: float = 0.0,
    aim_deg: float = 0.0,
    longer: float = 1.0,
    window: int = 0,
) -> tuple[Wiring, np.ndarray]:
    """The wiring found and the lamp that each wire really lights.

    Lamps stand elsewhere than the rig says, some highlights are missing, cameras are aimed
    elsewhere and have longer lenses; `window` wires show one and the same place in place of a lamp.
    """
    rng = np.random.default_rng(seed)
    true = displaced(rig, off_mm, seed + 1)
    count = len(rig.lights)
    lamp_of = rng.permutation(count)
    wire_of = np.argsort(lamp_of)
    ball = Ball(np.array([20.0, -15.0, 12.0]), RADIUS_MM, 0.6)
    seen = []
    for camera in rig.cameras:
        real = turned(camera, aim_deg, rng)
        real = dataclasses.replace(real, fx_px=real.fx_px * longer, fy_px=real.fy_px * longer)
        px = real.project(highlights_mm(ball, real, true.positions_mm))[0]
        there = np.isfinite(px).all(axis=1) & (rng.random(count) >= missing)
        wires, px = wire_of[there], px[there] + noise_px * rng.normal(size=(there.sum(), 2))
        px[wires < window] = np.median(px, axis=0) + np.array([5.0, 3.0])
        found = Highlights(px, np.ones((len(px), 3)))
        unknown = np.full((len(px), 3), np.nan)
        signature, level = np.full((count, 3), np.nan), np.ones(count)
        seen.append(Seen(0, camera, found, wires, unknown, signature, level, 0.0))
    return find_wiring(seen, rig, RADIUS_MM), lamp_of


NINE, THREE = small_rig(9, 0.12), small_rig(3, 0.12)


@pytest.mark.parametrize(
    ("rig", "flaws"),
    [
        (NINE, {}),
        (NINE, {"missing": 0.2}),
        (THREE, {"off_mm": 2.0}),
        (NINE, {"aim_deg": 3.0}),
        (NINE, {"aim_deg": 1.0, "longer": 1.05}),
    ],
)
def test_all_168_lamps_are_found_however_the_stage_is_wired(rig, flaws):
    found, lamp_of = looked_at(rig, 0, **flaws)
    assert np.array_equal(found.lamp, lamp_of)
    assert not any(found.maybe)


@pytest.mark.parametrize(
    ("rig", "flaws"),
    [
        (NINE, {"off_mm": 18.0}),
        (NINE, {"noise_px": 1.0}),
        (THREE, {"off_mm": 10.0, "aim_deg": 2.0, "longer": 1.03}),
    ],
)
def test_what_is_not_sure_is_reported_and_never_guessed(rig, flaws):
    found, lamp_of = looked_at(rig, 1, **flaws)
    sure = found.lamp >= 0
    assert 0.8 < sure.mean() < 1
    assert np.array_equal(found.lamp[sure], lamp_of[sure])
    for wire in np.flatnonzero(~sure):
        # No lamp is near, or the right one is among those that are.
        assert lamp_of[wire] in found.maybe[wire] or not found.maybe[wire]


def test_wires_that_show_a_window_are_not_sure():
    found, lamp_of = looked_at(NINE, 3, window=2)
    assert (found.lamp[:2] == -1).all()
    assert np.array_equal(found.lamp[2:], lamp_of[2:])


def test_a_wire_that_no_camera_saw_is_not_sure_and_takes_no_lamp():
    found, _ = looked_at(small_rig(1, 0.12), 0, missing=0.1)
    unseen = found.sightings == 0
    assert unseen.any()
    assert (found.lamp[unseen] == -1).all()
    assert np.isinf(found.off_mm[unseen]).all()


@given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 12),
    st.floats(0, 1),
    st.sampled_from([0.0, 0.2, 0.7]),
)
@settings(max_examples=200)
def test_a_sure_lamp_is_near_clearly_nearest_and_of_one_wire(seed, count, spread, unknown):
    rng = np.random.default_rng(seed)
    table = np.where(np.eye(count) > 0, spread, 4.0) * rng.random((count, count))
    table[rng.random(table.shape) < unknown] = np.inf
    table = rng.permutation(table, axis=1)
    lamp = sure_lamps(table, 1.0)
    sure = lamp[lamp >= 0]
    assert len(set(sure)) == len(sure)
    for wire, own in enumerate(lamp):
        if own < 0:
            continue
        assert table[wire, own] == table[wire].min() <= 1.0
        others = [k for k in range(count) if k not in sure]
        assert all(table[wire, own] < CLEAR * table[wire, k] for k in others)


class Stage:
    """A few lamps around a mirror ball, wired otherwise than the rig says, and photographed."""

    def __init__(self, folder: Path) -> None:
        rig = default_rig().scaled(0.12)
        rig = dataclasses.replace(rig, lights=rig.lights[::17], cameras=rig.cameras[:2])
        self.count = len(rig.lights)
        self.rig = rig.readdressed([LightAddress(i) for i in range(self.count)])
        self.wires = shuffled_wires(self.rig, 5)
        self.lost = int(np.flatnonzero(self.wires == 3)[0])
        self.folder = folder
        config = folder / "config.toml"
        config.write_text(QUICK)
        self.whole = self._lab("whole", config, self.wires)
        unplugged = self.wires.copy()  # on a channel more that nobody lights
        unplugged[self.lost] = self.count
        self.unplugged = self._lab("unplugged", config, unplugged)

    def _lab(self, name: str, config: Path, wires: np.ndarray) -> Path:
        lab = self.folder / name
        with TargetStage(self.folder / f"{name}-desk", self.rig, "mirror", wires=wires) as stage:
            more = ("--every-light", "--poses", "1", "--config", str(config))
            done = stage.calibrate(lab, "mirror", *more, answers=["", *["k"] * 9])
        assert done.returncode == 0, done.stderr
        return lab


@pytest.fixture(scope="module")
def stage(tmp_path_factory) -> Stage:
    with quickly():
        return Stage(tmp_path_factory.mktemp("wired"))


def located(*words: object):
    return CliRunner().invoke(app, ["locate-lights", *map(str, words)])


def test_a_stage_wired_by_chance_is_photographed_and_every_address_found(stage, tmp_path):
    out = tmp_path / "rig.json"
    done = located(stage.whole, "--out", out, "--json")
    assert done.exit_code == 0, done.output
    assert [a.channel for a in load_rig(out).addresses] == stage.wires.tolist()
    facts = json.loads(done.stdout.splitlines()[-1])
    assert (facts["found"], facts["unsure"]) == (stage.count, [])
    assert facts["changed"] == int((stage.wires != np.arange(stage.count)).sum())
    assert facts["worst_mm"] < 1.0


def test_addresses_are_written_into_another_rig_of_the_same_lights(stage, tmp_path):
    measured = dataclasses.replace(stage.rig, more={"note": "measured"})
    rig = save_rig(measured, tmp_path / "measured.json")
    done = located(stage.whole, "--rig", rig, "--out", rig)
    assert done.exit_code == 0, done.output
    assert json.loads(rig.read_text())["note"] == "measured"
    assert [a.channel for a in load_rig(rig).addresses] == stage.wires.tolist()
    assert f"{stage.count} of {stage.count} lamps found" in done.stdout
    fewer = save_rig(dataclasses.replace(stage.rig, lights=stage.rig.lights[1:]), rig)
    refused = located(stage.whole, "--rig", fewer, "--out", tmp_path / "new.json")
    assert "other ids than the shots'" in str(refused.exception)


def test_an_unplugged_lamp_is_named_and_nothing_is_written(stage, tmp_path):
    out = tmp_path / "rig.json"
    refused = str(located(stage.unplugged, "--out", out).exception)
    assert re.search(r"found 1 wire whose lamp is not sure: channel 3 \(meant for ", refused)
    assert "no highlight in any camera" in refused
    assert not out.exists()
    done = located(stage.unplugged, "--out", out, "--allow-unsure")
    assert done.exit_code == 0, done.output
    assert "1 not sure" in done.stdout
    # The only lamp that is left has the only channel that is left.
    assert [a.channel for a in load_rig(out).addresses] == stage.wires.tolist()
