"""Skin's surface as a rough dielectric: beside a plain twin, the integral, and its own kernel."""

from __future__ import annotations

import dataclasses
import inspect
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from learning.__main__ import bake, render
from learning.maps import load_head
from learning.render.dielectric import F0, let_through, mean_through, mirrored
from learning.render.shading import ShadeOptions, shade
from lightstage.formats.mesh import read_obj
from lightstage.formats.processed import ProcessedFolder
from processing.lighting.fresnel import fresnel
from processing.lighting.interface import mirrored as integral
from processing.lighting.interface import smith
from tests.learning.scenes import flat_skin, one_light, random_lights, random_skin

OPTIONS = ShadeOptions("dielectric", subsurface_mm=0)
EAGER = dataclasses.replace(OPTIONS, engine="eager")


def test_relighting_shades_by_the_dielectric_unless_told_otherwise() -> None:
    for command in (render, bake):
        assert inspect.signature(command).parameters["mode"].default == "dielectric"


def test_what_goes_through_is_the_integral_over_the_lobe() -> None:
    roughness = np.linspace(0.12, 0.6, 7)
    cosine = np.linspace(0.1, 1, 10)
    found = [
        let_through(mirrored(torch.tensor(m)), torch.tensor(cosine)).numpy() for m in roughness
    ]
    truth = [[1 - integral(c, m, steps=96) for c in cosine] for m in roughness]
    off = np.array(found) - truth
    assert np.sqrt((off**2).mean()) < 0.002
    assert abs(off).max() < 0.008
    for m in roughness:
        steps = torch.linspace(0, 1, 2001, dtype=torch.float64)
        coefficients = mirrored(torch.tensor(m))
        mean = torch.trapezoid(2 * steps * let_through(coefficients, steps), steps)
        assert float(mean_through(coefficients)) == pytest.approx(float(mean), abs=1e-6)


def twin(normal: np.ndarray, light: np.ndarray, view: np.ndarray, m: float) -> tuple[float, float]:
    """Diffuse and mirror part of a texel of albedo 1 under a distant light of 1, plainly."""
    n_l, n_v = float(normal @ light), float(normal @ view)
    if n_l <= 0:
        return 0.0, 0.0
    half = (light + view) / np.linalg.norm(light + view)
    n_h = float(normal @ half)
    steep = (1 - n_h**2) / n_h**2 / m**2
    density = np.exp(-steep) / (m**2 * n_h**4)
    masked = 1 + float(smith(np.array(n_l), m)) + float(smith(np.array(n_v), m))
    lobe = density * float(fresnel(F0, np.array(half @ view))) / (4 * F0 * n_v * masked)
    through = [1 - integral(c, m, steps=96) for c in (n_l, n_v)]
    cosines = (np.arange(200) + 0.5) / 200
    mean = np.mean([2 * c * (1 - integral(c, m)) for c in cosines])
    return n_l * through[0] * through[1] / mean, lobe


@pytest.mark.parametrize("engine", ["auto", "eager"])
@pytest.mark.parametrize(("tilt_deg", "m"), [(20.0, 0.2), (60.0, 0.3), (125.0, 0.3)])
def test_one_texel_is_as_by_a_plain_twin(engine: str, tilt_deg: float, m: float) -> None:
    tilt, aside = np.deg2rad(tilt_deg), np.deg2rad(50)
    normal = np.array([np.sin(aside), 0, np.cos(aside)])
    toward = np.array([np.sin(tilt), 0, np.cos(tilt)])
    one = torch.ones(1, 1, 1, 1, dtype=torch.float64)
    skin = flat_skin(tuple(normal), 1.0, specular_albedo=one, shininess=one * (2 / m**2 - 2))
    environment = one_light(tuple(1e7 * toward), rgb=1.0)
    options = dataclasses.replace(OPTIONS, engine=engine)
    both = float(shade(skin, environment, options)[0, 0, 0, 0])
    matte = dataclasses.replace(skin, specular_albedo=0 * one)
    diffuse = float(shade(matte, environment, options)[0, 0, 0, 0])
    expected = twin(normal, toward, np.array([0, 0, 1.0]), m)
    assert diffuse == pytest.approx(expected[0], rel=0.012)
    assert both - diffuse == pytest.approx(expected[1], rel=1e-4)


