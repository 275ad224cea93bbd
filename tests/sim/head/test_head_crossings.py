"""No head of the model runs through itself: counted as registration counts it."""

from __future__ import annotations

import numpy as np
import pytest

from lightstage.formats.mesh import Mesh
from processing.registration.flips import crossing_triangles
from sim.head.mesh import neutral_mesh
from sim.head.parametric import random_head


def crossings(mesh: Mesh) -> int:
    """Triangles that cross another one of the same mesh."""
    return int(crossing_triangles(mesh.vertices, mesh.triangles()).sum())


def test_the_mean_head_does_not_cross_itself() -> None:
    assert crossings(neutral_mesh()) == 0


@pytest.mark.parametrize("seed", range(4))
def test_random_heads_do_not_cross_themselves(seed: int) -> None:
    assert crossings(random_head(np.random.default_rng(seed))) == 0


def test_a_nose_pulled_through_the_head_is_counted() -> None:
    mesh = neutral_mesh()
    vertices = mesh.vertices.copy()
    vertices[np.argmax(vertices[:, 2])] -= [0.0, 0.0, 400.0]
    assert crossings(mesh.with_vertices(vertices)) > 0
