"""The compiled sums of a rough dielectric (see `dielectric`), where no gradient is needed.

A function's `buf` is one block, (FACET_ROWS * TEXELS,); its `light` is (9,), as of
`kernel_forward`.
"""

from __future__ import annotations

import numba
import numpy as np

from learning.render import texel_blocks as rows
from learning.render.dielectric import (
    F0,
    HALF_RANGE,
    INDEX,
    LEAST_COSINE,
    MIDDLE,
    MIRRORED,
    ROUGHEST,
    SMOOTHEST,
)
from learning.render.kernel_forward import black
from learning.render.lanes_math import ANY_ORDER, exp
from learning.render.texel_blocks import (
    INV,
    LOBE,
    NARROWEST,
    ND,
    NSV,
    OCC,
    ROWS,
    SEEN,
    TEXELS,
    A,
    B,
    E,
    Lights,
    S,
    Skins,
    V,
    next_block,
    task_range,
    tasks_of,
    toward_light,
)

P = rows.P
FIT = np.array(MIRRORED)
POWERS = len(MIRRORED)
# Rows beyond those of all modes: R's coefficients; Smith's Lambda of the view; the share let out;
# the clamped cosine to the view; 1 / m^2.
K, LAMBDA, OUT, SIGHT, STEEP = ROWS, ROWS + POWERS, ROWS + 8, ROWS + 9, ROWS + 10
FACET_ROWS = ROWS + 11


@numba.njit(fastmath=ANY_ORDER, error_model="numpy", inline="always")
def smith(cosine: float, steepness: float) -> float:
    """Smith's Lambda of a cosine above 0 [Walter2007]; numbers of the cosine's own precision."""
    one = cosine * 0 + 1
    square = one - cosine * cosine
    tiny = one * 1e-12
    square = tiny if square < tiny else square
    a = cosine * np.sqrt(steepness / square)
    far = a >= one * 1.6
    a = one if far else a
    fitted = (one - a * one * 1.259 + a * a * one * 0.396) / (a * one * 3.535 + a * a * one * 2.181)
    return one * 0 if far else fitted


@numba.njit(fastmath=ANY_ORDER, error_model="numpy")
def prepare_facets(buf: np.ndarray) -> None:
    """Write what a block's lights share."""
    kind = buf.dtype.type
    zero, one, two = kind(0.0), kind(1.0), kind(2.0)
    for t in range(TEXELS):
        s = buf[S * TEXELS + t]
        m = np.sqrt(two / (s + two))
        m = kind(SMOOTHEST) if m < kind(SMOOTHEST) else m
        m = kind(ROUGHEST) if m > kind(ROUGHEST) else m
        x = (np.sqrt(m) - kind(MIDDLE)) / kind(HALF_RANGE)
        cosine = zero
        for k in range(3):
            cosine += buf[(ND + k) * TEXELS + t] * buf[(V + k) * TEXELS + t]
        cosine = zero if cosine < zero else cosine
        u = two * (one if cosine > one else cosine) - one
        mean, through, power = one, one, one
        for i in range(POWERS):
            value = kind(FIT[i, -1])
            for j in range(FIT.shape[1] - 2, -1, -1):
                value = value * x + kind(FIT[i, j])
            buf[(K + i) * TEXELS + t] = value
            mean -= value / kind(i + 1 if i % 2 == 0 else i + 2)
            through -= value * power
            power *= u
        buf[OUT * TEXELS + t] = through / mean
        sight = buf[NSV * TEXELS + t]
        least = kind(LEAST_COSINE)
        sight = least if sight < least else sight
        sight = one if sight > one else sight
        steepness = (s + two) / two
        buf[SIGHT * TEXELS + t] = sight
        buf[STEEP * TEXELS + t] = steepness
        buf[LAMBDA * TEXELS + t] = smith(sight, steepness)


@numba.njit(fastmath=ANY_ORDER, error_model="numpy")
def entering_light(buf: np.ndarray, light: np.ndarray) -> None:
    """Add one light's diffuse part, as it enters, to a block's E."""
    kind = buf.dtype.type
    zero, one, two = kind(0.0), kind(1.0), kind(2.0)
    power, red, green, blue = light[4], light[6], light[7], light[8]
    for t in range(TEXELS):
        a, inverse = buf[A * TEXELS + t], buf[INV * TEXELS + t]
        a = zero if a < zero else a
        u = two * (one if a > one else a) - one
        mirrored = buf[(K + POWERS - 1) * TEXELS + t]
        for i in range(POWERS - 2, -1, -1):
            mirrored = mirrored * u + buf[(K + i) * TEXELS + t]
        strength = a * (one - mirrored) * power * inverse * inverse * buf[SEEN * TEXELS + t]
        buf[E * TEXELS + t] += red * strength
        buf[(E + 1) * TEXELS + t] += green * strength
        buf[(E + 2) * TEXELS + t] += blue * strength


