"""The openings of our template's skin: what is cut, what stays, and that the mouth opens."""

from __future__ import annotations

import numpy as np
import pytest

from learning.export.morphs import morph_targets
from learning.export.parts.opened import Opened, is_ours, opened, template_lines
from lightstage.formats.mesh import edge_counts
from lightstage.formats.template import default_template_path, load_template


@pytest.fixture(scope="module")
def skin() -> Opened:
    return opened(load_template(default_template_path()).mesh)


def test_the_cut_leaves_vertices_and_texture_coordinates_in_place(skin: Opened) -> None:
    mesh = load_template(default_template_path()).mesh
    assert mesh.uvs is not None
    assert skin.mesh.uvs is not None
    assert np.array_equal(skin.mesh.vertices[: len(mesh.vertices)], mesh.vertices)
    assert np.array_equal(skin.mesh.uvs[: len(mesh.uvs)], mesh.uvs)
    lips = skin.mesh.vertices
    assert np.array_equal(lips[skin.upper], lips[skin.lower])


def test_lips_and_two_eyes_are_open_and_the_triangles_meet_as_before_elsewhere(
    skin: Opened,
) -> None:
    mesh = load_template(default_template_path()).mesh

    def borders(triangles: np.ndarray) -> int:
        return int((edge_counts(triangles)[1] == 1).sum())

    lips = 2 * (len(skin.upper) - 1)
    lids = sum(2 * (b - a + d - c) for a, b, c, d in template_lines().eyes)
    assert borders(skin.mesh.triangles()) == borders(mesh.triangles()) + lips + lids


def test_an_open_jaw_parts_the_lips_and_the_corners_stay_joined(skin: Opened) -> None:
    mesh = load_template(default_template_path()).mesh
    targets, _ = morph_targets(default_template_path(), mesh, np.eye(3, 4))
    moved = skin.carried(targets["jawOpen"])
    gap = moved[skin.upper] - moved[skin.lower]
    assert gap[len(gap) // 2, 1] > 15
    assert np.abs(gap[[0, -1]]).max() == 0
    assert (np.abs(np.diff(gap[:, 1])) < 4).all()


def test_a_mesh_with_other_triangles_is_not_ours() -> None:
    mesh = load_template(default_template_path()).mesh
    assert is_ours(mesh)
    assert not is_ours(opened(mesh).mesh)
