"""Compiled loops of `joint` over pixels."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit, prange

from processing.refinement.joint_equations import (
    Spread,
    across_normal,
    diffuse_light,
    least_turn,
    left_over,
    left_when_fitted,
    matte_normal,
    normal_equations,
    skin_albedo,
    solve_in_place,
)
from processing.refinement.joint_light import Lamps, gather

LONGEST_TURN = 0.15
"""A step of Gauss-Newton turns the normal by at most this tangent: the lobe is some 20 deg wide."""


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


class Solved(NamedTuple):
    """Of n pixels; zero where not solved.

    Attributes:
        normal: (n, 3) float32 unit, from all that was read.
        matte: (n, 3) float32 unit, from the part of the readings that no white gloss holds; of
            polarised ones, from what is left of all when gloss is taken off.
        lit: (n, 3) float32 least squares of the diffuse albedo is lit / power.
        power: (n, 3) float32 the sum of squared irradiance.
        misfit: (n,) float32 mean squared residual over its expected variance.
        irradiance: (n, P) float32 what enters straight from the lights, for the normals found.
        certainty: (n,) float32 least information on a turn of the normal, one over rad^2.
        matte_turn2: (n,) float32 mean squared turn of `matte`, rad^2, by the readings' own noise.
    """

    normal: np.ndarray
    matte: np.ndarray
    lit: np.ndarray
    power: np.ndarray
    misfit: np.ndarray
    irradiance: np.ndarray
    certainty: np.ndarray
    matte_turn2: np.ndarray


@njit(cache=True)
def _keep(
    out: Solved,
    i: int,
    n: np.ndarray,
    matte: np.ndarray,
    rho: np.ndarray,
    power: np.ndarray,
    light: np.ndarray,
    misfit: float,
    certainty: float,
    turn2: float,
) -> None:
    """Keep one pixel's result.

    A function, as numba drops what a parallel loop itself writes to a tuple's field (its issue
    7135).
    """
    for c in range(3):
        out.normal[i, c] = n[c]
        out.matte[i, c] = matte[c]
        out.lit[i, c] = rho[c] * power[c]
        out.power[i, c] = power[c]
    for k in range(len(light)):
        out.irradiance[i, k] = light[k, 0]
    out.misfit[i] = misfit
    out.certainty[i] = certainty
    out.matte_turn2[i] = turn2


@njit(parallel=True, cache=True, error_model="numpy")
def solve_kernel(
    pixels: Pixels,
    lamps: Lamps,
    spread: Spread,
    rounds: int,
    colour: bool,
    out: Solved,
) -> None:
    """Fill in what `joint.solve_jointly` returns; arguments as there."""
    rgb, points, views, roughness = pixels.rgb, pixels.points, pixels.views, pixels.roughness
    corners, weights, rests = pixels.corners, pixels.weights, pixels.rests
    patterns = rgb.shape[1]
    for index in prange(len(rgb)):
        i = np.int64(index)  # else numba compiles `_keep` for uint64 too
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
            diffuse_light(light, spread.kept, rests[i], diffuse)
            skin_albedo(light, diffuse, rgb[i], s, rho, power)
            across_normal(n, across)
            normal_equations(light, diffuse, rgb[i], rho, s, across, spread, a, b, others)
            # Beside the step, two columns of the inverse: the covariance of the turns.
            b[:, 1:] = 0
            b[0, 1] = b[1, 2] = 1
            good = solve_in_place(a, b)
            certainty = least_turn(b[:2, 1:])
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
        matte_turn2 = matte_normal(light, rgb[i], rho, s, colour, spread, matte)
        if matte_turn2 < 0:
            matte[:] = matte_turn2 = 0.0
        # The last step is short: what it changes is taken as linear.
        for k in range(patterns):
            for x in range(3):
                light[k, 0] += light[k, 1 + x] * turned[x]
                light[k, 4] += light[k, 5 + x] * turned[x]
        diffuse_light(light, spread.kept, rests[i], diffuse)
        skin_albedo(light, diffuse, rgb[i], s, rho, power)
        total = left_over(light, diffuse, rgb[i], rho, s, spread)
        if not (math.isfinite(total) and math.isfinite(power.sum())):
            continue
        misfit = total / (3 * patterns - 5)
        _keep(out, i, n, matte, rho, power, light, misfit, certainty, matte_turn2)


@njit(cache=True)
def _face(
    pixels: Pixels, i: int, lamps: Lamps, spread: Spread
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A pixel's light, its diffuse part, albedo, axes across the normal, and normal equations."""
    n, rgb, s = pixels.starts[i], pixels.rgb[i], float(pixels.specular[i])
    light, diffuse = np.zeros((len(rgb), 12), np.float32), np.zeros((len(rgb), 3))
    across, rho, power = np.zeros((2, 3)), np.zeros(3), np.zeros(3)
    a, b, others = np.zeros((5, 5)), np.zeros((5, 3)), np.zeros((3, 3))
    gather(
        pixels.points[i], n, pixels.views[i], pixels.roughness[i],
        pixels.corners[i], pixels.weights[i], lamps, light,
    )  # fmt: skip
    diffuse_light(light, spread.kept, pixels.rests[i], diffuse)
    skin_albedo(light, diffuse, rgb, s, rho, power)
    across_normal(n, across)
    normal_equations(light, diffuse, rgb, rho, s, across, spread, a, b, others)
    return light, diffuse, rho, across, a, b, others


