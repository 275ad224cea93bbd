"""What MeshLab does for us: scans cleaned, meshes decimated in their texture, crossings counted."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage import meshlab
from lightstage.formats.mesh import Mesh, connected, directed_edges, edge_counts
from lightstage.formats.template import default_template_path, load_template

TEMPLATE = load_template(default_template_path()).mesh
HEAD = Mesh(TEMPLATE.vertices, TEMPLATE.triangles())


def cyclic(triangles: np.ndarray) -> np.ndarray:
    """Triangles from their lowest vertex on, in order: equal where they face the same way."""
    first = np.argmin(triangles, axis=1)
    rolled = np.take_along_axis(triangles, (first[:, None] + np.arange(3)) % 3, axis=1)
    return np.asarray(rolled[np.lexsort(rolled.T)])


def soup() -> tuple[Mesh, dict[str, int]]:
    corners = HEAD.vertices[HEAD.faces].reshape(-1, 3)
    mesh = Mesh(corners, np.arange(len(corners), dtype=np.int32).reshape(-1, 3))
    return mesh, {"duplicate_vertices": len(corners) - len(HEAD.vertices)}


def twice() -> tuple[Mesh, dict[str, int]]:
    faces = np.concatenate([HEAD.faces, HEAD.faces[::3], np.roll(HEAD.faces[1::3], 1, axis=1)])
    return Mesh(HEAD.vertices, faces), {"duplicate_triangles": len(faces) - len(HEAD.faces)}


def fins() -> tuple[Mesh, dict[str, int]]:
    """A small third triangle at every 400th edge."""
    some = HEAD.faces[::400].copy()
    tips = HEAD.vertices[some[:, :2]].mean(axis=1) + 0.05
    some[:, 2] = len(HEAD.vertices) + np.arange(len(some))
    mesh = Mesh(np.concatenate([HEAD.vertices, tips]), np.concatenate([HEAD.faces, some]))
    return mesh, {"triangles_of_non_manifold_edges": len(some), "unused_vertices": len(some)}


def crumbs() -> tuple[Mesh, dict[str, int]]:
    """Two crumbs of 5 mm, which go."""
    shell = np.array([[0, 0, 400.0], [3, 0, 400], [0, 3, 400], [0, 0, 403]])
    sides = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32) + len(HEAD.vertices)
    vertices = np.concatenate([HEAD.vertices, shell, shell + 50])
    faces = np.concatenate([HEAD.faces, sides, sides + 4])
    return Mesh(vertices, faces), {"triangles_of_islands": 8, "unused_vertices": 8}


def flat() -> tuple[Mesh, dict[str, int]]:
    needles = HEAD.faces[:20][:, [0, 1, 1]]
    mesh = Mesh(HEAD.vertices, np.concatenate([needles, HEAD.faces]))
    return mesh, {"triangles_without_area": 20}


def turned() -> tuple[Mesh, dict[str, int]]:
    """The first triangle too, whose direction MeshLab takes for all."""
    faces = HEAD.faces.copy()
    faces[:30] = faces[:30, ::-1]
    return Mesh(HEAD.vertices, faces), {"triangles_turned_over": 30}


@pytest.mark.parametrize("damaged", [soup, twice, fins, crumbs, flat, turned])
def test_a_damaged_scan_becomes_the_clean_one_and_what_went_is_counted(
    damaged: Callable[[], tuple[Mesh, dict[str, int]]],
) -> None:
    mesh, expected = damaged()
    found = meshlab.cleaned(mesh, "scan.ply")
    assert found.removed == expected
    assert all(
        f"{name.replace('_', ' ')} {count}" in found.note for name, count in expected.items()
    )
    order = np.lexsort(found.mesh.vertices.T)
    np.testing.assert_array_equal(
        found.mesh.vertices[order], HEAD.vertices[np.lexsort(HEAD.vertices.T)]
    )
    if damaged is soup:  # whose vertices have another order
        rank = np.empty(len(order), int)
        rank[order] = np.lexsort(HEAD.vertices.T)
        np.testing.assert_array_equal(cyclic(rank[found.mesh.faces]), cyclic(HEAD.faces))
    else:
        np.testing.assert_array_equal(cyclic(found.mesh.faces), cyclic(HEAD.faces))


def test_a_clean_scan_keeps_every_bit_and_its_order() -> None:
    found = meshlab.cleaned(HEAD, "scan.ply")
    np.testing.assert_array_equal(found.mesh.vertices, HEAD.vertices)
    np.testing.assert_array_equal(found.mesh.faces, HEAD.faces)
    assert (found.removed, found.note) == ({}, "")


def test_eyes_stay_and_a_mesh_of_crumbs_alone_stays_whole() -> None:
    eye = 0.06 * (HEAD.vertices - HEAD.vertices.mean(axis=0)) + [30, 0, 100]
    both = Mesh(
        np.concatenate([HEAD.vertices, eye]),
        np.concatenate([HEAD.faces, HEAD.faces + len(HEAD.vertices)]),
    )
    for mesh in (both, Mesh(0.01 * HEAD.vertices, HEAD.faces)):
        found = meshlab.cleaned(mesh, "scan.ply")
        np.testing.assert_array_equal(found.mesh.faces, mesh.faces)
        assert found.removed == {}


def test_a_mesh_without_any_area_comes_back_as_it_was() -> None:
    flat = Mesh(np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0.0]]), np.array([[0, 1, 2]], np.int32))
    found = meshlab.cleaned(flat, "scan.ply")
    np.testing.assert_array_equal(found.mesh.faces, flat.faces)
    assert found.removed == {}


def test_a_part_that_faces_inward_as_a_whole_is_not_turned() -> None:
    """Which way is out is found by the cameras, not here."""
    inward = Mesh(HEAD.vertices, np.ascontiguousarray(HEAD.faces[:, ::-1]))
    found = meshlab.cleaned(inward, "scan.ply")
    np.testing.assert_array_equal(found.mesh.faces, inward.faces)


@settings(max_examples=25, deadline=None)
@given(
    st.lists(
        st.tuples(*[st.integers(0, 7)] * 3).filter(lambda t: len(set(t)) == 3),
        min_size=1,
        max_size=30,
    ),
    st.sampled_from([1e-3, 1.0, 1e4]),
)
def test_whatever_is_cleaned_has_no_edge_of_three_triangles_and_none_twice(
    triangles: list[tuple[int, int, int]], scale: float
) -> None:
    cube = scale * np.array([[x, y, z] for x in (0, 1) for y in (0, 1.5) for z in (0, 2.25)])
    found = meshlab.cleaned(Mesh(cube, np.array(triangles, np.int32)), "scan.ply").mesh
    assert len(found.faces)
    assert edge_counts(found.faces)[1].max() <= 2
    assert len(np.unique(np.sort(found.faces, axis=1), axis=0)) == len(found.faces)
    assert {*map(tuple, found.vertices)} <= {*map(tuple, cube)}


def test_a_decimated_head_keeps_its_shape_its_texture_and_its_seam() -> None:
    from processing.closest import ClosestPoints

    count = len(HEAD.faces) // 4
    found = meshlab.decimated(TEMPLATE, count)
    assert count * 0.99 <= len(found.faces) <= count
    assert found.uvs is not None
    assert 0 <= found.uvs.min() <= found.uvs.max() <= 1
    back = ClosestPoints(found.vertices, found.faces).query(HEAD.vertices).distance_mm
    assert np.median(back) < 0.05
    assert back.max() < 0.4
    # One surface, open at the neck alone, as the whole one is.
    for mesh in (HEAD, found):
        part = connected(directed_edges(mesh.faces), len(mesh.vertices))
        assert len(np.unique(part[mesh.faces])) == 1
    assert (edge_counts(found.faces)[1] == 1).sum() == (edge_counts(HEAD.faces)[1] == 1).sum()
    # The texture shows the same place of the head: the middle of each triangle, in mm.
    near = ClosestPoints(HEAD.vertices, HEAD.faces).query(found.vertices[found.faces].mean(axis=1))
    assert TEMPLATE.uvs is not None
    there = TEMPLATE.uvs[TEMPLATE.triangle_uvs()[near.face]]
    expected = np.einsum("nk,nkc->nc", near.barycentric, there)
    away = np.linalg.norm(found.uvs[found.triangle_uvs()].mean(axis=1) - expected, axis=1)
    assert np.quantile(away, 0.5) < 0.0006
    assert np.quantile(away, 0.95) < 0.003


def test_decimation_gives_the_same_mesh_twice() -> None:
    first, second = (meshlab.decimated(TEMPLATE, 2000) for _ in range(2))
    for name in ("vertices", "faces", "uvs", "face_uvs"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))


def test_triangles_that_cut_through_each_other_are_found_and_no_others() -> None:
    assert not meshlab.self_intersecting(HEAD.vertices, HEAD.faces).any()
    a = np.array([[0, 0, 0], [4, 0, 0], [0, 4, 0]], float)
    through = np.array([[1, 1, -1], [1, 1, 1], [1, 2, 1]], float)
    beside = a + np.array([0, 0, 5])
    found = meshlab.self_intersecting(
        np.concatenate([a, through, beside]), np.arange(9).reshape(3, 3)
    )
    assert found.tolist() == [True, True, False]


def test_without_pymeshlab_the_mesh_stays_and_the_note_names_the_extra(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    find = importlib.util.find_spec

    def none(name: str, *rest: Any) -> Any:
        return None if name == "pymeshlab" else find(name, *rest)

    monkeypatch.setattr(importlib.util, "find_spec", none)
    mesh, _ = twice()
    found = meshlab.cleaned(mesh, "scan.ply")
    np.testing.assert_array_equal(found.mesh.faces, mesh.faces)
    assert found.removed is None
    assert found.note == (
        "scan.ply was not cleaned: pymeshlab is not installed (pip install 'lightstage[meshlab]')"
    )


def test_a_filter_whose_system_library_is_missing_is_named_before_it_is_called(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    import pymeshlab

    monkeypatch.setattr(pymeshlab, "filter_list", lambda: list(meshlab.FILTERS[1:]))
    found = meshlab.cleaned(twice()[0], "scan.ply")
    assert found.removed is None
    assert "libopengl0" in found.note


def test_pymeshlab_works_where_it_is_imported_before_the_other_libraries() -> None:
    code = """
import pymeshlab, cv2, open3d
work = pymeshlab.MeshSet(verbose=False)
work.create_sphere()
ball = open3d.geometry.TriangleMesh.create_sphere()
print(work.current_mesh().face_number(), len(ball.triangles), float("1.5"))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.split() == ["1280", "1520", "1.5"], done.stderr
