"""The simulator's transport against a path tracer that others keep (Mitsuba 3)."""

from __future__ import annotations

import numpy as np
import pytest

from sim.render import shade

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


def mitsuba_radiance(bsdf: dict, light_mm: np.ndarray, directions: np.ndarray) -> np.ndarray:
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
    light_mm: np.ndarray, directions: np.ndarray, normals: np.ndarray, roughness: float, f0: float
) -> tuple[np.ndarray, np.ndarray]:
    """(n,) diffuse part of albedo 0.5 and (n,) specular part."""
    count = len(normals)
    diffuse, specular = shade(
        RADIUS_MM * normals,
        normals,
        normals,
        -directions,
        np.full((count, 3), 0.5),
        np.full(count, f0),
        np.full(count, roughness),
        np.ones((count, 1), np.uint8),
        light_mm[None],
        np.ones((1, 1, 3)),
    )
    return diffuse[0, :, 1], specular[0, :, 1]


@pytest.mark.parametrize("light_mm", LIGHTS_MM)
def test_diffuse_light_is_that_of_mitsuba(light_mm: np.ndarray) -> None:
    directions, normals = sphere_rays(np.random.default_rng(1), 300)
    truth = mitsuba_radiance({"type": "diffuse", "reflectance": 0.5}, light_mm, directions)
    found, _ = our_radiance(light_mm, directions, normals, 0.3, 0.028)
    assert truth.max() > 0.1
    np.testing.assert_allclose(found, truth, atol=2e-4 * truth.max())


@pytest.mark.parametrize("light_mm", LIGHTS_MM)
@pytest.mark.parametrize("roughness", [0.2, 0.35])
def test_specular_light_is_that_of_mitsuba(light_mm: np.ndarray, roughness: float) -> None:
    """A conductor of k = 0 reflects as a dielectric does: exact Fresnel, Beckmann, Smith."""
    directions, normals = sphere_rays(np.random.default_rng(2), 300)
    bsdf = {
        "type": "roughconductor",
        "distribution": "beckmann",
        "alpha": roughness,
        "eta": {"type": "rgb", "value": 1.4},
        "k": {"type": "rgb", "value": 0.0},
    }
    truth = mitsuba_radiance(bsdf, light_mm, directions)
    _, found = our_radiance(light_mm, directions, normals, roughness, (0.4 / 2.4) ** 2)
    # Ours masks by the height-correlated Smith term, Mitsuba by the separable one, which is darker
    # at grazing angles only.
    facing = (normals @ light_mm / np.linalg.norm(light_mm) > 0.4) & (
        np.einsum("nk,nk->n", normals, -directions) > 0.4
    )
    assert truth[facing].max() > 0.001
    np.testing.assert_allclose(found[facing], truth[facing], rtol=0.02, atol=1e-5)
    assert (found >= truth * 0.98 - 1e-5).all()
