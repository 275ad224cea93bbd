"""Method `kampouris`: the published separation by colour, pair by pair.

Of a pair of complements the brighter photograph g shows diffuse and specular light, the darker c
the diffuse alone. Specular light is white, so that it lowers the saturation S = C / V of g, where V
is the largest channel and C = V less the smallest: delta = V_g - C_g / S_c is the white that takes
the saturation of g to that of c. What is left is diffuse.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from processing.albedo import diffuse_light
from processing.lighting.lights import PatternLights, far_field, no_shadows
from processing.lighting.lobe import transport
from processing.normals import blurred, ratio_normals, solve_far_normals
from processing.readings import read_pixels
from processing.separation.config import KampourisConfig, Relief, SeparateConfig, relief_of
from processing.separation.lobe_fit import with_detail
from processing.separation.pairs import axis_pairs, full_reading
from processing.separation.variants import normal_signal
from processing.separation.view_readings import Pixels
from processing.view_maps import PixelMaps

RELIEF: Relief = "mirror"
"""What its specular normals are by itself."""
COMBINES = ("maximum", "median", "mean", "weighted")


def separate_pixels(pixels: Pixels, lights: PatternLights, config: SeparateConfig) -> PixelMaps:
    """The published separation of one view's pixels.

    Normals are ratios of the separated photographs, or of what `config.normals` names; specular
    normals halve the angle between the specular ratios' direction and the view.

    Args:
        pixels: of the view.
        lights: of their patterns.
        config: see there.

    Returns:
        PixelMaps; confidence 0 and zeros where a pixel is clipped, dark, grey or not finite.

    Raises:
        ProcessingError: patterns without the three pairs.

    Source: [Kampouris2018].
    """
    options = config.kampouris
    pairs = axis_pairs(lights.patterns)
    views, mask = pixels.views, pixels.mask
    rgb, _, saturation, usable = read_pixels(
        pixels.rgb, pixels.valid, lights.colour, config.dark_level
    )
    rgb /= lights.colour.astype(np.float32)
    specular, vector, diffuse = published_parts(rgb, pairs, options)
    if options.pool_mm > 0:
        specular = blurred(specular[:, None], usable, mask, options.pool_mm * pixels.px_per_mm)[
            :, 0
        ]
    if config.normals != "auto":
        diffuse = normal_signal(rgb, config.normals)[:, pairs.ravel()]
    normal = pair_normals(diffuse, lights, pairs, views, options.field, config.iterations)
    solved = usable & (np.einsum("nk,nk->n", normal, normal) > 0.5)
    colourful = np.clip(saturation / config.grey_saturation - 1, 0, 1)
    solved &= colourful > 0
    albedo = np.maximum(
        flat_albedo(rgb, lights, pairs, normal, views, specular, options.field, config.roughness), 0
    )
    facets = normal
    if (relief := relief_of(RELIEF, config)) != "diffuse":
        facets = _halved(views, vector, normal)
    if relief == "detail":
        sigma_px = config.linear.detail_mm * pixels.px_per_mm
        facets = with_detail(normal, facets, solved, mask, sigma_px)
    facing = np.clip(np.einsum("nk,nk->n", normal, views) / 0.3, 0, 1)
    maps = (normal, facets, albedo, specular, np.full(len(rgb), config.roughness))
    normal, facets, albedo, specular, roughness = (
        np.where(solved if x.ndim == 1 else solved[:, None], x, 0) for x in maps
    )
    confidence = np.where(solved, colourful * facing, 0)
    return PixelMaps(normal, facets, albedo, specular, roughness, confidence)


def _halved(views: np.ndarray, vector: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """(n, 3) unit, halfway between the view and where the specular part comes from."""
    half = views + vector
    length = np.linalg.norm(half, axis=1, keepdims=True)
    mirrored = (length > 0.1) & (np.einsum("nk,nk->n", vector, vector) > 0.5)[:, None]
    return np.where(mirrored, half / np.where(mirrored, length, 1), normal)


def published_parts(
    rgb: np.ndarray, pairs: np.ndarray, config: KampourisConfig
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Specular part, direction it comes from, and diffuse readings of the pairs.

    Args:
        rgb: (n, P, 3) readings, white where the lights are; finite.
        pairs: (3, 2) of `axis_pairs`.
        config: see there.

    Returns:
        (n,) float32 specular part in 0..most_specular; (n, 3) float32 unit direction of the
        specular ratios, zero without one; (n, 6) float32 mean channel of the diffuse part of
        x+ x- y+ y- z+ z-.
    """
    count = len(rgb)
    specular = np.zeros(count, np.float32)
    vector = np.zeros((count, 3), np.float32)
    diffuse = np.zeros((count, 6), np.float32)
    _parts(
        np.ascontiguousarray(rgb, np.float32),
        pairs,
        COMBINES.index(config.combine),
        config.least_saturation,
        config.most_specular,
        specular,
        vector,
        diffuse,
    )
    return specular, vector, diffuse


