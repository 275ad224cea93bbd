"""Compiled loops of `joint`: one pixel's light, normal equations and their solution."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit, prange

from processing.refinement.joint_light import Lamps, gather

LONGEST_TURN = 0.15
"""A step of Gauss-Newton turns the normal by at most this tangent: the lobe is some 20 deg wide."""
MOST_TURN2 = 1e6
"""A larger mean squared turn, rad^2, is told as this: such a normal is noise alone."""


class Pixels(NamedTuple):
    """n pixels as compiled code takes them, in float32 but for the corners.

    Attributes:
        rgb: (n, P, 3) readings.
        points: (n, 3) mm.
        starts, views: (n, 3) unit.
        roughness, specular: (n,).
        corners, weights: (n, 3) of `Shadows`.
        rests: (n, P, 3) of `Scattered`.
    """

    rgb: np.ndarray
    points: np.ndarray
    starts: np.ndarray
    views: np.ndarray
    roughness: np.ndarray
    specular: np.ndarray
    corners: np.ndarray
    weights: np.ndarray
    rests: np.ndarray


class Spread(NamedTuple):
    """Variances of `joint.Noise`, and (3,) float64 `kept` of `joint.Scattered`."""

    sensor2: float
    model2: float
    shade2: float
    kept: np.ndarray


UNSHADOWED = np.float32(0.390625)
"""Facets whose slope squared times m squared stays below (.625 squared) hide nothing."""


@njit(cache=True, error_model="numpy")
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


@njit(cache=True, error_model="numpy")
def _diffuse(light: np.ndarray, kept: np.ndarray, rest: np.ndarray, out: np.ndarray) -> None:
    """Fill out (P, 3) with each channel's irradiance."""
    for k in range(len(light)):
        for c in range(3):
            out[k, c] = max(kept[c] * light[k, 0] + rest[k, c], 0.0) + light[k, 9 + c]


@njit(cache=True, error_model="numpy")
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


@njit(cache=True, error_model="numpy")
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


@njit(cache=True, error_model="numpy")
def _weight(value: float, sensor2: float, model2: float) -> float:
    """One over the variance of a reading."""
    bright = max(value, 0.0)
    return 1 / (sensor2 * (0.25 + bright) + model2 * bright * bright)


@njit(cache=True, error_model="numpy")
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
    shade2: float,
    a: np.ndarray,
    b: np.ndarray,
    c: np.ndarray,
) -> None:
    """Fill a (5, 5), b (5, 3), c (3, 3): two turns and three albedos; residual, B and s dB/dm.

    a is the unknowns' products with each other, b theirs with the other three, c these three's
    with each other, weighted by the inverse of the readings' covariance: each reading's own
    variance, and an error of the irradiance that is common to a pattern's channels.
    """
    a[:] = 0
    b[:] = 0
    c[:] = 0
    row = np.zeros(8)
    common = np.zeros(8)
    for k in range(len(light)):
        et = eu = bt = bu = 0.0
        for x in range(3):
            et += light[k, 1 + x] * across[0, x]
            eu += light[k, 1 + x] * across[1, x]
            bt += light[k, 5 + x] * across[0, x]
            bu += light[k, 5 + x] * across[1, x]
        common[:] = 0
        power = 0.0
        for channel in range(3):
            e = diffuse[k, channel]
            w = _weight(rgb[k, channel], sensor2, model2)
            shade = rho[channel] * e
            row[0] = rho[channel] * kept[channel] * et + s * bt
            row[1] = rho[channel] * kept[channel] * eu + s * bu
            row[2] = row[3] = row[4] = 0.0
            row[2 + channel] = e
            row[5] = rgb[k, channel] - shade - s * light[k, 4]
            row[6] = light[k, 4]
            row[7] = s * light[k, 8]
            for p in range(8):
                common[p] += w * shade * row[p]
            power += w * shade * shade
            _add(row, w, channel, a, b, c)
        if shade2 > 0:
            share = shade2 / (1 + shade2 * power)
            for p in range(5):
                for q in range(p + 1):
                    a[p, q] -= share * common[p] * common[q]
                for q in range(3):
                    b[p, q] -= share * common[p] * common[5 + q]
            for p in range(3):
                for q in range(3):
                    c[p, q] -= share * common[5 + p] * common[5 + q]


@njit(cache=True, error_model="numpy")
def _left_over(
    light: np.ndarray,
    diffuse: np.ndarray,
    rgb: np.ndarray,
    rho: np.ndarray,
    s: float,
    sensor2: float,
    model2: float,
    shade2: float,
) -> float:
    """The squared residual alone, weighed as in `_normal_equations`."""
    total = 0.0
    for k in range(len(light)):
        common = power = 0.0
        for channel in range(3):
            w = _weight(rgb[k, channel], sensor2, model2)
            shade = rho[channel] * diffuse[k, channel]
            left = rgb[k, channel] - shade - s * light[k, 4]
            total += w * left * left
            common += w * shade * left
            power += w * shade * shade
        if shade2 > 0:
            total -= shade2 / (1 + shade2 * power) * common * common
    return total