@numba.njit(fastmath=ANY_ORDER, error_model="numpy")
def mirrored_light(buf: np.ndarray, light: np.ndarray) -> None:
    """Add one light's mirror lobe to a block's LOBE."""
    kind = buf.dtype.type
    zero, one, two, half = kind(0.0), kind(1.0), kind(2.0), kind(0.5)
    narrow, least = kind(NARROWEST), kind(1e-6)
    optical, scale = kind(INDEX * INDEX - 1), kind(1 / (4 * F0))
    lx, ly, lz, near = light[0], light[1], light[2], light[3]
    power, red, green, blue = light[4], light[6], light[7], light[8]
    for t in range(TEXELS):
        b, inverse = buf[B * TEXELS + t], buf[INV * TEXELS + t]
        x = lx - near * buf[P * TEXELS + t]
        y = ly - near * buf[(P + 1) * TEXELS + t]
        z = lz - near * buf[(P + 2) * TEXELS + t]
        c = x * buf[V * TEXELS + t] + y * buf[(V + 1) * TEXELS + t]
        c = (c + z * buf[(V + 2) * TEXELS + t]) * inverse
        wide = two + two * c
        root = one / np.sqrt(narrow if wide < narrow else wide)
        h = (b + buf[NSV * TEXELS + t]) * root
        h = one if h > one else h
        dark = h <= zero or b <= zero
        h2 = one if dark else h * h
        steepness = buf[STEEP * TEXELS + t]
        density = steepness * exp(-steepness * (one / h2 - one)) / (h2 * h2)
        lh = (one + c) * root
        lh = zero if lh < zero else lh
        lh = one if lh > one else lh
        g = np.sqrt(optical + lh * lh)
        minus, plus = g - lh, g + lh
        first, second = minus / plus, (lh * plus - one) / (lh * minus + one)
        fresnel = half * first * first * (one + second * second)
        lit = least if b < least else b
        masked = one + buf[LAMBDA * TEXELS + t] + smith(one if lit > one else lit, steepness)
        lobe = density * fresnel * scale / (buf[SIGHT * TEXELS + t] * masked)
        lobe = zero if dark else lobe
        strength = lobe * power * inverse * inverse * buf[SEEN * TEXELS + t]
        buf[LOBE * TEXELS + t] += red * strength
        buf[(LOBE + 1) * TEXELS + t] += green * strength
        buf[(LOBE + 2) * TEXELS + t] += blue * strength


@numba.njit(parallel=True, cache=True, fastmath=ANY_ORDER, error_model="numpy")
def forward_facets(
    skins: Skins, lights: Lights, glossy: np.ndarray, irradiance: np.ndarray, lobes: np.ndarray
) -> None:
    """Sum over lights of what enters the skin and of what its surface mirrors.

    Args:
        skins, lights: as of `kernel_forward.forward`.
        glossy: (B, n) bool, where the lobe is needed.
        irradiance: (B, 3, n) is filled; 0 where there is no surface.
        lobes: (B, 3, n) is filled; 0 where not glossy.
    """
    batch, _, texels = skins.position.shape
    for task in numba.prange(batch * tasks_of(texels)):
        entry, _, first, last = task_range(task, texels)
        buf = np.zeros(FACET_ROWS * TEXELS, irradiance.dtype)
        texel = np.zeros(TEXELS, np.int64)
        irradiance[entry, :, first:last] = 0
        lobes[entry, :, first:last] = 0
        while first < last:
            count, first = next_block(buf, texel, entry, first, last, skins, lights)
            if count == 0:
                break
            gloss = False
            for t in range(count):
                gloss |= glossy[entry, texel[t]]
            prepare_facets(buf)
            for j in range(lights.packed.shape[1]):
                light = lights.packed[entry, j]
                if black(light):
                    continue
                by_diffuse, by_specular = toward_light(buf, texel, entry, j, lights)
                if by_diffuse:
                    entering_light(buf, light)
                if gloss and by_specular:
                    mirrored_light(buf, light)
            ambient = lights.ambient[entry]
            for k in range(3):
                for t in range(count):
                    entered = buf[(E + k) * TEXELS + t] * buf[OUT * TEXELS + t]
                    entered += ambient[k] * buf[OCC * TEXELS + t]
                    irradiance[entry, k, texel[t]] = entered
                    lobes[entry, k, texel[t]] = buf[(LOBE + k) * TEXELS + t]
