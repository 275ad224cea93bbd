"""The maps themselves: 16-bit PNG and OpenEXR."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from learning.export.encode import (
    SPECULAR_WHITE,
    Curve,
    level,
    perceptual,
    plain,
    png,
    quantised,
    quantised_normals,
    srgb,
)
from learning.export.source import Source
from lightstage.formats.exr import write_exr
from lightstage.formats.files import write_bytes

MAPS = "maps"


@dataclasses.dataclass(frozen=True)
class MapFile:
    """How one map is written.

    Attributes:
        curve: what a PNG stores of it.
        stores: the same in words.
        exr: what the OpenEXR file holds.
    """

    curve: Curve
    stores: str
    exr: str


FILES = {
    "diffuse_albedo": MapFile(srgb, "sRGB of the albedo", "linear; 1 = perfect white"),
    "specular_albedo": MapFile(
        level,
        f"the albedo / {SPECULAR_WHITE:g}, linear",
        "linear; mirror reflectance along the normal",
    ),
    "roughness": MapFile(perceptual, "the root of Beckmann's m, linear", "Beckmann's m"),
    "ambient_occlusion": MapFile(plain, "the share itself, linear", "1 = open"),
    "confidence": MapFile(plain, "the share itself, linear", "0..1; 0 = no camera saw it"),
}
NORMALS = {"specular_normal": "normal_specular", "diffuse_normal": "normal_diffuse"}
NORMAL_STORES = "(n + 1) / 2, MikkTSpace, green up"


def write_maps(folder: Path, source: Source) -> Iterator[tuple[str, str, str]]:
    """Write a PNG and an OpenEXR file of every map there is under `folder`/maps.

    Yields:
        After each: its files' stem, what the PNG stores, what the OpenEXR file holds.
    """
    place = folder / MAPS
    place.mkdir()
    for name, how in FILES.items():
        if name not in source.maps:
            continue
        spread = source.spread(source.maps[name])
        write_bytes(place / f"{name}.png", png(quantised(spread, how.curve, np.uint16)))
        write_exr(place / f"{name}.exr", spread)
        yield name, how.stores, how.exr
    for name, stem in NORMALS.items():
        tangent = source.tangent(name)
        write_bytes(place / f"{stem}.png", png(quantised_normals(tangent, np.uint16)))
        write_exr(place / f"{stem}.exr", tangent)
        yield stem, NORMAL_STORES, "n, MikkTSpace, green up, -1..1"
