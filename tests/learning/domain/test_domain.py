"""The light that textures have in common: found, refined, written, trained in; and bad input."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from learning.domain import command
from learning.domain.closed import Found, LitSurfaces, find_light
from learning.domain.command import _read, places_of, read_target_light
from learning.domain.descent import descend
from learning.domain.sample import Sample, sample_of
from learning.errors import MapsError
from learning.limits import require_within
from learning.networks.whole_face import WholeFaceNetwork
from learning.patch_light import target_environment
from learning.render.environments import (
    RandomLightConfig,
    TargetLight,
    random_environment,
    random_lights,
)
from learning.whole.light import Light, LitSurface
from lightstage.errors import LightstageError
from lightstage.formats.environment import LightSet, read_lights, write_lights
from lightstage.formats.exr import write_exr
from lightstage.formats.files import write_json
from tests.learning.domain.conftest import CAMERA_MM, LIGHT, Domain
from tests.learning.export.called import printed, refusal


@pytest.fixture(scope="module")
def samples(domain: Domain, network: WholeFaceNetwork) -> list[Sample]:
    return [
        sample_of(network, texture, mesh, (f"person {index}", "mesh"))
        for index, (texture, mesh) in enumerate(zip(domain.textures, domain.meshes, strict=True))
    ]


def off(found: LightSet) -> tuple[float, float]:
    """Degrees between the strongest lamps, and the logarithm of their strengths' ratio."""
    strongest = found.rgb.sum(axis=1).argmax()
    one, other = found.position_mm[strongest], LIGHT.position_mm[0]
    cosine = one @ other / np.linalg.norm(one) / np.linalg.norm(other)
    ratio = np.log(found.rgb[strongest].sum() / LIGHT.rgb[0].sum())
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1)))), abs(float(ratio))


def test_heads_as_one_surface_are_the_heads_one_after_the_other(samples: list[Sample]) -> None:
    both = LitSurfaces(samples, CAMERA_MM)
    irradiance, lobe = both.under(LIGHT.position_mm)
    openness = both.split(both.openness())
    seen = both.split(both.seen(LIGHT.position_mm), 1)
    last = LitSurface(samples[-1].mesh, samples[-1].raster, CAMERA_MM)
    np.testing.assert_array_equal(last.under(LIGHT.position_mm)[0], both.split(irradiance)[-1])
    np.testing.assert_array_equal(last.openness(), openness[-1])
    np.testing.assert_array_equal(last.seen(LIGHT.position_mm), seen[-1])
    assert lobe.shape == irradiance.shape
    assert [len(part) for part in openness] == [s.raster.covered.sum() for s in samples]


def test_the_lamps_of_two_textures_are_found_in_closed_form(
    samples: list[Sample], network: WholeFaceNetwork
) -> None:
    found = find_light(samples, network, CAMERA_MM, 600.0, 1).light
    degrees, strength = off(LightSet("", np.array(found.lamps_mm), found.rgb[:-1], found.rgb[-1]))
    assert degrees < 4
    assert strength < 0.3
    np.testing.assert_allclose(found.rgb[-1], LIGHT.ambient_rgb, rtol=0.5)


def test_descent_brings_a_wrong_light_to_the_true_one_under_a_true_reflectance(
    domain: Domain, samples: list[Sample]
) -> None:
    true = [
        dataclasses.replace(
            s,
            answer=dataclasses.replace(
                s.answer,
                log_albedo=np.log(np.maximum(albedo, 1e-3)),
                specular=np.full_like(s.answer.specular, 0.03),
                trust=np.ones_like(s.answer.trust),
            ),
        )
        for s, albedo in zip(samples, domain.albedos, strict=True)
    ]
    turned = LIGHT.position_mm + np.array([[250.0, -200.0, 100.0], [150.0, 200.0, -100.0]])
    wrong = LightSet("wrong", turned, LIGHT.rgb[:, ::-1] * [[1.3], [0.6]], 2 * LIGHT.ambient_rgb)
    refined = descend(true, wrong, CAMERA_MM, 60, 0.05, 20)
    assert off(wrong)[0] > 12
    assert off(refined.light)[0] < 4
    np.testing.assert_allclose(refined.light.rgb, LIGHT.rgb, rtol=0.25)
    assert refined.after < 0.35 * refined.before
    still = descend(true[:1], wrong, CAMERA_MM, 0, 0.05, 20)
    np.testing.assert_allclose(still.light.rgb, wrong.rgb, rtol=1e-5)
    assert still.before == still.after