@pytest.mark.parametrize(("kind", "off"), [(torch.float64, 1e-11), (torch.float32, 2e-4)])
def test_the_compiled_sums_are_torchs_own(kind: torch.dtype, off: float) -> None:
    skin = random_skin(np.random.default_rng(3), 24, 20, kind)
    lights = random_lights(np.random.default_rng(4), 5)
    found, expected = shade(skin, lights, OPTIONS), shade(skin, lights, EAGER)
    torch.testing.assert_close(found, expected, atol=off, rtol=off)
    assert (expected > 0).any()


def test_every_map_light_and_camera_has_its_gradient() -> None:
    skin = random_skin(np.random.default_rng(5), 2, 2)
    lights = random_lights(np.random.default_rng(6), 2)
    names = (
        "diffuse_albedo", "specular_albedo", "diffuse_normal", "specular_normal", "shininess",
        "position_mm",
    )  # fmt: skip

    def picture(rgb: torch.Tensor, place: torch.Tensor, *maps: torch.Tensor) -> torch.Tensor:
        changed = dataclasses.replace(skin, **dict(zip(names, maps, strict=True)))
        environment = dataclasses.replace(lights, rgb=rgb, position_mm=place)
        return shade(changed, environment, OPTIONS)

    tensors = [lights.rgb, lights.position_mm, *(getattr(skin, name) for name in names)]
    given_tensors = [tensor.clone().requires_grad_() for tensor in tensors]
    assert torch.autograd.gradcheck(picture, given_tensors, atol=1e-6, rtol=1e-3)


numbers = st.one_of(
    st.floats(-2, 2), st.sampled_from([0.0, 1e-30, -1e-30, 1e30, np.nan, np.inf, -np.inf])
)


@settings(max_examples=60, deadline=None)
@given(arrays.arrays(np.float64, (3,), elements=numbers), st.floats(0.5, 800))
def test_bad_normals_are_the_same_with_both_engines_and_reach_their_own_texel_alone(
    normal: np.ndarray, exponent: float
) -> None:
    skin = random_skin(np.random.default_rng(7), 1, 3)
    bad = skin.specular_normal.clone()
    bad[:, :, 0, 1] = torch.from_numpy(normal)
    skin = dataclasses.replace(skin, specular_normal=bad, diffuse_normal=bad)
    skin.shininess[:] = exponent
    lights = random_lights(np.random.default_rng(8), 2)
    found, expected = shade(skin, lights, OPTIONS), shade(skin, lights, EAGER)
    beside = torch.tensor([0, 2])
    assert torch.isfinite(found[..., beside]).all()
    torch.testing.assert_close(found[..., beside], expected[..., beside])
    if np.isfinite(normal).all() and 1e-3 < np.linalg.norm(normal) < 100:
        torch.testing.assert_close(found, expected, atol=1e-7, rtol=1e-6)


def test_grazing_light_shines_more_than_without_fresnel_and_stays_finite() -> None:
    one = torch.ones(1, 1, 1, 1, dtype=torch.float64)
    skin = flat_skin((0.9962, 0, 0.0872), 0.0, specular_albedo=0.028 * one, shininess=26 * one)
    behind = one_light((9e6, 0, -1.5e6), rgb=1.0)
    values = {
        mode: float(shade(skin, behind, ShadeOptions(mode, subsurface_mm=0)).max())  # type: ignore[arg-type]
        for mode in ("dielectric", "physical")
    }
    assert values["dielectric"] > 3 * values["physical"]
    assert np.isfinite(values["dielectric"])


def test_a_map_of_roughness_goes_before_the_constant(
    people: list[ProcessedFolder], tmp_path: Path
) -> None:
    import shutil

    root = tmp_path / "person"
    shutil.copytree(people[0].root, root)
    folder = ProcessedFolder(root)
    rough = np.full(folder.read_atlas("confidence").shape, 0.25, np.float32)
    rough[:48] = 0.0
    folder.write_atlas("roughness", rough)
    head = load_head(root / "atlas", read_obj(folder.registered_mesh))
    shininess = head.skin.shininess[0, 0].numpy()
    np.testing.assert_allclose(shininess[48:], 2 / 0.25**2 - 2)
    np.testing.assert_allclose(shininess[:48], 32.0)
