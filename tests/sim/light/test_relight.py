"""People under environments: furnace, suns, shadows, and the command that renders them."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from lightstage.errors import LightstageError
from lightstage.formats.environment import LightSet, write_lights
from lightstage.formats.exr import read_exr, write_exr
from lightstage.rig import Camera, Rig
from sim.errors import SimError
from sim.light.environments import FAR_MM, Panorama, add_sun, directions, panorama_lights
from sim.light.lamps import point_lamps
from sim.light.olat import shade
from sim.light.portrait import portrait, write_portrait
from sim.light.relight import (
    RelightConfig,
    auto_exposure,
    environment_lights,
    environment_names,
    is_environment,
    relit,
    write_picture,
)
from sim.light.scene import Scene
from sim.people.subject import Subject


@pytest.fixture(scope="module")
def camera(tiny_rig: Rig) -> Camera:
    return tiny_rig.cameras[0]


def painted(ball: Subject, albedo: float, specular: float) -> Subject:
    return dataclasses.replace(
        ball,
        diffuse_albedo=np.full_like(ball.diffuse_albedo, albedo),
        specular_albedo=np.full_like(ball.specular_albedo, specular),
    )


def test_a_white_ball_in_uniform_light_is_as_bright_everywhere(
    ball: Subject, camera: Camera
) -> None:
    """White furnace: what the interface mirrors and what the white body sends back make 1."""
    scene = Scene(painted(ball, 1.0, (0.4 / 2.4) ** 2))
    lights = environment_lights("uniform", RelightConfig(lights=1024))
    picture = relit(scene, camera, lights, samples=1)
    surface = scene.surface(camera)
    facing = np.einsum("nk,nk->n", surface.normal, surface.view) > 0.3
    seen = picture.reshape(-1, 3)[surface.pixel][facing]
    np.testing.assert_allclose(np.median(seen), 1.0, atol=0.01)
    np.testing.assert_allclose(seen, 1.0, atol=0.03)


def test_a_matte_ball_in_uniform_light_shows_its_albedo(ball: Subject, camera: Camera) -> None:
    scene = Scene(painted(ball, 0.4, 0.0))
    picture = relit(scene, camera, environment_lights("uniform"), samples=1)
    surface = scene.surface(camera)
    facing = np.einsum("nk,nk->n", surface.normal, surface.view) > 0.8
    seen = picture.reshape(-1, 3)[surface.pixel][facing]
    # The interface lets a little more out straight ahead than on average.
    assert seen.std() < 0.01 * seen.mean()
    np.testing.assert_allclose(seen.mean(), 0.4, rtol=0.06)


def test_a_sun_of_one_texel_lights_as_a_directional_light(ball: Subject, camera: Camera) -> None:
    radiance = np.zeros((32, 64, 3))
    toward = directions(32)[10, 40]
    add_sun(radiance, toward, np.pi * np.array([1.0, 0.8, 0.5]))
    scene = Scene(ball)
    picture = relit(scene, camera, panorama_lights(Panorama("sun", radiance), 64), samples=1)
    surface = scene.surface(camera)
    lamp = point_lamps(FAR_MM * toward[None])
    bits = scene.visible_lights(surface, lamp.positions_mm, coarse_px=1)
    fields = (surface.position, surface.geometric, surface.normal, surface.view)
    skin = (surface.albedo, surface.specular, surface.roughness)
    body, mirror = shade(*fields, *skin, bits, lamp, np.array([[[1.0, 0.8, 0.5]]]))
    known = surface.picture((body + mirror)[0])
    assert known.max() > 0.2
    np.testing.assert_allclose(picture, known, atol=1e-5)
    # Far lights do not fall off over a head: a facing matte point reads its albedo.
    facing = surface.normal @ toward
    diffuse = body[0, :, 1] / surface.albedo[:, 1]
    np.testing.assert_array_less(diffuse, np.maximum(facing, 0) * 1.15 + 1e-5)


def test_silhouettes_are_means_of_many_rays(ball: Subject, camera: Camera) -> None:
    scene, lights = Scene(ball), environment_lights("softbox", RelightConfig(lights=16))
    coarse = relit(scene, camera, lights, samples=1)
    fine = relit(scene, camera, lights, samples=3)
    body = (coarse.max(axis=2) > 0).astype(np.uint8)
    inside = cv2.erode(body, np.ones((7, 7))) > 0
    np.testing.assert_allclose(fine[inside], coarse[inside], rtol=0.05, atol=0.002)
    assert fine.sum() == pytest.approx(coarse.sum(), rel=0.03)
    # The rim is a share of the ball, neither all nor nothing: more levels than one ray gives.
    rim = (cv2.dilate(body, np.ones((3, 3))) > 0) & ~(cv2.erode(body, np.ones((3, 3))) > 0)
    dim = (fine.max(axis=2) > 0) & (fine.max(axis=2) < 0.5 * np.median(fine[inside]))
    assert (rim & dim).sum() > (rim & (coarse.max(axis=2) > 0) & dim).sum()


def test_lights_in_parts_are_all_lights(ball: Subject, camera: Camera) -> None:
    scene = Scene(ball)
    lights = environment_lights("uniform", RelightConfig(lights=300))
    whole = relit(scene, camera, lights, samples=1)
    halves = [
        LightSet("part", lights.position_mm[k::2], lights.rgb[k::2], np.zeros(3)) for k in (0, 1)
    ]
    parts = [relit(scene, camera, half, samples=1) for half in halves]
    np.testing.assert_allclose(parts[0] + parts[1], whole, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("name", ["street", "uniform", "softbox", "ring", "rim", "clamshell"])
def test_every_environment_without_mitsuba_has_light(name: str) -> None:
    assert name in environment_names()
    lights = environment_lights(name, RelightConfig(lights=64, rotate_deg=30.0), seed=1)
    assert lights.rgb.sum() > 0
    assert np.isfinite(lights.position_mm).all()
    assert not lights.ambient_rgb.any()


@pytest.mark.parametrize("name", ["noon", "sunset"])
def test_every_sky_has_light(name: str) -> None:
    pytest.importorskip("mitsuba", reason="needs the extra `reference`")
    lights = environment_lights(name, RelightConfig(lights=64))
    assert len(lights.rgb) == 64
    assert lights.rgb.sum() > 0


def test_ambient_light_of_a_light_set_comes_from_all_around(tmp_path: Path) -> None:
    one = LightSet("two", np.array([[0.0, 0.0, 900.0]]), np.ones((1, 3)), np.full(3, 0.25))
    write_lights(one, tmp_path / "lights.json")
    lights = environment_lights(str(tmp_path / "lights.json"), RelightConfig(lights=200))
    up = np.array([0.0, 1.0, 0.0])
    toward = lights.position_mm / np.linalg.norm(lights.position_mm, axis=1, keepdims=True)
    falls = np.maximum(toward @ up, 0) @ lights.rgb
    np.testing.assert_allclose(falls, 0.25, rtol=0.02)


def test_unknown_names_and_counts_are_refused(tmp_path: Path) -> None:
    with pytest.raises(SimError, match="street"):
        environment_lights("disco")
    for wrong in ({"lights": 0}, {"lights": 10**6}, {"rotate_deg": float("nan")}):
        with pytest.raises(SimError, match="environment"):
            RelightConfig(**wrong)  # type: ignore[arg-type]
    with pytest.raises(SimError, match=r"\.png or \.exr"):
        write_picture(np.ones((2, 2, 3)), tmp_path / "a.jpg", 1.0)
    assert not is_environment("x+")
    assert is_environment("a.hdr")


def test_pictures_are_written_exposed_or_linear(tmp_path: Path) -> None:
    linear = np.full((4, 6, 3), 0.2, np.float32)
    linear[0] = 0
    assert auto_exposure(linear) == pytest.approx(0.75 / 0.2)
    assert auto_exposure(np.zeros((2, 2, 3))) == 1.0
    assert write_portrait(linear, tmp_path / "a.exr", None) == 1.0
    np.testing.assert_array_equal(read_exr(tmp_path / "a.exr"), linear)
    assert write_portrait(linear, tmp_path / "a.png", 1.0) == 2.0
    shown = cv2.imread(str(tmp_path / "a.png"))
    # 0.4 linear is 170 of 255 in sRGB.
    assert shown[0].max() == 0
    assert abs(int(shown[1, 0, 0]) - 170) <= 1


@pytest.mark.parametrize("light", ["full", "x+", "full@cross", "softbox"])
def test_a_portrait_under_patterns_and_environments(
    ball: Subject, tiny_rig: Rig, light: str
) -> None:
    picture = portrait(ball, tiny_rig, "cam0", light, RelightConfig(lights=16))
    assert picture.shape == (96, 64, 3)
    assert np.isfinite(picture).all()
    assert picture.max() > 0.01


def test_the_command_writes_a_picture_and_states_its_facts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ball: Subject
) -> None:
    from typer.testing import CliRunner

    import sim.people.subjects
    from sim.__main__ import app

    monkeypatch.setattr(sim.people.subjects, "load_subject", lambda *_: ball)
    out = tmp_path / "ball.png"
    words = ["render", "--subject", "ball", "--width", "40", "--lights", "32", "--json"]
    done = CliRunner().invoke(app, [*words, "--light", "street", "--out", str(out)])
    assert done.exit_code == 0, done.output
    facts = json.loads(done.stdout.strip().splitlines()[-1])
    assert (facts["width_px"], facts["height_px"]) == (40, 60)
    assert cv2.imread(str(out)).shape == (60, 40, 3)
    write_exr(tmp_path / "bad.exr", np.full((4, 8, 3), -1, np.float32))
    for light in ("disco", str(tmp_path / "bad.exr"), str(tmp_path / "none.hdr")):
        other = tmp_path / "other.png"
        done = CliRunner().invoke(app, [*words, "--light", light, "--out", str(other)])
        assert isinstance(done.exception, LightstageError)
        assert not other.exists()
