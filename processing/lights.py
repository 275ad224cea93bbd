"""What a surface point receives from each light pattern: the stage's lights, near and far."""

from __future__ import annotations

import dataclasses

import numpy as np
from numba import njit, prange

from lightstage.formats.environment import stage_lights
from lightstage.formats.scale import full_levels
from lightstage.formats.session import Session
from processing.errors import ProcessingError
from processing.interface import BARE, Interface, let_through, row_of

OCTAHEDRON = 96
"""Side of the octahedral grid that the far field is tabulated for (off by 2.5 deg at most)."""


@dataclasses.dataclass(frozen=True)
class PatternLights:
    """The lights of P patterns, on the session's scale.

    Attributes:
        patterns: P names.
        position_mm: (L, 3).
        radius_mm: (L,) distance of each light from the origin.
        weight: (L,) what a white diffuser at the origin that faces the light reads because of it
            at its highest level, mean over the colour channels.
        levels: (G, P) drive levels, as shares of a light's highest, of the G groups of lights that
            every pattern drives alike (eight octants under binary gradients), so that sums over
            lights are made once a group.
        group_end: (G,) int64, the lights are sorted by group; where each one ends.
        colour: (3,) the lights' common colour, mean 1; white is (1, 1, 1).
        colour_spread: largest departure of a light's own colour from that one.
    """

    patterns: tuple[str, ...]
    position_mm: np.ndarray
    radius_mm: np.ndarray
    weight: np.ndarray
    levels: np.ndarray
    group_end: np.ndarray
    colour: np.ndarray
    colour_spread: float

    @property
    def strength(self) -> np.ndarray:
        """(P, L) each light's weight in each pattern."""
        counts = np.diff(self.group_end, prepend=0)
        return np.asarray(np.repeat(self.levels, counts, axis=0).T * self.weight)


@dataclasses.dataclass(frozen=True)
class Shadows:
    """Which lights n points see, interpolated from the vertices of the triangles they lie on.

    Attributes:
        corners: (n, 3) int32 vertices of each point's triangle.
        weights: (n, 3) float32 their barycentric weights.
        visible: (vertices, L) uint8, 1 where a vertex sees a light.
    """

    corners: np.ndarray
    weights: np.ndarray
    visible: np.ndarray

    def of(self, points: np.ndarray) -> Shadows:
        """The shadows of some of the points, by index or mask."""
        return Shadows(self.corners[points], self.weights[points], self.visible)


def no_shadows(count: int, lights: PatternLights) -> Shadows:
    """Shadows of `count` points that see every light."""
    corners = np.zeros((count, 3), np.int32)
    weights = np.tile(np.array([[1, 0, 0]], np.float32), (count, 1))
    return Shadows(corners, weights, np.ones((1, len(lights.position_mm)), np.uint8))


def pattern_lights(session: Session, patterns: tuple[str, ...]) -> PatternLights:
    """The lights of a session's patterns, from its rig and what was really driven."""
    rig = session.rig
    lit = rig.rgb_gains.max(axis=1) > 0
    rgb = stage_lights(rig, np.ones(len(rig.lights)), "all", full_levels(session)).rgb
    driven = np.stack([session.levels(name)[lit] for name in patterns], axis=1)
    # Lights of unlike strength that go on and off together are one group: what each has at most
    # goes into its weight.
    most = driven.max(axis=1)
    shares = driven / np.where(most > 0, most, 1.0)[:, None]
    levels, group = np.unique(shares, axis=0, return_inverse=True)
    order = np.argsort(group, kind="stable")
    position = rig.positions_mm[lit][order]
    mean = rgb.mean(axis=1)
    colour = rgb.sum(axis=0) / mean.sum()
    return PatternLights(
        patterns=patterns,
        position_mm=position,
        radius_mm=np.linalg.norm(position, axis=1),
        weight=(mean * most)[order],
        levels=levels,
        group_end=np.cumsum(np.bincount(group, minlength=len(levels))),
        colour=colour,
        colour_spread=float(np.abs(rgb / mean[:, None] - colour).max()),
    )


def require_unpolarised(lights: PatternLights) -> None:
    """Refuse patterns from which no normal follows without a polariser.

    Raises:
        ProcessingError: fewer than three independent directions of light, or polarised patterns.
    """
    patterns = lights.patterns
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


def irradiance_vectors(
    lights: PatternLights,
    points_mm: np.ndarray,
    normals: np.ndarray,
    shadows: Shadows,
    interface: Interface = BARE,
    roughness: float = 0.26,
) -> np.ndarray:
    """Irradiance vectors at points near the origin, shadows and fall-off included.

    g_k(p) = sum over visible lights above the horizon of strength_k l T(n . l) (d0 / d)^2, with l
    the unit direction to the light, d its distance and d0 its distance from the origin.

    Args:
        lights: of P patterns.
        points_mm: (n, 3).
        normals: (n, 3) that set the horizon and what the interface lets in.
        shadows: of the n points.
        interface: that light passes on its way in.
        roughness: of the interface, Beckmann's m.

    Returns:
        (n, P, 3) float32.
    """
    out = np.zeros((len(points_mm), len(lights.patterns), 3), np.float32)
    _irradiance_vectors(
        np.ascontiguousarray(points_mm, np.float32),
        np.ascontiguousarray(normals, np.float32),
        shadows.corners,
        shadows.weights,
        shadows.visible,
        lights.position_mm.astype(np.float32),
        lights.radius_mm.astype(np.float32),
        lights.weight.astype(np.float32),
        lights.levels.astype(np.float32),
        lights.group_end,
        interface.table,
        np.float32(roughness),
        out,
    )
    return out


@njit(parallel=True, cache=True)
def _irradiance_vectors(
    points: np.ndarray,
    normals: np.ndarray,
    corners: np.ndarray,
    weights: np.ndarray,
    visible: np.ndarray,
    position: np.ndarray,
    radius: np.ndarray,
    weight: np.ndarray,
    levels: np.ndarray,
    group_end: np.ndarray,
    through: np.ndarray,
    roughness: float,
    out: np.ndarray,
) -> None:
    row, part = row_of(roughness, len(through))
    for i in prange(len(points)):
        c0, c1, c2 = corners[i, 0], corners[i, 1], corners[i, 2]
        first = 0
        for group in range(len(group_end)):
            x = y = z = np.float32(0)
            for j in range(first, group_end[group]):
                seen = (
                    weights[i, 0] * visible[c0, j]
                    + weights[i, 1] * visible[c1, j]
                    + weights[i, 2] * visible[c2, j]
                )
                dx = position[j, 0] - points[i, 0]
                dy = position[j, 1] - points[i, 1]
                dz = position[j, 2] - points[i, 2]
                facing = normals[i, 0] * dx + normals[i, 1] * dy + normals[i, 2] * dz
                if seen <= 0 or facing <= 0:
                    continue
                d2 = dx * dx + dy * dy + dz * dz
                d = np.sqrt(d2)
                fall = seen * weight[j] * radius[j] * radius[j] / (d2 * d)
                fall *= let_through(through, row, part, facing / d)
                x += fall * dx
                y += fall * dy
                z += fall * dz
            first = group_end[group]
            for k in range(levels.shape[1]):
                out[i, k, 0] += levels[group, k] * x
                out[i, k, 1] += levels[group, k] * y
                out[i, k, 2] += levels[group, k] * z
