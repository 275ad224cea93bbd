from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from learning.errors import MapsError
from learning.render import shading
from learning.render.environments import Environment, from_light_set, stack
from learning.render.shading import ShadeOptions, SkinMaps, direct, shade
from lightstage.formats.environment import LightSet

NO_SCATTER = ShadeOptions(subsurface_mm=0)


def random_skin(
    rng: np.random.Generator, height: int = 5, width: int = 4, dtype: torch.dtype = torch.float64
) -> SkinMaps:
    def values(channels: int, low: float, high: float) -> torch.Tensor:
        return torch.tensor(rng.uniform(low, high, (2, channels, height, width)), dtype=dtype)

    return SkinMaps(
        diffuse_albedo=values(3, 0.05, 0.9),
        specular_albedo=values(1, 0.01, 0.1),
        diffuse_normal=values(3, -1, 1),
        specular_normal=values(3, -1, 1),
        shininess=values(1, 2, 80),
        translucency=values(1, 0.1, 0.9),
        position_mm=values(3, -80, 80),
        area=values(1, 0.5, 1.5),
        texel_mm=1.0,
        ambient_occlusion=values(1, 0.3, 1),
    )


def random_lights(rng: np.random.Generator, count: int = 3) -> Environment:
    def tensor(values: np.ndarray) -> torch.Tensor:
        return torch.tensor(values, dtype=torch.float64)

    direction = rng.normal(size=(2, count, 3))
    direction /= np.linalg.norm(direction, axis=2, keepdims=True)
    return Environment(
        tensor(direction * rng.uniform(400, 1500, (2, count, 1))),
        tensor(rng.uniform(0.05, 0.4, (2, count, 3))),
        tensor(rng.uniform(0, 0.3, (2, 3))),
        torch.tensor([[i % 2 == 1 for i in range(count)]] * 2),
        tensor(np.array([[50.0, -30.0, 1000.0], [0.0, 0.0, 900.0]])),
    )


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


def flat_skin(
    normal: tuple[float, float, float] = (0, 0, 1), albedo: float = 1.0, **changes: torch.Tensor
) -> SkinMaps:
    one = torch.ones(1, 1, 1, 1, dtype=torch.float64)
    up = torch.tensor(normal, dtype=torch.float64).view(1, 3, 1, 1)
    skin = SkinMaps(
        albedo * one.repeat(1, 3, 1, 1), 0 * one, up, up, 32 * one, 0 * one, 0 * up, one, 1.0, one
    )
    return dataclasses.replace(skin, **changes)


def one_light(
    position: tuple[float, float, float], rgb: float = 0.7, ambient: float = 0.0
) -> Environment:
    lights = LightSet("one", np.array([position]), np.full((1, 3), rgb), np.full(3, ambient))
    environment = from_light_set(lights, np.array([0, 0, 1000.0]))
    fields = dataclasses.fields(environment)
    values = {f.name: getattr(environment, f.name) for f in fields}
    return Environment(**{k: v if v.dtype == torch.bool else v.double() for k, v in values.items()})


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


GRADIENT_FIELDS = (
    "diffuse_albedo",
    "specular_albedo",
    "diffuse_normal",
    "specular_normal",
    "shininess",
    "translucency",
    "position_mm",
    "ambient_occlusion",
)


@pytest.mark.parametrize("mode", ["physical", "paper"])
@pytest.mark.parametrize("field", GRADIENT_FIELDS)
def test_gradient_of_every_map_is_exact(field: str, mode: str) -> None:
    rng = np.random.default_rng(2)
    skin, lights = random_skin(rng, 3, 2), random_lights(rng)
    options = ShadeOptions(mode=mode)

    def render(values: torch.Tensor) -> torch.Tensor:
        return shade(dataclasses.replace(skin, **{field: values}), lights, options)

    values = getattr(skin, field).clone().requires_grad_()
    assert torch.autograd.gradcheck(render, (values,), eps=1e-6, atol=1e-6)


@pytest.mark.parametrize("field", ["position_mm", "rgb", "ambient_rgb", "camera_mm"])
def test_gradient_of_every_light_is_exact(field: str) -> None:
    rng = np.random.default_rng(4)
    skin, lights = random_skin(rng, 2, 2), random_lights(rng)

    def render(values: torch.Tensor) -> torch.Tensor:
        return shade(skin, dataclasses.replace(lights, **{field: values}))

    values = getattr(lights, field).clone().requires_grad_()
    assert torch.autograd.gradcheck(render, (values,), eps=1e-4, atol=1e-6)


@settings(max_examples=60, deadline=None)
@given(
    normal=st.sampled_from(
        [(0, 0, 0), (1, 0, 0), (0, 0, 1), (0, 0, -1), (1e-9, 0, 0), (1e6, 0, 0)]
    ),
    albedo=st.sampled_from([0.0, 1e-6, 0.5, 1.0, 1e6]),
    exponent=st.floats(1, 1000),
    position=st.sampled_from([(0, 0, 1000), (1000, 0, 0), (1e6, 0, 1), (1e-3, 0, 0), (0, 0, -5)]),
    distant=st.booleans(),
    strength=st.sampled_from([0.0, 1e-6, 1.0, 1e6]),
)
def test_values_and_gradients_stay_finite_at_the_extremes(
    normal: tuple[float, float, float],
    albedo: float,
    exponent: float,
    position: tuple[float, float, float],
    distant: bool,
    strength: float,
) -> None:
    skin = flat_skin(normal, albedo, shininess=torch.full((1, 1, 1, 1), exponent).double())
    skin = dataclasses.replace(skin, specular_albedo=torch.full((1, 1, 1, 1), albedo).double())
    lights = dataclasses.replace(one_light(position, strength), distant=torch.tensor([[distant]]))
    leaves = {name: getattr(skin, name).clone().requires_grad_() for name in GRADIENT_FIELDS}
    picture = shade(dataclasses.replace(skin, **leaves), lights)
    assert torch.isfinite(picture).all()
    picture.sum().backward()
    for name, leaf in leaves.items():
        assert leaf.grad is not None, name
        assert torch.isfinite(leaf.grad).all(), name


def test_nan_is_passed_on_and_not_hidden() -> None:
    skin = flat_skin(albedo=float("nan"))
    assert torch.isnan(shade(skin, one_light((0, 0, 1000.0)), NO_SCATTER)).all()


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


def test_maps_of_different_sizes_are_refused() -> None:
    with pytest.raises(MapsError, match="specular_albedo: found 2 x 2 texels, expected 1 x 1"):
        flat_skin(specular_albedo=torch.zeros(1, 1, 2, 2))
