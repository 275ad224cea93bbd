"""Skin's reflectance as the reference has it."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("mitsuba", reason="needs the extra `reference`")

from sim.reference.lobes import BODY, MIRROR, TABLE, facets_mirror, fresnel, lobes_of

NODES, WEIGHTS = np.polynomial.legendre.leggauss(48)
COSINES, SHARES = (NODES + 1) / 2, WEIGHTS / 2


def lobe(roughness: float, part: int, first: np.ndarray, second: np.ndarray) -> float:
    """Mitsuba's lobe times the second direction's cosine."""
    import mitsuba as mi

    mi.set_variant("scalar_rgb")
    si = mi.SurfaceInteraction3f()
    si.wi = mi.Vector3f(first.tolist())
    context = mi.BSDFContext()
    context.component = part
    return float(
        lobes_of("beckmann", roughness).bsdf.eval(context, si, mi.Vector3f(second.tolist()))[0]
    )


def direction(cosine: float, turn: float = 0.0) -> np.ndarray:
    sine = np.sqrt(1 - cosine**2)
    return np.array([sine * np.cos(turn), sine * np.sin(turn), cosine])


def test_fresnel_of_skin_is_that_of_methods() -> None:
    angles = np.radians([0.0, 45.0, 60.0, 75.0])
    found = fresnel(np.cos(angles))
    np.testing.assert_allclose(found, [0.0278, 0.037, 0.072, 0.231], atol=6e-4)


@pytest.mark.parametrize("roughness", [0.15, 0.3])
@pytest.mark.parametrize("cosine", [1.0, 0.6, 0.25])
def test_white_furnace_returns_all_light_that_entered(roughness: float, cosine: float) -> None:
    """Light from one direction on white skin: what leaves from below is what T let in."""
    lobes = lobes_of("beckmann", roughness)
    light = direction(cosine)
    # The body's lobe has no azimuth.
    out = [lobe(roughness, BODY, light, direction(c)) for c in COSINES]
    left = lobes.body_scale * 2 * np.pi * float(np.sum(SHARES * out))
    entered = np.interp(cosine, np.linspace(0, 1, TABLE), lobes.enters)
    assert left == pytest.approx(entered, rel=0.005)
    turns = (np.arange(32) + 0.5) / 32 * np.pi
    mirrored = sum(
        share * np.mean([lobe(roughness, MIRROR, light, direction(c, t)) for t in turns])
        for c, share in zip(COSINES, SHARES, strict=True)
    )
    # Light that facets mirror onto other facets is in neither part: a rough surface loses it.
    total = left + 2 * np.pi * mirrored
    assert 0.93 < total < 1.005


def test_mitsubas_own_scale_loses_light_inside_a_rough_surface() -> None:
    """Why the body is scaled: as it comes, white skin of m = .3 returns 88 % of what entered."""
    assert 1 / lobes_of("beckmann", 0.3).body_scale == pytest.approx(0.883, abs=0.003)
    assert 1 / lobes_of("beckmann", 0.1).body_scale == pytest.approx(0.972, abs=0.003)


def test_a_smooth_surface_mirrors_f0() -> None:
    assert facets_mirror("beckmann", 0.001) == pytest.approx(1 / 36, rel=1e-4)
    assert facets_mirror("ggx", 0.001) == pytest.approx(1 / 36, rel=1e-2)


@pytest.mark.parametrize("part", [BODY, MIRROR])
def test_reciprocity(part: int) -> None:
    rng = np.random.default_rng(4)
    for _ in range(40):
        first, second = (direction(rng.uniform(0.05, 1), rng.uniform(0, 6.3)) for _ in range(2))
        there = lobe(0.25, part, first, second) / second[2]
        back = lobe(0.25, part, second, first) / first[2]
        assert there == pytest.approx(back, rel=1e-3, abs=1e-6)
