"""What a polarised stage's lamps and lenses leave of mirror reflection, lamp by lamp.

Lamps of the vertical bank shine with their field along the meridian through the lamp, those of the
horizontal bank with theirs along the circle of latitude; lenses pass the upright field. A facet
that mirrors a lamp turns its field: the part s across the plane of lamp and camera comes back times
Fresnel's r_s, the part in the plane times r_p. What passes the lens, as a share of what the same
facet sends of unpolarised light into a lens without polariser, is

    ((e . s) r_s (s . a) + (e . p_in) r_p (p_out . a))^2 / ((r_s^2 + r_p^2) / 2)
"""

from __future__ import annotations

import dataclasses

import numpy as np

from lightstage.rig import Camera
from processing.interface import INDEX
from processing.lights import PatternLights

SHORT = 1e-9


def mirror_shares(directions: np.ndarray, vertical: np.ndarray, camera: Camera) -> np.ndarray:
    """Share of each lamp's mirror reflection that passes a camera's polariser.

    Args:
        directions: (L, 3) unit, toward the lamps.
        vertical: (L,) bool, lamps of the vertical bank.
        camera: its polariser passes the field along its picture's columns.

    Returns:
        (L,) about 1 for the vertical bank and 0 for the horizontal one near the camera.

    Source: [Baek2018] for the facet, [Ghosh2011] for lamps and lenses.
    """
    view = camera.centre_mm / np.linalg.norm(camera.centre_mm)
    upright = _across(-camera.cam_from_world[1, :3][None], view[None])[0]
    latitude = np.stack([directions[:, 2], np.zeros(len(directions)), -directions[:, 0]], axis=1)
    length = np.linalg.norm(latitude, axis=1, keepdims=True)
    latitude = np.where(length > SHORT, latitude / np.maximum(length, SHORT), [1.0, 0.0, 0.0])
    field = np.where(vertical[:, None], np.cross(directions, latitude), latitude)
    s = np.cross(directions, view)
    # Light straight back has no plane of incidence; every one gives the same.
    length = np.linalg.norm(s, axis=1, keepdims=True)
    s = np.where(length > SHORT, s / np.maximum(length, SHORT), upright)
    p_in, p_out = np.cross(-directions, s), np.cross(view, s)
    cosine = np.sqrt(np.clip((1 + directions @ view) / 2, 0, 1))
    inside = np.sqrt(1 - (1 - cosine**2) / INDEX**2)
    r_s = (cosine - INDEX * inside) / (cosine + INDEX * inside)
    r_p = (INDEX * cosine - inside) / (INDEX * cosine + inside)
    passed = _dot(field, s) * r_s * (s @ upright) + _dot(field, p_in) * r_p * (p_out @ upright)
    return np.asarray(passed**2 / ((r_s**2 + r_p**2) / 2))


def mirror_lights(lights: PatternLights, camera: Camera) -> PatternLights:
    """The lights as mirror reflection shows them to one camera, for the lobe alone.

    Args:
        lights: of patterns that are all polarised; a lamp that both banks light counts as
            vertical.
        camera: whose.
    """
    directions = lights.position_mm / lights.radius_mm[:, None]
    parallel = np.array([name.endswith("@parallel") for name in lights.patterns])
    vertical = (lights.strength[parallel] > 0).any(axis=0)
    shares = mirror_shares(directions, vertical, camera)
    return dataclasses.replace(
        lights,
        weight=lights.weight * shares,
        diffuse_share=np.ones(len(lights.patterns)),
        mirror_share=np.ones(len(lights.patterns)),
    )


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.asarray(np.einsum("nk,nk->n", a, b))


def _across(axis: np.ndarray, ray: np.ndarray) -> np.ndarray:
    """The part of axes across rays, unit."""
    part = axis - _dot(axis, ray)[:, None] * ray
    return np.asarray(part / np.linalg.norm(part, axis=1, keepdims=True))