@njit(cache=True, inline="always")
def _add(
    row: np.ndarray, w: float, channel: int, a: np.ndarray, b: np.ndarray, c: np.ndarray
) -> None:
    """Add the products of one reading's row to the normal equations."""
    own = 2 + channel
    a[0, 0] += w * row[0] * row[0]
    a[1, 0] += w * row[0] * row[1]
    a[1, 1] += w * row[1] * row[1]
    a[own, 0] += w * row[own] * row[0]
    a[own, 1] += w * row[own] * row[1]
    a[own, own] += w * row[own] * row[own]
    for q in range(3):
        other = w * row[5 + q]
        b[0, q] += other * row[0]
        b[1, q] += other * row[1]
        b[own, q] += other * row[own]
        for p in range(3):
            c[p, q] += other * row[5 + p]


@njit(parallel=True, cache=True, error_model="numpy")
def solve_kernel(
    pixels: Pixels,
    lamps: Lamps,
    spread: Spread,
    rounds: int,
    colour: bool,
    normals: np.ndarray,
    mattes: np.ndarray,
    lit: np.ndarray,
    powers: np.ndarray,
    misfits: np.ndarray,
    irradiances: np.ndarray,
    certainties: np.ndarray,
    matte_turns: np.ndarray,
) -> None:
    """Fill in what `joint.solve_jointly` returns; arguments as there."""
    rgb, points, views, roughness = pixels.rgb, pixels.points, pixels.views, pixels.roughness
    corners, weights, rests = pixels.corners, pixels.weights, pixels.rests
    sensor2, model2, shade2, kept = spread.sensor2, spread.model2, spread.shade2, spread.kept
    patterns = rgb.shape[1]
    for i in prange(len(rgb)):
        n = pixels.starts[i].copy()
        if not (n[0] * n[0] + n[1] * n[1] + n[2] * n[2] > 0.5 and roughness[i] > 0):
            continue
        s = float(pixels.specular[i])
        light = np.zeros((patterns, 12), np.float32)
        across, rho, power = np.zeros((2, 3)), np.zeros(3), np.zeros(3)
        diffuse = np.zeros((patterns, 3))
        a, b, others = np.zeros((5, 5)), np.zeros((5, 3)), np.zeros((3, 3))
        matte, turned = np.zeros(3), np.zeros(3)
        good = True
        certainty = 0.0
        for _ in range(rounds):
            gather(points[i], n, views[i], roughness[i], corners[i], weights[i], lamps, light)
            _diffuse(light, kept, rests[i], diffuse)
            _albedo(light, diffuse, rgb[i], s, rho, power)
            _across(n, across)
            _normal_equations(
                light, diffuse, rgb[i], rho, s, kept, across, sensor2, model2, shade2, a, b, others
            )
            # Beside the step, two columns of the inverse: the covariance of the turns.
            b[:, 1:] = 0
            b[0, 1] = b[1, 2] = 1
            good = _solve_in_place(a, b)
            certainty = _least_turn(b[:2, 1:])
            x, y = b[0, 0], b[1, 0]
            turn = math.sqrt(x * x + y * y)
            good = good and turn < 1e9
            if not good:
                break
            if turn > LONGEST_TURN:
                x, y = x * LONGEST_TURN / turn, y * LONGEST_TURN / turn
            length = 0.0
            for c in range(3):
                turned[c] = n[c]
                n[c] += x * across[0, c] + y * across[1, c]
                length += n[c] * n[c]
            n /= math.sqrt(length)
            for c in range(3):
                turned[c] = n[c] - turned[c]
        if not good:
            continue
        matte_turn2 = _matte_normal(light, rgb[i], rho, s, colour, sensor2, model2, matte)
        if matte_turn2 < 0:
            matte[:] = matte_turn2 = 0.0
        # The last step is short: what it changes is taken as linear.
        for k in range(patterns):
            for x in range(3):
                light[k, 0] += light[k, 1 + x] * turned[x]
                light[k, 4] += light[k, 5 + x] * turned[x]
        _diffuse(light, kept, rests[i], diffuse)
        _albedo(light, diffuse, rgb[i], s, rho, power)
        total = _left_over(light, diffuse, rgb[i], rho, s, sensor2, model2, shade2)
        if not (math.isfinite(total) and math.isfinite(power.sum())):
            continue
        for c in range(3):
            normals[i, c] = n[c]
            mattes[i, c] = matte[c]
            lit[i, c] = rho[c] * power[c]
            powers[i, c] = power[c]
        for k in range(patterns):
            irradiances[i, k] = light[k, 0]
        misfits[i] = total / (3 * patterns - 5)
        certainties[i] = certainty
        matte_turns[i] = matte_turn2


