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

LONGEST_TURN = 0.15
"""A step of Gauss-Newton turns the normal by at most this tangent: the lobe is some 20 deg wide."""


@dataclasses.dataclass(frozen=True)
class Noise:
    """Variance of a reading I is sensor^2 (0.25 + I) + (model I)^2.

    Attributes:
        sensor: standard deviation of a reading of .75.
        model: what the model of light is wrong by, as a share of the reading.
    """

    sensor: float = 0.001
    model: float = 0.003


@dataclasses.dataclass(frozen=True)
class Place:
    """Where n pixels lie on the mesh.

    Attributes:
        points_mm: (n, 3).
        views: (n, 3) unit, toward the camera.
        shadows: lights that each sees.
    """

    points_mm: np.ndarray
    views: np.ndarray
    shadows: Shadows


@dataclasses.dataclass(frozen=True)
class Scattered:
    """How light that wanders inside the skin calms what the relief does to diffuse light.

    The irradiance of channel c is g . (kept_c n + rest_c): what leaves where it entered follows the
    pixel's own normal, the rest follows its neighbours'.

    Attributes:
        kept: (3,) float64 share of each channel that leaves where it entered; 1 without scattering.
        rest: (n, 3, 3) float32 by channel, what the neighbours' normals give; zero without.
    """

    kept: np.ndarray
    rest: np.ndarray


@dataclasses.dataclass(frozen=True)
class Solved:
    """Of n pixels; zero where not solved.

    Attributes:
        normal: (n, 3) float32 unit.
        lit: (n, 3) float32 least squares of the diffuse albedo is lit / power.
        power: (n, 3) float32 the sum of squared irradiance.
        misfit: (n,) float32 mean squared residual over its expected variance.
        certainty: (n,) float32 least information on a turn of the normal, one over rad^2.
    """

    normal: np.ndarray
    lit: np.ndarray
    power: np.ndarray
    misfit: np.ndarray
    certainty: np.ndarray


def solve_jointly(
    rgb: np.ndarray,
    lights: PatternLights,
    place: Place,
    normals: np.ndarray,
    roughness: np.ndarray,
    specular: np.ndarray,
    interface: Interface,
    scattered: Scattered,
    noise: Noise,
    rounds: int = 2,
) -> Solved:
    """Normals and albedo of pixels whose gloss is known, by Gauss-Newton from given normals.

    Args:
        rgb: (n, P, 3) readings in the lights' own colour.
        lights: of P patterns.
        place: of the n pixels.
        normals: (n, 3) unit, to start from; zero where there is none.
        roughness: (n,) Beckmann's m.
        specular: (n,) reflectance at normal incidence.
        interface: that light passes on its way into the diffuse layer and out.
        scattered: inside the skin.
        noise: of the readings.
        rounds: steps.
    """
    count = len(rgb)
    out = Solved(
        *(np.zeros((count, 3), np.float32) for _ in range(3)),
        *(np.zeros(count, np.float32) for _ in range(2)),
    )
    _solve(
        *_arguments(rgb, lights, place, normals, roughness, specular, interface, scattered, noise),
        rounds,
        out.normal,
        out.lit,
        out.power,
        out.misfit,
        out.certainty,
    )
    return out


def gloss_evidence(
    rgb: np.ndarray,
    lights: PatternLights,
    place: Place,
    normals: np.ndarray,
    roughness: np.ndarray,
    specular: np.ndarray,
    interface: Interface,
    scattered: Scattered,
    noise: Noise,
) -> np.ndarray:
    """What each pixel says of its specular albedo and roughness, normal and albedo left free.

    Args:
        rgb, lights, place, normals, interface, scattered, noise: as in `solve_jointly`.
        roughness, specular: (n,) about which the lobe is taken as linear.

    Returns:
        (n, 5) float32: information on s, on s and m together, on m; its product with the offsets
        of s and of m from the given ones that fit best. Sums over pixels of one gloss are that
        gloss's. Zero where a pixel cannot be solved; outliers count little.
    """
    out = np.zeros((len(rgb), 5), np.float32)
    given = (rgb, lights, place, normals, roughness, specular, interface, scattered, noise)
    _evidence(*_arguments(*given), out)
    return out


