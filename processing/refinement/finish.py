"""A solved pixel's maps: how far it is trusted, and what stands in where it is not."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit, prange

from processing.refinement.config import RefineConfig
from processing.view_maps import PixelMaps

NORMAL, MATTE, ALBEDO, POWER, MISFIT, CERTAINTY, SATURATION = 0, 3, 6, 9, 12, 13, 14
MESH, FACING, INSIDE, PRIOR, ROUGHNESS, SPECULAR, USABLE, OPEN = 15, 18, 19, 20, 23, 24, 25, 26
VIEW, MATTE_TURN2, GIVEN = 27, 30, 31
"""Places of what `finish_pixel` is given: both normals, albedo and its power in R G B, what
`joint.Solved` has of misfit and certainty, saturation, the mesh's normal, how much it faces the
camera (`facing`), the distance to the nearest edge in pixels, the neighbours' albedo, gloss, 1
where the readings can be used, ambient occlusion, the direction to the camera, and the mean
squared turn that noise gives the matte normal."""
LEAST_WEIGHT = 1e-6
"""Least weight of a pixel in its neighbours' albedo."""


class Limits(NamedTuple):
    """The settings of `RefineConfig` for trust, against readings as noisy as expected."""

    edge_px: float
    grey_saturation: float
    dark_power: float
    doubtful_misfit: float
    doubtful_turn2: float
    prior_power: float
    steady_below: float
    apart2: float
    doubtful_apart2: float


class Maps(NamedTuple):
    """Of n pixels, float32: both normals and albedo (n, 3), the others (n,)."""

    matte: np.ndarray
    normal: np.ndarray
    albedo: np.ndarray
    specular: np.ndarray
    roughness: np.ndarray
    confidence: np.ndarray
    occlusion: np.ndarray

    def pixel_maps(self) -> PixelMaps:
        """As stages know them."""
        return PixelMaps(*self[:6])


def limits_of(config: RefineConfig, doubt: float = 1.0, noisier: float = 1.0) -> Limits:
    """The part of a configuration that compiled code takes.

    Args:
        config: see there.
        doubt: by what factor the scene's readings err more than expected, in variance.
        noisier: by what factor their noise is above what was configured, in variance.
    """
    return Limits(
        config.edge_px,
        config.grey_saturation,
        config.dark_power,
        config.doubtful_misfit * doubt,
        float(np.radians(config.doubtful_turn_deg)) ** 2 / doubt,
        config.albedo_prior_power,
        config.steady_below,
        # Of noise as configured chroma's normals stay free of what is modelled of the gloss.
        float(np.radians(config.apart_deg)) ** 2 / max(doubt - 1 / noisier, 1e-6),
        float(np.radians(config.doubtful_apart_deg)) ** 2,
    )


def empty_maps(count: int) -> Maps:
    """Zero: nothing is solved; memory is taken when it is written to."""
    three = (np.zeros((count, 3), np.float32) for _ in range(3))
    one = (np.zeros(count, np.float32) for _ in range(4))
    return Maps(*three, *one)


def facing(normals: np.ndarray, views: np.ndarray) -> np.ndarray:
    """(n,) 0..1: less where a surface of (n, 3) normals is seen edge on."""
    cosine = np.maximum(np.einsum("nk,nk->n", normals, views), 0)
    return np.asarray(np.minimum((cosine / 0.8) ** 0.7, 1))