@njit(cache=True, inline="always")
def _value(r: float, g: float, b: float) -> tuple[float, float]:
    """V and C: the largest channel, and it less the smallest."""
    most = max(r, max(g, b))
    return most, most - min(r, min(g, b))


@njit(parallel=True, cache=True)
def _parts(
    rgb: np.ndarray,
    pairs: np.ndarray,
    combine: int,
    least_saturation: float,
    most_specular: float,
    specular: np.ndarray,
    vector: np.ndarray,
    diffuse: np.ndarray,
) -> None:
    for i in prange(len(rgb)):
        found = np.zeros(3)
        weight = np.zeros(3)
        side = np.zeros(3)
        for a in range(3):
            p, m = rgb[i, pairs[a, 0]], rgb[i, pairs[a, 1]]
            plus = (p[0] + p[1] + p[2]) / 3
            minus = (m[0] + m[1] + m[2]) / 3
            diffuse[i, 2 * a], diffuse[i, 2 * a + 1] = plus, minus
            value_p, chroma_p = _value(p[0], p[1], p[2])
            value_m, chroma_m = _value(m[0], m[1], m[2])
            if not (value_p > 0 and value_m > 0):
                continue
            plus_shines = plus >= minus
            if combine == 3:
                # The side whose colour the highlight washed out, whichever is brighter.
                plus_shines = chroma_p * value_m <= chroma_m * value_p
            if plus_shines:
                shine, value, chroma, pure = plus, value_p, chroma_p, chroma_m / value_m
                other = minus
                side[a] = 1
            else:
                shine, value, chroma, pure = minus, value_m, chroma_m, chroma_p / value_p
                other = plus
                side[a] = -1
            if pure < least_saturation:
                continue
            delta = min(max(value - chroma / pure, 0.0), max(value - chroma, 0.0))
            found[a] = min(delta, most_specular)
            ratio = other / max(shine, 1e-12)
            weight[a] = max(ratio, 0.0) ** 2 / (1 + ratio * ratio) * pure * pure
        if combine == 0:
            whole = max(found[0], max(found[1], found[2]))
        elif combine == 1:
            low, high = min(found[0], found[1]), max(found[0], found[1])
            whole = max(low, min(high, found[2]))
        elif combine == 2:
            whole = (found[0] + found[1] + found[2]) / 3
        else:
            total = weight[0] + weight[1] + weight[2]
            whole = 0.0
            for a in range(3):
                whole += weight[a] * found[a] / max(total, 1e-30)
        specular[i] = whole
        length = 0.0
        for a in range(3):
            length += found[a] * found[a]
            diffuse[i, 2 * a + (0 if side[a] > 0 else 1)] -= found[a]
        length = np.sqrt(length)
        if length > 0:
            for a in range(3):
                vector[i, a] = side[a] * found[a] / length


def pair_normals(
    signal: np.ndarray,
    lights: PatternLights,
    pairs: np.ndarray,
    views: np.ndarray,
    field: str,
    iterations: int,
) -> np.ndarray:
    """(n, 3) unit normals from the six gradients, zero where there is none.

    Args:
        signal: (n, 6) readings of x+ x- y+ y- z+ z-.
        lights: of the P patterns.
        pairs: (3, 2) of `axis_pairs`.
        views: (n, 3) unit, toward the camera.
        field: ``uniform`` takes ratios as they are, ``lights`` solves with the stage's own.
        iterations: of `solve_far_normals`.
    """
    if field == "uniform":
        return ratio_normals(signal, ("x+", "x-", "y+", "y-", "z+", "z-"))
    return solve_far_normals(
        np.ascontiguousarray(signal, np.float32),
        np.ascontiguousarray(far_field(lights)[:, pairs.ravel()]),
        views,
        iterations,
    )


def flat_albedo(
    rgb: np.ndarray,
    lights: PatternLights,
    pairs: np.ndarray,
    normal: np.ndarray,
    views: np.ndarray,
    specular: np.ndarray,
    field: str,
    roughness: float,
) -> np.ndarray:
    """(n, 3) diffuse albedo: `full` less the specular part, over 1 or over the light it received.

    Args:
        rgb: (n, P, 3) readings, white where the lights are.
        lights: of the P patterns.
        pairs: (3, 2) of `axis_pairs`.
        normal, views: (n, 3) unit.
        specular: (n,) what to take off.
        field: ``uniform`` or ``lights``.
        roughness: of the lobe that takes its share of the stage's own lights.
    """
    if field == "uniform":
        return np.asarray(full_reading(rgb, lights.patterns, pairs) - specular[:, None])
    sky = no_shadows(len(rgb), lights)
    e, lobe = transport(lights, np.zeros_like(normal), normal, views, roughness, sky)
    lit, power = diffuse_light(rgb, e, lobe, specular)
    return np.asarray(lit / np.where(power > 0, power, np.inf)[:, None])
