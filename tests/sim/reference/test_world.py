"""Photographs of the reference against analysis and against Mitsuba's own path tracer."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from lightstage.commands import quiet
from lightstage.formats.exr import read_exr
from sim.errors import SimError
from sim.light.lamps import LampConfig, Lamps, lamps_of
from sim.people.subject import Subject
from sim.reference.config import ReferenceConfig
from sim.reference.direct import lamp_strength
from sim.reference.variant import SCALAR, find_variant
from sim.reference.world import ReferenceWorld
from sim.session import SessionConfig, write_direct
from tests.sim.conftest import ball_subject, small_rig
from tests.sim.reference.surfaces import corner, plane, stage

mi = pytest.importorskip("mitsuba", reason="needs the extra `reference`")

VARIANTS = sorted({SCALAR, find_variant()})
DIRECT = ReferenceConfig(bounces=0, subsurface=False, samples=1)
LIGHTS = np.array([[200.0, 300.0, 900.0], [-700.0, 100.0, 600.0], [600.0, -200.0, 500.0]])


def lamp(place: np.ndarray, **shape: float) -> Lamps:
    return lamps_of(stage(place[None]), LampConfig(**shape))


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_plane_obeys_inverse_square_and_cosine(variant: str) -> None:
    """One lamp over a plane without mirror: closed form, with Mitsuba's T by angle."""
    config = dataclasses.replace(DIRECT, variant=variant)
    # The view is along the normal within 2 degrees, where X hardly changes.
    for place in (np.array([0.0, 0.0, 500.0]), np.array([400.0, 0.0, 400.0])):
        rig = stage(place[None], 4, 4, 20.0)
        lamps = lamp(place, radius_mm=0.0, exponent=0.0)
        world = ReferenceWorld(plane(specular=0.0), rig, lamps, config)
        found = world.photograph("cam0", np.ones((1, 1)))[0, ..., 1]
        _, points = world._seen(rig.cameras[0])
        toward = place - points.position
        distance = np.linalg.norm(toward, axis=1)
        from sim.reference.lobes import interface_of

        interface = interface_of("beckmann")
        cosine = toward[:, 2] / distance
        known = interface.entry(cosine, points.roughness) * cosine
        known = known * (np.linalg.norm(place) / distance) ** 2 * lamps.weights[0, 1]
        known *= 0.5 * interface.exit(points.view[:, 2], points.roughness)
        np.testing.assert_allclose(found.ravel(), known, rtol=2e-3)


@pytest.mark.parametrize("exponent", [0.0, 1.0, 4.0])
def test_a_disc_lights_a_diffuser_at_the_origin_by_its_weight(exponent: float) -> None:
    lamps = lamp(np.array([0.0, 0.0, 200.0]), radius_mm=80.0, exponent=exponent)
    radius = 80.0 * np.sqrt((np.arange(4000) + 0.5) / 4000)
    distance2 = 200.0**2 + radius**2
    cosine = 200.0 / np.sqrt(distance2)
    light = np.mean(cosine ** (exponent + 1) / distance2) * lamp_strength(lamps)[0] / np.pi
    assert light == pytest.approx(1.0, rel=1e-6)


def test_both_variants_agree() -> None:
    rig = stage(LIGHTS, 8, 8)
    lamps = lamps_of(rig, LampConfig(radius_mm=0.0))
    levels = np.array([[1.0, 1.0, 1.0], [1.0, 0.0, 0.5]])
    pictures = [
        ReferenceWorld(
            corner(roughness=0.22), rig, lamps, dataclasses.replace(DIRECT, variant=variant)
        ).photograph("cam0", levels)
        for variant in VARIANTS
    ]
    for picture in pictures:
        np.testing.assert_allclose(picture, pictures[0], rtol=2e-3, atol=1e-4)
        assert picture.max() > 0.1


