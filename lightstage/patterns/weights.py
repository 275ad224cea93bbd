"""The solid angle that each lamp represents: what makes an even field of crowded lamps."""

from __future__ import annotations

import functools

import numpy as np

from lightstage.rig import Rig

TINY = 1e-15
"""A direction's part below the rounding of the others."""
SAME_DIRECTION = 1e-5
"""Lights whose directions differ by less, in radians, share one solid angle."""
FLAT = 1e-7
"""Directions that are nearer than this to one plane are taken to be in it."""
SPHERE = 4 * np.pi
SAMPLES = 200_000


def light_weights(rig: Rig) -> np.ndarray:
    """Levels at which all lights together make the most even field at the centre.

    A lamp's weight is the solid angle it represents, times the square of its distance, over the
    largest such product of the rig. On a sphere the distance falls out. What a light was measured
    to give (`rgb_gain`) is left out on purpose: three gains cannot be met by one level, one dim
    light would dim the stage, and a new calibration would change what sessions are driven with.
    Processing has the gains from the rig. Emitters of each colour make an even field of their own:
    those of other colours beside them take nothing from their solid angles.

    Returns:
        (n,) float64 in (0, 1], at least one of them 1.
    """
    far = np.linalg.norm(rig.positions_mm, axis=1)
    solid = np.empty(len(far))
    for which in rig.colours.values():
        solid[which] = _areas(rig.positions_mm[which].tobytes())
    weight = solid * (far / far.max()) ** 2
    return np.maximum(weight / weight.max(), np.finfo(float).tiny)


def solid_angles_sr(rig: Rig) -> np.ndarray:
    """Area of each light's cell in the spherical Voronoi diagram of the lights' directions.

    Lights in one direction share its cell. Up to three directions, and any number in one plane (a
    ring), have cells that meet in the plane's two poles, whose areas are angles; so have two lights
    half the sphere each, and one has all of it. A dome that covers only a part of the sphere is
    not treated apart: the lights at its rim stand for all directions that are nearest to them,
    the empty ones too, for so the field comes nearest to an even one.

    Source: [Caroli2010], as scipy has it.

    Returns:
        (n,) steradians, positive, with the sum 4 pi.
    """
    return _areas(rig.positions_mm.tobytes()).copy()


