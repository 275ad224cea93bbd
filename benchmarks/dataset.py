"""A random 512 patch of a 6144 x 4096 scan: the store against whole EXR files and plain arrays."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.record import record
from lightstage.formats.files import write_json
from lightstage.formats.processed import MAPS, ProcessedFolder
from processing.dataset import CHANNELS, build_store, open_store

ROWS, COLUMNS, PATCH = 6144, 4096, 512
NAMES = [name for name in CHANNELS if name != "confidence"]


def write_scan(
    folder: ProcessedFolder, rng: np.random.Generator, rows: int = ROWS, columns: int = COLUMNS
) -> None:
    """Maps with pores and noise, as hard to compress as measured ones."""
    v, u = np.meshgrid(
        np.linspace(0, 1, rows, dtype=np.float32),
        np.linspace(0, 1, columns, dtype=np.float32),
        indexing="ij",
    )
    for name, channels in CHANNELS.items():
        layers = []
        for channel in range(channels):
            smooth = np.sin(6 * u + channel) * np.cos(4 * v + channel)
            noise = rng.standard_normal((rows, columns), dtype=np.float32)
            layers.append(0.5 + 0.3 * smooth + 0.01 * noise)
        image = np.stack(layers, axis=2)
        folder.write_atlas(name, np.ones_like(image) if name == "confidence" else image)
    folder.write_atlas("skin", np.ones((rows, columns), np.float32))
    write_json(folder.head_pose, {"head_from_world": np.eye(3, 4).tolist()})
    write_json(folder.root / "report.json", {"subject": "bench", "expression": "neutral"})


def milliseconds(read: Callable[[int, int], object], places: np.ndarray) -> float:
    """Median time of a patch."""
    spent = []
    for row, column in places.tolist():
        start = time.perf_counter()
        read(row, column)
        spent.append(time.perf_counter() - start)
    return 1e3 * float(np.median(spent))


def size_mb(path: Path) -> float:
    return sum(p.stat().st_size for p in path.rglob("*") if p.is_file()) / 1e6


def main() -> None:
    rng = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as scratch:
        root = Path(scratch)
        folder = ProcessedFolder(root / "scan")
        write_scan(folder, rng)
        start = time.perf_counter()
        store = open_store(build_store([folder.root], root / "store"))
        built_s = time.perf_counter() - start
        (root / "plain").mkdir()
        plain = {}
        for name in NAMES:
            image = folder.read_atlas(name).reshape(ROWS, COLUMNS, -1)
            kind = np.float16 if MAPS[name].half else np.float32
            np.save(root / "plain" / f"{name}.npy", image.astype(kind))
            plain[name] = np.load(root / "plain" / f"{name}.npy", mmap_mode="r")
            del image

        def from_store(row: int, column: int) -> dict[str, np.ndarray]:
            part = slice(row, row + PATCH), slice(column, column + PATCH)
            return {name: store.read(0, name, *part) for name in NAMES}

        def from_exr(row: int, column: int) -> dict[str, np.ndarray]:
            part = slice(row, row + PATCH), slice(column, column + PATCH)
            return {name: folder.read_atlas(name)[part] for name in NAMES}

        def from_plain(row: int, column: int) -> dict[str, np.ndarray]:
            part = slice(row, row + PATCH), slice(column, column + PATCH)
            return {name: plain[name][part].astype(np.float32) for name in NAMES}

        places = rng.integers(0, [ROWS - PATCH, COLUMNS - PATCH], (40, 2))
        first = places[0].tolist()
        expected = from_exr(*first)
        rows = []
        sizes = {"EXR": folder.root / "atlas", "store": store.path, "plain": root / "plain"}
        readers = {"EXR": from_exr, "store": from_store, "plain": from_plain}
        labels = {
            "EXR": "whole EXR files (OpenEXR 3.5, ZIP)",
            "store": "the store (zarr v3, chunk 256, shard 2048, zstd)",
            "plain": "uncompressed .npy, memory-mapped",
        }
        spent = {
            name: milliseconds(read, places[:2] if name == "EXR" else places)
            for name, read in readers.items()
        }
        for name, read in readers.items():
            found = read(*first)
            error = max(
                float(abs(found[n].reshape(-1) - expected[n].reshape(-1)).max()) for n in NAMES
            )
            ratio = spent["EXR"] / spent[name]
            size = size_mb(sizes[name])
            cells = [f"{spent[name]:.1f}", f"{ratio:.1f}", f"{error:.1e}", f"{size:.0f}"]
            rows.append([labels[name], *cells])
    record(
        "Dataset: one random patch",
        ["reader", "ms a patch", "times faster than EXR", "largest difference", "MB on disk"],
        rows,
        f"Patch of {PATCH}, 13 channels, of a {ROWS} x {COLUMNS} scan in the page cache; median of "
        f"40 (EXR: 2) patches; building the store took {built_s:.0f} s.",
    )


if __name__ == "__main__":
    main()
