"""The zarr arrays of stores and published sets: written whole, with checksums.

zarr reads a part that is not there as zeros, and alters nothing where bytes are. So every part is
written, also one of zeros alone, each carries a checksum, and what opens an array counts its parts.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import zarr

from processing.dataset.scan import DatasetError

WHOLE = "every_part_written"
"""Attribute of arrays that have all parts; those of earlier versions lack parts of zeros alone."""
LACKING = "Copy the store again from where it is whole, or build it again."


def written_whole() -> dict[str, Any]:
    """The options of `zarr.create_array` for every array besides its name, shape and sizes."""
    return {
        "compressors": (zarr.codecs.ZstdCodec(level=3), zarr.codecs.Crc32cCodec()),
        "fill_value": 0,
        "config": {"write_empty_chunks": True},
        "attributes": {WHOLE: True},
    }


def open_whole(path: Path) -> Any:
    """Open an array of a store for reading.

    Raises:
        DatasetError: no array, or one that lacks a part.
    """
    try:
        array = zarr.open_array(path, mode="r")
    except (FileNotFoundError, ValueError) as error:
        raise DatasetError(
            path, found=str(error), expected="a zarr array", hint="Build the store again."
        ) from None
    if array.attrs.get(WHOLE):
        part = array.shards or array.chunks
        wanted = math.prod(-(-side // size) for side, size in zip(array.shape, part, strict=True))
        there = sum(1 for file in (path / "c").rglob("*") if file.is_file())
        if there < wanted:
            raise DatasetError(
                path,
                found=f"{there} of its {wanted} parts",
                expected="all of them",
                hint=LACKING,
            )
    return array


def read_part(array: Any, path: Path, *place: slice) -> Any:
    """Read part of an array that `open_whole` opened.

    Args:
        array: of `open_whole`.
        path: of its folder.
        place: rows and columns.

    Raises:
        DatasetError: bytes that are not those that were written, or NaN, which none were.
    """
    try:
        found = array[place]
        fault = "" if np.isfinite(found).all() else "NaN or infinity"
    except (ValueError, RuntimeError) as error:
        fault = str(error)
    if fault:
        raise DatasetError(
            path,
            found=f"bytes that are not those that were written ({fault})",
            expected="a map as `dataset build` wrote it",
            hint=LACKING,
        )
    return found
