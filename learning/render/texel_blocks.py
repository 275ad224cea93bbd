"""Blocks of texels for the compiled shading: gathered, normalised, laid out for vectors.

A block holds `TEXELS` texels of the surface; those that show none are left out, so that a loop over
a block is a loop over skin. All fields of a block are in one flat array, row after row, at constant
places: the compiler sees that they do not overlap and turns loops over a block into vectors.

A function's `buf` is one block, flat: `ROWS` rows of `TEXELS` numbers, or more where a caller needs
them. Its `texel` holds the (TEXELS,) indices of the block's texels.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from learning.render.lanes_math import ANY_ORDER

TEXELS = 128
"""Texels of a block: with all its rows it stays in a core's first cache."""
BLOCKS_A_TASK = 16
"""Blocks that one thread takes at a time."""

# Rows of a block.
P, ND, NS, V = 0, 3, 6, 9  # position; unit diffuse normal, specular normal, direction to the camera
S, NSV, OCC, VALID = 12, 13, 14, 15  # exponent; specular normal . V; ambient occlusion; 1 or 0
LEN = 17  # 1 / length of ND, NS, V as given
E, LOBE = 20, 23  # sums over the lights
A, B, INV, SEEN = 26, 27, 28, 29  # of one light: cosines at ND and NS, 1 / distance, visibility
NORM, SLOPE = 30, 31  # the lobe's normalisation, and the slope of its logarithm
ROWS = 32

SHORTEST = 1e-6
"""Normals shorter than this have no direction: they fade to zero."""
NEAREST_MM = 1.0
"""Within 1 mm of a lamp the inverse square has no meaning for a point light."""
NARROWEST = 1e-4
"""Least |l + v|^2: where a light is opposite to the camera no half vector exists."""


class Skins(NamedTuple):
    """B skins of n texels as compiled code takes them.

    Attributes:
        position: (B, 3, n) mm.
        diffuse_normal: (B, 3, n) of any length.
        specular_normal: (B, 3, n).
        shininess: (B, 1, n).
        occlusion: (B, 1, n) of the ambient light.
        valid: (B, n) bool, where a surface is.
    """

    position: np.ndarray
    diffuse_normal: np.ndarray
    specular_normal: np.ndarray
    shininess: np.ndarray
    occlusion: np.ndarray
    valid: np.ndarray


class Lights(NamedTuple):
    """Their B sets of L lights.

    Attributes:
        packed: (B, L, 9) of `kernel_forward.pack_lights`.
        seen: (B, L, n), or (B, 0, n) where every light is seen.
        ambient: (B, 3).
        camera: (B, 3) mm.
    """

    packed: np.ndarray
    seen: np.ndarray
    ambient: np.ndarray
    camera: np.ndarray


@numba.njit
def tasks_of(texels: int) -> int:
    """How many tasks a texture is cut into."""
    span = TEXELS * BLOCKS_A_TASK
    return (texels + span - 1) // span


@numba.njit
def task_range(task: int, texels: int) -> tuple[int, int, int, int]:
    """Batch entry of a task, its number there, its first texel and the one after its last."""
    span, tasks = TEXELS * BLOCKS_A_TASK, tasks_of(texels)
    entry, number = task // tasks, task % tasks
    return entry, number, number * span, min(texels, (number + 1) * span)


@numba.njit(fastmath=ANY_ORDER, error_model="numpy")
def unit_rows(buf: np.ndarray, first: int, length: int) -> None:
    """Make three rows of a block unit vectors, and write one over their length to a row."""
    one = buf.dtype.type(1.0)
    least = buf.dtype.type(SHORTEST * SHORTEST)
    for t in range(TEXELS):
        x = buf[first * TEXELS + t]
        y = buf[(first + 1) * TEXELS + t]
        z = buf[(first + 2) * TEXELS + t]
        square = x * x + y * y + z * z
        # 1 / floor for short ones, its sign turned: the gradient is then another one.
        short = square < least
        scale = one / np.sqrt(least if short else square)
        buf[first * TEXELS + t] = x * scale
        buf[(first + 1) * TEXELS + t] = y * scale
        buf[(first + 2) * TEXELS + t] = z * scale
        buf[length * TEXELS + t] = -scale if short else scale