def _arguments(
    rgb: np.ndarray,
    lights: PatternLights,
    place: Place,
    normals: np.ndarray,
    roughness: np.ndarray,
    specular: np.ndarray,
    interface: Interface,
    scattered: Scattered,
    noise: Noise,
) -> tuple[object, ...]:
    """What both kernels take."""
    given = (rgb, place.points_mm, normals, place.views, roughness, specular)
    return (
        *(np.ascontiguousarray(values, np.float32) for values in given),
        place.shadows.corners,
        place.shadows.weights,
        place.shadows.visible,
        lights.position_mm.astype(np.float32),
        lights.radius_mm.astype(np.float32),
        lights.weight.astype(np.float32),
        lights.levels.astype(np.float32),
        lights.group_end,
        fresnel_table().astype(np.float32),
        interface.table,
        interface.mean,
        np.ascontiguousarray(scattered.kept, np.float64),
        np.ascontiguousarray(scattered.rest, np.float32),
        float(noise.sensor) ** 2,
        float(noise.model) ** 2,
    )


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
    """Fill out (P, 9): E, its gradient (3), B, its gradient (3), B's slope over m."""
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
        b = bx = by = bz = bm = np.float32(0)
        for j in range(first, group_end[group]):
            seen = (
                weights[0] * visible[c0, j]
                + weights[1] * visible[c1, j]
                + weights[2] * visible[c2, j]
            )
            if seen <= 0:
                continue
            lx, ly, lz = (
                position[j, 0] - point[0],
                position[j, 1] - point[1],
                position[j, 2] - point[2],
            )
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
            bm += lobe * (2 * (1 - nh2) / (nh2 * m2) - 2)
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
            out[k, 8] += level * bm / roughness


@njit(cache=True)
def _solve_in_place(a: np.ndarray, b: np.ndarray) -> bool:
    """Solve a x = b for (n, m) b, a symmetric (its lower triangle is read); false where singular.

    Cholesky's way; a is destroyed.
    """
    size = len(b)
    for i in range(size):
        scale = a[i, i]
        for j in range(i + 1):
            total = a[i, j]
            for k in range(j):
                total -= a[i, k] * a[j, k]
            if i == j:
                if not total > 1e-12 * scale:
                    return False
                a[i, i] = math.sqrt(total)
            else:
                a[i, j] = total / a[j, j]
    for c in range(b.shape[1]):
        for i in range(size):
            total = b[i, c]
            for k in range(i):
                total -= a[i, k] * b[k, c]
            b[i, c] = total / a[i, i]
        for i in range(size - 1, -1, -1):
            total = b[i, c]
            for k in range(i + 1, size):
                total -= a[k, i] * b[k, c]
            b[i, c] = total / a[i, i]
    return True


@njit(cache=True)
def _diffuse(light: np.ndarray, kept: np.ndarray, rest: np.ndarray, out: np.ndarray) -> None:
    """Fill out (P, 3) with each channel's irradiance."""
    for k in range(len(light)):
        for c in range(3):
            e = kept[c] * light[k, 0]
            for x in range(3):
                e += light[k, 1 + x] * rest[c, x]
            out[k, c] = max(e, 0.0)


@njit(cache=True)
def _albedo(
    light: np.ndarray,
    diffuse: np.ndarray,
    rgb: np.ndarray,
    s: float,
    rho: np.ndarray,
    power: np.ndarray,
) -> None:
    """Fill (3,) the least squares of the albedo with the gloss s taken off, and its divisor."""
    rho[:] = 0
    power[:] = 0
    for k in range(len(light)):
        for c in range(3):
            e = diffuse[k, c]
            power[c] += e * e
            rho[c] += e * (rgb[k, c] - s * light[k, 4])
    for c in range(3):
        if power[c] > 0:
            rho[c] /= power[c]


@njit(cache=True)
def _across(n: np.ndarray, out: np.ndarray) -> None:
    """Fill out (2, 3) with two unit directions across a unit normal."""
    if abs(n[0]) < 0.6:
        x, y, z = 0.0, n[2], -n[1]
    else:
        x, y, z = -n[2], 0.0, n[0]
    length = math.sqrt(x * x + y * y + z * z)
    x, y, z = x / length, y / length, z / length
    out[0, 0], out[0, 1], out[0, 2] = x, y, z
    out[1, 0] = n[1] * z - n[2] * y
    out[1, 1] = n[2] * x - n[0] * z
    out[1, 2] = n[0] * y - n[1] * x