@njit(cache=True, error_model="numpy")
def finish_pixel(given: np.ndarray, at: int, limits: Limits, maps: Maps) -> None:
    """Write a pixel's maps from its (GIVEN,) numbers.

    An unsolved one has no confidence, the mesh's normal and gloss, and its neighbours' albedo.
    """
    maps.occlusion[at] = given[OPEN]
    _stand_in(given, at, maps)
    agreement = toward = 0.0
    for x in range(3):
        agreement += given[NORMAL + x] * given[MESH + x]
        toward += given[NORMAL + x] * given[VIEW + x]
    # A normal that the mesh could not have: mistaken shadows, or hair.
    if not (given[USABLE] > 0 and given[FACING] > 0 and agreement > 0 and toward > 0):
        return
    power = (given[POWER] + given[POWER + 1] + given[POWER + 2]) / 3
    # All that is found errs more where the skin is seen aslant, the diffuse normal least.
    trust = math.sqrt(given[FACING]) * min(max(given[INSIDE] / limits.edge_px, 0.0), 1.0)
    trust *= min(2 * agreement, 1.0)
    trust *= min(max(given[SATURATION] / limits.grey_saturation - 1, 0.0), 1.0)
    trust *= power / (power + limits.dark_power)
    trust /= 1 + given[MISFIT] / limits.doubtful_misfit
    trust /= 1 + 1 / (max(given[CERTAINTY], 1e-12) * limits.doubtful_turn2)
    # Chroma alone is noisier than all readings, whose normal knows the gloss only as modelled:
    # the two should agree, and what they are apart beyond noise the model lacks.
    found = given[MATTE] ** 2 + given[MATTE + 1] ** 2 + given[MATTE + 2] ** 2 > 0
    found = found and given[MATTE_TURN2] >= 0
    chroma = limits.apart2 / (limits.apart2 + given[MATTE_TURN2]) if found else 0.0
    apart2 = 0.0
    for x in range(3):
        apart2 += (chroma * (given[MATTE + x] - given[NORMAL + x])) ** 2
    trust /= 1 + apart2 / limits.doubtful_apart2
    if not math.isfinite(trust):
        return
    maps.confidence[at] = trust
    # A pixel that is hardly trusted takes its neighbours' albedo.
    weight = max(trust * trust, LEAST_WEIGHT)
    prior = PRIOR if given[PRIOR] + given[PRIOR + 1] + given[PRIOR + 2] > 0 else ALBEDO
    for c in range(3):
        own = given[POWER + c] * weight
        lit = given[ALBEDO + c] * own + limits.prior_power * given[prior + c]
        maps.albedo[at, c] = max(lit / (own + limits.prior_power), 0.0)
    share = min(trust / limits.steady_below, 1.0)
    for own, out in ((chroma, maps.matte), (0.0, maps.normal)):
        x = own * given[MATTE] + (1 - own) * given[NORMAL]
        y = own * given[MATTE + 1] + (1 - own) * given[NORMAL + 1]
        z = own * given[MATTE + 2] + (1 - own) * given[NORMAL + 2]
        x = share * x + (1 - share) * given[MESH]
        y = share * y + (1 - share) * given[MESH + 1]
        z = share * z + (1 - share) * given[MESH + 2]
        length = math.sqrt(x * x + y * y + z * z)
        if length > 1e-6:
            out[at, 0], out[at, 1], out[at, 2] = x / length, y / length, z / length


@njit(cache=True, error_model="numpy")
def _stand_in(given: np.ndarray, at: int, maps: Maps) -> None:
    """Write what is known of a pixel without its readings; what is not finite stays zero."""
    length2 = albedo = 0.0
    for x in range(3):
        length2 += given[MESH + x] * given[MESH + x]
        albedo += given[PRIOR + x]
    if length2 > 0.5 and math.isfinite(length2):
        for x in range(3):
            maps.matte[at, x] = maps.normal[at, x] = given[MESH + x] / math.sqrt(length2)
    if math.isfinite(albedo):
        for x in range(3):
            maps.albedo[at, x] = max(given[PRIOR + x], 0.0)
    if math.isfinite(given[SPECULAR] + given[ROUGHNESS]):
        maps.specular[at], maps.roughness[at] = given[SPECULAR], given[ROUGHNESS]


@njit(parallel=True, cache=True, error_model="numpy")
def finish(given: np.ndarray, places: np.ndarray, limits: Limits, maps: Maps) -> None:
    """Write the maps of (n, GIVEN) pixels at their (n,) places."""
    for i in prange(len(places)):
        finish_pixel(given[i], places[i], limits, maps)
