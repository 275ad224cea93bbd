"""Polarised photographs: cross is matte, twice cross is the diffuse light, Mitsuba agrees."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from lightstage.commands import quiet
from lightstage.formats.exr import read_exr
from lightstage.formats.session import load_session
from lightstage.patterns import pattern_levels
from lightstage.rig import Rig, default_rig
from sim.errors import SimError
from sim.light.lamps import Lamps
from sim.light.olat import shade, states
from sim.light.polarised import (
    PolarisedWorld,
    PolariserConfig,
    facet_shares,
    filters,
    lamp_axes,
    lens_axis,
    seen_through,
)
from sim.light.polarised_factors import polarised_factors
from sim.light.scene import Scene
from sim.light.world import World
from sim.people.subject import Subject
from sim.session import SessionConfig, write_direct
from tests.sim.conftest import ball_mesh, ball_subject

NONE = PolariserConfig(lamp_extinction=1.0, lens_extinction=1.0)
PERFECT = PolariserConfig(lamp_extinction=np.inf, lens_extinction=np.inf)


@pytest.fixture(scope="module")
def stage() -> World:
    """The ball in the default rig's lights, seen by two of its cameras, small."""
    rig = default_rig()
    rig = dataclasses.replace(rig, cameras=(rig.camera("cam0"), rig.camera("cam4")))
    return World(ball_subject(), rig.scaled(64 / 6016))


def parts(world: World, name: str, config: PolariserConfig | None) -> tuple[np.ndarray, np.ndarray]:
    """Diffuse and specular green light (n,) of camera 0's pixels under a pattern."""
    surface, lamps = world.surfaces["cam0"], world.lamps
    camera = world.rig.camera("cam0")
    weights = pattern_levels(name, world.rig)[None, :, None] * lamps.weights
    bits = world.scene.visible_lights(surface, lamps.positions_mm)
    fields = (surface.position, surface.geometric, surface.normal, surface.view)
    skin = (surface.albedo, surface.specular, surface.roughness, bits)
    optics = None if config is None else filters(world.rig, camera, config)
    body, mirror = [], []
    for _, diffuse, specular in states(*fields, *skin, lamps, weights, optics=optics):
        body.append(diffuse[0, :, 1])
        mirror.append(specular[0, :, 1])
    return np.concatenate(body), np.concatenate(mirror)


def test_lamps_fields_lie_across_their_rays_and_the_banks_at_right_angles() -> None:
    rig = default_rig()
    axes, toward = lamp_axes(rig), rig.positions_mm / 1250
    np.testing.assert_allclose(np.einsum("mk,mk->m", axes, toward), 0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(axes, axis=1), 1, atol=1e-12)
    horizontal = np.array([light.bank == "horizontal" for light in rig.lights])
    np.testing.assert_allclose(axes[horizontal, 1], 0, atol=1e-12)
    swapped = dataclasses.replace(
        rig,
        lights=tuple(
            dataclasses.replace(x, bank="vertical" if x.bank == "horizontal" else "horizontal")
            for x in rig.lights
        ),
    )
    np.testing.assert_allclose(np.einsum("mk,mk->m", axes, lamp_axes(swapped)), 0, atol=1e-12)


def test_a_lens_passes_the_upright_field() -> None:
    for camera in default_rig().cameras[:5]:
        np.testing.assert_allclose(lens_axis(camera, PolariserConfig()), [0, 1, 0], atol=1e-9)
        flat = lens_axis(camera, PolariserConfig(lens_deg=0.0))
        assert abs(flat[1]) < 1e-9


def test_without_polarisers_a_polarised_photograph_is_the_plain_one(stage: World) -> None:
    levels = np.stack([pattern_levels(name, stage.rig) for name in ("full", "x+@cross")])
    np.testing.assert_allclose(
        PolarisedWorld(stage, NONE).photograph("cam0", levels),
        stage.photograph("cam0", levels),
        rtol=2e-5,
        atol=1e-6,
    )


def test_twice_the_cross_shot_is_the_diffuse_light_of_its_bank(stage: World) -> None:
    """Within 3 % where the ball faces the camera; refraction polarises more toward its rim."""
    plain, _ = parts(stage, "full@cross", None)
    cross, _ = parts(stage, "full@cross", PERFECT)
    off = np.abs(2 * cross / plain - 1)
    facing = stage.surfaces["cam0"].normal[:, 2] > 0.7
    assert off[facing].max() < 0.05
    assert np.median(off[facing]) < 0.02
    assert np.median(off) < 0.03


def test_cross_keeps_little_specular_light_and_parallel_keeps_it(stage: World) -> None:
    """Stated leakage, ball, frontal camera, extinction 1000: under 6 % everywhere of the peak."""
    _, plain = parts(stage, "full@cross", None)
    _, cross = parts(stage, "full@cross", PolariserConfig())
    _, plain_parallel = parts(stage, "full@parallel", None)
    _, parallel = parts(stage, "full@parallel", PolariserConfig())
    middle = stage.surfaces["cam0"].normal[:, 2] > 0.8
    assert np.median(cross[middle] / plain[middle]) < 0.06
    assert np.median(parallel[middle] / plain_parallel[middle]) > 0.7


@pytest.mark.parametrize(("below_deg", "most"), [(15.0, 0.003), (30.0, 0.016), (60.0, 0.14)])
def test_the_leakage_of_cameras_on_the_equator_stays_below_what_is_stated(
    below_deg: float, most: float
) -> None:
    rig = default_rig()
    horizontal = np.array([light.bank == "horizontal" for light in rig.lights])
    for camera in rig.cameras[:5]:
        incidence, share = facet_shares(rig, camera)
        assert share[horizontal & (incidence < below_deg)].max() < most