def test_a_complement_is_full_minus_the_other() -> None:
    rig = stage(LIGHTS, 8, 8)
    config = dataclasses.replace(DIRECT, samples=4)
    levels = np.array([[1.0, 1.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 1.0]])
    world = ReferenceWorld(corner(), rig, lamps_of(rig), config)
    full, first, rest = world.photograph("cam0", levels)
    alone = world.photograph("cam0", levels[2:])[0]
    np.testing.assert_allclose(rest, alone, atol=1e-5 * full.max())
    np.testing.assert_allclose(first + rest, full, atol=1e-5 * full.max())
    world.prepare(levels)
    np.testing.assert_allclose(world.photograph("cam0", levels[2:])[0], alone, atol=1e-5)
    assert not world.photograph("cam0", np.zeros((1, 3))).any()


def brute_force(subject: Subject, samples: int, depth: int) -> np.ndarray:
    """(16, 16) of Mitsuba's own path tracer: disc emitters, its camera, its roughplastic."""
    from sim.reference.lobes import lobes_of

    mi.set_variant("scalar_rgb")
    rig = stage(LIGHTS)
    lamps = lamps_of(rig, LampConfig(radius_mm=20.0))
    mesh = subject.mesh
    shape = mi.Mesh("skin", len(mesh.vertices), len(mesh.triangles()))
    parameters = mi.traverse(shape)
    parameters["vertex_positions"] = mesh.vertices.ravel().astype(np.float32)
    parameters["faces"] = mesh.triangles().ravel().astype(np.uint32)
    parameters.update()
    scale = lobes_of("beckmann", 0.3).body_scale
    skin = {
        "type": "roughplastic",
        "alpha": 0.3,
        "int_ior": 1.4,
        "ext_ior": 1.0,
        "nonlinear": False,
        "diffuse_reflectance": {"type": "rgb", "value": 0.5 * scale},
        "specular_reflectance": {"type": "rgb", "value": float(subject.specular_albedo[0, 0] * 36)},
    }
    shape.set_bsdf(mi.load_dict(skin))
    scene: dict[str, object] = {"type": "scene", "skin": shape}
    for k, place in enumerate(LIGHTS):
        # A disc of radiance L lights the origin by pi L a^2 / (a^2 + d^2).
        radiance = lamps.weights[k, 0] * (1 + place @ place / 20.0**2)
        scene[f"lamp{k}"] = {
            "type": "disk",
            "to_world": mi.ScalarTransform4f().look_at(place.tolist(), [0, 0, 0], [0, 1, 0])
            @ mi.ScalarTransform4f().scale(20.0),
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": float(radiance)}},
        }
    scene["camera"] = {
        "type": "perspective",
        "fov": float(np.degrees(2 * np.arctan(30.0 / 1000))),
        "to_world": mi.ScalarTransform4f().look_at([0, 0, 1000], [0, 0, 0], [0, 1, 0]),
        "film": {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}},
        "sampler": {"type": "multijitter", "sample_count": samples},
    }
    scene["integrator"] = {"type": "path", "max_depth": depth, "rr_depth": 99}
    return np.array(mi.render(mi.load_dict(scene), spp=samples))[..., 1]


@pytest.fixture(scope="module")
def flat_corner() -> Subject:
    """The corner, its walls' normals their own: no shading across the fold."""
    shape = corner()
    mesh = shape.mesh
    quads = mesh.vertices[mesh.faces]
    faces = np.arange(quads.shape[0] * 4).reshape(-1, 4).astype(np.int32)
    assert mesh.uvs is not None
    assert mesh.face_uvs is not None
    apart = dataclasses.replace(
        mesh,
        vertices=quads.reshape(-1, 3),
        faces=faces,
        uvs=mesh.uvs[mesh.face_uvs].reshape(-1, 2),
        face_uvs=faces,
    )
    return dataclasses.replace(shape, mesh=apart)


