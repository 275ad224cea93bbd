"""What light becomes in a sensor's pixels: counted photons, read noise, saturation, counts.

Random numbers are a function of the seed and the pixel alone (SplitMix64 [Steele2014], a stream a
pixel), so a photograph is the same to the byte however many threads draw it. Photons are drawn by
an exact method at every brightness (multiplication of uniforms below ten, transformed rejection
[Hormann1993] above), not by a Gaussian in its place.
"""

from __future__ import annotations

import math

import numba
import numpy as np

_STEP = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)
_TO_UNIT = 1.0 / 9007199254740992.0  # 2^-53
BRIGHTEST = 1e12
"""More light than any pixel holds, and finite."""
FEW = 10.0
"""Mean electrons below which uniforms are multiplied; the rejection needs at least this many."""


@numba.njit(cache=True, inline="always")
def _mixed(state: np.uint64) -> np.uint64:
    z = (state ^ (state >> np.uint64(30))) * _MIX_1
    z = (z ^ (z >> np.uint64(27))) * _MIX_2
    return z ^ (z >> np.uint64(31))


@numba.njit(cache=True, inline="always")
def _unit(state: np.uint64) -> float:
    """A number in (0, 1]."""
    return (float(_mixed(state) >> np.uint64(11)) + 1.0) * _TO_UNIT


@numba.njit(cache=True)
def _photons(mean: float, state: np.uint64) -> tuple[float, np.uint64]:
    """A Poisson number and the stream's next state."""
    if mean <= 0.0:
        return 0.0, state
    if mean < FEW:
        limit = math.exp(-mean)
        product, count = 1.0, -1.0
        while product > limit:
            state += _STEP
            product *= _unit(state)
            count += 1.0
        return count, state
    b = 0.931 + 2.53 * math.sqrt(mean)
    a = -0.059 + 0.02483 * b
    inverse_alpha = 1.1239 + 1.1328 / (b - 3.4)
    quick = 0.9277 - 3.6224 / (b - 2.0)
    log_mean = math.log(mean)
    while True:
        state += _STEP
        u = _unit(state) - 0.5
        state += _STEP
        v = _unit(state)
        us = 0.5 - abs(u)
        if us <= 0.0:
            continue
        count = math.floor((2.0 * a / us + b) * u + mean + 0.43)
        if us >= 0.07 and v <= quick:
            return count, state
        if count < 0.0 or (us < 0.013 and v > us):
            continue
        likely = count * log_mean - mean - math.lgamma(count + 1.0)
        if math.log(v * inverse_alpha / (a / (us * us) + b)) <= likely:
            return count, state


@numba.njit(cache=True, parallel=True)
def count_kernel(
    light: np.ndarray,
    electrons: np.ndarray,
    full_well_e: float,
    noise_e: float,
    electrons_per_dn: float,
    black_dn: float,
    white_dn: float,
    seed: np.uint64,
    out: np.ndarray,
    unusable: np.ndarray,
) -> None:
    """Counts of an RGGB mosaic.

    Args:
        light: (h, w, 3) float32 linear. Below zero is no light; infinity clips.
        electrons: (3, 3) float64 mean electrons of a red, green and blue pixel from light's r g b.
        full_well_e: electrons that a pixel holds.
        noise_e: standard deviation of what reading adds, electrons.
        electrons_per_dn: electrons for one count.
        black_dn: counts without light.
        white_dn: largest count.
        seed: of this photograph.
        out: (h, w) uint16, written.
        unusable: (h,) int64, written: pixels of the row whose light is NaN. They count 0.
    """
    height, width = out.shape
    for row in numba.prange(height):
        bad = 0
        for column in range(width):
            kind = (row & 1) + (column & 1)
            mean = 0.0
            for channel in range(3):
                value = float(light[row, column, channel])
                # Infinity times a crosstalk of zero would be no number; NaN passes through.
                value = 0.0 if value < 0.0 else BRIGHTEST if value > BRIGHTEST else value
                mean += electrons[kind, channel] * value
            if math.isnan(mean):
                bad += 1
                out[row, column] = 0
                continue
            # Twice the full well is clipped whatever the noise.
            mean = min(max(mean, 0.0), 2.0 * full_well_e)
            state = _mixed(seed + np.uint64(row * width + column) * _STEP)
            held, state = _photons(mean, state)
            state += _STEP
            radius = math.sqrt(-2.0 * math.log(_unit(state)))
            state += _STEP
            read = noise_e * radius * math.cos(2.0 * math.pi * _unit(state))
            value = black_dn + (min(held, full_well_e) + read) / electrons_per_dn
            out[row, column] = np.uint16(min(max(np.rint(value), 0.0), white_dn))
        unusable[row] = bad
