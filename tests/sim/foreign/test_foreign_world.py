"""Photographs with Mitsuba's own materials: light, textures' places, shadows."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import sim.foreign.world
from sim.errors import SimError
from sim.foreign.cameras import Glare
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


def test_a_matt_plane_obeys_inverse_square_and_cosine() -> None:
    place = np.array([400.0, 0.0, 400.0])
    rig = stage(place[None], 4, 4, 20.0)
    lamps = lamps_of(rig, LampConfig(radius_mm=0.0, exponent=0.0))
    world = ForeignWorld(plane(albedo=0.5, specular=0.0), rig, "lambert-ggx", lamps, samples=1)
    found = world.photograph("cam0", np.ones((1, 1)))[0, ..., 1]
    _, points = world._seen(rig.cameras[0])
    toward = place - points.position
    distance = np.linalg.norm(toward, axis=1)
    at_origin = np.linalg.norm(place)
    # A white diffuser at the origin that faces the lamp reads its weight.
    known = 0.5 * lamps.weights[0, 1] * (at_origin / distance) ** 2 * toward[:, 2] / distance
    np.testing.assert_allclose(found[found > 0], known, rtol=1e-4)


@pytest.mark.parametrize("kind", MATERIALS)
def test_a_texture_lies_where_our_own_renderer_has_it(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sim.foreign.world, "TEXEL_MM", 5.0)
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


def test_a_disc_lights_as_its_points_do_and_its_shadow_is_soft() -> None:
    rig = stage(np.array([[-900.0, 0, 300.0]]), 32, 32, 60.0)
    shown = []
    for radius_mm in (0.0, 60.0):
        lamps = lamps_of(rig, LampConfig(radius_mm=radius_mm))
        world = ForeignWorld(corner(specular=0.0), rig, "lambert-ggx", lamps)
        shown.append(world.photograph("cam0", np.ones((1, 1)))[0, ..., 1])
    point, disc = shown
    assert disc.sum() == pytest.approx(point.sum(), rel=0.02)
    bright = point.max()
    between = [((image > 0.1 * bright) & (image < 0.5 * bright)).sum() for image in shown]
    assert between[1] > between[0]


def test_a_materials_mirror_and_body_are_the_subjects_textures() -> None:
    """At normal incidence, lit and seen along the normal, a rough mirror of F0 adds F0 D / 4."""
    alpha, f0, albedo = 0.4, 0.03, 0.5
    rig = stage(np.array([[0.0, 0, 1000.0]]), 2, 2, 1.0)
    lamps = lamps_of(rig, LampConfig(radius_mm=0.0, exponent=0.0))
    peak = f0 / (np.pi * alpha**2) / 4
    for kind, rel in (("lambert-ggx", 0.05), ("principled", 0.05), ("roughplastic", 0.12)):
        both = [
            float(
                ForeignWorld(
                    plane(albedo=albedo, specular=specular, roughness=alpha), rig, kind, lamps, 1
                ).photograph("cam0", np.ones((1, 1)))[0, 0, 0, 1]
            )
            for specular in (0.01, f0)
        ]
        # A white diffuser would read 1, which is pi times its light. What the blend mirrors is no
        # part of its body.
        body = [albedo * (1 - f if kind == "lambert-ggx" else 1) for f in (0.01, f0)]
        added = (both[1] - both[0] - (body[1] - body[0])) / np.pi
        assert added == pytest.approx(peak * (1 - 0.01 / f0), rel=0.1), kind
        assert both[1] - np.pi * peak == pytest.approx(body[1], rel=rel), kind


def test_a_stretched_mirror_turns_with_its_direction_and_a_round_one_does_not() -> None:
    rig = stage(np.array([[300.0, 0, 950.0], [0.0, 300.0, 950.0]]), 2, 2, 1.0)
    lamps = lamps_of(rig, LampConfig(radius_mm=0.0, exponent=0.0))
    seen = {}
    for stretch in (1.0, 2.0):
        world = ForeignWorld(
            plane(albedo=0.0, roughness=0.15), rig, "lambert-ggx", lamps, 1, stretch=stretch
        )
        seen[stretch] = world.photograph("cam0", np.eye(2))[:, 0, 0, 1]
    assert seen[1.0][0] == pytest.approx(seen[1.0][1], rel=0.02)
    assert max(seen[2.0]) > 1.5 * min(seen[2.0])
    with pytest.raises(SimError, match=r"1\.5 of principled, expected 1: it is round"):
        material("principled", plane(), 1.5)


def test_even_light_stays_even_when_it_wanders_and_an_edge_softens_most_in_red() -> None:
    flat = plane(size_mm=60.0, albedo=0.5, specular=0.0)
    rig = stage(np.array([[0.0, 0, 9000.0]]), 40, 40, 40.0)
    lamps = lamps_of(rig, LampConfig(radius_mm=0.0, exponent=0.0))
    shown = [
        ForeignWorld(flat, rig, kind, lamps, 1).photograph("cam0", np.ones((1, 1)))[0]
        for kind in ("lambert-ggx", "burley")
    ]
    np.testing.assert_allclose(shown[1], shown[0], rtol=2e-3)
    folded = corner(specular=0.0)
    rig = stage(np.array([[-900.0, 0, 300.0]]), 64, 16, 60.0)
    soft = ForeignWorld(folded, rig, "burley", samples=1).photograph("cam0", np.ones((1, 1)))[0]
    sharp = ForeignWorld(folded, rig, "lambert-ggx", samples=1).photograph("cam0", np.ones((1, 1)))[
        0
    ]
    assert np.isfinite(soft).all()
    dark = (sharp[..., 1] == 0) & (sharp.sum(axis=2) == 0)
    spilt = soft[dark].sum(axis=0)
    assert spilt[0] >= spilt[1] >= spilt[2]


def test_an_effect_is_what_photographs_show_and_not_what_is_relit() -> None:
    rig = stage(np.array([[0.0, 0, 1000.0]]), 16, 16, 90.0)
    world = ForeignWorld(plane(), rig, "lambert-ggx", samples=1, effect=Glare(veil=0.1))
    plain = ForeignWorld(plane(), rig, "lambert-ggx", samples=1)
    clear, veiled = (w.photograph("cam0", np.ones((1, 1)))[0] for w in (plain, world))
    assert (clear[0, 0] == 0).all()
    assert (veiled[0, 0] > 0.05 * clear.mean(axis=(0, 1))).all()
    assert world.with_subject(plane()).photograph("cam0", np.ones((1, 1)))[0].min() > 0


def test_what_is_no_material_and_what_has_no_llvm_is_refused() -> None:
    with pytest.raises(SimError, match="expected lambert-ggx, principled, roughplastic, burley"):
        material("wax", ball_subject())
    rig = stage(np.array([[0.0, 0, 900.0]]), 4, 4, 20.0)
    with pytest.raises(SimError, match="Mitsuba's scalar_rgb, expected llvm_ad_rgb"):
        ForeignWorld(plane(), rig, "principled", variant=SCALAR)