@pytest.mark.parametrize(("bounces", "specular"), [(0, 1 / 36), (3, 0.0)])
def test_without_subsurface_the_picture_is_that_of_a_path_tracer(
    flat_corner: Subject, bounces: int, specular: float
) -> None:
    subject = dataclasses.replace(
        flat_corner, specular_albedo=np.full((32, 32), specular, np.float32)
    )
    known = brute_force(subject, 512, bounces + 2)
    config = ReferenceConfig(
        bounces=bounces, subsurface=False, samples=4, texel_mm=3.0, bounce_rays=48
    )
    rig = stage(LIGHTS)
    lamps = lamps_of(rig, LampConfig(radius_mm=20.0))
    found = ReferenceWorld(subject, rig, lamps, config).photograph("cam0", np.ones((1, 3)))
    # Pixels that see the fold or the walls' ends hold few of our samples.
    inner = np.zeros((16, 16), bool)
    inner[2:14, 2:7] = inner[2:14, 9:14] = True
    ratio = found[0, ..., 1][inner] / known[inner]
    assert np.median(ratio) == pytest.approx(1.0, abs=0.01)
    assert np.quantile(np.abs(ratio - 1), 0.9) < 0.03


def test_only_mirrored_light_after_a_bounce_is_left_out(flat_corner: Subject) -> None:
    """In a right angle, the worst place for it, it is 3 % of the light."""
    config = ReferenceConfig(subsurface=False, samples=4, texel_mm=3.0, bounce_rays=32)
    rig = stage(LIGHTS)
    lamps = lamps_of(rig, LampConfig(radius_mm=20.0))
    found = ReferenceWorld(flat_corner, rig, lamps, config).photograph("cam0", np.ones((1, 3)))
    known = brute_force(flat_corner, 512, config.bounces + 2)
    share = np.median(found[0, 2:14, 2:14, 1] / known[2:14, 2:14])
    assert 0.96 < share < 1.0


def test_repeats_differ_by_less_than_a_percent() -> None:
    rig = stage(LIGHTS, 12, 12)
    pictures = [
        ReferenceWorld(
            corner(30.0),
            rig,
            lamps_of(rig),
            ReferenceConfig(samples=1, texel_mm=3.0, bounce_rays=64, seed=seed),
        ).photograph("cam0", np.ones((1, 3)))[0]
        for seed in (1, 2, 3)
    ]
    seen = pictures[0].min(axis=-1) > 0
    error = np.std(pictures, axis=0, ddof=1)[seen]
    assert np.median(error) < 0.01 * np.median(pictures[0][seen])


def test_a_stretched_lobe_is_refused() -> None:
    stretched = plane(anisotropy=np.full((32, 32), 0.5, np.float32))
    with pytest.raises(SimError, match="anisotropy"):
        ReferenceWorld(stretched, stage(LIGHTS), None, DIRECT)


@pytest.mark.parametrize(
    "wrong",
    [{"bounces": -1}, {"samples": 3}, {"texel_mm": 0.0}, {"bounce_rays": 0}, {"seed": -1}],
)
def test_a_config_that_cannot_be_is_refused(wrong: dict) -> None:
    with pytest.raises(SimError, match=next(iter(wrong))):
        ReferenceConfig(**wrong)


def test_an_unknown_variant_is_refused() -> None:
    with pytest.raises(SimError, match="variant"):
        find_variant("cuda_ad_rgb")


def test_a_session_of_the_reference_is_written_like_any_other(tmp_path: Path) -> None:
    config = SessionConfig(sequence="full,x+,x-")
    coarse = ReferenceConfig(bounces=1, samples=1, texel_mm=5.0, bounce_rays=4)
    world = ReferenceWorld(ball_subject(), small_rig(6, 16, 24, 1), None, coarse)
    write_direct(world, tmp_path / "S", config, 1, quiet)
    full, first, second = (
        read_exr(tmp_path / "S" / "frames" / name / "cam0.exr") for name in ("full", "x+", "x-")
    )
    assert full.max() > 0.1
    np.testing.assert_allclose(first + second, full, atol=2e-3 * full.max())
    assert (tmp_path / "S" / "session.json").is_file()