@njit(cache=True)
def _weight(value: float, sensor2: float, model2: float) -> float:
    """One over the variance of a reading."""
    bright = max(value, 0.0)
    return 1 / (sensor2 * (0.25 + bright) + model2 * bright * bright)


@njit(cache=True)
def _normal_equations(
    light: np.ndarray,
    diffuse: np.ndarray,
    rgb: np.ndarray,
    rho: np.ndarray,
    s: float,
    kept: np.ndarray,
    across: np.ndarray,
    sensor2: float,
    model2: float,
    a: np.ndarray,
    b: np.ndarray,
) -> float:
    """Fill a (5, 5) and b (5, 3): two turns and three albedos against residual, B and dB/dm s.

    Returns:
        The weighted sum of squared residuals.
    """
    a[:] = 0
    b[:] = 0
    total = 0.0
    for k in range(len(light)):
        et = eu = bt = bu = 0.0
        for x in range(3):
            et += light[k, 1 + x] * across[0, x]
            eu += light[k, 1 + x] * across[1, x]
            bt += light[k, 5 + x] * across[0, x]
            bu += light[k, 5 + x] * across[1, x]
        gloss, wider = light[k, 4], s * light[k, 8]
        for c in range(3):
            e = diffuse[k, c]
            w = _weight(rgb[k, c], sensor2, model2)
            left = rgb[k, c] - rho[c] * e - s * gloss
            total += w * left * left
            t, u = rho[c] * kept[c] * et + s * bt, rho[c] * kept[c] * eu + s * bu
            a[0, 0] += w * t * t
            a[1, 0] += w * t * u
            a[1, 1] += w * u * u
            a[2 + c, 0] += w * e * t
            a[2 + c, 1] += w * e * u
            a[2 + c, 2 + c] += w * e * e
            b[0, 0] += w * t * left
            b[1, 0] += w * u * left
            b[2 + c, 0] += w * e * left
            b[0, 1] += w * t * gloss
            b[1, 1] += w * u * gloss
            b[2 + c, 1] += w * e * gloss
            b[0, 2] += w * t * wider
            b[1, 2] += w * u * wider
            b[2 + c, 2] += w * e * wider
    return total


@njit(parallel=True, cache=True)
def _solve(
    rgb: np.ndarray,
    points: np.ndarray,
    starts: np.ndarray,
    views: np.ndarray,
    roughness: np.ndarray,
    specular: np.ndarray,
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
    kept: np.ndarray,
    rests: np.ndarray,
    sensor2: float,
    model2: float,
    rounds: int,
    normals: np.ndarray,
    lit: np.ndarray,
    powers: np.ndarray,
    misfits: np.ndarray,
    certainties: np.ndarray,
) -> None:
    patterns = rgb.shape[1]
    for i in prange(len(rgb)):
        n = starts[i].copy()
        if not n[0] * n[0] + n[1] * n[1] + n[2] * n[2] > 0.5:
            continue
        s = float(specular[i])
        light = np.zeros((patterns, 9), np.float32)
        across, rho, power = np.zeros((2, 3)), np.zeros(3), np.zeros(3)
        diffuse = np.zeros((patterns, 3))
        a, b = np.zeros((5, 5)), np.zeros((5, 3))
        good = True
        certainty = 0.0
        for _ in range(rounds):
            _gather(
                points[i], n, views[i], roughness[i], corners[i], weights[i], visible,
                position, radius, weight, levels, group_end, table, through, mean, light,
            )  # fmt: skip
            _diffuse(light, kept, rests[i], diffuse)
            _albedo(light, diffuse, rgb[i], s, rho, power)
            _across(n, across)
            _normal_equations(light, diffuse, rgb[i], rho, s, kept, across, sensor2, model2, a, b)
            certainty = _least_turn(a)
            if not _solve_in_place(a, b[:, :1]):
                good = False
                break
            x, y = b[0, 0], b[1, 0]
            turn = math.sqrt(x * x + y * y)
            if not turn < 1e9:
                good = False
                break
            if turn > LONGEST_TURN:
                x, y = x * LONGEST_TURN / turn, y * LONGEST_TURN / turn
            length = 0.0
            for c in range(3):
                n[c] += x * across[0, c] + y * across[1, c]
                length += n[c] * n[c]
            n /= math.sqrt(length)
        if not good:
            continue
        _gather(
            points[i], n, views[i], roughness[i], corners[i], weights[i], visible,
            position, radius, weight, levels, group_end, table, through, mean, light,
        )  # fmt: skip
        _diffuse(light, kept, rests[i], diffuse)
        _albedo(light, diffuse, rgb[i], s, rho, power)
        total = _normal_equations(
            light, diffuse, rgb[i], rho, s, kept, across, sensor2, model2, a, b
        )
        if not (math.isfinite(total) and math.isfinite(power.sum())):
            continue
        for c in range(3):
            normals[i, c] = n[c]
            lit[i, c] = rho[c] * power[c]
            powers[i, c] = power[c]
        misfits[i] = total / (3 * patterns - 5)
        certainties[i] = certainty


