"""The joint solve of eight pixels at once, from the polynomials of `node_light`.

What `joint_kernels` does with light gathered for one pixel is done here in single precision with
light that four nodes around a pixel know: a lane of the processor's vectors is a pixel. What cannot
be solved well that way (a normal far from its nodes', an equation near singular) is marked, and
left to the other.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from processing.lanes import LANES, above, at_least, at_most, every, load, root, store
from processing.refinement.joint_equations import MOST_TURN2
from processing.refinement.joint_kernels import LONGEST_TURN
from processing.refinement.node_light import OF_PATTERN

OF_STATE = 12
"""Numbers of a pixel for each pattern: E B and their slopes, light in R G B, F and its slopes."""
RESULTS = 16
"""Place of each result: normal's t and u, matte's three along T U N, albedo, power, misfit,
certainty, 1 where the result holds, and matte's squared turn."""
SMALLEST = np.float32(1e-6)
"""Share of a diagonal that must be left of it, or the equations are taken as singular."""
LONGEST = np.float32(LONGEST_TURN)
FEW = np.float32(1e-30)


@njit(cache=True, forceinline=True)
def _at(ws: np.ndarray, row: int) -> Any:
    return load(ws, row * LANES)


@njit(cache=True, forceinline=True)
def _put(ws: np.ndarray, row: int, value: Any) -> None:
    store(ws, row * LANES, value)


@njit(cache=True, error_model="numpy")
def evaluate(
    ws: np.ndarray,
    rgb: int,
    node: int,
    state: int,
    patterns: int,
    t: Any,
    u: Any,
    s: Any,
    kept: Any,
) -> tuple[Any, Any, Any, Any, Any, Any]:
    """Fill in the light for the turns (t, u); returns albedo and power in R G B."""
    one, two, zero = every(np.float32(1)), every(np.float32(2)), every(np.float32(0))
    k0, k1, k2 = kept
    shorter = one / root(one + t * t + u * u)
    ts, us = t * shorter * shorter, u * shorter * shorter
    p0, p1, p2, r0, r1, r2 = zero, zero, zero, zero, zero, zero
    for k in range(patterns):
        a = node + k * OF_PATTERN
        f, ft, fu = _at(ws, a), _at(ws, a + 1), _at(ws, a + 2)
        ftt, ftu, fuu = _at(ws, a + 3), _at(ws, a + 4), _at(ws, a + 5)
        b, bt, bu = _at(ws, a + 6), _at(ws, a + 7), _at(ws, a + 8)
        btt, btu, buu = _at(ws, a + 9), _at(ws, a + 10), _at(ws, a + 11)
        f = f + t * (ft + t * ftt + u * ftu) + u * (fu + u * fuu)
        ft, fu = ft + two * t * ftt + u * ftu, fu + two * u * fuu + t * ftu
        b = b + t * (bt + t * btt + u * btu) + u * (bu + u * buu)
        bt, bu = bt + two * t * btt + u * btu, bu + two * u * buu + t * btu
        e = f * shorter
        d0 = at_least(k0 * e + _at(ws, a + 15), zero) + _at(ws, a + 12)
        d1 = at_least(k1 * e + _at(ws, a + 16), zero) + _at(ws, a + 13)
        d2 = at_least(k2 * e + _at(ws, a + 17), zero) + _at(ws, a + 14)
        gloss = s * b
        p0, p1, p2 = p0 + d0 * d0, p1 + d1 * d1, p2 + d2 * d2
        r0 = r0 + d0 * (_at(ws, rgb + 3 * k) - gloss)
        r1 = r1 + d1 * (_at(ws, rgb + 3 * k + 1) - gloss)
        r2 = r2 + d2 * (_at(ws, rgb + 3 * k + 2) - gloss)
        o = state + k * OF_STATE
        _put(ws, o, e)
        _put(ws, o + 1, (ft - f * ts) * shorter)
        _put(ws, o + 2, (fu - f * us) * shorter)
        _put(ws, o + 3, b)
        _put(ws, o + 4, bt)
        _put(ws, o + 5, bu)
        _put(ws, o + 6, d0)
        _put(ws, o + 7, d1)
        _put(ws, o + 8, d2)
        _put(ws, o + 9, f)
        _put(ws, o + 10, ft)
        _put(ws, o + 11, fu)
    few = every(FEW)
    return r0 / at_least(p0, few), r1 / at_least(p1, few), r2 / at_least(p2, few), p0, p1, p2


