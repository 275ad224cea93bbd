"""The files of a release: one zarr group, or tars in the naming of webdataset; their checksums.

    PUB/patches-000000.tar      0000000.diffuse_albedo.npy, 0000000.specular_albedo.npy, ...

Before the first dot is a patch's number, after it the map. Nothing besides the
patches themselves shows which belong together: all parts of a map have one size, since packing
would make them as small as a person's skin is smooth, and all files have one time.
"""

from __future__ import annotations

import io
import os
import tarfile
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import zarr

from lightstage.commands import ProgressCallback, quiet
from lightstage.formats.files import read_json, sha256_file, write_json
from processing.dataset.arrays import written_whole
from processing.dataset.hashes import differences
from processing.dataset.scan import DatasetError

CHANNELS: dict[str, int] = {
    "diffuse_albedo": 3,
    "specular_albedo": 1,
    "diffuse_normal": 3,
    "specular_normal": 3,
    "shape": 3,
}
AXES = ("patch", "row", "column", "channel")
FORMS = ("zarr", "webdataset")
TAR_PATCHES = 256
"""Patches of a tar."""
TARS = "patches-*.tar"
FILE_TIME_S = 315532800
"""Time of all files and folders of a release: 1980, the first day that every archive can write."""
COPY_AGAIN = "Copy the release again from where it is whole."
CHECKSUMS, CHECKSUMS_SCHEMA = "checksums.json", "lightstage.checksums/1"


def kind_of(name: str) -> type[np.floating[Any]]:
    """The numbers of a published map."""
    return np.float32 if name == "shape" else np.float16


class ReleaseWriter(Protocol):
    """Takes patches in the order of the release."""

    def write(self, first: int, blocks: Mapping[str, np.ndarray]) -> None:
        """Write patches from number `first` on: by map (n, size, size, channels) float32."""

    def close(self) -> None:
        """Write what is left."""


class ZarrRelease:
    """One zarr group with an array a map."""

    def __init__(self, folder: Path, count: int, size: int, shard_patches: int) -> None:
        """A group for `count` patches of `size` texels, so many in a file."""
        self._folder = folder
        group = zarr.create_group(folder, zarr_format=3, attributes={"about": "dataset.json"})
        self._arrays = {
            name: group.create_array(
                name,
                shape=(count, size, size, channels),
                dtype=np.dtype(kind_of(name)).name,
                chunks=(1, size, size, channels),
                shards=(min(shard_patches, count), size, size, channels),
                dimension_names=AXES,
                **{**written_whole(), "compressors": (zarr.codecs.Crc32cCodec(),)},
            )
            for name, channels in CHANNELS.items()
        }

    def write(self, first: int, blocks: Mapping[str, np.ndarray]) -> None:
        """See `ReleaseWriter`."""
        for name, block in blocks.items():
            self._arrays[name][first : first + len(block)] = block.astype(kind_of(name))

    def close(self) -> None:
        """Put the arrays' metadata into the group's, so that readers need not list the folder.

        Listing it, zarr warns of dataset.json, which is no part of the group.
        """
        with warnings.catch_warnings():
            # Zarr warns that the format's text does not define this yet; readers without it list.
            warnings.simplefilter("ignore")
            zarr.consolidate_metadata(self._folder)


class TarRelease:
    """Tars of `TAR_PATCHES` patches each."""

    def __init__(self, folder: Path) -> None:
        """Tars in a folder that is there."""
        self._folder = folder
        self._tar: tarfile.TarFile | None = None

    def write(self, first: int, blocks: Mapping[str, np.ndarray]) -> None:
        """See `ReleaseWriter`."""
        for index in range(len(blocks["shape"])):
            number = first + index
            if number % TAR_PATCHES == 0 or self._tar is None:
                self.close()
                name = f"patches-{number // TAR_PATCHES:06d}.tar"
                path = self._folder / name
                self._tar = tarfile.TarFile(path, "w", format=tarfile.USTAR_FORMAT)
            for each in CHANNELS:
                data = io.BytesIO()
                np.save(data, np.ascontiguousarray(blocks[each][index].astype(kind_of(each))))
                # Its time, owner and group are 0 and nobody's until somebody sets them.
                member = tarfile.TarInfo(f"{number:07d}.{each}.npy")
                member.size = data.tell()
                data.seek(0)
                self._tar.addfile(member, data)

    def close(self) -> None:
        """End the last tar."""
        if self._tar is not None:
            self._tar.close()
            self._tar = None


def write_checksums(folder: Path) -> Path:
    """Write checksums.json: the SHA-256 of every other file of a release."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    sums = {str(path.relative_to(folder)): sha256_file(path) for path in files}
    return write_json(folder / CHECKSUMS, {"schema": CHECKSUMS_SCHEMA, "files": sums})


def verify_release(folder: Path, progress: ProgressCallback = quiet) -> int:
    """Hold every file of a release against checksums.json.

    Args:
        folder: of the release.
        progress: called after each file.

    Returns:
        Files that were compared.

    Raises:
        DatasetError: all files that are missing, changed or not of the release, in one message.
        FormatError: checksums.json is missing or no list of hashes.
    """
    listed = folder / CHECKSUMS
    known = read_json(listed, CHECKSUMS_SCHEMA).get("files")
    if not isinstance(known, dict) or not all(isinstance(each, str) for each in known.values()):
        raise DatasetError(
            listed,
            field="files",
            found=type(known).__name__ if not isinstance(known, dict) else "hashes of another type",
            expected="an object: the SHA-256 of each file",
            hint=COPY_AGAIN,
        )
    if wrong := differences(folder, known, CHECKSUMS, "the release", progress):
        raise DatasetError(
            folder, found=wrong, expected="the files that were published", hint=COPY_AGAIN
        )
    return len(known)


def give_one_time(folder: Path) -> None:
    """Give all files and folders of a release one time, so that it does not show their order."""
    for path in (*folder.rglob("*"), folder):
        os.utime(path, (FILE_TIME_S, FILE_TIME_S))
