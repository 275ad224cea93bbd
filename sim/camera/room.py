"""Room light: what reaches the subject when every lamp is dark."""

from __future__ import annotations

import functools

import numpy as np
from scipy.spatial import cKDTree

from sim.light.lamps import Lamps

DIRECTIONS = 20_000


def even_levels(lamps: Lamps) -> np.ndarray:
    """Levels of the stage's lamps that make the field nearest to light from everywhere.

    Each lamp represents the directions nearest to it. So room light needs no renderer of its own:
    it is one more state of the lamps, with the subject's shadows.

    Args:
        lamps: what can shine.

    Returns:
        (m,) at least 0, not bounded by 1: a white diffuser in the middle reads about 1 whichever
        way it faces. Lamps of no light are left out.
    """
    weights = lamps.weights.mean(axis=1)
    alive = np.flatnonzero(weights > 0)
    # Integrated over the sphere, cosine / pi gives a diffuser its reading of an even field.
    weights_wanted = _shares(lamps.positions_mm[alive].tobytes(), len(alive)) * 4.0
    levels = np.zeros(len(weights))
    levels[alive] = weights_wanted / weights[alive]
    return levels


@functools.lru_cache(maxsize=4)
def _shares(positions: bytes, count: int) -> np.ndarray:
    """(count,) share of all directions that are nearest to each of the places; sums to 1."""
    place = np.frombuffer(positions).reshape(count, 3)
    index = np.arange(DIRECTIONS) + 0.5
    height, angle = 1 - 2 * index / DIRECTIONS, index * np.pi * (3 - np.sqrt(5))
    ring = np.sqrt(1 - height**2)
    directions = np.stack([ring * np.cos(angle), height, ring * np.sin(angle)], axis=1)
    nearest = cKDTree(place / np.linalg.norm(place, axis=1, keepdims=True)).query(directions)[1]
    return np.bincount(nearest, minlength=count) / DIRECTIONS