@numba.njit(fastmath=ANY_ORDER, error_model="numpy")
def gather(
    buf: np.ndarray, texel: np.ndarray, count: int, entry: int, skins: Skins, camera: np.ndarray
) -> None:
    """Fill a block with `count` of the texels listed, of one batch entry; the rest is zero.

    `camera` is its (3,) place, mm.
    """
    zero = buf.dtype.type(0.0)
    position = skins.position[entry]
    diffuse_normal, specular_normal = skins.diffuse_normal[entry], skins.specular_normal[entry]
    shininess, occlusion = skins.shininess[entry], skins.occlusion[entry]
    for k in range(3):
        for t in range(TEXELS):
            n = texel[t]
            buf[(P + k) * TEXELS + t] = position[k, n]
            buf[(ND + k) * TEXELS + t] = diffuse_normal[k, n]
            buf[(NS + k) * TEXELS + t] = specular_normal[k, n]
            buf[(V + k) * TEXELS + t] = camera[k] - position[k, n]
            buf[(E + k) * TEXELS + t] = zero
            buf[(LOBE + k) * TEXELS + t] = zero
    for t in range(TEXELS):
        buf[S * TEXELS + t] = shininess[0, texel[t]]
        buf[OCC * TEXELS + t] = occlusion[0, texel[t]]
        buf[VALID * TEXELS + t] = buf.dtype.type(t < count)
    unit_rows(buf, ND, LEN)
    unit_rows(buf, NS, LEN + 1)
    unit_rows(buf, V, LEN + 2)
    for t in range(TEXELS):
        buf[NSV * TEXELS + t] = (
            buf[NS * TEXELS + t] * buf[V * TEXELS + t]
            + buf[(NS + 1) * TEXELS + t] * buf[(V + 1) * TEXELS + t]
            + buf[(NS + 2) * TEXELS + t] * buf[(V + 2) * TEXELS + t]
        )


@numba.njit
def next_texels(valid: np.ndarray, first: int, last: int, texel: np.ndarray) -> tuple[int, int]:
    """List up to a block's texels of the surface, `valid` (n,) bool, from `first` on.

    A block that is not full repeats its last texel, so that every place can be read.

    Returns:
        How many there are, and the index of the next texel.
    """
    count = 0
    while first < last and count < TEXELS:
        if valid[first]:
            texel[count] = first
            count += 1
        first += 1
    for t in range(count, TEXELS):
        texel[t] = texel[count - 1] if count else 0
    return count, first


@numba.njit
def next_block(
    buf: np.ndarray,
    texel: np.ndarray,
    entry: int,
    first: int,
    last: int,
    skins: Skins,
    lights: Lights,
) -> tuple[int, int]:
    """List and gather the next block's texels; as `next_texels`, with `buf` of `toward_light`."""
    count, first = next_texels(skins.valid[entry], first, last, texel)
    if count:
        gather(buf, texel, count, entry, skins, lights.camera[entry])
    return count, first


@numba.njit(fastmath=ANY_ORDER, error_model="numpy")
def toward_light(
    buf: np.ndarray, texel: np.ndarray, entry: int, index: int, lights: Lights
) -> tuple[int, int]:
    """Cosines and distance of a block's texels to one light; its visibility.

    Args:
        buf: (rows * TEXELS,), the block.
        texel: (TEXELS,) int64, which texels it holds.
        entry: of the batch.
        index: of the light.
        lights: all.

    Returns:
        How many texels the light may reach: by the diffuse normal, by the specular one. A NaN
        counts, so that it is passed on.
    """
    one, zero = buf.dtype.type(1.0), buf.dtype.type(0.0)
    light, seen = lights.packed[entry, index], lights.seen[entry]
    lx, ly, lz, near, least = light[0], light[1], light[2], light[3], light[5]
    by_diffuse, by_specular = 0, 0
    for t in range(TEXELS):
        buf[SEEN * TEXELS + t] = seen[index, texel[t]] if len(seen) else one
    for t in range(TEXELS):
        x = lx - near * buf[P * TEXELS + t]
        y = ly - near * buf[(P + 1) * TEXELS + t]
        z = lz - near * buf[(P + 2) * TEXELS + t]
        square = x * x + y * y + z * z
        inverse = one / np.sqrt(least if square < least else square)
        a = x * buf[ND * TEXELS + t] + y * buf[(ND + 1) * TEXELS + t]
        a = (a + z * buf[(ND + 2) * TEXELS + t]) * inverse
        b = x * buf[NS * TEXELS + t] + y * buf[(NS + 1) * TEXELS + t]
        b = (b + z * buf[(NS + 2) * TEXELS + t]) * inverse
        buf[A * TEXELS + t] = a
        buf[B * TEXELS + t] = b
        buf[INV * TEXELS + t] = inverse
        by_diffuse += 0 if a <= zero else 1
        by_specular += 0 if b <= zero else 1
    return by_diffuse, by_specular
