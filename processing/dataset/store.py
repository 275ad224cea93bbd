"""The lab's store: whole maps of every scan in the head frame, read patch by patch (zarr v3).

    STORE/
      dataset.json              lightstage.realfacedb/2: channels, counts, statistics, scans
      scans/SCAN/NAME/          one zarr array a map, chunks of 256 in shards of 2048
      scans/SCAN/shards.json    SHA-256 of each file of the scan

A chunk is what one read decodes, a shard what one file holds: a random 512 patch costs four to
nine chunks whatever the map's size, and 6144 x 4096 makes six files a map. scan.py has
the fields of a scan (`ScanEntry`) and the maps of a store (`CHANNELS`).
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import shlex
from pathlib import Path

import numpy as np

from lightstage.formats.files import check_schema, read_json
from lightstage.formats.paths import check_name
from processing.dataset.arrays import open_whole, read_part
from processing.dataset.scan import CHANNELS, DatasetError, holds_scans

SCHEMA = "lightstage.realfacedb/2"
PUBLISHED_SCHEMA = "lightstage.realfacedb/1"
DATASET = "dataset.json"
SCANS = "scans"
STORE, PUBLISHED = "store", "published"
"""Kinds of a dataset; a command replaces only its own."""
NOT_FOR_TRAINING = (
    "Published patches lack what training takes besides them: the whole texture (the network's "
    "second input), the place in it (cast shadows) and the person (to hold some people out). "
    "docs/dataset.md opens them."
)
NO_SCANS = (
    "Published patches belong to no scan; `lightstage-processing dataset verify` compares a "
    "release's files with its checksums.json."
)
PATCH = 512
STRIDE = 256
CHUNK = 256
SHARD = 2048


@dataclasses.dataclass(frozen=True)
class Scan:
    """One scan of a store: its number, whose it is, the size of its maps.

    Attributes:
        index: in the store.
        subject: the person's pseudonym.
        expression: such as ``neutral``.
        rows: of the maps.
        columns: of the maps.
        sha256: of the files that it was made of.
        consent: id of the record of the person's consent, None where there is none.
        synthetic: a simulated person, who needs none.
        folder: in the store's `scans`.
        has_sums: whether the store keeps what its statistics are made of, and more of the scan
            (`contents.Entry`); those of earlier versions do not.
    """

    index: int
    subject: str
    expression: str
    rows: int
    columns: int
    sha256: str = ""
    consent: str | None = None
    synthetic: bool = False
    folder: str = ""
    has_sums: bool = False

    @property
    def trace(self) -> str:
        """What a checkpoint knows the scan by; empty where it has no `sha256`."""
        return trace_of(self.sha256) if self.sha256 else ""


def trace_of(sha256: str) -> str:
    """A hash of a scan's SHA-256, for what leaves the lab as weights do.

    The SHA-256 itself must not go with them: it draws the places and the turns of a person's
    published patches (`places.places_of`).
    """
    return hashlib.sha256(f"a network was trained on {sha256}".encode()).hexdigest()


@dataclasses.dataclass(frozen=True)
class Store:
    """A store that was opened; arrays are opened when first read.

    Attributes:
        path: the folder.
        scans: in the order of their index. Split them by `subject`, never by patch.
        fingerprint: SHA-256 over all that went in; a checkpoint names it.
    """

    path: Path
    scans: tuple[Scan, ...]
    fingerprint: str

    @property
    def consents(self) -> dict[str, str | None]:
        """Consent ids by scan, of all that need one; a simulated person needs none."""
        return {
            f"{scan.subject}, {scan.expression}, scan {scan.folder}": scan.consent
            for scan in self.scans
            if not scan.synthetic
        }

    def read(self, scan: int, name: str, rows: slice, columns: slice) -> np.ndarray:
        """Part of a map.

        Args:
            scan: index of the scan.
            name: one of `CHANNELS`.
            rows: of the texture, from the top.
            columns: of the texture.

        Returns:
            (h, w, c) float32; normals and position in the head frame, zero where no surface is.

        Raises:
            DatasetError: no such scan or map, or one that was damaged since it was written.
        """
        path = self._path(scan, name)
        return np.asarray(read_part(_open_array(path), path, rows, columns), np.float32)

    def patch_origins(
        self, scan: int, size: int, stride: int, min_coverage: float
    ) -> list[tuple[int, int]]:
        """Top-left corners of the patches of a scan that show enough of the face.

        Args:
            scan: index of the scan.
            size: side of a patch in texels.
            stride: step from patch to patch in texels, from the corner (0, 0).
            min_coverage: smallest share of a patch's texels whose confidence is above 0.

        Returns:
            (row, column) of each, in row order; empty where the maps are smaller than a patch.
        """
        if size < 1 or stride < 1:
            raise DatasetError(
                self.path,
                field="patch",
                found=f"size {size}, stride {stride}",
                expected="at least 1 texel",
            )
        seen = self.read(scan, "confidence", slice(None), slice(None))[:, :, 0] > 0
        total = np.zeros((seen.shape[0] + 1, seen.shape[1] + 1), np.int64)
        total[1:, 1:] = seen.cumsum(axis=0, dtype=np.int64).cumsum(axis=1)
        fewest = min_coverage * size * size
        return [
            (row, column)
            for row in range(0, seen.shape[0] - size + 1, stride)
            for column in range(0, seen.shape[1] - size + 1, stride)
            if total[row + size, column + size]
            - total[row, column + size]
            - total[row + size, column]
            + total[row, column]
            >= fewest
        ]

    def _path(self, scan: int, name: str) -> Path:
        if name not in CHANNELS or not 0 <= scan < len(self.scans):
            raise DatasetError(
                self.path,
                field=f"scan {scan}, map {name}",
                found="no such thing",
                expected=f"scans 0..{len(self.scans) - 1}, maps {', '.join(CHANNELS)}",
            )
        return self.path / SCANS / self.scans[scan].folder / name


_open_array = functools.lru_cache(maxsize=1024)(open_whole)


def is_release(path: Path) -> bool:
    """Whether a folder's dataset.json is that of a published set; FormatError if unreadable."""
    file = path / DATASET
    if not file.exists():
        return False
    value = read_json(file)
    return isinstance(value, dict) and value.get("kind") == PUBLISHED


