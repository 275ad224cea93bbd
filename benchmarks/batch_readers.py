"""Patches a second from a store, from tars and from whole EXR files, by several readers at once."""

from __future__ import annotations

import io
import itertools
import multiprocessing
import shutil
import tarfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np

from benchmarks.dataset import write_scan
from lightstage.formats.files import write_json
from lightstage.formats.processed import ProcessedFolder
from processing.dataset import PublishConfig, build_store, open_store, publish, read_about
from processing.dataset.release_files import CHANNELS

READERS = (1, 2, 4)
READ_ROWS, READ_COLUMNS = 1536, 1024
SIDE = READ_ROWS // 12
"""Of a patch, texels."""
ABOUT = Path(__file__).parents[1] / "demo" / "about.toml"
Form = Literal["store", "tars", "EXR files"]
Patch = dict[str, np.ndarray]


def patches_a_second(place: Path, seconds: float) -> dict[str, dict[str, float]]:
    """Make two scans, their store and tars, and read them.

    Args:
        place: folder, made anew.
        seconds: that readers read.

    Returns:
        By form and number of readers.
    """
    shutil.rmtree(place, ignore_errors=True)
    folders = []
    for index in range(2):
        folder = ProcessedFolder(place / "people" / f"{index}")
        write_scan(folder, np.random.default_rng(index), READ_ROWS, READ_COLUMNS)
        report = {"subject": f"P{index}", "expression": "neutral", "consent": "C-1"}
        write_json(folder.root / "report.json", report)
        folders.append(folder.root)
    store = open_store(build_store(folders, place / "store"))
    config = PublishConfig(form="webdataset", most_face=1.0)
    publish(store, place / "tars", 0, config, about=read_about(ABOUT))
    rates: dict[str, dict[str, float]] = {}
    context = multiprocessing.get_context("spawn")
    for form in ("store", "tars", "EXR files"):
        for count in READERS:
            ready = context.Barrier(count)
            counts = context.Queue()
            orders = [(form, place, seconds, seed, ready, counts) for seed in range(count)]
            readers = [context.Process(target=read_on, args=each) for each in orders]
            for reader in readers:
                reader.start()
            rates.setdefault(form, {})[str(count)] = sum(counts.get() for _ in readers)
            for reader in readers:
                reader.join()
    return rates


def read_on(form: Form, place: Path, seconds: float, seed: int, ready: Any, counts: Any) -> None:
    """One reader: patches a second from when all readers are ready."""
    source = {"store": store_patches, "tars": tar_patches, "EXR files": exr_patches}[form]
    patches = source(place, np.random.default_rng(seed))
    next(patches)
    ready.wait()
    began, count = time.perf_counter(), 0
    while time.perf_counter() - began < seconds:
        found = next(patches)
        assert len(found) == len(CHANNELS)
        count += 1
    counts.put(count / (time.perf_counter() - began))


def somewhere(rng: np.random.Generator) -> tuple[slice, slice]:
    row, column = (int(rng.integers(size - SIDE)) for size in (READ_ROWS, READ_COLUMNS))
    return slice(row, row + SIDE), slice(column, column + SIDE)


def store_patches(place: Path, rng: np.random.Generator) -> Iterator[Patch]:
    """Random patches, as training reads them."""
    store = open_store(place / "store")
    names = [name if name != "shape" else "position" for name in CHANNELS]
    while True:
        scan, where = int(rng.integers(len(store.scans))), somewhere(rng)
        yield {name: store.read(scan, name, *where) for name in names}


def tar_patches(place: Path, rng: np.random.Generator) -> Iterator[Patch]:
    """All patches in the order of the tars, again and again, as webdataset reads them."""
    paths = sorted((place / "tars").glob("*.tar"))
    for path in itertools.cycle(rng.permutation(np.array(paths, object)).tolist()):
        with tarfile.open(path) as tar:
            patch: Patch = {}
            for member in tar:
                file = tar.extractfile(member)
                assert file is not None
                name = member.name.split(".")[1]
                patch[name] = np.load(io.BytesIO(file.read())).astype(np.float32)
                if len(patch) == len(CHANNELS):
                    yield patch
                    patch = {}


def exr_patches(place: Path, rng: np.random.Generator) -> Iterator[Patch]:
    """Random patches, each cut from whole files that are read for it."""
    folders = sorted((place / "people").iterdir())
    names = [name if name != "shape" else "position" for name in CHANNELS]
    while True:
        folder = ProcessedFolder(folders[int(rng.integers(len(folders)))])
        where = somewhere(rng)
        yield {name: folder.read_atlas(name)[where] for name in names}