@njit(cache=True, forceinline=True)
def _pivot(left: Any, whole: Any, sound: Any) -> tuple[Any, Any]:
    """One over the root of a pivot, and whether all were sound so far."""
    least = every(SMALLEST) * whole
    sound = sound * above(left, least)
    return every(np.float32(1)) / root(at_least(at_least(left, least), every(FEW))), sound


@njit(cache=True, error_model="numpy")
def _step(
    ws: np.ndarray, rgb: int, state: int, patterns: int, s: Any, kept: Any, rho: Any, shade2: float
) -> tuple[Any, Any, Any, Any]:
    """A step of Gauss-Newton: the turns, the least information on a turn, and 1 where it holds."""
    zero, one, shade2s = every(np.float32(0)), every(np.float32(1)), every(np.float32(shade2))
    k0, k1, k2 = kept
    q0, q1, q2 = rho
    tt, tu, uu, yt, yu = zero, zero, zero, zero, zero
    t0, t1, t2, u0, u1, u2 = zero, zero, zero, zero, zero, zero
    a00, a11, a22, a01, a02, a12, y0, y1, y2 = (
        zero, zero, zero, zero, zero, zero, zero, zero, zero,
    )  # fmt: skip
    kq0, kq1, kq2 = k0 * q0, k1 * q1, k2 * q2
    for k in range(patterns):
        o, i = state + k * OF_STATE, rgb + 3 * k
        et, eu = _at(ws, o + 1), _at(ws, o + 2)
        gloss, bt, bu = s * _at(ws, o + 3), s * _at(ws, o + 4), s * _at(ws, o + 5)
        e0, e1, e2 = _at(ws, o + 6), _at(ws, o + 7), _at(ws, o + 8)
        w = i + 3 * patterns
        w0, w1, w2 = _at(ws, w), _at(ws, w + 1), _at(ws, w + 2)
        h0, h1, h2 = q0 * e0, q1 * e1, q2 * e2
        jt0, jt1, jt2 = kq0 * et + bt, kq1 * et + bt, kq2 * et + bt
        ju0, ju1, ju2 = kq0 * eu + bu, kq1 * eu + bu, kq2 * eu + bu
        d0 = _at(ws, i) - h0 - gloss
        d1 = _at(ws, i + 1) - h1 - gloss
        d2 = _at(ws, i + 2) - h2 - gloss
        wh0, wh1, wh2 = w0 * h0, w1 * h1, w2 * h2
        mt = wh0 * jt0 + wh1 * jt1 + wh2 * jt2
        mu = wh0 * ju0 + wh1 * ju1 + wh2 * ju2
        md = wh0 * d0 + wh1 * d1 + wh2 * d2
        m0, m1, m2 = wh0 * e0, wh1 * e1, wh2 * e2
        share = shade2s / (one + shade2s * (wh0 * h0 + wh1 * h1 + wh2 * h2))
        st, su, s0, s1, s2 = share * mt, share * mu, share * m0, share * m1, share * m2
        wt0, wt1, wt2 = w0 * jt0, w1 * jt1, w2 * jt2
        wu0, wu1, wu2 = w0 * ju0, w1 * ju1, w2 * ju2
        tt = tt + wt0 * jt0 + wt1 * jt1 + wt2 * jt2 - st * mt
        tu = tu + wt0 * ju0 + wt1 * ju1 + wt2 * ju2 - st * mu
        uu = uu + wu0 * ju0 + wu1 * ju1 + wu2 * ju2 - su * mu
        yt = yt + wt0 * d0 + wt1 * d1 + wt2 * d2 - st * md
        yu = yu + wu0 * d0 + wu1 * d1 + wu2 * d2 - su * md
        t0, t1, t2 = t0 + wt0 * e0 - s0 * mt, t1 + wt1 * e1 - s1 * mt, t2 + wt2 * e2 - s2 * mt
        u0, u1, u2 = u0 + wu0 * e0 - s0 * mu, u1 + wu1 * e1 - s1 * mu, u2 + wu2 * e2 - s2 * mu
        we0, we1, we2 = w0 * e0, w1 * e1, w2 * e2
        a00, a11, a22 = a00 + we0 * e0 - s0 * m0, a11 + we1 * e1 - s1 * m1, a22 + we2 * e2 - s2 * m2
        a01, a02, a12 = a01 - s0 * m1, a02 - s0 * m2, a12 - s1 * m2
        y0, y1, y2 = y0 + we0 * d0 - s0 * md, y1 + we1 * d1 - s1 * md, y2 + we2 * d2 - s2 * md
    # Cholesky's way, the albedos first: what is left for the turns is their information.
    p, sound = _pivot(a00, a00, one)
    a01, a02, t0, u0, y0 = a01 * p, a02 * p, t0 * p, u0 * p, y0 * p
    p, sound = _pivot(a11 - a01 * a01, a11, sound)
    a12, t1, u1, y1 = (
        (a12 - a01 * a02) * p, (t1 - a01 * t0) * p, (u1 - a01 * u0) * p, (y1 - a01 * y0) * p,
    )  # fmt: skip
    p, sound = _pivot(a22 - a02 * a02 - a12 * a12, a22, sound)
    t2 = (t2 - a02 * t0 - a12 * t1) * p
    u2 = (u2 - a02 * u0 - a12 * u1) * p
    y2 = (y2 - a02 * y0 - a12 * y1) * p
    ltt = tt - t0 * t0 - t1 * t1 - t2 * t2
    ltu = tu - t0 * u0 - t1 * u1 - t2 * u2
    luu = uu - u0 * u0 - u1 * u1 - u2 * u2
    yt = yt - t0 * y0 - t1 * y1 - t2 * y2
    yu = yu - u0 * y0 - u1 * y1 - u2 * y2
    half = every(np.float32(0.5))
    middle, aside = half * (ltt + luu), half * (ltt - luu)
    least = middle - root(aside * aside + ltu * ltu)
    p, sound = _pivot(ltt, tt, sound)
    ltu, yt = ltu * p, yt * p
    r, sound = _pivot(luu - ltu * ltu, uu, sound)
    du = (yu - ltu * yt) * r * r
    dt = (yt - ltu * du) * p
    return dt, du, at_least(least, zero), sound