def test_upright_lenses_leak_a_tenth_of_what_horizontal_ones_do() -> None:
    rig = default_rig()
    horizontal = np.array([light.bank == "horizontal" for light in rig.lights])
    leaks = []
    for angle, bank in ((90.0, horizontal), (0.0, ~horizontal)):
        incidence, share = facet_shares(rig, rig.cameras[0], PolariserConfig(lens_deg=angle))
        leaks.append(share[bank & (incidence < 60)].mean())
    assert leaks[0] < 0.05
    assert leaks[1] > 10 * leaks[0]


def test_worse_polarisers_leak_more() -> None:
    rig = default_rig()
    horizontal = np.array([light.bank == "horizontal" for light in rig.lights])
    leaks = []
    for extinction in (np.inf, 1000.0, 100.0, 10.0):
        config = PolariserConfig(extinction, extinction)
        incidence, share = facet_shares(rig, rig.cameras[0], config)
        leaks.append(share[horizontal & (incidence < 15)].max())
    assert leaks == sorted(leaks)
    assert leaks[0] < 2e-4


@pytest.mark.parametrize(
    "wrong", [{"lamp_extinction": 0.5}, {"lens_extinction": np.nan}, {"lens_deg": np.inf}]
)
def test_impossible_polarisers_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(SimError, match="polarisers"):
        PolariserConfig(**wrong)


def test_a_session_may_mix_plain_and_polarised_patterns(ball: Subject, tmp_path: Path) -> None:
    rig = default_rig()
    rig = dataclasses.replace(rig, cameras=rig.cameras[:1]).scaled(32 / 6016)
    world = World(ball, rig)
    out = tmp_path / "session"
    sequence = "full@cross,full,full@parallel"
    write_direct(world, out, SessionConfig(sequence=sequence), 0, quiet)
    file = load_session(out).file
    assert file.sequence == sequence.split(",")
    for name in file.sequence:
        levels = pattern_levels(name, rig)[None]
        lit = world if name == "full" else PolarisedWorld(world)
        known = lit.photograph("cam0", levels)[0]
        found = read_exr(out / f"frames/{name}/cam0.exr")
        np.testing.assert_allclose(found, known, rtol=2e-3, atol=1e-4)
        assert file.patterns[name].levels == levels[0].tolist()


def test_a_capture_takes_polarised_patterns_only_or_none(stage: World) -> None:
    assert seen_through(stage, ["full", "x+"]) is stage
    assert isinstance(seen_through(stage, ["full@cross", "x+@parallel"]), PolarisedWorld)
    with pytest.raises(SimError, match="polarised patterns only, or none"):
        seen_through(stage, ["full@cross", "full"])


def test_the_reference_is_not_asked_for_polarised_pictures(stage: World) -> None:
    with pytest.raises(SimError, match="own light"):
        seen_through(PolarisedWorld(stage), ["full@cross"])


@pytest.mark.parametrize("bank", ["horizontal", "vertical"])
def test_polarised_pictures_are_those_of_mitsuba(bank: str) -> None:
    """A ball under one polarised lamp: mirror light by brightness, diffuse light by its share."""
    pytest.importorskip("mitsuba", reason="needs the extra `reference`")
    from sim.light.polarised_reference import PlainSkin, StokesConfig, analysed, stokes_picture

    light = dataclasses.replace(
        default_rig().lights[0], position_mm=(-1050.0, 234.0, 584.0), bank=bank
    )
    camera = default_rig().cameras[0].scaled(96 / 6016)
    rig = Rig((light,), (camera,))
    place, config = rig.positions_mm, PERFECT
    axis = lamp_axes(rig)
    subject = ball_subject()
    subject = dataclasses.replace(
        subject,
        mesh=ball_mesh(80.0, 96, 192),
        normal=np.zeros_like(subject.normal),
        specular_albedo=np.full_like(subject.specular_albedo, (0.4 / 2.4) ** 2),
    )
    scene = Scene(subject)
    surface = scene.surface(camera)
    lamp = Lamps(place, np.ones((1, 3)), -place / np.linalg.norm(place), 1.0, 0.0)
    bits = scene.visible_lights(surface, place)
    fields = (surface.position, surface.geometric, surface.normal, surface.view)
    skin = (surface.albedo, surface.specular, surface.roughness)
    _, mirror = shade(*fields, *skin, bits, lamp, np.ones((1, 1, 3)))
    body_share, mirror_share = polarised_factors(
        surface.position,
        surface.normal,
        surface.view,
        place,
        axis,
        lens_axis(camera, config),
        1.4,
        np.inf,
        np.inf,
    )
    long = StokesConfig(samples=128)
    glossy, matte = PlainSkin(diffuse=0.0), PlainSkin(specular=0.0)
    known = analysed(stokes_picture(subject.mesh, camera, place[0], axis[0], glossy, long), config)
    known = known.ravel()[surface.pixel]
    found = mirror[0, :, 1] * mirror_share[:, 0]
    peak = float(mirror.max())
    assert np.median(np.abs(found - known)) < 0.002 * peak
    assert np.quantile(np.abs(found - known), 0.95) < 0.02 * peak
    unpolarised = stokes_picture(subject.mesh, camera, place[0], None, matte, long)[..., 0]
    through = analysed(stokes_picture(subject.mesh, camera, place[0], axis[0], matte, long), config)
    plain = unpolarised.ravel()[surface.pixel]
    bright = plain > 0.1 * plain.max()
    share = through.ravel()[surface.pixel][bright] / plain[bright]
    assert np.median(np.abs(share - body_share[bright, 0])) < 0.002
    assert np.quantile(np.abs(share - body_share[bright, 0]), 0.95) < 0.02
