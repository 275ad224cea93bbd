"""Maps of one view's pixels, as every method of separation and `refine` returns them."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numba import njit

from lightstage.counting import counted
from lightstage.formats.half import half_bits


@dataclasses.dataclass(frozen=True)
class PixelMaps:
    """Maps of the n pixels of a mask, in row order; where unsolved, 0 or what stands in.

    Attributes:
        diffuse_normal: (n, 3) unit, the direction that explains the diffuse shading.
        specular_normal: (n, 3) unit, the surface's own with its finest relief.
        albedo: (n, 3) diffuse.
        specular: (n,) reflectance at normal incidence.
        roughness: (n,) Beckmann's m that the specular albedo was found with.
        confidence: (n,) 0..1.
    """

    diffuse_normal: np.ndarray
    specular_normal: np.ndarray
    albedo: np.ndarray
    specular: np.ndarray
    roughness: np.ndarray
    confidence: np.ndarray


MAP_NAMES = {
    "diffuse_normal": "diffuse_normal",
    "specular_normal": "specular_normal",
    "albedo": "diffuse_albedo",
    "specular": "specular_albedo",
    "roughness": "roughness",
    "confidence": "confidence",
}
"""Fields of `PixelMaps`, and the maps that they are written to."""


def pasted(mask: np.ndarray, values: np.ndarray) -> np.ndarray:
    """(h, w, ..) float16 picture of n pixels' (n, ..) values, zero outside the (h, w) mask.

    What half floats cannot hold becomes infinite, and is refused when it is written.
    """
    count, channels = int(np.count_nonzero(mask)), math.prod(values.shape[1:])
    if len(values) != count:
        raise ValueError(f"{counted(len(values), 'value')} for a mask of {counted(count, 'pixel')}")
    image = np.zeros((*mask.shape, *values.shape[1:]), np.float16)
    flat = np.ascontiguousarray(values, np.float32).reshape(count, channels)
    bits = image.view(np.uint16).reshape(*mask.shape, channels)
    _paste(np.ascontiguousarray(mask), flat, bits)
    return image


@njit(cache=True, nogil=True)
def _paste(mask: np.ndarray, values: np.ndarray, image: np.ndarray) -> None:
    """Fill (h, w, c) half floats' bits with (n, c) values where the mask is true."""
    place = 0
    for row in range(mask.shape[0]):
        for column in range(mask.shape[1]):
            if mask[row, column]:
                for c in range(values.shape[1]):
                    image[row, column, c] = half_bits(values[place, c])
                place += 1
