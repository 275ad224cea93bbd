"""What a surface point receives from each light pattern: the stage's lights, near and far."""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import numpy as np
from numba import njit, prange

from lightstage.formats.session import Session
from processing.errors import ProcessingError
from processing.lighting.interface import BARE, Interface, let_through, row_of
from processing.lighting.lamps import Lamps, Source, session_lamps

DIFFUSE_SHARES = {"": 1.0, "parallel": 0.5, "cross": 0.5}
MIRROR_SHARES = {"": 1.0, "parallel": 1.0, "cross": 0.0}
"""What a lens's polariser passes of the light that scattered in the skin, which has lost its
polarisation, and of what its surface mirrored, which has kept it [Ma2007]."""
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
        rgb: (L, 3) the same in each colour channel.
        colour: (3,) the lights' common colour, mean 1; white is (1, 1, 1).
        colour_spread: largest departure of a light's own colour from that one.
        diffuse_share: (P,) what the camera gets of the light that scattered in the skin: a half
            through a polariser. Irradiance holds it: a white reads rho E.
        mirror_share: (P,) the same of what the surface mirrored: all of it in a parallel shot, none
            in a crossed one. The lobe holds it.
        exponent: a light's intensity falls with the cosine to its axis, which points at the
            origin, to this power.
        stray_rgb: (3, P, 3, 4) light beside the lamps' in each channel: n . (A n + b) for a white
            of normal n, [A | b] the last two axes.
        source: whether the lights were measured or are the rig's nominal ones.
    """

    patterns: tuple[str, ...]
    position_mm: np.ndarray
    radius_mm: np.ndarray
    weight: np.ndarray
    levels: np.ndarray
    group_end: np.ndarray
    rgb: np.ndarray
    colour: np.ndarray
    colour_spread: float
    diffuse_share: np.ndarray
    mirror_share: np.ndarray
    exponent: float
    stray_rgb: np.ndarray
    source: Source

    @property
    def polarised(self) -> bool:
        """Whether some pattern was photographed through polarisers."""
        return bool((self.diffuse_share < 1).any())

    @property
    def stray(self) -> np.ndarray:
        """(P, 3, 4) mean of `stray_rgb` over the channels."""
        return np.asarray(self.stray_rgb.mean(axis=0))

    def channel(self, index: int) -> PatternLights:
        """The lights as one colour channel sees them.

        Where lights have colours of their own, as under `mux`, each channel sees patterns of its
        own: far_field, irradiance_vectors and transport of these lights are that channel's.
        """
        rgb = np.repeat(self.rgb[:, index, None], 3, axis=1)
        return dataclasses.replace(
            self,
            weight=self.rgb[:, index],
            rgb=rgb,
            colour=np.ones(3),
            colour_spread=0.0,
            stray_rgb=np.repeat(self.stray_rgb[index, None], 3, axis=0),
        )

    def of(self, patterns: tuple[str, ...]) -> PatternLights:
        """The lights of some of the patterns, in this order; KeyError where one is not there."""
        places = {name: k for k, name in enumerate(self.patterns)}
        some = [places[name] for name in patterns]
        return dataclasses.replace(
            self,
            patterns=patterns,
            levels=self.levels[:, some],
            diffuse_share=self.diffuse_share[some],
            mirror_share=self.mirror_share[some],
            stray_rgb=self.stray_rgb[:, some],
        )

    @property
    def strength(self) -> np.ndarray:
        """(P, L) each light's weight in each pattern."""
        counts = np.diff(self.group_end, prepend=0)
        return np.asarray(np.repeat(self.levels, counts, axis=0).T * self.weight)


@dataclasses.dataclass(frozen=True)
class Shadows:
    """Which lights n points see, interpolated from the vertices of the triangles they are on.

    Attributes:
        corners: (n, 3) int32 vertices of each point's triangle.
        weights: (n, 3) float32 their barycentric weights.
        visible: (vertices, L) uint8, 1 where a vertex sees a light.
    """

    corners: np.ndarray
    weights: np.ndarray
    visible: np.ndarray

    def of(self, points: np.ndarray) -> Shadows:
        """The shadows of some of the points, by (k,) indices or a (n,) mask."""
        return Shadows(self.corners[points], self.weights[points], self.visible)


def no_shadows(count: int, lights: PatternLights) -> Shadows:
    """Shadows of `count` points that see every light."""
    corners = np.zeros((count, 3), np.int32)
    weights = np.tile(np.array([[1, 0, 0]], np.float32), (count, 1))
    return Shadows(corners, weights, np.ones((1, len(lights.position_mm)), np.uint8))


def pattern_lights(session: Session, patterns: tuple[str, ...]) -> PatternLights:
    """The lights of a session's patterns: as measured where its calibration has them, else nominal.

    Patterns are what was really driven. Through polarisers (`@parallel`, `@cross`) a bank shows its
    shares of scattered and mirrored light; the other bank is dark in the pattern's levels.

    Raises:
        FormatError: a file of measured lights that does not fit the rig.
        ProcessingError: patterns polarised in a way that is not known.
    """
    levels = np.stack([session.levels(name) for name in patterns])
    return lights_of(session_lamps(session), patterns, levels)


