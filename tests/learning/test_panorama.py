from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from learning.errors import MapsError
from learning.render.environments import Environment
from learning.render.light_dome import even_directions, harmonics
from learning.render.panorama import (
    Panorama,
    directions,
    importance,
    irradiance,
    median_cut,
    project,
    solid_angles,
)
from lightstage.errors import FormatError

CAMERA = np.array([0.0, 0.0, 1100.0])


def room(rows: int = 16, seed: int = 0) -> Panorama:
    """Dim walls, a window, a coloured lamp."""
    rng = np.random.default_rng(seed)
    radiance = rng.uniform(0.05, 0.2, (rows, 2 * rows, 3))
    radiance[rows // 4 : rows // 2, rows // 2 : rows] += [4, 5, 6]
    radiance[rows // 3, rows + 5] += [90, 40, 10]
    return Panorama(radiance)


def received(lights: Environment, normals: np.ndarray) -> np.ndarray:
    """(n, 3) of white diffusers."""
    cosine = np.maximum(normals @ lights.position_mm[0].double().numpy().T, 0)
    return cosine @ lights.rgb[0].double().numpy()


def given_by(lights: Environment, normals: np.ndarray) -> np.ndarray:
    """(n, 3) of white diffusers, with the ambient light."""
    return received(lights, normals) + lights.ambient_rgb[0].double().numpy()


def truth(panorama: Panorama, normals: np.ndarray) -> np.ndarray:
    rows = len(panorama.radiance)
    power = (panorama.radiance * solid_angles(rows)[..., None] / np.pi).reshape(-1, 3)
    return np.maximum(normals @ directions(rows).reshape(-1, 3).T, 0) @ power


def test_directions_cover_the_sphere_and_name_its_axes() -> None:
    assert float(solid_angles(9).sum() * 18) == pytest.approx(4 * np.pi)
    way = directions(64)
    assert way[0, 0, 1] > 0.99
    assert way[32, 64, 2] > 0.99
    assert way[32, 96, 0] > 0.99


def test_median_cut_keeps_the_light_and_comes_closer_with_more_lights() -> None:
    panorama, normals = room(), even_directions(200)
    exact = truth(panorama, normals)
    errors = []
    for count in (4, 32, 256):
        lights = median_cut(panorama, count, CAMERA)
        assert lights.rgb.shape[1] == count
        power = panorama.radiance * solid_angles(16)[..., None] / np.pi
        np.testing.assert_allclose(lights.rgb[0].sum(0), power.sum((0, 1)), rtol=1e-5)
        errors.append(np.abs(received(lights, normals) - exact).mean() / exact.mean())
    assert errors[2] < 0.01 < errors[1] < errors[0]
    every = median_cut(panorama, 10_000, CAMERA)
    np.testing.assert_allclose(received(every, normals), exact, rtol=1e-4)


def test_an_even_sky_has_no_direction() -> None:
    normals = even_directions(200)
    even = Panorama(np.full((16, 32, 3), [0.2, 0.5, 1.0]))
    alone = median_cut(even, 1, CAMERA)
    assert alone.rgb.shape == (1, 0, 3)
    np.testing.assert_allclose(alone.ambient_rgb[0], [0.2, 0.5, 1.0], rtol=1e-5)
    # Nor has one whose noise alone points somewhere.
    noisy = np.random.default_rng(0).uniform(0.99, 1.01, even.radiance.shape)
    nearly = Panorama(even.radiance * noisy)
    np.testing.assert_allclose(
        given_by(median_cut(nearly, 1, CAMERA), normals), truth(nearly, normals), rtol=0.01
    )


def test_few_lights_leave_wide_light_to_the_ambient_light_and_lose_none() -> None:
    panorama, normals = room(), even_directions(400)
    panorama.radiance[:] += 2
    exact = truth(panorama, normals)
    errors = []
    for count in (1, 2, 4, 16, 64):
        lights = median_cut(panorama, count, CAMERA)
        found = given_by(lights, normals)
        np.testing.assert_allclose(found.mean(axis=0), exact.mean(axis=0), rtol=0.02)
        errors.append(np.abs(found - exact).mean() / exact.mean())
        # A rectangle of less than a hemisphere has one lamp and nothing else.
        assert (lights.ambient_rgb > 0).all() == (count < 4)
    assert errors[0] < 0.3


def test_importance_is_right_on_average() -> None:
    panorama, normals = room(), even_directions(60)
    rng = np.random.default_rng(0)
    found = [received(importance(panorama, 16, CAMERA, rng), normals) for _ in range(300)]
    exact = truth(panorama, normals)
    spread = np.std(found, axis=0) / np.sqrt(300)
    assert (np.abs(np.mean(found, axis=0) - exact) < 5 * spread + 1e-4 * exact).all()
    assert (spread > 0).any()


def test_harmonics_are_orthonormal_and_give_a_diffusers_light() -> None:
    way = torch.from_numpy(directions(64))
    basis = harmonics(way, 4)
    weight = torch.from_numpy(solid_angles(64))[..., None]
    products = torch.einsum("hwi,hwj->ij", basis * weight, basis)
    torch.testing.assert_close(products, torch.eye(25).double(), atol=2e-3, rtol=0)
    panorama, normals = room(), even_directions(300)
    grid = torch.from_numpy(normals.T[None, :, :, None])
    exact = truth(panorama, normals)
    errors = []
    for order in (0, 1, 2, 4):
        found = irradiance(project(panorama, order), grid)[0, :, :, 0].numpy().T
        errors.append(np.abs(found - exact).mean() / exact.mean())
    assert errors == sorted(errors, reverse=True)
    assert errors[2] < 0.04
    assert errors[3] < 0.02


def test_harmonics_have_a_gradient_at_the_poles() -> None:
    light = project(room(), 2)
    normal = torch.tensor([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [0.6, 0.0, 0.8]]).double()
    grid = normal.T[None, :, :, None].requires_grad_()
    assert torch.autograd.gradcheck(lambda n: irradiance(light, n), (grid,))
    with pytest.raises(MapsError, match="at most 4"):
        irradiance(torch.zeros(3, 36), grid)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 999),
    rows=st.integers(2, 9),
    count=st.integers(1, 60),
    scale=st.sampled_from([1e-6, 1.0, 1e6]),
    dark=st.floats(0, 0.99),
)
def test_any_picture_of_light_is_kept(
    seed: int, rows: int, count: int, scale: float, dark: float
) -> None:
    rng = np.random.default_rng(seed)
    radiance = scale * rng.uniform(0, 1, (rows, 2 * rows, 3))
    radiance *= rng.uniform(size=(rows, 2 * rows, 1)) >= dark
    radiance[0, 0] = scale
    lights = median_cut(Panorama(radiance), count, CAMERA)
    assert 1 <= lights.rgb.shape[1] <= count
    power = (radiance * solid_angles(rows)[..., None] / np.pi).sum((0, 1))
    np.testing.assert_allclose(lights.rgb[0].sum(0) + 4 * lights.ambient_rgb[0], power, rtol=1e-4)
    np.testing.assert_allclose(lights.position_mm.norm(dim=-1), 1, rtol=1e-5)


@pytest.mark.parametrize(
    ("radiance", "message"),
    [
        (np.ones((4, 9, 3)), "4 x 9 x 3"),
        (np.full((4, 8, 3), np.nan), "NaN"),
        (-np.ones((4, 8, 3)), "negative"),
        (np.zeros((4, 8, 3)), "no light"),
    ],
)
def test_what_is_no_picture_of_light_is_refused(radiance: np.ndarray, message: str) -> None:
    with pytest.raises(FormatError, match=message):
        Panorama(radiance)