@njit(parallel=True, cache=True)
def _evidence(
    rgb: np.ndarray,
    points: np.ndarray,
    starts: np.ndarray,
    views: np.ndarray,
    roughness: np.ndarray,
    specular: np.ndarray,
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
    kept: np.ndarray,
    rests: np.ndarray,
    sensor2: float,
    model2: float,
    out: np.ndarray,
) -> None:
    patterns = rgb.shape[1]
    for i in prange(len(rgb)):
        n = starts[i]
        if not n[0] * n[0] + n[1] * n[1] + n[2] * n[2] > 0.5:
            continue
        s = float(specular[i])
        light = np.zeros((patterns, 9), np.float32)
        across, rho, power = np.zeros((2, 3)), np.zeros(3), np.zeros(3)
        diffuse = np.zeros((patterns, 3))
        a, b = np.zeros((5, 5)), np.zeros((5, 3))
        _gather(
            points[i], n, views[i], roughness[i], corners[i], weights[i], visible,
            position, radius, weight, levels, group_end, table, through, mean, light,
        )  # fmt: skip
        _diffuse(light, kept, rests[i], diffuse)
        _albedo(light, diffuse, rgb[i], s, rho, power)
        _across(n, across)
        _normal_equations(light, diffuse, rgb[i], rho, s, kept, across, sensor2, model2, a, b)
        free = b.copy()
        if not _solve_in_place(a, free):
            continue
        ss = sm = mm = s_left = m_left = left2 = 0.0
        for k in range(patterns):
            gloss, wider = light[k, 4], s * light[k, 8]
            for c in range(3):
                e = diffuse[k, c]
                w = _weight(rgb[i, k, c], sensor2, model2)
                left = rgb[i, k, c] - rho[c] * e - s * gloss
                ss += w * gloss * gloss
                sm += w * gloss * wider
                mm += w * wider * wider
                s_left += w * gloss * left
                m_left += w * wider * left
                left2 += w * left * left
        for p in range(5):
            ss -= b[p, 1] * free[p, 1]
            sm -= b[p, 1] * free[p, 2]
            mm -= b[p, 2] * free[p, 2]
            s_left -= b[p, 1] * free[p, 0]
            m_left -= b[p, 2] * free[p, 0]
            left2 -= b[p, 0] * free[p, 0]
        # What no gloss explains is shadow, hair or motion: such a pixel has little to say.
        outside = max(left2, 0.0) / (3 * patterns - 7)
        trust = 1 / (1 + outside / 9) ** 2
        if not (ss > 0 and mm >= 0 and math.isfinite(s_left + m_left + sm)):
            continue
        out[i, 0] = trust * ss
        out[i, 1] = trust * sm
        out[i, 2] = trust * mm
        out[i, 3] = trust * s_left
        out[i, 4] = trust * m_left


@njit(cache=True)
def _least_turn(a: np.ndarray) -> float:
    """Least information on a turn of the normal with the albedos free."""
    t00, t01, t11 = a[0, 0], a[1, 0], a[1, 1]
    for c in range(2, 5):
        if a[c, c] > 0:
            t00 -= a[c, 0] * a[c, 0] / a[c, c]
            t01 -= a[c, 0] * a[c, 1] / a[c, c]
            t11 -= a[c, 1] * a[c, 1] / a[c, c]
    middle = (t00 + t11) / 2
    return max(middle - math.sqrt(((t00 - t11) / 2) ** 2 + t01 * t01), 0.0)
