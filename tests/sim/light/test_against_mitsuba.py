"""The simulator's transport against a path tracer that others keep (Mitsuba 3)."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from sim.light.facets import SKIN_F0
from sim.light.lamps import point_lamps
from sim.light.olat import shade
from sim.light.render import Lobe

RADIUS_MM = 80.0
LIGHTS_MM = np.array([[300.0, 500.0, 1100.0], [-900.0, 80.0, 860.0], [100.0, -1240.0, 120.0]])
CAMERA_MM = np.array([0.0, 0.0, 1100.0])


def sphere_rays(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Directions from the camera to a sphere at the origin, and its unit normals where they hit."""
    aim = rng.normal(size=(count, 3))
    aim *= RADIUS_MM / np.linalg.norm(aim, axis=1, keepdims=True)
    direction = aim - CAMERA_MM
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    along = direction @ CAMERA_MM
    distance = -along - np.sqrt(along**2 - CAMERA_MM @ CAMERA_MM + RADIUS_MM**2)
    return direction, (CAMERA_MM + distance[:, None] * direction) / RADIUS_MM


def mitsuba_radiance(
    bsdf: dict[str, Any], light_mm: np.ndarray, directions: np.ndarray
) -> np.ndarray:
    """(n,) radiance of the sphere, on our scale for a light of weight 1."""
    mi = pytest.importorskip("mitsuba", reason="needs the extra `reference`")
    mi.set_variant("scalar_rgb")
    # A white diffuser at the origin facing the light reads 1 when I / d^2 = pi.
    intensity = float(np.pi * light_mm @ light_mm)
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "direct"},
            "ball": {"type": "sphere", "radius": RADIUS_MM, "bsdf": bsdf},
            "lamp": {
                "type": "point",
                "position": light_mm.tolist(),
                "intensity": {"type": "rgb", "value": intensity},
            },
        }
    )
    sampler = mi.load_dict({"type": "independent"})
    integrator = scene.integrator()
    out = []
    for direction in directions:
        ray = mi.RayDifferential3f(mi.Point3f(*CAMERA_MM), mi.Vector3f(*direction))
        out.append(integrator.sample(scene, sampler, ray)[0][1])
    return np.array(out, float)


def our_radiance(
    light_mm: np.ndarray,
    directions: np.ndarray,
    normals: np.ndarray,
    roughness: float,
    distribution: str = "beckmann",
) -> tuple[np.ndarray, np.ndarray]:
    """(n,) diffuse part of albedo 0.5 and (n,) specular part of F0."""
    count = len(normals)
    diffuse, specular = shade(
        RADIUS_MM * normals,
        normals,
        normals,
        -directions,
        np.full((count, 3), 0.5),
        np.full(count, SKIN_F0),
        np.full(count, roughness),
        np.ones((count, 1), np.uint8),
        point_lamps(light_mm[None]),
        np.ones((1, 1, 3)),
        Lobe(distribution),
    )
    return diffuse[0, :, 1], specular[0, :, 1]


def facing(light_mm: np.ndarray, directions: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(n,) bool: the light and the camera both stand within 66 degrees of the normal."""
    to_light = light_mm - RADIUS_MM * normals
    to_light /= np.linalg.norm(to_light, axis=1, keepdims=True)
    above = np.einsum("nk,nk->n", normals, to_light) > 0.4
    return above & (np.einsum("nk,nk->n", normals, -directions) > 0.4)


def kept_share(bsdf: dict[str, Any]) -> float:
    """What Mitsuba's diffuse layer of albedo 1 leaves of the light that entered.

    Its internal reflectance and its external transmittance are not each other's adjoint for rough
    facets, so that some light is lost.
    """
    mi = pytest.importorskip("mitsuba", reason="needs the extra `reference`")
    mi.set_variant("scalar_rgb")
    made = mi.load_dict(bsdf)
    nodes, weights = np.polynomial.legendre.leggauss(64)
    cosines, context, seen = (nodes + 1) / 2, mi.BSDFContext(), mi.SurfaceInteraction3f()
    left = 0.0
    for cosine, weight in zip(cosines, weights / 2, strict=True):
        seen.wi = mi.Vector3f(np.sqrt(1 - cosine**2), 0, cosine)
        # `eval` holds the cosine to the light, which comes along the normal.
        value = made.eval(context, seen, mi.Vector3f(0, 0, 1))[1] / 0.5
        left += weight * 2 * np.pi * cosine * value
    return left / (1 - SKIN_F0)


@pytest.mark.parametrize("light_mm", LIGHTS_MM)
@pytest.mark.parametrize("distribution", ["beckmann", "ggx"])
@pytest.mark.parametrize("roughness", [0.2, 0.3])
def test_diffuse_light_is_near_that_of_roughplastic_made_lossless(
    light_mm: np.ndarray, distribution: str, roughness: float
) -> None:
    """The same product of two transmittances.

    Mitsuba takes for lost what one facet throws upon another; ours lets it into the skin, which
    is what keeps the energy (test_energy). GGX has more such light.
    """
    directions, normals = sphere_rays(np.random.default_rng(1), 300)
    bsdf = roughplastic(distribution, roughness, 0.0)
    truth = mitsuba_radiance(bsdf, light_mm, directions) / kept_share(bsdf)
    found, _ = our_radiance(light_mm, directions, normals, roughness, distribution)
    front = facing(light_mm, directions, normals)
    error = found[front] / truth[front] - 1
    wide = distribution == "ggx"
    assert truth.max() > 0.1
    assert np.median(np.abs(error)) < (0.05 if wide else 0.02)
    assert np.abs(error).max() < (0.12 if wide else 0.06)
    assert (found[truth == 0] < 1e-3).all()


@pytest.mark.parametrize("light_mm", LIGHTS_MM)
@pytest.mark.parametrize("distribution", ["beckmann", "ggx"])
@pytest.mark.parametrize("roughness", [0.2, 0.35])
def test_specular_light_is_that_of_mitsuba(
    light_mm: np.ndarray, distribution: str, roughness: float
) -> None:
    """A conductor of k = 0 reflects as a dielectric does: exact Fresnel, the same facets."""
    directions, normals = sphere_rays(np.random.default_rng(2), 300)
    bsdf = {
        "type": "roughconductor",
        "distribution": distribution,
        "alpha": roughness,
        "eta": {"type": "rgb", "value": 1.4},
        "k": {"type": "rgb", "value": 0.0},
    }
    truth = mitsuba_radiance(bsdf, light_mm, directions)
    _, found = our_radiance(light_mm, directions, normals, roughness, distribution)
    front = facing(light_mm, directions, normals)
    assert truth[front].max() > 0.001
    np.testing.assert_allclose(found[front], truth[front], rtol=0.03, atol=1e-5)
    assert (found >= truth * 0.98 - 1e-5).all()


def roughplastic(distribution: str, roughness: float, specular: float) -> dict[str, Any]:
    return {
        "type": "roughplastic",
        "distribution": distribution,
        "alpha": roughness,
        "int_ior": 1.4,
        "ext_ior": 1.0,
        "nonlinear": False,
        "diffuse_reflectance": {"type": "rgb", "value": 0.5},
        "specular_reflectance": {"type": "rgb", "value": specular},
    }
