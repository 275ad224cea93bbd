"""The compiled shading's gradients for a batch of textures; `kernel_gradients` has the terms."""

from __future__ import annotations

import numba
import numpy as np

from learning.render.kernel_forward import black, normalise_lobe, seen_of
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
    colour_worth,
    diffuse_worth,
    finish_block,
    normal_worth,
    place_worth,
    specular_worth,
)
from learning.render.lanes_math import ANY_ORDER
from learning.render.texel_blocks import (
    BLOCKS_A_TASK,
    NORM,
    SLOPE,
    TEXELS,
    gather,
    next_texels,
    toward_light,
)

LIGHT_SUMS = 7


@numba.njit(parallel=True, cache=True, fastmath=ANY_ORDER, error_model="numpy")
def backward(
    position: np.ndarray,
    diffuse_normal: np.ndarray,
    specular_normal: np.ndarray,
    shininess: np.ndarray,
    occlusion: np.ndarray,
    valid: np.ndarray,
    seen: np.ndarray,
    lights: np.ndarray,
    ambient: np.ndarray,
    camera: np.ndarray,
    paper: bool,
    lobes: np.ndarray,
    of_irradiance: np.ndarray,
    of_lobes: np.ndarray,
    want_normals: bool,
    want_places: bool,
    want_colours: bool,
    of_position: np.ndarray,
    of_diffuse_normal: np.ndarray,
    of_specular_normal: np.ndarray,
    of_shininess: np.ndarray,
    of_occlusion: np.ndarray,
    of_seen: np.ndarray,
    light_sums: np.ndarray,
    camera_sums: np.ndarray,
    ambient_sums: np.ndarray,
) -> None:
    """Gradients of `kernel_forward.forward`.

    Args:
        position: as forward, and all that follow up to `paper`.
        lobes: (B, 3, n), what forward filled.
        of_irradiance: (B, 3, n), what the irradiance is worth.
        of_lobes: (B, 3, n).
        want_normals: whether normals and exponent are asked for.
        want_places: whether position, camera or the lights' places are.
        want_colours: whether the lights' rgb are.
        of_position: (B, 3, n), or (B, 3, 0) where not asked for; so are the next ones.
        of_diffuse_normal: (B, 3, n).
        of_specular_normal: (B, 3, n).
        of_shininess: (B, 1, n).
        of_occlusion: (B, 1, n).
        of_seen: (B, L, n).
        light_sums: (B, tasks, L, 7): x, y, z, |P|^2, r, g, b of a task's texels.
        camera_sums: (B, tasks, 3).
        ambient_sums: (B, tasks, 3).
    """
    batch, _, texels = position.shape
    span = TEXELS * BLOCKS_A_TASK
    tasks = (texels + span - 1) // span
    one, zero = position.dtype.type(1.0), position.dtype.type(0.0)
    for task in numba.prange(batch * tasks):
        entry, first = task // tasks, (task % tasks) * span
        last = min(texels, first + span)
        sums = light_sums[entry, task % tasks]
        buf = np.zeros(GRADIENT_ROWS * TEXELS, position.dtype)
        visible = np.full(TEXELS, one)
        texel = np.zeros(TEXELS, np.int64)
        while first < last:
            count, first = next_texels(valid[entry], first, last, texel)
            if count == 0:
                break
            gather(
                buf,
                texel,
                count,
                position[entry],
                diffuse_normal[entry],
                specular_normal[entry],
                shininess[entry],
                occlusion[entry],
                camera[entry],
            )
            gloss = False
            buf[GE * TEXELS :] = zero
            for k in range(3):
                for t in range(count):
                    buf[(GE + k) * TEXELS + t] = of_irradiance[entry, k, texel[t]]
                    worth = of_lobes[entry, k, texel[t]]
                    gloss |= worth != zero
                    buf[(GL + k) * TEXELS + t] = worth
            if gloss and not paper:
                normalise_lobe(buf)
                for k in range(3):
                    for t in range(count):
                        worth = buf[(GL + k) * TEXELS + t]
                        share = worth * lobes[entry, k, texel[t]]
                        buf[GS * TEXELS + t] += share * buf[SLOPE * TEXELS + t]
                        buf[(GL + k) * TEXELS + t] = worth * buf[NORM * TEXELS + t]
            for j in range(lights.shape[1]):
                light = lights[entry, j]
                if black(light) and not want_colours:
                    continue
                if seen.shape[1]:
                    seen_of(seen[entry], j, texel, visible)
                by_diffuse, by_specular = toward_light(buf, light, visible)
                if not (by_diffuse or (gloss and by_specular) or paper):
                    continue
                diffuse_worth(buf, light, paper)
                if gloss and (by_specular or paper):
                    specular_worth(buf, light, paper)
                if want_normals:
                    normal_worth(buf, light)
                if want_places:
                    place_worth(buf, light, paper, sums[j])
                if want_colours:
                    colour_worth(buf, sums[j])
                if of_seen.shape[2]:
                    for t in range(count):
                        of_seen[entry, j, texel[t]] = buf[GSEEN * TEXELS + t]
            finish_block(buf)
            for k in range(3):
                from_camera, everywhere = zero, zero
                for t in range(count):
                    n = texel[t]
                    from_view = buf[(GV + k) * TEXELS + t]
                    from_camera += from_view
                    everywhere += of_irradiance[entry, k, n] * occlusion[entry, 0, n]
                    if of_position.shape[2]:
                        of_position[entry, k, n] = buf[(GP + k) * TEXELS + t] - from_view
                    if of_diffuse_normal.shape[2]:
                        of_diffuse_normal[entry, k, n] = buf[(GND + k) * TEXELS + t]
                    if of_specular_normal.shape[2]:
                        of_specular_normal[entry, k, n] = buf[(GNS + k) * TEXELS + t]
                    if of_occlusion.shape[2]:
                        worth = of_irradiance[entry, k, n] * ambient[entry, k]
                        of_occlusion[entry, 0, n] += worth
                camera_sums[entry, task % tasks, k] += from_camera
                ambient_sums[entry, task % tasks, k] += everywhere
            if of_shininess.shape[2]:
                for t in range(count):
                    of_shininess[entry, 0, texel[t]] = buf[GS * TEXELS + t]
