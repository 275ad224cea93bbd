"""Maps as the whole numbers of a PNG: which function of a value is stored, and its step.

Maps are half floats, which have 65,536 values: a table of all of them encodes any map exactly.

| picture | stores | step of 8 bits |
|---|---|---|
| base colour | sRGB of the diffuse albedo | 1/255 of the sRGB value |
| roughness | the root of Beckmann's m, which glTF squares to alpha | 1/255 |
| specular | specular albedo / 0.08 | 0.00031 |
| normal | (n + 1) / 2 in MikkTSpace's frame | 1/255 |
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np

from lightstage.formats.png import png_bytes
from processing.colour import srgb_from_linear

SPECULAR_WHITE = 0.08
"""Specular albedo that a picture shows as white: what Unreal's input `Specular` and the specular
level of other principled shaders with an index of 1.5 call 1."""
FASTEST = (cv2.IMWRITE_PNG_COMPRESSION, 1)
"""A face's grain hardly gets smaller by trying harder."""

Curve = Callable[[np.ndarray], np.ndarray]


def srgb(values: np.ndarray) -> np.ndarray:
    """(...) linear light to sRGB's 0..1; values above white become white."""
    return np.asarray(srgb_from_linear(np.clip(values, 0, 1)))


def perceptual(roughness: np.ndarray) -> np.ndarray:
    """(...) Beckmann's m to the roughness that glTF, Blender and Unreal square to GGX's alpha.

    Both distributions have the same height in their middle where alpha = m [Walter2007].
    """
    return np.sqrt(np.clip(roughness, 0, 1))


def level(specular_albedo: np.ndarray) -> np.ndarray:
    """(...) specular albedo to the level of a principled shader."""
    return specular_albedo / SPECULAR_WHITE


def plain(values: np.ndarray) -> np.ndarray:
    """(...) shares, unchanged."""
    return values


def quantised(image: np.ndarray, curve: Curve, kind: type[np.unsignedinteger[Any]]) -> np.ndarray:
    """Encode half floats.

    Args:
        image: any shape, float16.
        curve: from the map's values to 0..1; what falls outside is clamped.
        kind: uint8 or uint16.
    """
    every = np.arange(65536, dtype=np.uint16).view(np.float16).astype(np.float64)
    with np.errstate(invalid="ignore", over="ignore"):
        shares = curve(np.where(np.isfinite(every), every, 0.0))
    top = np.iinfo(kind).max
    table = np.round(np.clip(shares, 0, 1) * top).astype(kind)
    encoded: np.ndarray = table[np.ascontiguousarray(image, np.float16).view(np.uint16)]
    return encoded


def quantised_normals(
    tangent: np.ndarray, kind: type[np.unsignedinteger[Any]], band: int = 256
) -> np.ndarray:
    """(rows, columns, 3) unit normals as (n + 1) / 2 of the whole range; in bands of rows."""
    top = np.iinfo(kind).max
    out = np.empty(tangent.shape, kind)
    for first in range(0, len(tangent), band):
        rows = slice(first, first + band)
        out[rows] = np.round(np.clip(tangent[rows] * 0.5 + 0.5, 0, 1) * top)
    return out


def png(pixels: np.ndarray) -> bytes:
    """The bytes of a PNG file: uint8 or uint16 of (h, w), (h, w, 3) rgb or (h, w, 4) rgba."""
    return png_bytes(pixels, "picture", FASTEST)