def test_a_domains_light_is_what_a_training_draws_around(tmp_path: Path) -> None:
    path = write_lights(
        dataclasses.replace(LIGHT, camera_mm=np.array([100.0, 0.0, 900.0])), tmp_path / "light.json"
    )
    assert len(read_lights(path).rgb) == 2
    target = read_target_light(path)
    config = RandomLightConfig(target=target, position_spread=0.2, intensity_spread=0.1)
    rng = np.random.default_rng(0)
    for _ in range(20):
        places = random_lights(rng, config)
        away = np.linalg.norm(places - LIGHT.position_mm, axis=1)
        assert (away <= 0.2 * np.linalg.norm(LIGHT.position_mm, axis=1) + 1e-6).all()
        drawn = random_environment(rng, config, places)
        np.testing.assert_allclose(drawn.rgb[0].numpy(), LIGHT.rgb, rtol=0.11)
        np.testing.assert_allclose(drawn.ambient_rgb[0].numpy(), LIGHT.ambient_rgb, rtol=0.11)
    one = target_environment(config, "physical", 3)
    np.testing.assert_allclose(one.camera_mm[0].numpy(), [100, 0, 900])
    np.testing.assert_allclose(one.position_mm[0].numpy(), LIGHT.position_mm)
    assert float(target_environment(config, "paper", 3).ambient_rgb.min()) == 1.0


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"position_mm": (), "rgb": ()}, "0 lamps"),
        ({"position_mm": ((0.0, 0.0, 900.0),), "rgb": ()}, "0 colours"),
        ({"position_mm": ((0.0, 0.0, 0.1),)}, "distance"),
        ({"position_mm": ((float("nan"), 0.0, 900.0),)}, "distance"),
        ({"rgb": ((-1.0, 0.0, 0.0),)}, "rgb"),
        ({"rgb": ((float("inf"), 0.0, 0.0),)}, "rgb"),
        ({"camera_mm": (0.0, 0.0, 0.0)}, "camera_mm"),
    ],
)
def test_a_target_light_that_is_none_is_refused(values: dict[str, Any], said: str) -> None:
    good: dict[str, Any] = {"position_mm": ((0.0, 0.0, 900.0),), "rgb": ((1.0, 1.0, 1.0),)}
    require_within(TargetLight(**good), "light.json", "lights.target")
    with pytest.raises(LightstageError, match=said):
        require_within(TargetLight(**{**good, **values}), "light.json", "lights.target")


def test_domain_light_reads_fits_and_names_what_is_wrong(
    domain: Domain, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "light.json"
    wrong = Light(((500.0, 500.0, 900.0),), np.array([[0.5] * 3, [0.2] * 3]), 1.0)
    monkeypatch.setattr(command, "find_light", lambda *_: Found(wrong, []))
    line = ["domain-light", domain.folder, "--out", out, "--steps", "5"]
    facts = json.loads(printed(*line, "--json").splitlines()[-1])
    assert (facts["textures"], facts["lamps"]) == (2, 1)
    assert facts["difference_after"] < facts["difference_before"]
    assert len(read_lights(out).rgb) == 1
    assert len(read_target_light(out).camera_mm) == 3
    assert "2 textures" in facts["notes"][0]
    dark = Light((), np.array([[0.2] * 3]), 1.0)
    monkeypatch.setattr(command, "find_light", lambda *_: Found(dark, []))
    assert "no lamp" in refusal(*line)
    empty, grey = tmp_path / "empty", tmp_path / "grey.exr"
    empty.mkdir()
    write_exr(grey, np.zeros((96, 64), np.float32))
    told = write_json(tmp_path / "c.json", {"schema": "lightstage.landmarks/1"})
    mesh = domain.folder / "person0" / "registered_mesh.obj"
    for words, said in (
        ([tmp_path / "none"], "no such file"),
        ([empty], "no texture"),
        ([grey], "--mesh"),
        ([grey, "--mesh", mesh], "one channel"),
        ([domain.folder, "--steps", "-1"], "--steps: found -1"),
        ([domain.folder, "--seconds", "nan"], "--seconds: found nan"),
        ([domain.folder, "--config", told], "c.json"),
    ):
        other = tmp_path / "other.json"
        assert said in refusal("domain-light", *words, "--out", other), said
        assert not other.exists()


def test_half_a_face_of_a_fit_is_not_taken_for_one_upside_down(
    domain: Domain, network: WholeFaceNetwork, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def upside_down(*_: object) -> None:
        raise MapsError("texture", found="a face upside down", expected="one that is not")

    monkeypatch.setattr("learning.whole.infer.require_upright", upside_down)
    fit = shutil.copytree(domain.folder / "person0", tmp_path / "fit")
    with pytest.raises(MapsError, match="upside down"):
        _read(places_of([fit], None)[0], network)
    rows, columns = domain.textures[0].shape[:2]
    known = np.zeros((rows, columns), np.float32)
    known[:, : columns // 2 + 6] = 0.7
    (fit / "atlas").mkdir()
    write_exr(fit / "atlas" / "confidence.exr", known)
    sample = _read(places_of([fit], None)[0], network)
    assert sample.answer.seen[:, : columns // 2].any()
    assert not sample.answer.seen[:, columns // 2 + 8 :].any()


def test_an_unlit_texture_has_no_light_to_find(domain: Domain, network: WholeFaceNetwork) -> None:
    black = np.zeros_like(domain.textures[0])
    with pytest.raises(MapsError):
        sample_of(network, black, domain.meshes[0], ("black.exr", "mesh"))


@pytest.mark.parametrize("camera", ["front", [0, 0], [0, 0, None], [0.0, float("nan"), 1.0]])
def test_a_camera_that_is_no_place_is_refused(tmp_path: Path, camera: object) -> None:
    path = tmp_path / "light.json"
    write_lights(dataclasses.replace(LIGHT, camera_mm=CAMERA_MM), path)
    value = {**json.loads(path.read_text()), "camera_mm": camera}
    path.write_text(json.dumps(value))
    with pytest.raises(LightstageError, match=r"camera_mm|NaN|finite"):
        read_target_light(path)
