"""Photographs with Mitsuba's own materials: light, textures' places, shadows."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from sim.errors import SimError
from sim.foreign import materials
from sim.foreign.materials import MATERIALS, material
from sim.foreign.world import ForeignWorld
from sim.light.lamps import LampConfig, lamps_of
from sim.light.world import World
from sim.reference.variant import LLVM, SCALAR, find_variant
from tests.sim.conftest import ball_subject, small_rig
from tests.sim.reference.surfaces import corner, plane, stage

pytest.importorskip("mitsuba", reason="needs the extra `reference`")
if find_variant() != LLVM:
    pytest.skip("Mitsuba finds no LLVM here", allow_module_level=True)


def test_a_matt_plane_obeys_inverse_square_and_cosine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(materials, "MIRROR_SHARE", 0.0)
    place = np.array([400.0, 0.0, 400.0])
    rig = stage(place[None], 4, 4, 20.0)
    lamps = lamps_of(rig, LampConfig(radius_mm=0.0, exponent=0.0))
    world = ForeignWorld(plane(albedo=0.5), rig, "lambert-ggx", lamps, samples=1)
    found = world.photograph("cam0", np.ones((1, 1)))[0, ..., 1]
    _, points = world._seen(rig.cameras[0])
    toward = place - points.position
    distance = np.linalg.norm(toward, axis=1)
    at_origin = np.linalg.norm(place)
    # A white diffuser at the origin that faces the lamp reads its weight.
    known = 0.5 * lamps.weights[0, 1] * (at_origin / distance) ** 2 * toward[:, 2] / distance
    np.testing.assert_allclose(found[found > 0], known, rtol=1e-4)


@pytest.mark.parametrize("kind", MATERIALS)
def test_a_texture_lies_where_our_own_renderer_has_it(kind: str) -> None:
    rng = np.random.default_rng(0)
    ball = ball_subject()
    rows, columns = ball.diffuse_albedo.shape[:2]
    tiles = rng.uniform(0.05, 0.9, (6, 4, 3)).repeat(-(-rows // 6), 0).repeat(-(-columns // 4), 1)
    ball = dataclasses.replace(ball, diffuse_albedo=tiles[:rows, :columns].astype(np.float32))
    rig = dataclasses.replace(small_rig(), cameras=small_rig().cameras[:1])
    levels = np.ones((1, len(rig.lights)))
    world = ForeignWorld(ball, rig, kind, samples=1)
    camera = rig.cameras[0].id
    found, own = world.photograph(camera, levels)[0], World(ball, rig).photograph(camera, levels)[0]
    assert np.isfinite(found).all()
    assert (found >= 0).all()
    both = (found.sum(axis=2) > 0) & (own.sum(axis=2) > 0)
    assert both.mean() > 0.1
    assert np.corrcoef(found[both].ravel(), own[both].ravel())[0, 1] > 0.95


def test_photographs_add_up_and_walls_cast_shadows() -> None:
    rig = stage(np.array([[-900.0, 0, 300.0], [900.0, 0, 300.0]]), 24, 24, 60.0)
    world = ForeignWorld(corner(), rig, "lambert-ggx", samples=1)
    left, right, both = world.photograph("cam0", np.array([[1.0, 0], [0, 1.0], [1.0, 1.0]]))
    np.testing.assert_allclose(left + right, both, atol=1e-5)
    # A lamp low on one side lights the far wall and not the near one.
    assert left[:, :8].sum() < 0.1 * left[:, -8:].sum()
    assert right[:, -8:].sum() < 0.1 * right[:, :8].sum()


def test_what_is_no_material_and_what_has_no_llvm_is_refused() -> None:
    with pytest.raises(SimError, match="expected lambert-ggx, principled, roughplastic"):
        material("wax", ball_subject())
    rig = stage(np.array([[0.0, 0, 900.0]]), 4, 4, 20.0)
    with pytest.raises(SimError, match="Mitsuba's scalar_rgb, expected llvm_ad_rgb"):
        ForeignWorld(plane(), rig, "principled", variant=SCALAR)
