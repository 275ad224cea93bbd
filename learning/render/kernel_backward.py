"""The compiled shading's gradients for a batch of textures; `kernel_gradients` has the terms."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from learning.render.kernel_forward import black, normalise_lobe
from learning.render.kernel_gradients import (
    GE,
    GL,
    GND,
    GNS,
    GP,
    GRADIENT_ROWS,
    GS,
    GSEEN,
    GV,
    colour_gradient,
    diffuse_gradient,
    finish_block,
    normal_gradient,
    place_gradient,
    specular_gradient,
)
from learning.render.lanes_math import ANY_ORDER
from learning.render.texel_blocks import (
    NORM,
    SLOPE,
    TEXELS,
    Lights,
    Skins,
    next_block,
    task_range,
    tasks_of,
    toward_light,
)

LIGHT_SUMS = 7


class Shaded(NamedTuple):
    """The two sums of `kernel_forward.forward`, or the gradients of both: (B, 3, n) each."""

    irradiance: np.ndarray
    lobes: np.ndarray


class Needed(NamedTuple):
    """Which gradients are needed: of the normals or the exponent; of the position, the camera
    or the lights' places; of the lights' rgb.
    """

    normals: bool
    places: bool
    colours: bool


class Gradients(NamedTuple):
    """Gradients with respect to the inputs; all start as zeros.

    Attributes:
        position: (B, 3, n), or (B, 3, 0) where not needed; so are the next ones.
        diffuse_normal: (B, 3, n).
        specular_normal: (B, 3, n).
        shininess: (B, 1, n).
        occlusion: (B, 1, n).
        seen: (B, L, n).
        light_sums: (B, tasks, L, 7): x, y, z, |P|^2, r, g, b of a task's texels.
        camera_sums: (B, tasks, 3).
        ambient_sums: (B, tasks, 3).
    """

    position: np.ndarray
    diffuse_normal: np.ndarray
    specular_normal: np.ndarray
    shininess: np.ndarray
    occlusion: np.ndarray
    seen: np.ndarray
    light_sums: np.ndarray
    camera_sums: np.ndarray
    ambient_sums: np.ndarray


@numba.njit(fastmath=ANY_ORDER, error_model="numpy")
def start_gradients(
    buf: np.ndarray,
    texel: np.ndarray,
    count: int,
    entry: int,
    paper: bool,
    lobes: np.ndarray,
    gradient: Shaded,
) -> bool:
    """Start a block: gradients of its sums, the lobe's before it was normalised.

    Args:
        buf: flat, of `GRADIENT_ROWS` rows of `TEXELS` numbers.
        texel: (TEXELS,) indices of the block's texels.
        count: how many of them are there.
        entry: of the batch.
        paper: whether the formulas are as printed.
        lobes: (B, 3, n), what forward filled.
        gradient: with respect to what forward filled.

    Returns:
        Whether the lobe has a gradient.
    """
    gloss = False
    zero = buf.dtype.type(0.0)
    buf[GE * TEXELS :] = zero
    for k in range(3):
        for t in range(count):
            buf[(GE + k) * TEXELS + t] = gradient.irradiance[entry, k, texel[t]]
            of_lobe = gradient.lobes[entry, k, texel[t]]
            gloss |= of_lobe != zero
            buf[(GL + k) * TEXELS + t] = of_lobe
    if gloss and not paper:
        normalise_lobe(buf)
        for k in range(3):
            for t in range(count):
                of_lobe = buf[(GL + k) * TEXELS + t]
                share = of_lobe * lobes[entry, k, texel[t]]
                buf[GS * TEXELS + t] += share * buf[SLOPE * TEXELS + t]
                buf[(GL + k) * TEXELS + t] = of_lobe * buf[NORM * TEXELS + t]
    return gloss


@numba.njit(fastmath=ANY_ORDER, error_model="numpy")
def write_gradients(
    buf: np.ndarray, texel: np.ndarray, count: int, entry: int, of: Gradients
) -> None:
    """Write the gradients of the maps that are needed; arrays as of `start_gradients`."""
    for k in range(3):
        for t in range(count):
            n = texel[t]
            if of.position.shape[2]:
                of.position[entry, k, n] = buf[(GP + k) * TEXELS + t] - buf[(GV + k) * TEXELS + t]
            if of.diffuse_normal.shape[2]:
                of.diffuse_normal[entry, k, n] = buf[(GND + k) * TEXELS + t]
            if of.specular_normal.shape[2]:
                of.specular_normal[entry, k, n] = buf[(GNS + k) * TEXELS + t]
    if of.shininess.shape[2]:
        for t in range(count):
            of.shininess[entry, 0, texel[t]] = buf[GS * TEXELS + t]


@numba.njit(parallel=True, cache=True, fastmath=ANY_ORDER, error_model="numpy")
def backward(
    skins: Skins,
    lights: Lights,
    paper: bool,
    lobes: np.ndarray,
    upstream: Shaded,
    needed: Needed,
    of: Gradients,
) -> None:
    """Gradients of `kernel_forward.forward`.

    Args:
        skins: as forward.
        lights: as forward.
        paper: as forward.
        lobes: (B, 3, n), what forward filled.
        upstream: gradients of the loss with respect to the sums that `forward` filled.
        needed: what is computed.
        of: is filled.
    """
    batch, _, texels = skins.position.shape
    zero = lobes.dtype.type(0.0)
    # Numba drops writes through a tuple's attribute inside a parallel loop, but not through names.
    of_seen, of_occlusion = of.seen, of.occlusion
    light_sums, camera_sums, ambient_sums = of.light_sums, of.camera_sums, of.ambient_sums
    for task in numba.prange(batch * tasks_of(texels)):
        entry, number, first, last = task_range(task, texels)
        sums = light_sums[entry, number]
        buf = np.zeros(GRADIENT_ROWS * TEXELS, lobes.dtype)
        texel = np.zeros(TEXELS, np.int64)
        while first < last:
            count, first = next_block(buf, texel, entry, first, last, skins, lights)
            if count == 0:
                break
            gloss = start_gradients(buf, texel, count, entry, paper, lobes, upstream)
            for j in range(lights.packed.shape[1]):
                light = lights.packed[entry, j]
                if black(light) and not needed.colours:
                    continue
                by_diffuse, by_specular = toward_light(buf, texel, entry, j, lights)
                if not (by_diffuse or (gloss and by_specular) or paper):
                    continue
                diffuse_gradient(buf, light, paper)
                if gloss and (by_specular or paper):
                    specular_gradient(buf, light, paper)
                if needed.normals:
                    normal_gradient(buf, light)
                if needed.places:
                    place_gradient(buf, light, paper, sums[j])
                if needed.colours:
                    colour_gradient(buf, sums[j])
                if of_seen.shape[2]:
                    for t in range(count):
                        of_seen[entry, j, texel[t]] = buf[GSEEN * TEXELS + t]
            finish_block(buf)
            write_gradients(buf, texel, count, entry, of)
            for k in range(3):
                from_camera, everywhere = zero, zero
                for t in range(count):
                    n = texel[t]
                    from_camera += buf[(GV + k) * TEXELS + t]
                    everywhere += upstream.irradiance[entry, k, n] * skins.occlusion[entry, 0, n]
                    if of_occlusion.shape[2]:
                        here = upstream.irradiance[entry, k, n] * lights.ambient[entry, k]
                        of_occlusion[entry, 0, n] += here
                camera_sums[entry, number, k] += from_camera
                ambient_sums[entry, number, k] += everywhere