@njit(cache=True, error_model="numpy")
def _left_over(
    ws: np.ndarray, rgb: int, state: int, patterns: int, s: Any, rho: Any, shade2: float
) -> Any:
    """The squared residual over its expected variance."""
    one, total, shade2s = every(np.float32(1)), every(np.float32(0)), every(np.float32(shade2))
    q0, q1, q2 = rho
    for k in range(patterns):
        o, i = state + k * OF_STATE, rgb + 3 * k
        w = i + 3 * patterns
        gloss = s * _at(ws, o + 3)
        h0, h1, h2 = q0 * _at(ws, o + 6), q1 * _at(ws, o + 7), q2 * _at(ws, o + 8)
        d0 = _at(ws, i) - h0 - gloss
        d1 = _at(ws, i + 1) - h1 - gloss
        d2 = _at(ws, i + 2) - h2 - gloss
        w0, w1, w2 = _at(ws, w), _at(ws, w + 1), _at(ws, w + 2)
        common = w0 * h0 * d0 + w1 * h1 * d1 + w2 * h2 * d2
        power = w0 * h0 * h0 + w1 * h1 * h1 + w2 * h2 * h2
        total = total + w0 * d0 * d0 + w1 * d1 * d1 + w2 * d2 * d2
        total = total - shade2s / (one + shade2s * power) * common * common
    return at_least(total, every(np.float32(0)))