def lights_of(lamps: Lamps, patterns: tuple[str, ...], driven: np.ndarray) -> PatternLights:
    """Lamps that make P patterns.

    Args:
        lamps: L of them; those that give no light, or none in these patterns, are left out.
        patterns: P names; an `@` in one names its bank.
        driven: (P, L) levels.

    Raises:
        ProcessingError: patterns polarised in a way that is not known.
    """
    # Emitters of another colour, dark in every pattern, do not affect these patterns' colour.
    lit = lamps.rgb.mean(axis=1) > 0
    used = lit & (np.asarray(driven).max(axis=0) > 0)
    lit = used if used.any() else lit
    rgb, driven = lamps.rgb[lit], np.asarray(driven, float)[:, lit].T
    # Lights of unlike strength that go on and off together are one group: what each has at most
    # goes into its weight.
    most = driven.max(axis=1)
    shares = driven / np.where(most > 0, most, 1.0)[:, None]
    levels, group = np.unique(shares, axis=0, return_inverse=True)
    group = group.ravel()
    order = np.argsort(group, kind="stable")
    position = lamps.position_mm[lit][order]
    mean = rgb.mean(axis=1)
    colour = rgb.sum(axis=0) / mean.sum()
    banks = [_bank(name) for name in patterns]
    # A sphere's mean cosine over all directions, below the horizon too, is a quarter.
    around = driven.T @ rgb / 4  # (P, 3)
    stray = [lamps.stray.get(name, np.zeros((3, 3, 4))) for name in patterns]
    return PatternLights(
        patterns=patterns,
        position_mm=position,
        radius_mm=np.linalg.norm(position, axis=1),
        weight=(mean * most)[order],
        levels=levels,
        group_end=np.cumsum(np.bincount(group, minlength=len(levels))),
        rgb=(rgb * most[:, None])[order],
        colour=colour,
        colour_spread=float(np.abs(rgb / mean[:, None] - colour).max()),
        diffuse_share=np.array([DIFFUSE_SHARES[bank] for bank in banks]),
        mirror_share=np.array([MIRROR_SHARES[bank] for bank in banks]),
        exponent=lamps.exponent,
        stray_rgb=np.einsum("pc,pcij->cpij", around, np.array(stray)),
        source=lamps.source,
    )


def _bank(pattern: str) -> str:
    """How a pattern is polarised: empty, parallel or cross."""
    bank = pattern.partition("@")[2]
    if bank not in DIFFUSE_SHARES:
        raise ProcessingError(
            f"pattern {pattern}", found=f"@{bank}", expected="@parallel, @cross or neither"
        )
    return bank


def rank(lights: PatternLights) -> int:
    """How many independent directions of light the patterns have: three determine a normal.

    Lights of unlike colours count channel by channel: two shots of `mux` may have three.
    """
    vectors = np.concatenate([_vectors(lights.channel(c)) for c in range(3)])
    return int(np.linalg.matrix_rank(vectors, tol=1e-3 * np.abs(vectors).max(initial=1e-300)))


def _vectors(lights: PatternLights) -> np.ndarray:
    return np.asarray(lights.strength @ (lights.position_mm / lights.radius_mm[:, None]))


def fix_normals(lights: PatternLights) -> bool:
    """Whether the patterns light from three directions in all channels alike.

    Two shots of `mux` do not: their channels, each by itself, hold one gradient and its complement.
    """
    vectors = _vectors(lights)
    return bool(np.linalg.matrix_rank(vectors, tol=1e-3 * np.abs(vectors).max(initial=1e-300)) == 3)


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
    """Index of the grid's cell that a direction falls into; 0 for none, or one not finite."""
    total = abs(x) + abs(y) + abs(z)
    if not (total > 0 and total < math.inf):
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


@njit(parallel=True, cache=True)
def cells_of(normals: np.ndarray) -> np.ndarray:
    """(n,) each normal's cell of the octahedral grid; 0 for a zero one, or one not finite."""
    out = np.zeros(len(normals), np.int64)
    for i in prange(len(normals)):
        out[i] = octahedral_cell(normals[i, 0], normals[i, 1], normals[i, 2], OCTAHEDRON)
    return out


def far_field(lights: PatternLights) -> np.ndarray:
    """Irradiance vectors at the origin for every cell of the octahedral grid of normals.

    The irradiance vector of a pattern k is g_k = sum of strength * direction over the lights above
    the horizon of the normal, so that a white Lambertian surface there reads n . g_k.

    Returns:
        (cells, P, 3) float64.
    """
    directions = lights.position_mm / lights.radius_mm[:, None]
    above = (octahedral_normals() @ directions.T > 0).astype(float)  # (cells, L)
    vectors = np.einsum("cl,pl,lk->cpk", above, lights.strength, directions, optimize=True)
    return np.ascontiguousarray(_as_seen(lights, octahedral_normals(), vectors))


