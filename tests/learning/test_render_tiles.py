from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest
import torch

from learning.render import eager
from learning.render.environments import Environment
from learning.render.shading import shade
from learning.render.skin import ShadeOptions, SkinMaps
from learning.render.tiles import shade_in_bands


def field(rng: np.random.Generator, channels: int, low: float, high: float) -> torch.Tensor:
    return torch.tensor(rng.uniform(low, high, (1, channels, 90, 40)), dtype=torch.float32)


def scene(rng: np.random.Generator) -> tuple[SkinMaps, Environment]:
    skin = SkinMaps(
        field(rng, 3, 0.1, 0.9),
        field(rng, 1, 0.0, 0.1),
        field(rng, 3, -1, 1),
        field(rng, 3, -1, 1),
        field(rng, 1, 4, 60),
        field(rng, 1, 0, 1),
        field(rng, 3, -80, 80),
        field(rng, 1, 0.5, 1.5),
        1.0,
        field(rng, 1, 0, 1),
        field(rng, 2, 0.7, 1.4),
    )
    lights = Environment(
        torch.tensor([[[300.0, 200, 900], [-500, 0, 400]]]),
        torch.tensor([[[0.5, 0.4, 0.3], [0.2, 0.3, 0.4]]]),
        torch.full((1, 3), 0.1),
        torch.tensor([[False, True]]),
        torch.tensor([[0.0, 0.0, 1000.0]]),
    )
    return skin, lights


@pytest.mark.parametrize("sigma", [0.0, 2.0])
def test_bands_give_the_picture_of_the_whole(sigma: float) -> None:
    rng = np.random.default_rng(0)
    skin, lights = scene(rng)
    seen, options = field(rng, 2, 0, 1), ShadeOptions(subsurface_mm=sigma)
    whole = shade(skin, lights, options, seen)
    for rows in (17, 64, 200):
        found = shade_in_bands(skin, lights, options, seen, rows)
        torch.testing.assert_close(found, whole, atol=1e-6 if sigma == 0 else 3e-4, rtol=0)


def test_what_is_skipped_changes_nothing() -> None:
    rng = np.random.default_rng(1)
    skin, lights = scene(rng)
    whole = shade(skin, lights)
    matte = torch.rand(1, 1, 90, 40) < 0.5
    holes = torch.rand(1, 1, 90, 40) < 0.3
    flat = ShadeOptions(subsurface_mm=0)
    some = dataclasses.replace(skin, specular_albedo=skin.specular_albedo * ~matte)
    found, full = shade(some, lights, flat), shade(skin, lights, flat)
    torch.testing.assert_close(found.where(matte, full), found)
    torch.testing.assert_close(found.where(~matte, full), full)
    holed = shade(dataclasses.replace(skin, area=skin.area * ~holes), lights, flat)
    assert torch.equal(holed, full * ~holes)
    opaque = dataclasses.replace(skin, translucency=0 * skin.translucency)
    torch.testing.assert_close(shade(opaque, lights), full)
    behind = dataclasses.replace(
        lights,
        position_mm=torch.cat(
            [lights.position_mm, lights.position_mm.new_tensor([[[0, 0, 1e6]]])], 1
        ),
        rgb=torch.cat([lights.rgb, torch.zeros(1, 1, 3)], 1),
        distant=torch.cat([lights.distant, torch.tensor([[True]])], 1),
    )
    assert torch.equal(shade(skin, behind), whole)


def test_gradients_do_not_depend_on_which_others_are_asked_for() -> None:
    rng = np.random.default_rng(2)
    skin, lights = scene(rng)
    names = ["diffuse_albedo", "specular_albedo", "diffuse_normal", "specular_normal"]
    names += ["shininess", "translucency", "position_mm", "ambient_occlusion"]
    leaves = {n: getattr(skin, n).clone().requires_grad_() for n in names}
    lit = shade(dataclasses.replace(skin, **leaves), lights)
    together = torch.autograd.grad(lit.square().sum(), list(leaves.values()))
    for name, expected in zip(names, together, strict=True):
        leaf = leaves[name]
        alone = shade(dataclasses.replace(skin, **{name: leaf}), lights)
        (found,) = torch.autograd.grad(alone.square().sum(), [leaf])
        torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-6)


def test_one_skin_under_many_lights_is_many_skins_under_each() -> None:
    rng = np.random.default_rng(3)
    skin, lights = scene(rng)
    other = dataclasses.replace(lights, rgb=lights.rgb.flip(1), camera_mm=lights.camera_mm + 90)
    fields = [f.name for f in dataclasses.fields(lights)]
    both = Environment(*(torch.cat([getattr(lights, n), getattr(other, n)]) for n in fields))
    for options in (ShadeOptions(), ShadeOptions(mode="ggx"), ShadeOptions(engine="eager")):
        found = shade(skin, both, options)
        expected = torch.cat([shade(skin, light, options) for light in (lights, other)])
        torch.testing.assert_close(found, expected, atol=1e-5, rtol=1e-4)


def test_half_precision_maps_are_shaded_in_single() -> None:
    rng = np.random.default_rng(4)
    skin, lights = scene(rng)
    whole = shade(skin, lights)
    names = [f.name for f in dataclasses.fields(skin) if f.name not in ("texel_mm", "position_mm")]
    halved = dataclasses.replace(skin, **{n: getattr(skin, n).half() for n in names})
    found = shade(halved, lights)
    assert found.dtype == torch.float32
    torch.testing.assert_close(found, whole, atol=3e-3, rtol=1e-2)


def test_the_compiled_engine_is_the_eager_one_traced(monkeypatch: pytest.MonkeyPatch) -> None:
    # Traced and differentiated as for code, but run by torch's operations: that the code which
    # torch makes of a trace does the same is torch's own claim, and takes half a minute.
    traced = functools.partial(torch.compile, backend="aot_eager")
    monkeypatch.setattr(torch, "compile", traced)
    monkeypatch.setattr(eager, "compiled", eager.compiled.__wrapped__)
    rng = np.random.default_rng(6)
    skin, lights = scene(rng)
    seen, found = field(rng, 2, 0, 1), []
    for engine in ("compiled", "eager"):
        normal = skin.specular_normal.clone().requires_grad_()
        maps = dataclasses.replace(skin, specular_normal=normal)
        picture = shade(maps, lights, ShadeOptions(engine=engine), seen)
        found.append([picture, *torch.autograd.grad(picture.square().sum(), [normal])])
    for a, b in zip(*found, strict=True):
        torch.testing.assert_close(a, b)
