"""One pixel's normal equations and their solution, for `joint_kernels`."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

MOST_TURN2 = 1e6
"""A larger mean squared turn, rad^2, is reported as this: such a normal is noise alone."""


class Spread(NamedTuple):
    """Variances of `joint.Noise`, and (3,) float64 `kept` of `joint.Scattered`.

    A reading I errs by read2 + shot2 I + model2 I^2.
    """

    read2: float
    shot2: float
    model2: float
    shade2: float
    kept: np.ndarray


@njit(cache=True, error_model="numpy")
def solve_in_place(a: np.ndarray, b: np.ndarray) -> bool:
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
def diffuse_light(light: np.ndarray, kept: np.ndarray, rest: np.ndarray, out: np.ndarray) -> None:
    """Fill out (P, 3) with each channel's irradiance."""
    for k in range(len(light)):
        for c in range(3):
            out[k, c] = max(kept[c] * light[k, 0] + rest[k, c], 0.0) + light[k, 9 + c]


@njit(cache=True, error_model="numpy")
def skin_albedo(
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
def across_normal(n: np.ndarray, out: np.ndarray) -> None:
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
def _weight(value: float, spread: Spread) -> float:
    """One over the variance of a reading."""
    bright = max(value, 0.0)
    return 1 / (spread.read2 + spread.shot2 * bright + spread.model2 * bright * bright)


@njit(cache=True, error_model="numpy")
def normal_equations(
    light: np.ndarray,
    diffuse: np.ndarray,
    rgb: np.ndarray,
    rho: np.ndarray,
    s: float,
    across: np.ndarray,
    spread: Spread,
    a: np.ndarray,
    b: np.ndarray,
    c: np.ndarray,
) -> None:
    """Fill a (5, 5), b (5, 3), c (3, 3): two turns and three albedos; residual, B and s dB/dm.

    a is the unknowns' products with each other, b theirs with the other three, c these three's
    with each other, weighted by the inverse of the readings' covariance: each reading's own
    variance, and an error of the irradiance that is common to a pattern's channels.
    """
    kept, shade2 = spread.kept, spread.shade2
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
            w = _weight(rgb[k, channel], spread)
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
def left_over(
    light: np.ndarray,
    diffuse: np.ndarray,
    rgb: np.ndarray,
    rho: np.ndarray,
    s: float,
    spread: Spread,
) -> float:
    """The squared residual alone, weighed as in `normal_equations`, whose shapes it takes."""
    shade2 = spread.shade2
    total = 0.0
    for k in range(len(light)):
        own = common = power = 0.0
        for channel in range(3):
            w = _weight(rgb[k, channel], spread)
            shade = rho[channel] * diffuse[k, channel]
            left = rgb[k, channel] - shade - s * light[k, 4]
            own += w * left * left
            common += w * shade * left
            power += w * shade * shade
        if shade2 > 0:
            own -= shade2 / (1 + shade2 * power) * common * common
        # Of readings a million times too bright, rounding leaves less than nothing.
        total += max(own, 0.0)
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


@njit(cache=True, error_model="numpy")
def matte_normal(
    light: np.ndarray,
    rgb: np.ndarray,
    rho: np.ndarray,
    s: float,
    colour: bool,
    spread: Spread,
    out: np.ndarray,
) -> float:
    """Normal (3,) from chroma: signal_k = g_k . b along the pixel's own hue, across white.

    Shapes are those of `normal_equations`; `out` is overwritten with the normal.

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
            variance += along * along / _weight(rgb[k, c], spread) / len(rgb)
        for x in range(3):
            b[x, 0] += light[k, 1 + x] * signal
            for y in range(x + 1):
                a[x, y] += light[k, 1 + x] * light[k, 1 + y]
    third = (a[0, 0] + a[1, 1] + a[2, 2]) / 3
    # Beside the normal, the inverse: its covariance but for the signal's variance.
    b[0, 1] = b[1, 2] = b[2, 3] = 1
    if not solve_in_place(a, b) or a[0, 0] * a[1, 1] * a[2, 2] < 1e-2 * third**1.5:
        return -1.0
    length = math.sqrt(b[0, 0] ** 2 + b[1, 0] ** 2 + b[2, 0] ** 2)
    if not (length > 0 and math.isfinite(length)):
        return -1.0
    turns = 0.0
    for x in range(3):
        out[x] = b[x, 0] / length
    # What is along the normal changes its length alone.
    for x in range(3):
        turns += b[x, 1 + x]
        for y in range(3):
            turns -= out[x] * b[x, 1 + y] * out[y]
    turn2 = variance * max(turns, 0.0) / length / length
    return turn2 if turn2 < MOST_TURN2 else MOST_TURN2


@njit(cache=True, error_model="numpy")
def least_turn(covariance: np.ndarray) -> float:
    """Least information on a turn of the normal with the albedos free, from (2, 2) covariance."""
    middle = (covariance[0, 0] + covariance[1, 1]) / 2
    half = (covariance[0, 0] - covariance[1, 1]) / 2
    most = middle + math.sqrt(half * half + covariance[0, 1] * covariance[1, 0])
    return 1 / most if most > 0 and math.isfinite(most) else 0.0


@njit(cache=True, error_model="numpy")
def left_when_fitted(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> float:
    """The squared residual that the best turns and albedos leave; NaN where they are not fixed.

    Args:
        a, b, c: of `normal_equations`; a is destroyed.
    """
    found = b[:, :1].copy()
    if not solve_in_place(a, found):
        return np.nan
    left = c[0, 0]
    for p in range(len(b)):
        left -= b[p, 0] * found[p, 0]
    return left
