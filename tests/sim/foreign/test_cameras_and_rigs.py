"""Stray light, another sensor, and lights on the splitting planes."""

from __future__ import annotations

import numpy as np

from lightstage.patterns import pattern_levels
from lightstage.rig import default_rig
from sim.foreign.cameras import Glare, Grain
from sim.foreign.rigs import on_planes


def spot(value: float = 1.0) -> np.ndarray:
    picture = np.zeros((2, 60, 80, 3), np.float32)
    picture[0, 10:20, 15:25] = value
    return picture


def test_glare_moves_light_and_makes_none_and_its_ghost_lies_opposite() -> None:
    glare = Glare(veil=0.02, haze=0.0, ghost=0.05)
    shown = glare("cam0", spot())
    assert not shown[1].any()
    np.testing.assert_allclose(shown[0].sum(), spot()[0].sum(), rtol=1e-3)
    np.testing.assert_allclose(shown[0, 15, 20], 0.93, rtol=0.01)
    assert shown[0, 45, 60, 0] > 5 * shown[0, 45, 20, 0] > 0
    np.testing.assert_allclose(glare("cam0", 3 * spot()), 3 * shown, rtol=1e-5)


def test_grain_is_of_photons_rows_and_unlike_pixels() -> None:
    flat = np.full((2, 200, 300, 3), 0.5, np.float32)
    whole = Grain(seed=4)("cam0", flat)
    np.testing.assert_array_equal(whole, Grain(seed=4)("cam0", flat))
    assert not np.array_equal(whole, Grain(seed=4)("cam1", flat))
    assert abs(float(whole.mean()) - 0.5) < 0.002
    electrons = 15_000 / 1.1
    # Of two pictures' difference the unlike gains fall out; photons are left.
    photons = float((whole[0] - whole[1]).std()) / np.sqrt(2) / 0.5 * electrons
    assert 0.9 < photons / np.sqrt(electrons) < 1.15
    alone = Grain(row_e=0.0, read_e=0.0, full_well_e=1e9, bits=40)("cam0", flat)
    assert 0.009 < float(alone[0].std()) / 0.5 < 0.011
    np.testing.assert_allclose(alone[0], alone[1], rtol=1e-3)
    dark = Grain(read_e=0.0, row_e=20.0)("cam0", np.concatenate([0 * flat[:1], flat[:1]]))
    assert np.ptp(dark[0], axis=(1, 2)).max() < 1e-6
    assert dark[0, :, 0, 0].std() > 0


def test_lights_on_the_planes_are_half_on_and_none_stands_on_another() -> None:
    rig = on_planes(default_rig())
    place = rig.positions_mm
    before = np.linalg.norm(default_rig().positions_mm, axis=1)
    np.testing.assert_allclose(np.linalg.norm(place, axis=1), before)
    assert ((place == 0).sum(axis=0) >= 12).all()
    apart = np.linalg.norm(place[:, None] - place, axis=2) + 1e9 * np.eye(len(place))
    assert apart.min() > 50
    full, plus, minus = (pattern_levels(name, rig) for name in ("full", "x+", "x-"))
    split = place[:, 0] == 0
    np.testing.assert_allclose(plus[split], full[split] / 2)
    np.testing.assert_allclose(plus + minus, full)
