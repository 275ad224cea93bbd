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
from processing.lighting.interface import INDEX
from processing.lighting.lights import PatternLights, octahedral_normals

SHORT = 1e-9
CENTRE = np.zeros(3)
HEAD_MM = 80.0
"""About how far from the stage's centre a head's surface is."""
ASIDE_MM = 60.0
"""Places so far from the stage's centre show how mirror reflection changes over a head."""


def mirror_amplitudes(
    lamps_mm: np.ndarray, vertical: np.ndarray, camera: Camera, point_mm: np.ndarray
) -> np.ndarray:
    """What of the field of each lamp's mirror reflection passes a camera's polariser.

    Args:
        lamps_mm: (L, 3).
        vertical: (L,) bool, lamps of the vertical bank.
        camera: its polariser passes the field along its picture's columns.
        point_mm: (3,) of the surface.

    Returns:
        (L,) of either sign, changing smoothly with the point. Its square is the share of the light
        that passes: about 1 for the vertical bank and 0 for the horizontal one near the camera.

    Source: [Baek2018] for the facet, [Ghosh2011] for lamps and lenses.
    """
    view, upright = _lens(camera, point_mm)
    directions = _unit(lamps_mm - point_mm)
    field = _fields(_unit(lamps_mm), vertical)
    field = _unit(field - _dot(field, directions)[:, None] * directions)
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
    return np.asarray(passed / np.sqrt((r_s**2 + r_p**2) / 2))


def diffuse_shares(lights: PatternLights, camera: Camera) -> np.ndarray:
    """What polarisers change of the diffuse light of each normal, beside taking half of it.

    Light enters and leaves the skin by transmittances T_s and T_p that differ at grazing angles:
    ((e . s)^2 T_s + (e . p)^2 T_p) over their mean on the way in, the same with the lens's field on
    the way out, s across the planes of normal and lamp, and of normal and camera.

    Args:
        lights: of P patterns, all of them polarised.
        camera: whose polariser passes the field along its picture's columns.

    Returns:
        (cells, P) factors about 1, by the cells of the octahedral grid of normals; 1 where a normal
        gets no light or is not seen.

    Source: [Baek2018].
    """
    normals = octahedral_normals()
    view, upright = _lens(camera, CENTRE)
    directions, vertical = _unit(lights.position_mm), _vertical(lights)
    field = _fields(directions, vertical)
    cosine = np.maximum(normals @ directions.T, 0)  # (cells, L)
    across = _share(np.cross(normals[:, None], directions[None]), field[None])
    entering = _passed(across, cosine)
    leaving = _passed(_share(np.cross(normals, view), upright[None]), np.maximum(normals @ view, 0))
    plain = cosine @ lights.strength.T
    kept = (cosine * entering) @ lights.strength.T
    seen = (plain > 0) & (normals @ view > 0)[:, None]
    return np.where(seen, kept / np.where(plain > 0, plain, 1) * leaving[:, None], 1.0)


def mirror_lights(lights: PatternLights, camera: Camera) -> PatternLights:
    """The lights as mirror reflection shows them to one camera, for the lobe alone.

    Each lamp's share is that of the place where a head of usual size mirrors it.

    Args:
        lights: of patterns that are all polarised; a lamp that both banks light counts as
            vertical.
        camera: whose.
    """
    field = mirrored_of_lamps(lights, camera)
    half = _unit(lights.position_mm) + _unit(camera.centre_mm)
    # No facet mirrors a lamp that is straight behind the head.
    facets = half / np.maximum(np.linalg.norm(half, axis=1, keepdims=True), SHORT)
    shares = (field[0] + np.einsum("ln,nl->l", HEAD_MM * facets, field[1:])) ** 2
    return dataclasses.replace(
        lights,
        weight=lights.weight * shares,
        diffuse_share=np.ones(len(lights.patterns)),
        mirror_share=np.ones(len(lights.patterns)),
    )


def mirrored_of_lamps(lights: PatternLights, camera: Camera) -> np.ndarray:
    """What of the field of each lamp's mirror reflection reaches a camera, over a head.

    Crossed polarisers leave little, which changes by its half over a head: what passes at the
    stage's centre is too much for a head's surface.

    Returns:
        (4, L) at the stage's centre, and how it changes a mm along x, y and z; its square is the
        share of the light. 1 everywhere without polarisers.
    """
    out = np.zeros((4, len(lights.weight)))
    out[0] = 1
    if lights.polarised:
        lamps = lights.position_mm, _vertical(lights), camera
        out[0] = mirror_amplitudes(*lamps, CENTRE)
        for axis, aside in enumerate(ASIDE_MM * np.eye(3)):
            change = mirror_amplitudes(*lamps, aside) - mirror_amplitudes(*lamps, -aside)
            out[1 + axis] = change / (2 * ASIDE_MM)
    return out


def diffuse_of_normals(lights: PatternLights, camera: Camera) -> np.ndarray:
    """(cells, P) share of the diffuse light of each normal, by the cells of the octahedral grid,
    that reaches a camera; (1, P) ones for all normals without polarisers.
    """
    if not lights.polarised:
        return np.ones((1, len(lights.patterns)))
    return diffuse_shares(lights, camera) * lights.diffuse_share


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.asarray(np.einsum("nk,nk->n", a, b))


def _unit(vectors: np.ndarray) -> np.ndarray:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def _vertical(lights: PatternLights) -> np.ndarray:
    """(L,) bool, the lamps of the vertical bank."""
    parallel = np.array([name.endswith("@parallel") for name in lights.patterns])
    return np.asarray((lights.strength[parallel] > 0).any(axis=0))


def _lens(camera: Camera, point_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(3,) unit, from a point toward the camera, and (3,) unit, the field that its lens passes."""
    view = _unit(camera.centre_mm - point_mm)
    down = camera.cam_from_world[1, :3]
    return view, _unit((down @ view) * view - down)


def _fields(directions: np.ndarray, vertical: np.ndarray) -> np.ndarray:
    """(L, 3) unit: the field of each lamp. Straight above or below it is that of +z's meridian."""
    latitude = np.stack([directions[:, 2], np.zeros(len(directions)), -directions[:, 0]], axis=1)
    length = np.linalg.norm(latitude, axis=1, keepdims=True)
    latitude = np.where(length > SHORT, latitude / np.maximum(length, SHORT), [1.0, 0.0, 0.0])
    return np.where(vertical[:, None], np.cross(directions, latitude), latitude)


def _share(s: np.ndarray, field: np.ndarray) -> np.ndarray:
    """Squared part of a field along s, whatever its length; a half where s has none."""
    length = (s * s).sum(axis=-1)
    part = (s * field).sum(axis=-1) ** 2
    return np.where(length > SHORT, part / np.maximum(length, SHORT), 0.5)


def _passed(across: np.ndarray, cosine: np.ndarray) -> np.ndarray:
    """Transmittance of a field of which the share `across` is along s, over the mean of both."""
    inside = np.sqrt(1 - (1 - cosine**2) / INDEX**2)
    t_s = 1 - ((cosine - INDEX * inside) / (cosine + INDEX * inside)) ** 2
    t_p = 1 - ((INDEX * cosine - inside) / (INDEX * cosine + inside)) ** 2
    mean = (t_s + t_p) / 2
    return np.where(mean > SHORT, (across * t_s + (1 - across) * t_p) / np.maximum(mean, SHORT), 1)
