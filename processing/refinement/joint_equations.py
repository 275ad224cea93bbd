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
    # Sums are written out: in arrays, each would go through memory at every step.
    q0, q1, q2 = rho[0], rho[1], rho[2]
    kq0, kq1, kq2 = spread.kept[0] * q0, spread.kept[1] * q1, spread.kept[2] * q2
    tt = tu = uu = t0 = t1 = t2 = u0 = u1 = u2 = 0.0
    a00 = a11 = a22 = a10 = a20 = a21 = 0.0
    tr = ur = r0 = r1 = r2 = tb = ub = b0 = b1 = b2 = tm = um = m0 = m1 = m2 = 0.0
    rr = rb = rm = bb = bm = mm = 0.0
    for k in range(len(light)):
        et = eu = bt = bu = 0.0
        for x in range(3):
            et += light[k, 1 + x] * across[0, x]
            eu += light[k, 1 + x] * across[1, x]
            bt += light[k, 5 + x] * across[0, x]
            bu += light[k, 5 + x] * across[1, x]
        mirror, width = float(light[k, 4]), s * light[k, 8]
        e0, e1, e2 = diffuse[k, 0], diffuse[k, 1], diffuse[k, 2]
        w0, w1, w2 = (
            _weight(rgb[k, 0], spread), _weight(rgb[k, 1], spread), _weight(rgb[k, 2], spread),
        )  # fmt: skip
        h0, h1, h2 = q0 * e0, q1 * e1, q2 * e2
        jt0, jt1, jt2 = kq0 * et + s * bt, kq1 * et + s * bt, kq2 * et + s * bt
        ju0, ju1, ju2 = kq0 * eu + s * bu, kq1 * eu + s * bu, kq2 * eu + s * bu
        gloss = s * mirror
        d0, d1, d2 = rgb[k, 0] - h0 - gloss, rgb[k, 1] - h1 - gloss, rgb[k, 2] - h2 - gloss
        # What all channels err by together is taken off again.
        wh0, wh1, wh2 = w0 * h0, w1 * h1, w2 * h2
        share = spread.shade2 / (1 + spread.shade2 * (wh0 * h0 + wh1 * h1 + wh2 * h2))
        ct, cu = wh0 * jt0 + wh1 * jt1 + wh2 * jt2, wh0 * ju0 + wh1 * ju1 + wh2 * ju2
        c0, c1, c2 = wh0 * e0, wh1 * e1, wh2 * e2
        cr, ch = wh0 * d0 + wh1 * d1 + wh2 * d2, wh0 + wh1 + wh2
        st, su, s0, s1, s2 = share * ct, share * cu, share * c0, share * c1, share * c2
        wt0, wt1, wt2 = w0 * jt0, w1 * jt1, w2 * jt2
        wu0, wu1, wu2 = w0 * ju0, w1 * ju1, w2 * ju2
        we0, we1, we2 = w0 * e0, w1 * e1, w2 * e2
        tt += wt0 * jt0 + wt1 * jt1 + wt2 * jt2 - st * ct
        tu += wt0 * ju0 + wt1 * ju1 + wt2 * ju2 - st * cu
        uu += wu0 * ju0 + wu1 * ju1 + wu2 * ju2 - su * cu
        t0, t1, t2 = t0 + wt0 * e0 - s0 * ct, t1 + wt1 * e1 - s1 * ct, t2 + wt2 * e2 - s2 * ct
        u0, u1, u2 = u0 + wu0 * e0 - s0 * cu, u1 + wu1 * e1 - s1 * cu, u2 + wu2 * e2 - s2 * cu
        a00, a11, a22 = a00 + we0 * e0 - s0 * c0, a11 + we1 * e1 - s1 * c1, a22 + we2 * e2 - s2 * c2
        a10, a20, a21 = a10 - s0 * c1, a20 - s0 * c2, a21 - s1 * c2
        tr += wt0 * d0 + wt1 * d1 + wt2 * d2 - st * cr
        ur += wu0 * d0 + wu1 * d1 + wu2 * d2 - su * cr
        r0, r1, r2 = r0 + we0 * d0 - s0 * cr, r1 + we1 * d1 - s1 * cr, r2 + we2 * d2 - s2 * cr
        # B and dB/dm are the same in all channels.
        over_t, over_u = wt0 + wt1 + wt2 - st * ch, wu0 + wu1 + wu2 - su * ch
        over_0, over_1, over_2 = we0 - s0 * ch, we1 - s1 * ch, we2 - s2 * ch
        tb, ub, tm, um = (
            tb + over_t * mirror, ub + over_u * mirror, tm + over_t * width, um + over_u * width,
        )  # fmt: skip
        b0, b1, b2 = b0 + over_0 * mirror, b1 + over_1 * mirror, b2 + over_2 * mirror
        m0, m1, m2 = m0 + over_0 * width, m1 + over_1 * width, m2 + over_2 * width
        rr += w0 * d0 * d0 + w1 * d1 * d1 + w2 * d2 * d2 - share * cr * cr
        left = w0 * d0 + w1 * d1 + w2 * d2 - share * cr * ch
        rb, rm = rb + left * mirror, rm + left * width
        whole = w0 + w1 + w2 - share * ch * ch
        bb, bm, mm = (
            bb + whole * mirror * mirror, bm + whole * mirror * width, mm + whole * width * width,
        )  # fmt: skip
    a[:] = 0
    a[0, 0], a[1, 0], a[1, 1] = tt, tu, uu
    a[2, 0], a[3, 0], a[4, 0] = t0, t1, t2
    a[2, 1], a[3, 1], a[4, 1] = u0, u1, u2
    a[2, 2], a[3, 3], a[4, 4] = a00, a11, a22
    a[3, 2], a[4, 2], a[4, 3] = a10, a20, a21
    b[0, 0], b[1, 0], b[2, 0], b[3, 0], b[4, 0] = tr, ur, r0, r1, r2
    b[0, 1], b[1, 1], b[2, 1], b[3, 1], b[4, 1] = tb, ub, b0, b1, b2
    b[0, 2], b[1, 2], b[2, 2], b[3, 2], b[4, 2] = tm, um, m0, m1, m2
    c[0, 0], c[1, 1], c[2, 2] = rr, bb, mm
    c[0, 1] = c[1, 0] = rb
    c[0, 2] = c[2, 0] = rm
    c[1, 2] = c[2, 1] = bm


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
        a: (5, 5) of `normal_equations`; it is destroyed.
        b: (5, 3) of `normal_equations`.
        c: (3, 3) of `normal_equations`.
    """
    found = b[:, :1].copy()
    if not solve_in_place(a, found):
        return np.nan
    left = c[0, 0]
    for p in range(len(b)):
        left -= b[p, 0] * found[p, 0]
    return left