def _as_seen(lights: PatternLights, normals: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Irradiance vectors (n, P, 3) of the lamps made, in place, those of all that a camera gets."""
    if lights.stray_rgb.any():
        stray = lights.stray.astype(vectors.dtype)
        vectors += np.einsum("pij,nj->npi", stray[:, :, :3], normals, optimize=True)
        vectors += stray[:, :, 3]
    if lights.polarised:
        vectors *= lights.diffuse_share[:, None]
    return vectors


def as_seen(
    lights: PatternLights, normals: np.ndarray, irradiance: np.ndarray, lobe: np.ndarray
) -> None:
    """Add stray light to (n, P) irradiance, and take from it and the lobe what polarisers take."""
    if lights.stray_rgb.any():
        stray = lights.stray
        vectors = np.einsum("pij,nj->npi", stray[:, :, :3], normals, optimize=True)
        irradiance += np.einsum("npi,ni->np", vectors + stray[:, :, 3], normals)
    if lights.polarised:
        irradiance *= lights.diffuse_share
        lobe *= lights.mirror_share


class SeenLights(NamedTuple):
    """Lights and who sees them as compiled loops take them, in single precision.

    Attributes: as of `Shadows` and `PatternLights`.
    """

    corners: np.ndarray
    weights: np.ndarray
    visible: np.ndarray
    position: np.ndarray
    radius: np.ndarray
    weight: np.ndarray
    levels: np.ndarray
    group_end: np.ndarray
    exponent: np.float32


def compiled(lights: PatternLights, shadows: Shadows) -> SeenLights:
    """What compiled loops take of lights and shadows."""
    return SeenLights(
        shadows.corners,
        shadows.weights,
        shadows.visible,
        position=lights.position_mm.astype(np.float32),
        radius=lights.radius_mm.astype(np.float32),
        weight=lights.weight.astype(np.float32),
        levels=np.ascontiguousarray(lights.levels, np.float32),
        group_end=lights.group_end,
        exponent=np.float32(lights.exponent),
    )


@njit(cache=True, inline="always")
def seen_share(corners: np.ndarray, weights: np.ndarray, visible: np.ndarray, light: int) -> float:
    """Share of a light that a point sees, interpolated from its triangle's corners.

    Args:
        corners: (3,) vertices.
        weights: (3,) of them.
        visible: (V, L) uint8.
        light: its column.
    """
    return (
        weights[0] * visible[corners[0], light]
        + weights[1] * visible[corners[1], light]
        + weights[2] * visible[corners[2], light]
    )


@njit(cache=True)
def off_axis(exponent: float, cosine: float) -> float:
    """Share of its intensity that a light sends off its axis; nothing backward of a spread one."""
    if exponent == 0:
        return 1.0
    if cosine <= 0:
        return 0.0
    return cosine if exponent == 1 else cosine**exponent


def irradiance_vectors(
    lights: PatternLights,
    points_mm: np.ndarray,
    normals: np.ndarray,
    shadows: Shadows,
    interface: Interface = BARE,
    roughness: float = 0.26,
) -> np.ndarray:
    """Irradiance vectors at points near the origin, shadows and fall-off included.

    g_k(p) = sum over visible lights above the horizon of strength_k l T(n . l) (d0 / d)^2 c^e, with
    l the unit direction to the light, d its distance, d0 its distance from the origin and c the
    cosine to the light's axis; beside it stray light, which comes from everywhere.

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
        compiled(lights, shadows),
        interface.table,
        np.float32(roughness),
        out,
    )
    return _as_seen(lights, normals, out)


@njit(parallel=True, cache=True)
def _irradiance_vectors(
    points: np.ndarray,
    normals: np.ndarray,
    lights: SeenLights,
    through: np.ndarray,
    roughness: float,
    out: np.ndarray,
) -> None:
    corners, weights, visible = lights.corners, lights.weights, lights.visible
    position, radius, weight = lights.position, lights.radius, lights.weight
    levels, group_end, exponent = lights.levels, lights.group_end, lights.exponent
    row, part = row_of(roughness, len(through))
    for i in prange(len(points)):
        first = 0
        for group in range(len(group_end)):
            x = y = z = np.float32(0)
            for j in range(first, group_end[group]):
                seen = seen_share(corners[i], weights[i], visible, j)
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
                aside = position[j, 0] * dx + position[j, 1] * dy + position[j, 2] * dz
                fall *= off_axis(exponent, aside / (radius[j] * d))
                x += fall * dx
                y += fall * dy
                z += fall * dz
            first = group_end[group]
            for k in range(levels.shape[1]):
                out[i, k, 0] += levels[group, k] * x
                out[i, k, 1] += levels[group, k] * y
                out[i, k, 2] += levels[group, k] * z
