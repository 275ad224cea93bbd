"""Lamps found in a texture: their columns beside a plain twin, their places, what is thrown at."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from learning.maps import SHININESS
from learning.render.uv import rasterise
from learning.whole.light import AMBIENT_SHINE, F0, LightFit, LitSurface
from lightstage.formats.mesh import Mesh
from lightstage.formats.template import default_template_path, load_template

SIZE = (48, 32)
CAMERA_MM = np.array([0.0, 0.0, 1100.0])
LAMPS_MM = np.array([[500.0, 400.0, 900.0], [-800.0, 100.0, 500.0]])
RGB = np.array([[0.6, 0.5, 0.4], [0.2, 0.3, 0.4], [0.15, 0.15, 0.15]])


@pytest.fixture(scope="module")
def head() -> Mesh:
    return load_template(default_template_path()).mesh


@pytest.fixture(scope="module")
def surface(head: Mesh) -> LitSurface:
    return LitSurface(head, rasterise(head, *SIZE), CAMERA_MM)


def lit(surface: LitSurface, albedo: np.ndarray, specular: float) -> np.ndarray:
    """The texture under `LAMPS_MM` and ambient light."""
    irradiance, lobe = surface.under(LAMPS_MM)
    whole = irradiance @ RGB[:2] + surface.openness()[:, None] * RGB[2]
    around = AMBIENT_SHINE * surface.openness()[:, None] * RGB[2]
    made: np.ndarray = albedo * whole + specular * (lobe @ RGB[:2] + around)
    return made


def degrees_between(found: np.ndarray, true: np.ndarray) -> float:
    cosine = found @ true / np.linalg.norm(found) / np.linalg.norm(true)
    return math.degrees(math.acos(min(1.0, float(cosine))))


def test_columns_are_the_sums_of_one_lamp_written_apart(head: Mesh, surface: LitSurface) -> None:
    raster = rasterise(head, *SIZE)
    points = raster.interpolate(head.vertices)[raster.covered]
    normals = raster.normals(head)[raster.covered]
    seen = surface.seen(LAMPS_MM)
    irradiance, lobe = surface.under(LAMPS_MM)
    for index, lamp in enumerate(LAMPS_MM):
        for texel in range(0, len(points), 37):
            toward = lamp - points[texel]
            distance = float(np.linalg.norm(toward))
            view = CAMERA_MM - points[texel]
            half = toward / distance + view / np.linalg.norm(view)
            cosine = max(0.0, float(normals[texel] @ toward) / distance)
            given = float(seen[index, texel]) * cosine * float(lamp @ lamp) / distance**2
            assert irradiance[texel, index] == pytest.approx(given, abs=1e-4)
            view, half = view / np.linalg.norm(view), half / np.linalg.norm(half)
            toward_view = float(normals[texel] @ view)
            facing = float(normals[texel] @ half)
            expected = 0.0
            if min(cosine, toward_view, facing) > 0:
                # Walter's facets and shadowing, Schlick's rise from F0.
                a = 2 / (SHININESS + 2)
                density = a / (math.pi * (facing**2 * (a - 1) + 1) ** 2)
                open_share = 1.0
                for c in (cosine, toward_view):
                    open_share *= 2 * c / (c + math.sqrt(a + (1 - a) * c**2))
                rise = (1 - float(view @ half)) ** 5
                fresnel = F0 + (1 - F0) * rise
                expected = math.pi * density * open_share * fresnel / (4 * cosine * toward_view)
            assert F0 * lobe[texel, index] == pytest.approx(given * expected, abs=1e-4)


def test_two_lamps_and_the_ambient_light_are_found_in_a_texture_of_known_skin(
    surface: LitSurface,
) -> None:
    count = int(surface.covered.sum())
    albedo = np.random.default_rng(0).uniform(0.2, 0.5, (count, 3))
    fit = LightFit(surface, lit(surface, albedo, 0.03), np.ones(count))
    found = fit.find(albedo, np.full(count, 0.03), None, math.inf)
    assert found.misfit < 0.05
    assert len(found.lamps_mm) >= 2
    order = np.argsort(-found.rgb[:-1].sum(axis=1))[:2]
    for index, lamp, rgb in zip(order, LAMPS_MM, RGB, strict=False):
        assert degrees_between(np.array(found.lamps_mm[index]), lamp) < 8
        np.testing.assert_allclose(found.rgb[index], rgb, atol=0.08)
    irradiance = fit.columns(found.lamps_mm)[0] @ found.rgb
    true = lit(surface, np.ones((count, 3)), 0.0)
    assert np.sqrt(np.mean((irradiance - true) ** 2)) < 0.04


def test_hairs_and_spots_on_a_tenth_of_the_skin_move_no_lamp_far(
    surface: LitSurface,
) -> None:
    count = int(surface.covered.sum())
    albedo = np.full((count, 3), 0.35)
    texture = lit(surface, albedo, 0.03)
    texture[np.random.default_rng(0).random(count) < 0.1] *= 0.4
    fit = LightFit(surface, texture, np.ones(count))
    found = fit.find(albedo, np.full(count, 0.03), None, math.inf)
    strongest = int(found.rgb[:-1].sum(axis=1).argmax())
    assert degrees_between(np.array(found.lamps_mm[strongest]), LAMPS_MM[0]) < 12


def test_time_that_is_up_still_gives_a_light(surface: LitSurface) -> None:
    count = int(surface.covered.sum())
    albedo = np.full((count, 3), 0.3)
    fit = LightFit(surface, lit(surface, albedo, 0.0), np.ones(count))
    found = fit.find(albedo, np.zeros(count), None, -math.inf)
    assert found.lamps_mm == ()
    assert np.isfinite(found.rgb).all()


@settings(max_examples=10, deadline=None)
@given(
    st.sampled_from([1e-6, 1.0, 1e6]),
    st.sampled_from(["black", "noise", "one texel", "one colour"]),
    st.sampled_from(["none", "all", "few"]),
)
def test_whatever_is_photographed_the_light_is_finite_and_not_negative(
    surface: LitSurface, scale: float, kind: str, counted: str
) -> None:
    count = int(surface.covered.sum())
    rng = np.random.default_rng(0)
    texture = {
        "black": np.zeros((count, 3)),
        "noise": rng.uniform(0, 1, (count, 3)),
        "one texel": np.eye(count, 3),
        "one colour": np.full((count, 3), 0.4),
    }[kind]
    weight = {"none": 0.0, "all": 1.0, "few": rng.random(count) > 0.99}[counted] * np.ones(count)
    fit = LightFit(surface, scale * texture, weight)
    found = fit.find(np.full((count, 3), 0.3), np.full(count, 0.03), None, -math.inf)
    assert np.isfinite(found.rgb).all()
    assert (found.rgb >= 0).all()
    assert np.isfinite(found.misfit)
