from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest
import torch

from learning.render import shading
from learning.render.environments import Environment, from_light_set, stack
from learning.render.shading import ShadeOptions, SkinMaps, direct, shade
from learning.render.skin import CHANNELS
from lightstage.formats.environment import LightSet
from tests.learning.scenes import flat_skin, one_light, random_lights, random_skin

NO_SCATTER = ShadeOptions(subsurface_mm=0)


def lobe_norm(exponent: float) -> float:
    """Giesen's factor times pi."""
    return (exponent + 2) * (exponent + 4) / (8 * (2 ** (-exponent / 2) + exponent))


def twin(
    skin: SkinMaps, lights: Environment, paper: bool, seen: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """The formulas one texel and one light at a time, in float64."""
    s = {f.name: getattr(skin, f.name) for f in dataclasses.fields(skin) if f.name != "texel_mm"}
    s = {name: value.numpy() for name, value in s.items() if value is not None}
    irradiance = np.zeros(s["diffuse_albedo"].shape)
    lobe = np.zeros_like(irradiance)
    batch, _, height, width = irradiance.shape
    for b, r, c in np.ndindex(batch, height, width):
        p, exponent = s["position_mm"][b, :, r, c], s["shininess"][b, 0, r, c]
        nd, ns = (s[n][b, :, r, c] for n in ("diffuse_normal", "specular_normal"))
        nd, ns = nd / np.linalg.norm(nd), ns / np.linalg.norm(ns)
        v = lights.camera_mm[b].numpy() - p
        v /= np.linalg.norm(v)
        for j in range(lights.rgb.shape[1]):
            at, rgb = lights.position_mm[b, j].numpy(), lights.rgb[b, j].numpy()
            toward = at if lights.distant[b, j] else at - p
            d = np.linalg.norm(toward)
            light = toward / d
            half = (light + v) / np.linalg.norm(light + v)
            highlight = max(0.0, ns @ half) ** exponent
            share = 1.0 if seen is None else seen[b, j, r, c]
            if paper:
                irradiance[b, :, r, c] += share * (nd @ light) * rgb * lights.ambient_rgb[b].numpy()
                lobe[b, :, r, c] += share * highlight * rgb
            else:
                reach = 1.0 if lights.distant[b, j] else (at @ at) / d**2
                irradiance[b, :, r, c] += share * max(0.0, nd @ light) * reach * rgb
                normal = lobe_norm(exponent)
                lobe[b, :, r, c] += share * normal * highlight * max(0.0, ns @ light) * reach * rgb
    ambient = lights.ambient_rgb.numpy()[:, :, None, None]
    if paper:
        return irradiance, lobe
    return irradiance + ambient * s["ambient_occlusion"], lobe


@pytest.mark.parametrize("engine", ["auto", "eager"])
@pytest.mark.parametrize("mode", ["physical", "paper"])
def test_shading_equals_a_plain_twin(mode: str, engine: str) -> None:
    rng = np.random.default_rng(0)
    skin, lights = random_skin(rng), random_lights(rng)
    seen = rng.uniform(size=(2, 3, 5, 4))
    options = ShadeOptions(mode=mode, subsurface_mm=0)
    options = dataclasses.replace(options, engine=engine)
    found = direct(skin, lights, options, torch.tensor(seen))
    expected = twin(skin, lights, mode == "paper", seen)
    for f, e in zip(found[:2], expected, strict=True):
        np.testing.assert_allclose(f.numpy(), e, rtol=1e-9, atol=1e-12)
    picture = shade(skin, lights, options, torch.tensor(seen))
    whole = skin.diffuse_albedo.numpy() * expected[0] + skin.specular_albedo.numpy() * expected[1]
    np.testing.assert_allclose(picture.numpy(), whole, rtol=1e-9, atol=1e-12)


def test_the_sums_do_not_depend_on_the_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(1)
    skin, lights = random_skin(rng), random_lights(rng)
    options = ShadeOptions(engine="eager")
    whole = shade(skin, lights, options)
    monkeypatch.setattr(shading, "PAIRS_AT_ONCE", 7)
    torch.testing.assert_close(shade(skin, lights, options), whole)
    torch.testing.assert_close(shade(skin, lights), whole)


def test_white_diffuser_reads_the_lights_own_value_and_ambient_adds() -> None:
    lights = one_light((0, 0, 1250.0), 0.7, ambient=0.1)
    assert shade(flat_skin(), lights, NO_SCATTER).flatten().tolist() == pytest.approx([0.8] * 3)
    tilted = one_light((0, 1000.0, 1000.0), 0.7)
    found = shade(flat_skin(), tilted, NO_SCATTER)
    assert float(found[0, 0, 0, 0]) == pytest.approx(0.7 * np.sqrt(0.5))
    behind = one_light((0, 0, -1000.0))
    assert float(shade(flat_skin(), behind, NO_SCATTER).max()) == 0.0


def test_light_falls_off_with_the_square_of_the_distance() -> None:
    nearer = flat_skin(position_mm=torch.tensor([0, 0, 500.0]).double().view(1, 3, 1, 1))
    found = shade(nearer, one_light((0, 0, 1000.0), 0.1), NO_SCATTER)
    assert float(found[0, 0, 0, 0]) == pytest.approx(0.4)
    distant = dataclasses.replace(one_light((0, 0, 1000.0), 0.1), distant=torch.tensor([[True]]))
    assert float(shade(nearer, distant, NO_SCATTER)[0, 0, 0, 0]) == pytest.approx(0.1)


def test_ambient_occlusion_dims_the_ambient_light_alone() -> None:
    open_half = flat_skin(ambient_occlusion=torch.full((1, 1, 1, 1), 0.5, dtype=torch.float64))
    found = shade(open_half, one_light((0, 0, 1000.0), 0.7, ambient=0.2), NO_SCATTER)
    assert float(found[0, 0, 0, 0]) == pytest.approx(0.8)


@pytest.mark.parametrize("exponent", [8.0, 32.0, 128.0, 1000.0])
def test_specular_albedo_is_the_share_reflected_at_normal_incidence(exponent: float) -> None:
    # By reciprocity: light from everywhere, seen from straight above, returns the albedo.
    count = 20000
    height = (np.arange(count) + 0.5) / count
    turn = np.arange(count) * 2.399963
    flat = np.sqrt(1 - height**2)
    direction = np.stack([flat * np.cos(turn), flat * np.sin(turn), height], axis=1)
    # A uniform field of radiance 1 gives a white diffuser 1; each light carries 2/count of it.
    lights = LightSet("dome", 1e6 * direction, np.full((count, 3), 2 / count), np.zeros(3))
    environment = from_light_set(lights, np.array([0, 0, 1e6]))
    one = torch.ones(1, 1, 1, 1)
    up = torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1)
    skin = SkinMaps(0 * up, one, up, up, exponent * one, 0 * one, 0 * up, one, 1.0, one)
    found = float(shade(skin, environment, NO_SCATTER)[0, 0, 0, 0])
    assert found == pytest.approx(1.0, abs=2e-3)


