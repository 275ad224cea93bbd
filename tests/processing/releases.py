"""A small store, and the settings under which tests publish it."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path

import numpy as np
import zarr

import processing.dataset
from processing.dataset import About, PublishConfig, Store, build_store, open_store
from tests.documents import ROOT

Make = Callable[..., Path]
SIZE, GAP = 16, 4
SMALL = PublishConfig(
    patch_px=SIZE,
    gap=GAP / SIZE,
    wander=0.25,
    drop=0.0,
    most_face=0.2,
    min_coverage=0.3,
    shard_patches=4,
)
ABOUT_FILE = ROOT / "demo" / "about.toml"
ABOUT = About(
    name="Patches of a test",
    license="https://creativecommons.org/licenses/by-nc/4.0/",
    terms="For tests alone.",
    creators=("The lab", "Another lab"),
    contact="somebody@example.org",
    url="https://example.org/patches",
)
publish = functools.partial(processing.dataset.publish, about=ABOUT)
SEED = 8675309886753098867
PEOPLE = ("anna-kowalska-77", "bo-larsson-12", "chidi-okoro-31")


class InMemory(Store):
    """A store whose maps are each read once: zarr takes a millisecond for every patch of one."""

    def read(self, scan: int, name: str, rows: slice, columns: slice) -> np.ndarray:
        return _whole(self, scan, name)[rows, columns].copy()


@functools.cache
def _whole(store: InMemory, scan: int, name: str) -> np.ndarray:
    return Store.read(store, scan, name, slice(None), slice(None))


def open_in_memory(path: Path) -> Store:
    """open_store, for a store that does not change."""
    store = open_store(path)
    return InMemory(store.path, store.scans, store.fingerprint)


def small_store(folder: Path, make_processed: Make) -> Store:
    """Three people, one expression each."""
    roots = [
        make_processed(folder / "in" / name, 192, 128, name, "grin-wide", index, None, f"C-{index}")
        for index, name in enumerate(PEOPLE)
    ]
    return open_in_memory(build_store(roots, folder / "store"))


def read(out: Path, name: str) -> np.ndarray:
    """All patches of a channel."""
    return np.asarray(zarr.open_group(out, mode="r")[name][:])
