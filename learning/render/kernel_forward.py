"""The compiled shading: what a block of texels receives of each light, and a batch of blocks.

A function's `buf` is one block, (ROWS * TEXELS,): rows of `TEXELS` numbers at the places of
`texel_blocks`. Its `light` is (9,), one light of `pack_lights`.
"""

from __future__ import annotations

import numba
import numpy as np

from learning.render import texel_blocks as rows
from learning.render.lanes_math import ANY_ORDER, exp, log
from learning.render.texel_blocks import (
    INV,
    LOBE,
    NARROWEST,
    NORM,
    NSV,
    OCC,
    ROWS,
    SEEN,
    SLOPE,
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
LIGHT_COLUMNS = 9


@numba.njit(fastmath=ANY_ORDER, error_model="numpy")
def diffuse_light(buf: np.ndarray, light: np.ndarray, paper: bool) -> None:
    """Add one light's diffuse part to a block's E."""
    zero, one = buf.dtype.type(0.0), buf.dtype.type(1.0)
    power, red, green, blue = light[4], light[6], light[7], light[8]
    for t in range(TEXELS):
        a, inverse = buf[A * TEXELS + t], buf[INV * TEXELS + t]
        reach = one if paper else power * inverse * inverse
        strength = (a if paper else (zero if a < zero else a)) * reach * buf[SEEN * TEXELS + t]
        buf[E * TEXELS + t] += red * strength
        buf[(E + 1) * TEXELS + t] += green * strength
        buf[(E + 2) * TEXELS + t] += blue * strength


@numba.njit(fastmath=ANY_ORDER, error_model="numpy")
def specular_light(buf: np.ndarray, light: np.ndarray, paper: bool) -> None:
    """Add one light's lobe, not yet normalised, to a block's LOBE."""
    zero, one, two = buf.dtype.type(0.0), buf.dtype.type(1.0), buf.dtype.type(2.0)
    narrow = buf.dtype.type(NARROWEST)
    tiny = buf.dtype.type(1e-30)
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
        half = (b + buf[NSV * TEXELS + t]) / np.sqrt(narrow if wide < narrow else wide)
        half = one if half > one else half
        lobe = exp(buf[S * TEXELS + t] * log(tiny if half < tiny else half))
        lobe = zero if half <= zero else lobe
        reach = one if paper else power * inverse * inverse * (zero if b < zero else b)
        strength = lobe * reach * buf[SEEN * TEXELS + t]
        buf[LOBE * TEXELS + t] += red * strength
        buf[(LOBE + 1) * TEXELS + t] += green * strength
        buf[(LOBE + 2) * TEXELS + t] += blue * strength


@numba.njit(fastmath=ANY_ORDER, error_model="numpy")
def normalise_lobe(buf: np.ndarray) -> None:
    """Write what makes the lobe reflect all light that comes along the normal, and its slope.

    pi times Giesen's factor, (s + 2) (s + 4) / (8 (2^(-s/2) + s)) [Giesen2009]; its usual short
    form (s + 8) / 8 reflects up to 7.5 % more than arrives. The slope is of its logarithm.
    """
    one, two, four, eight = (
        buf.dtype.type(1.0),
        buf.dtype.type(2.0),
        buf.dtype.type(4.0),
        buf.dtype.type(8.0),
    )
    half_log2 = buf.dtype.type(0.34657359027997264)
    for t in range(TEXELS):
        s = buf[S * TEXELS + t]
        power = exp(-half_log2 * s)
        buf[NORM * TEXELS + t] = (s + two) * (s + four) / (eight * (power + s))
        slope = one / (s + two) + one / (s + four)
        buf[SLOPE * TEXELS + t] = slope - (one - half_log2 * power) / (power + s)


@numba.njit(fastmath=ANY_ORDER, error_model="numpy")
def finish_sums(buf: np.ndarray, ambient: np.ndarray, paper: bool) -> None:
    """After all lights: add the (3,) ambient light, normalise the lobe; as printed do neither."""
    if paper:
        return
    normalise_lobe(buf)
    for k in range(3):
        for t in range(TEXELS):
            buf[(E + k) * TEXELS + t] += ambient[k] * buf[OCC * TEXELS + t]
            buf[(LOBE + k) * TEXELS + t] *= buf[NORM * TEXELS + t]


def pack_lights(
    position: np.ndarray, rgb: np.ndarray, distant: np.ndarray, nearest: float
) -> np.ndarray:
    """(B, L, 9) rows of (B, L) lights: position, near, |P|^2, least squared distance, rgb.

    A distant light is at distance 1, whatever length its direction was given with.

    Args:
        position: (B, L, 3) mm, or directions of distant lights.
        rgb: (B, L, 3).
        distant: (B, L) bool.
        nearest: mm, the least distance of a light from a texel.
    """
    square = np.square(position).sum(axis=-1)
    out = np.zeros((*rgb.shape[:2], LIGHT_COLUMNS), position.dtype)
    scale = np.where(distant, 1.0 / np.sqrt(np.maximum(square, 1e-30)), 1.0)
    out[..., :3] = position * scale[..., None]
    out[..., 3] = ~distant
    out[..., 4] = np.where(distant, 1.0, square)
    out[..., 5] = np.where(distant, 1e-12, nearest * nearest)
    out[..., 6:] = rgb
    return out


@numba.njit
def black(light: np.ndarray) -> bool:
    """Whether a packed light, (9,), gives no light."""
    return light[6] == 0.0 and light[7] == 0.0 and light[8] == 0.0


@numba.njit(parallel=True, cache=True, fastmath=ANY_ORDER, error_model="numpy")
def forward(
    skins: Skins,
    lights: Lights,
    glossy: np.ndarray,
    paper: bool,
    irradiance: np.ndarray,
    lobes: np.ndarray,
) -> None:
    """Sum over lights of Lambert's cosine and the Blinn-Phong lobe, for a batch of textures.

    Args:
        skins: the textures.
        lights: one set each.
        glossy: (B, n) bool, where the lobe is needed.
        paper: as printed: no clamp, no fall-off, no normalisation, and no ambient light, by which
            the caller multiplies.
        irradiance: (B, 3, n) is filled; 0 where there is no surface.
        lobes: (B, 3, n) is filled; 0 where not glossy.
    """
    batch, _, texels = skins.position.shape
    for task in numba.prange(batch * tasks_of(texels)):
        entry, _, first, last = task_range(task, texels)
        buf = np.zeros(ROWS * TEXELS, irradiance.dtype)
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
            for j in range(lights.packed.shape[1]):
                light = lights.packed[entry, j]
                if black(light):
                    continue
                by_diffuse, by_specular = toward_light(buf, texel, entry, j, lights)
                if by_diffuse or paper:
                    diffuse_light(buf, light, paper)
                if gloss and (by_specular or paper):
                    specular_light(buf, light, paper)
            finish_sums(buf, lights.ambient[entry], paper)
            for k in range(3):
                for t in range(count):
                    irradiance[entry, k, texel[t]] = buf[(E + k) * TEXELS + t]
                    lobes[entry, k, texel[t]] = buf[(LOBE + k) * TEXELS + t]
