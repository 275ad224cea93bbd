"""What a surface point receives from each light pattern: the stage's lights, near and far."""

from __future__ import annotations

import dataclasses

import numpy as np
from numba import njit, prange

from lightstage.formats.environment import stage_lights
from lightstage.formats.session import Session
from processing.errors import ProcessingError

OCTAHEDRON = 96
"""Side of the octahedral grid of normals for which the far field is tabulated (about 1.5 deg)."""


@dataclasses.dataclass(frozen=True)
class PatternLights:
    """The lights of P patterns, on the session's scale.

    Attributes:
        patterns: P names.
        position_mm: (L, 3).
        radius_mm: (L,) distance of each light from the origin.
        strength: (P, L) what a white diffuser at the origin that faces the light reads because of
            it in this pattern, mean over the colour channels.
        colour: (3,) the lights' common colour, mean 1; white is (1, 1, 1).
        colour_spread: largest departure of a light's own colour from that one.
    """

    patterns: tuple[str, ...]
    position_mm: np.ndarray
    radius_mm: np.ndarray
    strength: np.ndarray
    colour: np.ndarray
    colour_spread: float


def pattern_lights(session: Session, patterns: tuple[str, ...]) -> PatternLights:
    """The lights of a session's patterns, from its rig and what was really driven.

    Raises:
        ProcessingError: patterns that do not determine a normal, or polarised ones.
    """
    rig = session.rig
    lit = rig.rgb_gains.max(axis=1) > 0
    rgb = stage_lights(rig, np.ones(len(rig.lights)), "all").rgb
    levels = np.stack([session.levels(name)[lit] for name in patterns])
    mean = rgb.mean(axis=1)
    colour = rgb.sum(axis=0) / mean.sum()
    lights = PatternLights(
        patterns=patterns,
        position_mm=rig.positions_mm[lit],
        radius_mm=np.linalg.norm(rig.positions_mm[lit], axis=1),
        strength=levels * mean,
        colour=colour,
        colour_spread=float(np.abs(rgb / mean[:, None] - colour).max()),
    )
    vectors = lights.strength @ (lights.position_mm / lights.radius_mm[:, None])
    polarised = [name for name in patterns if "@" in name]
    if polarised or np.linalg.matrix_rank(vectors, tol=1e-3 * np.abs(vectors).max()) < 3:
        raise ProcessingError(
            "session.json",
            field="sequence",
            found=", ".join(polarised or patterns),
            expected="unpolarised patterns from three directions, such as the sequence binary",
            hint="Capture with `--sequence binary`.",
        )
    return lights


def octahedral_normals(side: int = OCTAHEDRON) -> np.ndarray:
    """(side * side, 3) unit normals at the cells of the octahedral grid.

    Source: [Cigolle2014].
    """
    line = (np.arange(side) + 0.5) / side * 2 - 1
    u, v = (grid.ravel() for grid in np.meshgrid(line, line, indexing="ij"))
    z = 1 - np.abs(u) - np.abs(v)
    below = z < 0
    x = np.where(below, (1 - np.abs(v)) * np.sign(u), u)
    y = np.where(below, (1 - np.abs(u)) * np.sign(v), v)
    normals = np.stack([x, y, z], axis=1)
    return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))


@njit(cache=True)
def octahedral_cell(x: float, y: float, z: float, side: int) -> int:
    """Index of the grid's cell that a direction falls into; 0 for a zero direction."""
    total = abs(x) + abs(y) + abs(z)
    if not total > 0:
        return 0
    u, v = x / total, y / total
    if z < 0:
        u, v = (
            (1 - abs(v)) * (1.0 if u >= 0 else -1.0),
            (1 - abs(u)) * (1.0 if v >= 0 else -1.0),
        )
    i = min(side - 1, int((u + 1) / 2 * side))
    j = min(side - 1, int((v + 1) / 2 * side))
    return i * side + j


def far_field(lights: PatternLights) -> np.ndarray:
    """Irradiance vectors at the origin for every cell of the octahedral grid of normals.

    The irradiance vector of a pattern k is g_k = sum of strength * direction over the lights above
    the horizon of the normal, so that a white Lambertian surface there reads n . g_k.

    Returns:
        (cells, P, 3) float64.
    """
    directions = lights.position_mm / lights.radius_mm[:, None]
    above = (octahedral_normals() @ directions.T > 0).astype(float)  # (cells, L)
    return np.einsum("cl,pl,lk->cpk", above, lights.strength, directions, optimize=True)


@njit(parallel=True, cache=True)
def irradiance_vectors(
    points_mm: np.ndarray,
    normals: np.ndarray,
    visible: np.ndarray,
    position_mm: np.ndarray,
    radius_mm: np.ndarray,
    strength: np.ndarray,
) -> np.ndarray:
    """Irradiance vectors at points near the origin, shadows and fall-off included.

    g_k(p) = sum over visible lights above the horizon of strength_k l (d0 / d)^2, with l the unit
    direction to the light, d its distance and d0 its distance from the origin.

    Args:
        points_mm: (n, 3).
        normals: (n, 3) that set the horizon.
        visible: (n, L) uint8, 1 where the light is seen.
        position_mm: (L, 3), radius_mm: (L,), strength: (P, L) of PatternLights.

    Returns:
        (n, P, 3) float64.
    """
    count, patterns = len(points_mm), len(strength)
    out = np.zeros((count, patterns, 3))
    for i in prange(count):
        for j in range(len(position_mm)):
            if visible[i, j] == 0:
                continue
            dx = position_mm[j, 0] - points_mm[i, 0]
            dy = position_mm[j, 1] - points_mm[i, 1]
            dz = position_mm[j, 2] - points_mm[i, 2]
            if normals[i, 0] * dx + normals[i, 1] * dy + normals[i, 2] * dz <= 0:
                continue
            d2 = dx * dx + dy * dy + dz * dz
            fall = radius_mm[j] * radius_mm[j] / (d2 * np.sqrt(d2))
            for k in range(patterns):
                weight = strength[k, j] * fall
                out[i, k, 0] += weight * dx
                out[i, k, 1] += weight * dy
                out[i, k, 2] += weight * dz
    return out