@njit(cache=True, error_model="numpy")
def _evidence(
    patterns: int, a: np.ndarray, b: np.ndarray, others: np.ndarray, out: np.ndarray
) -> None:
    """Fill in what `joint.gloss_evidence` returns of one pixel, (5,), from `_face`'s equations."""
    free = b.copy()
    if not solve_in_place(a, free):
        return
    left2, s_left, m_left = others[0, 0], others[1, 0], others[2, 0]
    ss, sm, mm = others[1, 1], others[1, 2], others[2, 2]
    for p in range(5):
        left2 -= b[p, 0] * free[p, 0]
        s_left -= b[p, 1] * free[p, 0]
        m_left -= b[p, 2] * free[p, 0]
        ss -= b[p, 1] * free[p, 1]
        sm -= b[p, 1] * free[p, 2]
        mm -= b[p, 2] * free[p, 2]
    # What no gloss explains is shadow, hair or motion: such a pixel has little evidence.
    outside = max(left2, 0.0) / (3 * patterns - 7)
    trust = 1 / (1 + outside / 9) ** 2
    if not (ss > 0 and mm >= 0 and math.isfinite(s_left + m_left + sm)):
        return
    out[0] = trust * ss
    out[1] = trust * sm
    out[2] = trust * mm
    out[3] = trust * s_left
    out[4] = trust * m_left


@njit(parallel=True, cache=True, error_model="numpy")
def fitted_kernel(
    pixels: Pixels,
    lamps: Lamps,
    spread: Spread,
    groups: np.ndarray,
    out: np.ndarray,
) -> None:
    """Fill in what `joint.held_out` returns, (n, G), of (P,) groups; arguments as there.

    Of no groups, (0,), what `joint.gloss_evidence` returns, (n, 5). One loop does both, since
    either takes as long to compile: nearly all of it is the equations that they share.
    """
    patterns = pixels.rgb.shape[1]
    for index in prange(len(pixels.rgb)):
        i = np.int64(index)  # else numba compiles `_face` for uint64 too
        n = pixels.starts[i]
        if not (n[0] * n[0] + n[1] * n[1] + n[2] * n[2] > 0.5 and pixels.roughness[i] > 0):
            continue
        light, diffuse, rho, across, a, b, c = _face(pixels, i, lamps, spread)
        if len(groups) == 0:
            _evidence(patterns, a, b, c, out[i])
            continue
        s = float(pixels.specular[i])
        own_a, own_b, own_c = np.zeros((5, 5)), np.zeros((5, 3)), np.zeros((3, 3))
        whole = left_when_fitted(a.copy(), b, c)
        for g in range(groups.max() + 1):
            some = np.flatnonzero(groups == g)
            normal_equations(
                light[some], diffuse[some], pixels.rgb[i][some], rho, s, across, spread,
                own_a, own_b, own_c,
            )  # fmt: skip
            rest = left_when_fitted(a - own_a, b - own_b, c - own_c)
            out[i, g] = max(whole - rest, 0.0) / (3 * len(some))
