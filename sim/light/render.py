"""The simulator's own light transport: lamps on a diffuse layer under a rough dielectric.

Outgoing light of a surface point p, on a session's scale (a perfect white diffuser at the origin
facing +z under `full` reads 1), with w_i a lamp's weight (`sim.light.lamps`), l_i the direction to
it, d_i its distance, d0_i its distance from the origin, q_i its own falloff with the angle to its
axis, V_i what the rays found, and E_i = V_i w_i q_i (n . l_i) (d0_i / d_i)^2:

    diffuse = albedo T(n . v) / mean(T) sum_i E_i T(n . l_i)
    specular = specular albedo / F0 sum_i E_i pi f(l_i, v),  f = D F G / (4 (n . l)(n . v))

T is what the interface lets through (`sim.light.transmittance`): a white skin in uniform light
leaves all it receives, and the albedo is exitant over incident for the light that entered. D is
Beckmann's or the GGX distribution, G Smith's height-correlated masking, F the exact Fresnel
reflectance at n = 1.4; the map of specular albedo scales the whole lobe. So is Mitsuba's
`roughplastic` [Jakob2022], but that masks by the separable term and loses what one facet throws on
another.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from typing import Any

import numba
import numpy as np

from sim.errors import SimError
from sim.light.facets import (
    DISTRIBUTIONS,
    SKIN_INDEX,
    beckmann_density,
    beckmann_lambda,
    fresnel_dielectric,
    ggx_density,
    ggx_lambda,
)
from sim.light.lamps import Lamps
from sim.light.transmittance import MAX_ROUGHNESS, MIN_ROUGHNESS, transmittance_table

MIN_COSINE: Any = np.float32(1e-4)
"""Fine normals may turn from the camera where the surface does not; n . v is kept above this."""
MIN_DISTANCE2: Any = np.float32(1e-30)
"""A lamp at the point itself has no direction and gives nothing."""
FARTHEST: Any = np.float32(16.0)
"""A Beckmann lobe is cut where it has fallen to e^-16."""
TILE = 16_384
"""Points whose response to all lamps is held at a time: 22 MB of 168 lamps."""

# Plain Python numbers are float64 to the compiler and would slow float32 work down.
_0: Any = np.float32(0.0)
_1: Any = np.float32(1.0)
_4: Any = np.float32(4.0)
_TINY: Any = np.float32(1e-6)
_INDEX: Any = np.float32(SKIN_INDEX)
_SMOOTHEST: Any = np.float32(MIN_ROUGHNESS)
_ROUGHEST: Any = np.float32(MAX_ROUGHNESS)


@numba.njit(cache=True, inline="always", error_model="numpy")
def _through(table: np.ndarray, row: int, part: float, cosine: float) -> float:
    """T of `sim.light.transmittance` at a place between two rows of its table."""
    steps = table.shape[1] - 1
    place = min(max(cosine, _0), _1) * np.float32(steps)
    column = min(int(place), steps - 1)
    across = place - np.float32(column)
    top = table[row, column] + across * (table[row, column + 1] - table[row, column])
    below = table[row + 1, column]
    below += across * (table[row + 1, column + 1] - below)
    return top + part * (below - top)


@numba.njit(cache=True, inline="always", error_model="numpy")
def _row(table: np.ndarray, roughness: float) -> tuple[int, Any]:
    """Where a roughness is in the table."""
    steps = table.shape[0] - 1
    place = math.sqrt(min(max(roughness, _0), _ROUGHEST) / _ROUGHEST) * np.float32(steps)
    row = min(int(place), steps - 1)
    return row, place - np.float32(row)


@numba.njit(cache=True, inline="always", error_model="numpy")
def _seen_roughness(slope: float, cosine: float, roughness: float) -> float:
    """The m that a stretched lobe shows to a direction; `roughness` straight from above."""
    sine2 = _1 - cosine * cosine
    return slope / math.sqrt(sine2) if sine2 > _TINY else roughness


@numba.njit(
    cache=True, parallel=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"}
)
def response_kernel(
    position: np.ndarray,
    geometric: np.ndarray,
    normal: np.ndarray,
    view: np.ndarray,
    roughness: np.ndarray,
    stretch: np.ndarray,
    tangent: np.ndarray,
    ggx: bool,
    bits: np.ndarray,
    lit: np.ndarray,
    lamps: np.ndarray,
    exponent: float,
    table: np.ndarray,
    mean: np.ndarray,
    diffuse: np.ndarray,
    specular: np.ndarray,
) -> None:
    """What n points of albedo 1 and specular albedo F0 send to the camera of each of m lamps.

    All are float32: position, geometric, normal, view (n, 3), roughness (n,); stretch (n,) and
    tangent (n, 3) of anisotropic lobes, or of length 0; lamps (m, 7): place, axis, squared
    distance from the origin. bits (n, bytes) uint8 of all lamps; lit (m,) int64, which of them
    these m are. table, mean of `transmittance_table`. diffuse, specular (n, m) are overwritten.
    """
    count = lamps.shape[0]
    for i in numba.prange(len(position)):
        px, py, pz = position[i, 0], position[i, 1], position[i, 2]
        nx, ny, nz = normal[i, 0], normal[i, 1], normal[i, 2]
        gx, gy, gz = geometric[i, 0], geometric[i, 1], geometric[i, 2]
        vx, vy, vz = view[i, 0], view[i, 1], view[i, 2]
        n_v = max(nx * vx + ny * vy + nz * vz, MIN_COSINE)
        m = max(roughness[i], _SMOOTHEST)
        area = m * m
        row, part = _row(table, m)
        row_v, part_v = row, part
        slope_v = m * math.sqrt(max(_1 - n_v * n_v, _0))
        tx = ty = tz = bx = by = bz = _0
        mu = mv = m
        stretched = False
        if len(stretch) > 0:
            # The tangent is made orthogonal to the normal that shades.
            tx, ty, tz = tangent[i, 0], tangent[i, 1], tangent[i, 2]
            along = tx * nx + ty * ny + tz * nz
            tx, ty, tz = tx - along * nx, ty - along * ny, tz - along * nz
            length = math.sqrt(tx * tx + ty * ty + tz * tz)
            stretched = length > _TINY and stretch[i] < _1
            if stretched:
                tx, ty, tz = tx / length, ty / length, tz / length
                bx, by, bz = ny * tz - nz * ty, nz * tx - nx * tz, nx * ty - ny * tx
                mu, mv = m / stretch[i], m * stretch[i]
                x, y = tx * vx + ty * vy + tz * vz, bx * vx + by * vy + bz * vz
                across2 = x * x + y * y
                x, y = mu * x, mv * y
                # The sine is that of the cosine that was kept above its least value.
                if across2 > _0:
                    slope_v *= math.sqrt((x * x + y * y) / across2) / m
                row_v, part_v = _row(table, _seen_roughness(slope_v, n_v, m))
        out = _through(table, row_v, part_v, n_v)
        out /= mean[row] + part * (mean[row + 1] - mean[row])
        lambda_v = ggx_lambda(n_v, slope_v) if ggx else beckmann_lambda(n_v, slope_v)
        quarter = _1 / (_4 * n_v)
        inverse_area = _1 / area
        for k in range(count):
            diffuse[i, k] = _0
            specular[i, k] = _0
            bit = lit[k]
            if not (bits[i, bit >> 3] >> (bit & 7)) & 1:
                continue
            lx, ly, lz = lamps[k, 0] - px, lamps[k, 1] - py, lamps[k, 2] - pz
            n_l = nx * lx + ny * ly + nz * lz
            g_l = gx * lx + gy * ly + gz * lz
            d2 = lx * lx + ly * ly + lz * lz
            # Written so that a NaN fails it too: such a point stays dark.
            if not (n_l > _0 and g_l > _0 and d2 > MIN_DISTANCE2):
                continue
            inverse = _1 / math.sqrt(d2)
            lx, ly, lz = lx * inverse, ly * inverse, lz * inverse
            n_l = n_l * inverse
            falloff = lamps[k, 6] * inverse * inverse
            if exponent != _0:
                toward = -(lx * lamps[k, 3] + ly * lamps[k, 4] + lz * lamps[k, 5])
                if not toward > _0:
                    continue
                falloff *= toward if exponent == _1 else toward**exponent
            x = y = slope_l = _0
            row_l, part_l = row, part
            if stretched:
                x, y = mu * (tx * lx + ty * ly + tz * lz), mv * (bx * lx + by * ly + bz * lz)
                slope_l = math.sqrt(x * x + y * y)
                row_l, part_l = _row(table, _seen_roughness(slope_l, n_l, m))
            else:
                slope_l = m * math.sqrt(max(_1 - n_l * n_l, _0))
            diffuse[i, k] = n_l * falloff * out * _through(table, row_l, part_l, n_l)
            hx, hy, hz = lx + vx, ly + vy, lz + vz
            length = math.sqrt(hx * hx + hy * hy + hz * hz)
            if not length > _TINY:
                continue
            scale = _1 / length
            n_h = (nx * hx + ny * hy + nz * hz) * scale
            l_h = min((lx * hx + ly * hy + lz * hz) * scale, _1)
            if not (n_h > _0 and l_h > _0):
                continue
            c2 = min(n_h * n_h, _1)
            if stretched:
                x = (tx * hx + ty * hy + tz * hz) * scale / mu
                y = (bx * hx + by * hy + bz * hz) * scale / mv
                tilt = x * x + y * y
            else:
                tilt = (_1 - c2) * inverse_area
            if ggx:
                lobe = ggx_density(c2, tilt, area) / (_1 + lambda_v + ggx_lambda(n_l, slope_l))
            elif tilt < FARTHEST * c2:
                lobe = beckmann_density(c2, tilt, area)
                lobe /= _1 + lambda_v + beckmann_lambda(n_l, slope_l)
            else:
                continue
            # pi of the weight and 1 / pi of the distribution cancel.
            specular[i, k] = lobe * fresnel_dielectric(_INDEX, l_h) * quarter * falloff


@dataclasses.dataclass(frozen=True)
class Lobe:
    """The shape of n points' lobes beyond their m.

    Attributes:
        distribution: one of `sim.light.facets.DISTRIBUTIONS`.
        tangent: (n, 3) along which they are stretched, or None where they are round.
        anisotropy: (n,) 0..0.9, with `tangent`: m is m / a along it and m a across it,
            a = sqrt(1 - 0.9 anisotropy).
    """

    distribution: str = "beckmann"
    tangent: np.ndarray | None = None
    anisotropy: np.ndarray | None = None

    def __post_init__(self) -> None:
        """SimError for an unknown distribution."""
        if self.distribution not in DISTRIBUTIONS:
            raise SimError(
                "facets",
                field="distribution",
                found=repr(self.distribution),
                expected=" or ".join(DISTRIBUTIONS),
            )

    def of(self, chosen: np.ndarray | slice) -> Lobe:
        """The lobes of some of the points, a slice or (k,) indices."""
        if self.tangent is None or self.anisotropy is None:
            return self
        return Lobe(self.distribution, self.tangent[chosen], self.anisotropy[chosen])


ROUND = Lobe()


def responses(
    position: np.ndarray,
    geometric: np.ndarray,
    normal: np.ndarray,
    view: np.ndarray,
    roughness: np.ndarray,
    bits: np.ndarray,
    lamps: Lamps,
    lit: np.ndarray,
    lobe: Lobe = ROUND,
) -> Iterator[tuple[slice, np.ndarray, np.ndarray]]:
    """What each lamp alone, of weight 1, makes of each point: the basis of every light state.

    Args:
        position: (n, 3) mm, world.
        geometric: (n, 3) the mesh's unit normals: a lamp below their horizon gives nothing.
        normal: (n, 3) unit normals that shade.
        view: (n, 3) unit directions to the camera.
        roughness: (n,) m.
        bits: (n, ceil(m / 8)) uint8, bit k & 7 of byte k >> 3 set where lamp k is seen.
        lamps: m of them; their own weights are not used.
        lit: (k,) indices of the lamps that are asked for.
        lobe: of the points.

    Yields:
        Tile by tile, in order: which of the n points these t are; (t, k) float32 diffuse light of
        points of albedo 1; (t, k) float32 specular light of points whose specular albedo is F0 of
        n = 1.4. Both arrays are overwritten by the next tile.
    """
    shape = (min(TILE, len(position)), len(lit))
    diffuse, specular = np.empty(shape, np.float32), np.empty(shape, np.float32)
    places = np.asarray(lamps.positions_mm, float)[lit]
    reference2 = np.sum(places**2, axis=1, keepdims=True)
    packed = np.concatenate([places, np.asarray(lamps.axes, float)[lit], reference2], axis=1)
    packed = packed.astype(np.float32)
    which = np.ascontiguousarray(lit, np.int64)
    table, mean = transmittance_table(lobe.distribution)
    for first in range(0, len(position), TILE):
        tile = slice(first, min(first + TILE, len(position)))
        fields = [position, geometric, normal, view, roughness]
        shapes = [np.zeros(0), np.zeros((0, 3))]
        if lobe.tangent is not None and lobe.anisotropy is not None:
            stretch = np.sqrt(1 - 0.9 * np.clip(lobe.anisotropy[tile], 0, 1))
            shapes = [stretch, lobe.tangent[tile]]
        body, mirror = diffuse[: tile.stop - first], specular[: tile.stop - first]
        response_kernel(
            *(np.ascontiguousarray(a[tile], np.float32) for a in fields),
            *(np.ascontiguousarray(a, np.float32) for a in shapes),
            lobe.distribution == "ggx",
            np.ascontiguousarray(bits[tile], np.uint8),
            which,
            packed,
            np.float32(lamps.exponent),
            table,
            mean,
            body,
            mirror,
        )
        yield tile, body, mirror
