"""The lab's store: whole maps of every scan in the head frame, read patch by patch (zarr v3).

    STORE/
      dataset.json              lightstage.realfacedb/1: channels, counts, statistics, scans
      scans/0000/NAME/          one zarr array a map, chunks of 256 in shards of 2048

A chunk is what one read decodes, a shard what one file holds: a random 512 patch costs four to
nine chunks whatever the map's size, and 6144 x 4096 makes six files a map.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import shlex
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import zarr

from lightstage.commands import ProgressCallback, quiet
from lightstage.errors import LightstageError, one_error
from lightstage.formats.files import atomic_folder, check_schema, read_json, write_json
from processing.dataset.arrays import open_whole, read_part, written_whole
from processing.dataset.scan import CHANNELS, DatasetError, ScanEntry, holds_scans, read_scan
from processing.dataset.statistics import Statistics

SCHEMA = "lightstage.realfacedb/1"
DATASET = "dataset.json"
STORE, PUBLISHED = "store", "published"
"""Kinds of a dataset; a command replaces only its own."""
NOT_FOR_TRAINING = (
    "Published patches lack what training takes besides them: the whole texture (the network's "
    "second input), the place in it (cast shadows) and the person (to hold some people out). "
    "docs/dataset.md opens them."
)
AVERAGED = ("diffuse_albedo", "specular_albedo")
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
    """

    index: int
    subject: str
    expression: str
    rows: int
    columns: int
    sha256: str = ""
    consent: str | None = None
    synthetic: bool = False


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
        return self.path / "scans" / f"{scan:04d}" / name


_open_array = functools.lru_cache(maxsize=1024)(open_whole)


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


def build_store(processed: Sequence[Path], out: Path, progress: ProgressCallback = quiet) -> Path:
    """Gather the atlas maps of processed folders into one store.

    Every folder is read and checked before anything is said; on an error nothing is left behind.

    Args:
        processed: folders with atlas/, head_from_world.json and report.json (subject, expression,
            and the id of the record of the person's consent where there is one).
        out: the store's folder; an older store there is replaced.
        progress: called after each folder.

    Returns:
        `out`.

    Raises:
        FormatError, DatasetError: no folder, something that is no processed folder, a missing map,
            maps or atlases of different size, NaN, a missing or not rigid head_from_world, a folder
            given twice, a scan of the same files, a pseudonym of two people; all in one message.
    """
    if not processed:
        raise DatasetError(
            "dataset build",
            found="no processed folder among what was named",
            expected="at least one",
            hint="Name folders that `lightstage-processing run` made, as P/*.",
        )
    problems: list[LightstageError] = []
    entries: list[ScanEntry] = []
    first: tuple[Path, ScanEntry] | None = None
    known: dict[str, tuple[Path, ScanEntry]] = {}
    files: dict[tuple[str, str, str], Path] = {}
    simulated: dict[tuple[str, str], Path] = {}
    statistics = Statistics({name: CHANNELS[name] for name in AVERAGED})
    with atomic_folder(out, DATASET, STORE) as beside:
        for index, root in enumerate(processed):
            try:
                if root.resolve() in {p.resolve() for p in processed[:index]}:
                    raise DatasetError(root, found="the same folder twice", expected="once")
                entry, maps = read_scan(root)
                first = first or (root, entry)
                _require_same_size(root, entry, *first)
                _require_same_person(root, entry, *known.setdefault(entry.subject, (root, entry)))
                who = (entry.subject, entry.expression)
                _require_other_files(root, files.setdefault((*who, entry.sha256), root))
                if entry.synthetic:
                    _require_one_draw(root, entry, simulated.setdefault(who, root))
                if not problems:
                    _write_scan(beside / "scans" / f"{index:04d}", maps)
                entries.append(entry)
                statistics.add(maps, maps["confidence"][:, :, 0] > 0)
            except LightstageError as error:
                problems.append(error)
            progress(index + 1, len(processed))
        if problems:
            raise one_error(problems)
        write_json(
            beside / DATASET,
            {
                "schema": SCHEMA,
                "kind": STORE,
                "patch": PATCH,
                "stride": STRIDE,
                "channels": CHANNELS,
                "frame": "head",
                "counts": {
                    "subjects": len({entry.subject for entry in entries}),
                    "scans": len(entries),
                },
                "statistics": statistics.facts(),
                "fingerprint": hashlib.sha256(
                    "".join(entry.sha256 for entry in entries).encode()
                ).hexdigest(),
                "scans": [dataclasses.asdict(entry) for entry in entries],
            },
        )
    return out


def _require_same_size(root: Path, entry: ScanEntry, first_root: Path, first: ScanEntry) -> None:
    """Refuse an atlas of another size: its texels would be other places and its pores larger."""
    if (entry.rows, entry.columns) != (first.rows, first.columns):
        raise DatasetError(
            root / "atlas",
            found=f"{entry.rows} x {entry.columns} texels",
            expected=f"{first.rows} x {first.columns}, as {first_root / 'atlas'} has",
            hint="Make all atlases of a store again with one --atlas-rows.",
        )


def _require_same_person(root: Path, entry: ScanEntry, own_root: Path, own: ScanEntry) -> None:
    """Refuse a pseudonym of two people: one would be trained on while the other is held out."""
    if entry.synthetic != own.synthetic:
        whose = {True: "a simulated person's", False: "a captured person's"}
        raise DatasetError(
            root,
            field="subject",
            found=f"{entry.subject!r}, {whose[entry.synthetic]}",
            expected=f"a pseudonym of its own: in {own_root} it is {whose[own.synthetic]}",
            hint="Leave one of them out, or make one under another pseudonym. What was "
            "photographed on the simulated stage and processed counts as captured.",
        )


def _require_other_files(root: Path, own_root: Path) -> None:
    """Refuse a copy of a scan: it would count twice, and might be tested on what was trained on."""
    if root != own_root:
        raise DatasetError(
            root,
            found=f"the same files as {own_root}",
            expected="a scan of its own",
            hint="Leave one of the two out.",
        )


def _require_one_draw(root: Path, entry: ScanEntry, own_root: Path) -> None:
    """Refuse two simulated scans of one pseudonym and expression: they are of two people."""
    if root != own_root:
        raise DatasetError(
            root,
            field="subject",
            found=f"{entry.subject!r}, {entry.expression}, which {own_root} is already",
            expected="a pseudonym of its own",
            hint="Two calls of `lightstage-sim dataset` give their people the same names. Make all "
            "of them in one call, with more --subjects.",
        )


def _write_scan(folder: Path, maps: dict[str, np.ndarray]) -> None:
    for name, image in maps.items():
        rows, columns, channels = image.shape
        chunk = (min(CHUNK, rows), min(CHUNK, columns), channels)
        # A shard holds a whole number of chunks; a small map is one shard.
        shard = tuple(
            min(SHARD, -(-size // part) * part)
            for size, part in zip((rows, columns), chunk[:2], strict=True)
        )
        array = zarr.create_array(
            folder / name,
            shape=image.shape,
            dtype="float32" if name == "position" else "float16",
            chunks=chunk,
            shards=(*shard, channels),
            **written_whole(),
        )
        array[:] = image.astype(array.dtype)