def irradiance(rig: Rig, levels: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """What a small white sphere at the centre receives.

    Args:
        rig: the lights, with their gains (mean over the colours).
        levels: (n,) of the lights.
        normals: (k, 3) unit, places on the sphere.

    Returns:
        (k,) irradiance where a light of gain 1 at the rig's median distance gives 1 straight below.
    """
    far = np.linalg.norm(rig.positions_mm, axis=1)
    strength = levels * rig.rgb_gains.mean(axis=1) * (np.median(far) / far) ** 2
    toward = rig.positions_mm / far[:, None]
    total = np.zeros(len(normals))
    for part in np.array_split(np.arange(len(toward)), max(1, len(toward) // 512)):
        total += np.maximum(normals @ toward[part].T, 0.0) @ strength[part]
    return total


def unevenness(rig: Rig, levels: np.ndarray) -> float:
    """Standard deviation of the irradiance over all directions of a sphere, as a share of its mean.

    0 for an even field; 0 where no lamp is on. `levels` are (n,), in the rig's order.
    """
    seen = irradiance(rig, levels, directions(2000))
    return float(seen.std() / seen.mean()) if seen.any() else 0.0


def directions(count: int) -> np.ndarray:
    """(count, 3) unit directions spread evenly over the sphere, on a golden spiral."""
    index = np.arange(count) + 0.5
    height, angle = 1 - 2 * index / count, index * np.pi * (3 - np.sqrt(5))
    ring = np.sqrt(1 - height**2)
    return np.stack([ring * np.cos(angle), height, ring * np.sin(angle)], axis=1)


def shared_directions(rig: Rig) -> tuple[np.ndarray, np.ndarray]:
    """Directions of the lights, those within `SAME_DIRECTION` of each other as one.

    Returns:
        (k, 3) unit directions and (n,) which of them each light has.
    """
    return _shared(rig.positions_mm.tobytes())


@functools.lru_cache(maxsize=8)
def _areas(positions: bytes) -> np.ndarray:
    alone, cell = _shared(positions)
    return np.asarray((_cells(alone) / np.bincount(cell))[cell])


def _shared(positions: bytes) -> tuple[np.ndarray, np.ndarray]:
    place = np.frombuffer(positions).reshape(-1, 3)
    toward = place / np.linalg.norm(place, axis=1, keepdims=True)
    toward = np.where(np.abs(toward) < TINY, 0.0, toward)  # 1e-308 would be divided by later
    # Equal ones first: thousands in one direction are millions of near pairs.
    _, some, owner = np.unique(np.round(toward, 9), axis=0, return_index=True, return_inverse=True)
    alone, cell = np.unique(_joined(toward[some]), return_inverse=True)
    return toward[some][alone], cell[owner.ravel()]


def _joined(toward: np.ndarray) -> np.ndarray:
    """(k,) for each direction the index of the one near it whose cell it shares, or its own."""
    from scipy.spatial import cKDTree

    joined = np.arange(len(toward))
    # Of two that both stand alone the second joins: none joins one that has joined another.
    for i, j in sorted(cKDTree(toward).query_pairs(SAME_DIRECTION)):
        if joined[i] == i and joined[j] == j:
            joined[j] = i
    return joined


def _cells(toward: np.ndarray) -> np.ndarray:
    """(k,) areas of the Voronoi cells of k directions, no two of them near each other."""
    from scipy.spatial import QhullError, SphericalVoronoi

    if len(toward) == 1:
        return np.array([SPHERE])
    spread = np.linalg.svd(toward - toward.mean(axis=0), full_matrices=False)
    if len(toward) < 4 or _flat(spread.S, len(toward)):
        return _lunes(toward, spread.Vh)
    try:
        areas = SphericalVoronoi(toward, threshold=SAME_DIRECTION / 10).calculate_areas()
    except (ValueError, QhullError):  # so nearly flat that there is no hull
        return _counted(toward)
    good = np.isfinite(areas).all() and (areas > 0).all() and abs(areas.sum() - SPHERE) < 1e-6
    return np.asarray(areas * (SPHERE / areas.sum())) if good else _counted(toward)


def _flat(extent: np.ndarray, count: int) -> bool:
    """Whether directions of these singular values are on a circle, and are no mere small crowd.

    A crowd of radius r leaves its plane by r^2 / 2 because the sphere is round.
    """
    root = np.sqrt(count)
    return bool(extent[2] < FLAT * root and extent[2] < 0.01 * extent[0] ** 2 / root)


def _lunes(toward: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Areas for directions in one plane, whose normal is the last of these (3, 3) axes."""
    if len(toward) == 2:
        return np.full(2, SPHERE / 2)
    centre = toward.mean(axis=0)
    normal = axes[2]
    middle = normal * (centre @ normal)
    turn = np.arctan2((toward - middle) @ axes[1], (toward - middle) @ axes[0])
    order = np.argsort(turn)
    gaps = np.diff(turn[order], append=turn[order[0]] + 2 * np.pi)
    areas = np.empty(len(toward))
    # A lune between two meridians has twice their angle; half of each gap is each neighbour's.
    areas[order] = gaps + np.roll(gaps, 1)
    return areas


def _counted(toward: np.ndarray) -> np.ndarray:
    """Areas by counting, of many directions, those nearest to each; exact to about a thousandth."""
    from scipy.spatial import cKDTree

    nearest = cKDTree(toward).query(directions(SAMPLES))[1]
    share = np.maximum(np.bincount(nearest, minlength=len(toward)), 0.5)
    return np.asarray(share * (SPHERE / share.sum()))