@njit(cache=True, error_model="numpy")
def _matte_normal(
    light: np.ndarray,
    rgb: np.ndarray,
    rho: np.ndarray,
    s: float,
    colour: bool,
    sensor2: float,
    model2: float,
    out: np.ndarray,
) -> float:
    """Normal from chroma: signal_k = g_k . b along the pixel's own hue, across white.

    Without `colour`, from the sum of all channels less the mirror reflection. Returns the mean
    squared turn, rad^2, that the readings' noise gives it (all patterns' signals taken as equally
    noisy), or -1 where there is no normal.

    Source: [Mallick2005].
    """
    hue = np.zeros(3) if colour else np.ones(3)
    for k in range(len(rgb) if colour else 0):
        grey = (rgb[k, 0] + rgb[k, 1] + rgb[k, 2]) / 3
        for c in range(3):
            hue[c] += rgb[k, c] - grey
    length = math.sqrt(hue[0] * hue[0] + hue[1] * hue[1] + hue[2] * hue[2])
    if not length > 0:
        return -1.0
    a, b = np.zeros((3, 3)), np.zeros((3, 4))
    variance = 0.0
    for k in range(len(rgb)):
        signal = 0.0
        for c in range(3):
            along = hue[c] / length
            signal += along * (rgb[k, c] - rho[c] * light[k, 9 + c] - s * light[k, 4])
            variance += along * along / _weight(rgb[k, c], sensor2, model2) / len(rgb)
        for x in range(3):
            b[x, 0] += light[k, 1 + x] * signal
            for y in range(x + 1):
                a[x, y] += light[k, 1 + x] * light[k, 1 + y]
    third = (a[0, 0] + a[1, 1] + a[2, 2]) / 3
    # Beside the normal, the inverse: its covariance but for the signal's variance.
    b[0, 1] = b[1, 2] = b[2, 3] = 1
    if not _solve_in_place(a, b) or a[0, 0] * a[1, 1] * a[2, 2] < 1e-2 * third**1.5:
        return -1.0
    length = math.sqrt(b[0, 0] ** 2 + b[1, 0] ** 2 + b[2, 0] ** 2)
    if not (length > 0 and math.isfinite(length)):
        return -1.0
    spread = 0.0
    for x in range(3):
        out[x] = b[x, 0] / length
    # What is along the normal changes its length alone.
    for x in range(3):
        spread += b[x, 1 + x]
        for y in range(3):
            spread -= out[x] * b[x, 1 + y] * out[y]
    turn2 = variance * max(spread, 0.0) / length / length
    return turn2 if turn2 < MOST_TURN2 else MOST_TURN2


@njit(parallel=True, cache=True, error_model="numpy")
def evidence_kernel(
    pixels: Pixels,
    lamps: Lamps,
    spread: Spread,
    out: np.ndarray,
) -> None:
    """Fill in what `joint.gloss_evidence` returns; arguments as there."""
    rgb, points, views, roughness = pixels.rgb, pixels.points, pixels.views, pixels.roughness
    corners, weights, rests = pixels.corners, pixels.weights, pixels.rests
    sensor2, model2, shade2, kept = spread.sensor2, spread.model2, spread.shade2, spread.kept
    patterns = rgb.shape[1]
    for i in prange(len(rgb)):
        n = pixels.starts[i]
        if not (n[0] * n[0] + n[1] * n[1] + n[2] * n[2] > 0.5 and roughness[i] > 0):
            continue
        s = float(pixels.specular[i])
        light = np.zeros((patterns, 12), np.float32)
        across, rho, power = np.zeros((2, 3)), np.zeros(3), np.zeros(3)
        diffuse = np.zeros((patterns, 3))
        a, b, others = np.zeros((5, 5)), np.zeros((5, 3)), np.zeros((3, 3))
        gather(points[i], n, views[i], roughness[i], corners[i], weights[i], lamps, light)
        _diffuse(light, kept, rests[i], diffuse)
        _albedo(light, diffuse, rgb[i], s, rho, power)
        _across(n, across)
        _normal_equations(
            light, diffuse, rgb[i], rho, s, kept, across, sensor2, model2, shade2, a, b, others
        )
        free = b.copy()
        if not _solve_in_place(a, free):
            continue
        left2, s_left, m_left = others[0, 0], others[1, 0], others[2, 0]
        ss, sm, mm = others[1, 1], others[1, 2], others[2, 2]
        for p in range(5):
            left2 -= b[p, 0] * free[p, 0]
            s_left -= b[p, 1] * free[p, 0]
            m_left -= b[p, 2] * free[p, 0]
            ss -= b[p, 1] * free[p, 1]
            sm -= b[p, 1] * free[p, 2]
            mm -= b[p, 2] * free[p, 2]
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


@njit(cache=True, error_model="numpy")
def _least_turn(covariance: np.ndarray) -> float:
    """Least information on a turn of the normal with the albedos free, from (2, 2) covariance."""
    middle = (covariance[0, 0] + covariance[1, 1]) / 2
    half = (covariance[0, 0] - covariance[1, 1]) / 2
    most = middle + math.sqrt(half * half + covariance[0, 1] * covariance[1, 0])
    return 1 / most if most > 0 and math.isfinite(most) else 0.0