def open_store(path: Path, not_published: str = NOT_FOR_TRAINING) -> Store:
    """Open a store for reading.

    Args:
        path: the folder.
        not_published: why the caller takes no published set, for the message that refuses one.

    Raises:
        FormatError, DatasetError: no dataset.json, one of another schema, or a published set,
            which holds patches and no maps.
    """
    file = path / DATASET
    if not file.exists() and holds_scans(path):
        raise DatasetError(
            path,
            found="a folder of processed folders",
            expected="a store",
            hint="Gather them first: lightstage-processing dataset build "
            f"{shlex.quote(str(path))}/* --out STORE",
        )
    if not file.exists():
        raise DatasetError(
            path,
            found="no dataset.json" if path.is_dir() else "no such folder",
            expected="a store",
            hint="Name the folder that `lightstage-processing dataset build` wrote.",
        )
    value = read_json(file)
    check_schema(file, value, SCHEMA)
    if value.get("kind") != STORE:
        raise DatasetError(
            file,
            field="kind",
            found=repr(value.get("kind")),
            expected=repr(STORE),
            hint=f"Name the store that `dataset build` made. {not_published}",
        )
    try:
        scans = tuple(
            Scan(
                i,
                str(s["subject"]),
                str(s["expression"]),
                int(s["rows"]),
                int(s["columns"]),
                str(s["sha256"]),
                s.get("consent"),
                s.get("synthetic") is True,
                # Stores of before scans came and went one by one have numbers there.
                check_name(s.get("folder", f"{i:04d}"), file, f"scans[{i}].folder"),
                "sums" in s,
            )
            for i, s in enumerate(value["scans"])
        )
        fingerprint = str(value["fingerprint"])
        for digest in (fingerprint, *(scan.sha256 for scan in scans)):
            int(digest, 16)
    except (KeyError, TypeError, ValueError) as error:
        raise DatasetError(file, found=str(error), expected="scans and fingerprint") from None
    _open_array.cache_clear()
    return Store(path, scans, fingerprint)