def test_paper_mode_is_neither_clamped_nor_added() -> None:
    options = ShadeOptions(mode="paper", subsurface_mm=0)
    away = one_light((0, 0, -1000.0), 0.5, ambient=1.0)
    assert float(shade(flat_skin(), away, options)[0, 0, 0, 0]) == pytest.approx(-0.5)
    dark = one_light((0, 0, 1000.0), 0.5, ambient=0.0)
    assert float(shade(flat_skin(), dark, options)[0, 0, 0, 0]) == 0.0


def test_black_lights_fill_up_a_batch_without_changing_it() -> None:
    rng = np.random.default_rng(5)
    skin = random_skin(rng, dtype=torch.float32)
    first = from_light_set(
        LightSet("a", np.ones((1, 3)) * 700, np.ones((1, 3)), np.zeros(3)), [0, 0, 900]
    )
    second = from_light_set(
        LightSet("b", np.eye(3) * 700, np.ones((3, 3)), np.ones(3)), [0, 9, 900]
    )
    both = shade(skin, stack([first, second]))
    torch.testing.assert_close(both[:1], shade(skin, first)[:1])
    torch.testing.assert_close(both[1:], shade(skin, second)[1:])


# `paper` scatters in texels, over holes too, as printed.
@pytest.mark.parametrize(
    ("mode", "subsurface_mm"),
    [*itertools.product(["dielectric", "physical", "ggx"], [0.0, 1.4]), ("paper", 0.0)],
)
def test_a_texel_without_surface_is_black_and_reaches_no_gradient_whatever_its_maps_hold(
    mode: str, subsurface_mm: float
) -> None:
    rng = np.random.default_rng(5)
    skin, lights = random_skin(rng), random_lights(rng)
    skin.area[:, :, 1, 2] = 0
    options = ShadeOptions(mode=mode, subsurface_mm=subsurface_mm)
    expected = shade(skin, lights, options)
    for name in CHANNELS:
        value = getattr(skin, name)
        if value is None:
            continue
        for broken in (float("nan"), float("inf")):
            lost = value.clone()
            lost[:, :, 1, 2] = broken
            if name == "area" and broken > 0:
                continue
            leaves = {
                field: getattr(lights, field).clone().requires_grad_()
                for field in ("position_mm", "rgb", "ambient_rgb", "camera_mm")
            }
            lost.requires_grad_()
            picture = shade(
                dataclasses.replace(skin, **{name: lost}),
                dataclasses.replace(lights, **leaves),
                options,
            )
            np.testing.assert_allclose(picture.detach(), expected, rtol=1e-12, err_msg=name)
            assert not picture[:, :, 1, 2].any(), name
            picture.sum().backward()
            for field, leaf in {**leaves, name: lost}.items():
                assert leaf.grad is None or torch.isfinite(leaf.grad).all(), (name, field)
