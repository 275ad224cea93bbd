"""What the rounding of a store's numbers reveals of a published patch, and what hiding it costs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from processing.dataset.publish import published_places, read_patch
from processing.dataset.release_files import kind_of
from processing.dataset.store import Store
from tests.processing.releases import SIZE, SMALL, small_store


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory, make_processed: Callable[..., Path]) -> Store:
    return small_store(tmp_path_factory.mktemp("small"), make_processed)


class Bumpy(Store):
    """A store whose normals and positions have relief, and are rounded as a store's are."""

    def read(self, scan: int, name: str, rows: slice, columns: slice) -> np.ndarray:
        if name not in ("diffuse_normal", "specular_normal", "position"):
            return super().read(scan, name, rows, columns)
        whole = super().read(scan, name, slice(None), slice(None))
        bumps = np.random.default_rng(len(name)).normal(size=whole.shape)
        known = (whole != 0).any(axis=2, keepdims=True)
        if name == "position":
            return np.asarray((whole + bumps) * known, np.float32)[rows, columns]
        turned = whole + 0.3 * bumps
        turned /= np.linalg.norm(turned, axis=2, keepdims=True)
        return (turned * known).astype(np.float16)[rows, columns].astype(np.float32)


def steps_shown(values: np.ndarray, step: float, least: float) -> float:
    """How far (n, 3) numbers keep to multiples of a step, against what chance gives: about 1."""
    found = []
    for own in values.T:
        own = own[np.abs(own) >= least]
        if len(own) >= 40:
            found.append(abs(np.exp(2j * np.pi * own / step).mean()) * np.sqrt(len(own)))
    return max(found, default=0.0)


@pytest.mark.parametrize(
    ("name", "step", "least"),
    [("diffuse_normal", 2.0**-11, 0.5), ("specular_normal", 2.0**-11, 0.5), ("shape", 2.0**-17, 0)],
)
def test_the_rounding_of_stored_numbers_does_not_reveal_a_patchs_axes(
    store: Store, name: str, step: float, least: float
) -> None:
    """Along the head's axes stored numbers are multiples of a float's step, along no others."""
    bumpy = Bumpy(store.path, store.scans, store.fingerprint)
    own, others, rng = [], [], np.random.default_rng(0)
    for place in published_places(bumpy, SMALL.layout(bumpy), 0.2):
        maps, _ = read_patch(bumpy, place, SIZE)
        values = maps[name].astype(kind_of(name)).astype(float)
        values = values[(values != 0).any(axis=2)]
        values = values - values[0] if name == "shape" else values
        own.append(steps_shown(values @ place.axes, step, least))
        others.append(steps_shown(values @ Rotation.random(rng=rng).as_matrix(), step, least))
    assert len(own) > 20
    assert np.mean(own) < 1.5 * np.mean(others)


def test_directions_and_shape_differ_from_the_stores_by_less_than_anybody_measures(
    store: Store,
) -> None:
    bumpy = Bumpy(store.path, store.scans, store.fingerprint)
    for place in published_places(bumpy, SMALL.layout(bumpy), 0.2):
        here = slice(place.row, place.row + SIZE), slice(place.column, place.column + SIZE)
        maps, seen = read_patch(bumpy, place, SIZE)
        for name, stored, most in (
            ("specular_normal", "specular_normal", 0.0003),
            ("shape", "position", 0.00005),
        ):
            picture = maps[name][:, ::-1] if place.mirrored else maps[name]
            inside = seen[:, ::-1] if place.mirrored else seen
            picture, inside = (np.rot90(p, -place.quarter_turns) for p in (picture, inside))
            found = picture[inside] @ place.axes
            true = bumpy.read(place.scan, stored, *here)[inside].astype(float)
            if name == "shape":
                true = true - true.mean(axis=0)
            assert np.abs(found - true).max() < most
