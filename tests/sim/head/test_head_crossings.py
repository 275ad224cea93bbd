"""No head of the model runs through itself: counted by pymeshlab, another hand."""

from __future__ import annotations

import numpy as np
import pytest

from lightstage.formats.mesh import Mesh
from sim.head.parametric import parametric_head, random_head


def crossing_triangles(mesh: Mesh) -> int:
    """Triangles that cross another one of the same mesh."""
    pymeshlab = pytest.importorskip("pymeshlab", reason="needs the extra `dev`")
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(mesh.vertices, mesh.triangles()))
    meshes.compute_selection_by_self_intersections_per_face()
    return int(meshes.current_mesh().selected_face_number())


def test_the_mean_head_does_not_cross_itself() -> None:
    assert crossing_triangles(parametric_head(np.zeros(1))) == 0


@pytest.mark.parametrize("seed", range(4))
def test_random_heads_do_not_cross_themselves(seed: int) -> None:
    assert crossing_triangles(random_head(np.random.default_rng(seed))) == 0


def test_a_nose_pulled_through_the_head_is_counted() -> None:
    mesh = parametric_head(np.zeros(1))
    vertices = mesh.vertices.copy()
    vertices[np.argmax(vertices[:, 2])] -= [0.0, 0.0, 400.0]
    assert crossing_triangles(mesh.with_vertices(vertices)) > 0