@njit(cache=True, error_model="numpy")
def _matte(
    ws: np.ndarray, rgb: int, node: int, state: int, patterns: int, t: Any, u: Any, rho: Any,
    read2: float, shot2: float, model2: float,
) -> tuple[Any, Any, Any, Any]:  # fmt: skip
    """Normal from chroma along T, U and N, zero where there is none, and the mean squared turn
    that noise gives it: as in `joint_kernels`.
    """
    reads, shots = every(np.float32(read2)), every(np.float32(shot2))
    models, variance = every(np.float32(model2)), every(np.float32(0))
    zero, one, third = every(np.float32(0)), every(np.float32(1)), every(np.float32(1 / 3))
    q0, q1, q2 = rho
    x, y, z = zero, zero, zero
    for k in range(patterns):
        i = rgb + 3 * k
        r, g, b = _at(ws, i), _at(ws, i + 1), _at(ws, i + 2)
        grey = (r + g + b) * third
        x, y, z = x + r - grey, y + g - grey, z + b - grey
    length2 = x * x + y * y + z * z
    found = above(length2, zero)
    per = one / root(at_least(length2, every(FEW)))
    x, y, z = x * per, y * per, z * per
    a00, a01, a02, a11, a12, a22 = zero, zero, zero, zero, zero, zero
    y0, y1, y2 = zero, zero, zero
    for k in range(patterns):
        i, o, a = rgb + 3 * k, state + k * OF_STATE, node + k * OF_PATTERN + 12
        r, g, b = _at(ws, i), _at(ws, i + 1), _at(ws, i + 2)
        signal = x * (r - q0 * _at(ws, a))
        signal = signal + y * (g - q1 * _at(ws, a + 1))
        signal = signal + z * (b - q2 * _at(ws, a + 2))
        r, g, b = at_least(r, zero), at_least(g, zero), at_least(b, zero)
        variance = variance + x * x * (reads + shots * r + models * r * r)
        variance = variance + y * y * (reads + shots * g + models * g * g)
        variance = variance + z * z * (reads + shots * b + models * b * b)
        gt, gu = _at(ws, o + 10), _at(ws, o + 11)
        gn = _at(ws, o + 9) - t * gt - u * gu
        a00, a01, a02 = a00 + gt * gt, a01 + gt * gu, a02 + gt * gn
        a11, a12, a22 = a11 + gu * gu, a12 + gu * gn, a22 + gn * gn
        y0, y1, y2 = y0 + gt * signal, y1 + gu * signal, y2 + gn * signal
    third_of = (a00 + a11 + a22) * third
    p, found = _pivot(a00, a00, found)
    a01, a02, y0 = a01 * p, a02 * p, y0 * p
    q, found = _pivot(a11 - a01 * a01, a11, found)
    a12, y1 = (a12 - a01 * a02) * q, (y1 - a01 * y0) * q
    r, found = _pivot(a22 - a02 * a02 - a12 * a12, a22, found)
    # The determinant's root against the size of the whole.
    found = found * above(third_of * root(third_of) * p * q * r, zero)
    found = found * above(every(np.float32(100)), third_of * root(third_of) * p * q * r)
    bn = (y2 - a02 * y0 - a12 * y1) * r * r
    bu = (y1 - a12 * bn) * q
    bt = (y0 - a01 * bu - a02 * bn) * p
    length2 = bt * bt + bu * bu + bn * bn
    found = found * above(length2, zero)
    per = one / root(at_least(length2, every(FEW)))
    bt, bu, bn = bt * per * found, bu * per * found, bn * per * found
    # The inverse of Cholesky's triangle: its squares' sum is the covariance's trace.
    m10, m21 = a01 * p * q, a12 * q * r
    m20 = (a01 * a12 * q - a02) * p * r
    o0, o1, o2 = p * bt, q * bu - m10 * bt, m20 * bt - m21 * bu + r * bn
    spread = p * p + q * q + r * r + m10 * m10 + m21 * m21 + m20 * m20
    spread = at_least(spread - o0 * o0 - o1 * o1 - o2 * o2, zero)
    turn2 = variance * every(np.float32(1 / patterns)) * spread * per * per
    return bt, bu, bn, at_most(turn2, every(np.float32(MOST_TURN2))) * found


