"""Normal, diffuse albedo and specular albedo of a pixel, solved together from all its readings.

What pattern k and channel c read is modelled as rho_c E_k(n) + s B_k(n, m). Gauss-Newton on it
needs, beside E and B, how both turn with the normal; the relief moves the highlight between
patterns, so that gloss found with the normal held fast is wrong. Readings are weighted by their
noise.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numba import njit, prange

from processing.interface import Interface, let_through, row_of
from processing.lights import PatternLights, Shadows
from processing.lobe import FARTHEST_TAN, GRAZING, fresnel_table, shadowing

UNKNOWNS = 6
"""Two turns of the normal, the specular albedo, three channels of diffuse albedo."""
LONGEST_TURN = 0.15
"""A step of Gauss-Newton turns the normal by at most this tangent: the lobe is some 20 deg wide."""


@dataclasses.dataclass(frozen=True)
class Noise:
    """Variance of a reading I is read_noise^2 (0.25 + I) + (model I)^2: sensor's, and the model's.

    Attributes:
        sensor: of a reading of .75, a share of what a white under `full` reads.
        model: what the model is wrong by, as a share of the reading.
    """

    sensor: float = 0.001
    model: float = 0.01


@dataclasses.dataclass(frozen=True)
class Solved:
    """Of n pixels; zero where not solved.

    Attributes:
        normal: (n, 3) float32 unit.
        albedo: (n, 3) float32.
        specular: (n,) float32.
        evidence: (n,) float32 what the readings alone say of the specular albedo, as information
            (one over variance) times value, with normal and albedo left free.
        information: (n,) float32 one over its variance.
        misfit: (n,) float32 mean squared residual over its expected variance.
        certainty: (n,) float32 least information on a turn of the normal, one over rad^2.
    """

    normal: np.ndarray
    albedo: np.ndarray
    specular: np.ndarray
    evidence: np.ndarray
    information: np.ndarray
    misfit: np.ndarray
    certainty: np.ndarray


def solve_jointly(
    rgb: np.ndarray,
    lights: PatternLights,
    points_mm: np.ndarray,
    normals: np.ndarray,
    views: np.ndarray,
    roughness: np.ndarray | float,
    shadows: Shadows,
    interface: Interface,
    specular: np.ndarray,
    precision: np.ndarray,
    noise: Noise,
    rounds: int = 1,
) -> Solved:
    """Gauss-Newton from given normals.

    Args:
        rgb: (n, P, 3) readings in the lights' own colour; a pixel of zeros is left out.
        lights: of P patterns.
        points_mm: (n, 3).
        normals: (n, 3) unit, to start from; zero where there is none.
        views: (n, 3) unit, toward the camera.
        roughness: Beckmann's m, one or (n,).
        shadows: of the n points.
        interface: that light passes.
        specular: (n,) specular albedo that is expected, or where to start.
        precision: (n,) one over the variance of what is expected, 0 for nothing.
        noise: of the readings.
        rounds: steps.
    """
    count = len(rgb)
    out = Solved(
        np.zeros((count, 3), np.float32),
        np.zeros((count, 3), np.float32),
        *(np.zeros(count, np.float32) for _ in range(5)),
    )
    _solve(
        np.ascontiguousarray(rgb, np.float32),
        np.ascontiguousarray(points_mm, np.float32),
        np.ascontiguousarray(normals, np.float32),
        np.ascontiguousarray(views, np.float32),
        np.ascontiguousarray(np.broadcast_to(np.asarray(roughness, np.float32), count)),
        shadows.corners,
        shadows.weights,
        shadows.visible,
        lights.position_mm.astype(np.float32),
        lights.radius_mm.astype(np.float32),
        lights.weight.astype(np.float32),
        lights.levels.astype(np.float32),
        lights.group_end,
        fresnel_table().astype(np.float32),
        interface.table,
        interface.mean,
        np.ascontiguousarray(specular, np.float32),
        np.ascontiguousarray(precision, np.float32),
        float(noise.sensor) ** 2,
        float(noise.model) ** 2,
        rounds,
        out.normal,
        out.albedo,
        out.specular,
        out.evidence,
        out.information,
        out.misfit,
        out.certainty,
    )
    return out


@njit(cache=True)
def _gather(
    point: np.ndarray,
    n: np.ndarray,
    view: np.ndarray,
    roughness: float,
    corners: np.ndarray,
    weights: np.ndarray,
    visible: np.ndarray,
    position: np.ndarray,
    radius: np.ndarray,
    weight: np.ndarray,
    levels: np.ndarray,
    group_end: np.ndarray,
    table: np.ndarray,
    through: np.ndarray,
    mean: np.ndarray,
    out: np.ndarray,
) -> None:
    """Fill out (P, 8): E, its gradient (3), B, its gradient (3) at one point and normal."""
    out[:] = 0
    steps = len(table) - 1
    m2 = roughness * roughness
    nx, ny, nz = n[0], n[1], n[2]
    vx, vy, vz = view[0], view[1], view[2]
    nv = max(nx * vx + ny * vy + nz * vz, np.float32(GRAZING))
    shadow_v = shadowing(nv, roughness)
    row, part = row_of(roughness, len(through))
    leaving = let_through(through, row, part, nv)
    leaving /= mean[row] * (1 - part) + mean[row + 1] * part
    quarter = shadow_v / (4 * m2 * nv)
    c0, c1, c2 = corners[0], corners[1], corners[2]
    first = 0
    for group in range(len(group_end)):
        gx = gy = gz = np.float32(0)
        b = bx = by = bz = np.float32(0)
        for j in range(first, group_end[group]):
            seen = (
                weights[0] * visible[c0, j]
                + weights[1] * visible[c1, j]
                + weights[2] * visible[c2, j]
            )
            if seen <= 0:
                continue
            lx, ly, lz = position[j, 0] - point[0], position[j, 1] - point[1], position[j, 2] - point[2]
            nl = nx * lx + ny * ly + nz * lz
            if nl <= 0:
                continue
            inverse = 1 / math.sqrt(lx * lx + ly * ly + lz * lz)
            lx, ly, lz, nl = lx * inverse, ly * inverse, lz * inverse, nl * inverse
            fall = radius[j] * inverse
            seen *= weight[j] * fall * fall
            entered = seen * leaving * let_through(through, row, part, nl)
            gx += entered * lx
            gy += entered * ly
            gz += entered * lz
            hx, hy, hz = lx + vx, ly + vy, lz + vz
            length2 = hx * hx + hy * hy + hz * hz
            if length2 <= 0:
                continue
            scale = 1 / math.sqrt(length2)
            hx, hy, hz = hx * scale, hy * scale, hz * scale
            nh = nx * hx + ny * hy + nz * hz
            nh2 = nh * nh
            if nh <= 0 or (1 - nh2) > FARTHEST_TAN * m2 * nh2:
                continue
            lobe = quarter * math.exp((nh2 - 1) / (nh2 * m2)) / (nh2 * nh2)
            place = min(1.0, vx * hx + vy * hy + vz * hz) * steps
            below = min(steps - 1, int(place))
            rest = place - below
            lobe *= seen * shadowing(nl, roughness)
            lobe *= table[below] * (1 - rest) + table[below + 1] * rest
            slope = lobe * (2 / (nh2 * nh * m2) - 4 / nh)
            b += lobe
            bx += slope * hx
            by += slope * hy
            bz += slope * hz
        first = group_end[group]
        bx -= b * vx / nv
        by -= b * vy / nv
        bz -= b * vz / nv
        e = gx * nx + gy * ny + gz * nz
        for k in range(levels.shape[1]):
            level = levels[group, k]
            out[k, 0] += level * e
            out[k, 1] += level * gx
            out[k, 2] += level * gy
            out[k, 3] += level * gz
            out[k, 4] += level * b
            out[k, 5] += level * bx
            out[k, 6] += level * by
            out[k, 7] += level * bz


@njit(cache=True)
def _cholesky(a: np.ndarray, b: np.ndarray) -> bool:
    """Solve a x = b in place (a symmetric, its lower triangle read); false where not definite."""
    size = len(b)
    for i in range(size):
        for j in range(i + 1):
            total = a[i, j]
            for k in range(j):
                total -= a[i, k] * a[j, k]
            if i == j:
                if not total > 0:
                    return False
                a[i, i] = math.sqrt(total)
            else:
                a[i, j] = total / a[j, j]
    for i in range(size):
        total = b[i]
        for k in range(i):
            total -= a[i, k] * b[k]
        b[i] = total / a[i, i]
    for i in range(size - 1, -1, -1):
        total = b[i]
        for k in range(i + 1, size):
            total -= a[k, i] * b[k]
        b[i] = total / a[i, i]
    return True


@njit(parallel=True, cache=True)
def _solve(
    rgb: np.ndarray,
    points: np.ndarray,
    starts: np.ndarray,
    views: np.ndarray,
    roughnesses: np.ndarray,
    corners: np.ndarray,
    weights: np.ndarray,
    visible: np.ndarray,
    position: np.ndarray,
    radius: np.ndarray,
    weight: np.ndarray,
    levels: np.ndarray,
    group_end: np.ndarray,
    table: np.ndarray,
    through: np.ndarray,
    mean: np.ndarray,
    expected: np.ndarray,
    precision: np.ndarray,
    sensor2: float,
    model2: float,
    rounds: int,
    normals: np.ndarray,
    albedos: np.ndarray,
    speculars: np.ndarray,
    evidences: np.ndarray,
    informations: np.ndarray,
    misfits: np.ndarray,
    certainties: np.ndarray,
) -> None:
    patterns = rgb.shape[1]
    for i in prange(len(rgb)):
        n = starts[i].copy()
        if not n[0] * n[0] + n[1] * n[1] + n[2] * n[2] > 0.5:
            continue
        light = np.zeros((patterns, 8), np.float32)
        a = np.zeros((UNKNOWNS, UNKNOWNS))
        b = np.zeros(UNKNOWNS)
        row = np.zeros(UNKNOWNS)
        rho = np.zeros(3)
        s = float(expected[i])
        good = True
        information = evidence = least = 0.0
        for step in range(rounds):
            _gather(
                points[i], n, views[i], roughnesses[i], corners[i], weights[i], visible,
                position, radius, weight, levels, group_end, table, through, mean, light,
            )  # fmt: skip
            # Albedo for the normal of this step: it weighs how the readings turn with the normal.
            for c in range(3):
                top = bottom = 0.0
                for k in range(patterns):
                    top += light[k, 0] * (rgb[i, k, c] - s * light[k, 4])
                    bottom += light[k, 0] * light[k, 0]
                rho[c] = top / bottom if bottom > 0 else 0.0
            # Two directions across the normal.
            if abs(n[0]) < 0.6:
                tx, ty, tz = 0.0, n[2], -n[1]
            else:
                tx, ty, tz = -n[2], 0.0, n[0]
            length = math.sqrt(tx * tx + ty * ty + tz * tz)
            tx, ty, tz = tx / length, ty / length, tz / length
            ux, uy, uz = n[1] * tz - n[2] * ty, n[2] * tx - n[0] * tz, n[0] * ty - n[1] * tx
            a[:] = 0
            b[:] = 0
            for k in range(patterns):
                et = light[k, 1] * tx + light[k, 2] * ty + light[k, 3] * tz
                eu = light[k, 1] * ux + light[k, 2] * uy + light[k, 3] * uz
                bt = light[k, 5] * tx + light[k, 6] * ty + light[k, 7] * tz
                bu = light[k, 5] * ux + light[k, 6] * uy + light[k, 7] * uz
                for c in range(3):
                    value = rgb[i, k, c]
                    bright = max(value, np.float32(0))
                    w = 1 / (sensor2 * (0.25 + bright) + model2 * bright * bright)
                    row[:] = 0
                    row[0] = rho[c] * et + s * bt
                    row[1] = rho[c] * eu + s * bu
                    row[2] = light[k, 4]
                    row[3 + c] = light[k, 0]
                    for p in range(UNKNOWNS):
                        if row[p] == 0:
                            continue
                        for q in range(p + 1):
                            a[p, q] += w * row[p] * row[q]
                        b[p] += w * row[p] * value
            information, evidence, least = _marginal(a, b)
            a[2, 2] += precision[i]
            b[2] += precision[i] * expected[i]
            # Unsolvable directions stay where they are instead of failing the pixel.
            for p in range(UNKNOWNS):
                a[p, p] *= 1 + 1e-9
                a[p, p] += 1e-12
            if not _cholesky(a, b):
                good = False
                break
            x, y = b[0], b[1]
            turn = math.sqrt(x * x + y * y)
            if not turn < 1e9:
                good = False
                break
            if turn > LONGEST_TURN:
                x, y = x * LONGEST_TURN / turn, y * LONGEST_TURN / turn
            n[0] += x * tx + y * ux
            n[1] += x * ty + y * uy
            n[2] += x * tz + y * uz
            length = math.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
            n[0] /= length
            n[1] /= length
            n[2] /= length
            s = b[2]
            for c in range(3):
                rho[c] = b[3 + c]
        if not good:
            continue
        total = 0.0
        for k in range(patterns):
            for c in range(3):
                value = rgb[i, k, c]
                bright = max(value, np.float32(0))
                left = value - rho[c] * light[k, 0] - s * light[k, 4]
                total += left * left / (sensor2 * (0.25 + bright) + model2 * bright * bright)
        for c in range(3):
            normals[i, c] = n[c]
            albedos[i, c] = rho[c]
        speculars[i] = s
        evidences[i] = evidence
        informations[i] = information
        misfits[i] = total / (3 * patterns - UNKNOWNS)
        certainties[i] = least


@njit(cache=True)
def _marginal(a: np.ndarray, b: np.ndarray) -> tuple[float, float, float]:
    """Information and evidence on the specular albedo with all else free, least on a turn."""
    rest = np.array([0, 1, 3, 4, 5])
    inner = np.zeros((5, 5))
    cross = np.zeros(5)
    right = np.zeros(5)
    for p in range(5):
        for q in range(p + 1):
            inner[p, q] = a[rest[p], rest[q]]
        inner[p, p] = inner[p, p] * (1 + 1e-9) + 1e-12
        cross[p] = a[max(rest[p], 2), min(rest[p], 2)]
        right[p] = b[rest[p]]
    solved = cross.copy()
    if not _cholesky(inner, solved):
        return 0.0, 0.0, 0.0
    information, evidence = a[2, 2], b[2]
    for p in range(5):
        information -= solved[p] * cross[p]
        evidence -= solved[p] * right[p]
    # Turns with the albedos free: their block's Schur complement.
    t00, t01, t11 = a[0, 0], a[1, 0], a[1, 1]
    for c in range(3, 6):
        if a[c, c] > 0:
            t00 -= a[c, 0] * a[c, 0] / a[c, c]
            t01 -= a[c, 0] * a[c, 1] / a[c, c]
            t11 -= a[c, 1] * a[c, 1] / a[c, c]
    middle = (t00 + t11) / 2
    away = math.sqrt(((t00 - t11) / 2) ** 2 + t01 * t01)
    if not (information > 0 and abs(evidence) < 1e300):
        return 0.0, 0.0, max(middle - away, 0.0)
    return information, evidence, max(middle - away, 0.0)