@njit(cache=True, error_model="numpy")
def solve_eight(
    ws: np.ndarray, rgb: int, node: int, state: int, start: int, results: int, patterns: int,
    rounds: int, read2: float, shot2: float, model2: float, shade2: float, kept: np.ndarray,
    widest2: float,
) -> None:  # fmt: skip
    """Solve eight pixels: a workspace's rows are numbers of eight pixels.

    Args:
        ws: (rows * LANES,) float32, rows of LANES numbers.
        rgb: first of 3 P rows of readings; 3 P rows after them become their weights.
        node: first of OF_PATTERN P rows of light.
        state: first of OF_STATE P rows, scratch.
        start: first of three rows: turns t and u to start from, and specular albedo.
        results: first of RESULTS rows, filled in.
        patterns: P.
        rounds: steps.
        read2, shot2, model2, shade2: as of `joint_equations.Spread`.
        kept: (3,) float64, as of `joint_equations.Spread`.
        widest2: squared turn from the nodes' normals beyond which the light is not known.
    """
    one, zero = every(np.float32(1)), every(np.float32(0))
    reads, shots = every(np.float32(read2)), every(np.float32(shot2))
    models = every(np.float32(model2))
    many = every(np.float32(1e30))
    for i in range(3 * patterns):
        bright = at_least(_at(ws, rgb + i), zero)
        variance = reads + shots * bright + models * bright * bright
        _put(ws, rgb + 3 * patterns + i, at_most(one / variance, many))
    shares = every(np.float32(kept[0])), every(np.float32(kept[1])), every(np.float32(kept[2]))
    t, u, s = _at(ws, start), _at(ws, start + 1), _at(ws, start + 2)
    farthest, sound, least = t * t + u * u, one, zero
    for _ in range(rounds):
        q0, q1, q2, p0, p1, p2 = evaluate(ws, rgb, node, state, patterns, t, u, s, shares)
        dt, du, least, good = _step(ws, rgb, state, patterns, s, shares, (q0, q1, q2), shade2)
        sound = sound * good
        turn2 = dt * dt + du * du
        shorter = at_most(one, every(LONGEST) / root(at_least(turn2, every(FEW))))
        t, u = t + dt * shorter, u + du * shorter
        farthest = at_least(farthest, t * t + u * u)
    q0, q1, q2, p0, p1, p2 = evaluate(ws, rgb, node, state, patterns, t, u, s, shares)
    misfit = _left_over(ws, rgb, state, patterns, s, (q0, q1, q2), shade2)
    bt, bu, bn, matte_turn2 = _matte(
        ws, rgb, node, state, patterns, t, u, (q0, q1, q2), read2, shot2, model2
    )
    sound = sound * above(every(np.float32(widest2)), farthest)
    _put(ws, results, t)
    _put(ws, results + 1, u)
    _put(ws, results + 2, bt)
    _put(ws, results + 3, bu)
    _put(ws, results + 4, bn)
    _put(ws, results + 5, q0)
    _put(ws, results + 6, q1)
    _put(ws, results + 7, q2)
    _put(ws, results + 8, p0)
    _put(ws, results + 9, p1)
    _put(ws, results + 10, p2)
    _put(ws, results + 11, misfit * every(np.float32(1 / (3 * patterns - 5))))
    _put(ws, results + 12, least)
    _put(ws, results + 13, sound)
    _put(ws, results + 14, matte_turn2)
