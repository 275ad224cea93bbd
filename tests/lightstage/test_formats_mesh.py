"""Meshes: topology and UV kept, damage refused, normals against known shapes."""

import collections
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage.errors import FormatError
from lightstage.formats.mesh import (
    Mesh,
    _read_lines,
    _read_plain,
    connected,
    directed_edges,
    edge_counts,
    read_mesh,
    read_obj,
    read_ply,
    vertex_normals,
    write_obj,
    write_ply,
)
from lightstage.formats.template import default_template_path, load_template

MIXED = """# a quad and a triangle
mtllib x.mtl
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
v 2 0 0 0.5 0.5 0.5
vn 0 0 1
vt 0 0
vt 1 0
vt 1 1
vt 0 1
g face
f 1/1/1 2/2/1 3/3/1 4/4/1
f -4/2 -1/3 -3/4
"""


def obj(tmp_path, text):
    path = tmp_path / "m.obj"
    path.write_text(text)
    return path


@pytest.mark.parametrize("begins", ["\ufeff".encode(), "# Cr\u00e9\u00e9\n".encode("latin-1")])
def test_marks_and_comments_in_any_encoding_change_no_mesh(tmp_path, begins):
    path = tmp_path / "m.obj"
    path.write_bytes(begins + b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 9 9 9\nf 1 2 3\n")
    mesh = read_obj(path)
    assert mesh.vertices[mesh.faces[0]].tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0]]


def test_quads_triangles_negative_indices_and_uv_are_read(tmp_path):
    mesh = read_obj(obj(tmp_path, MIXED))
    assert mesh.faces.tolist() == [[0, 1, 2, 3], [1, 4, 2, -1]]
    assert mesh.face_uvs.tolist() == [[0, 1, 2, 3], [1, 2, 3, -1]]
    assert mesh.triangles().tolist() == [[0, 1, 2], [0, 2, 3], [1, 4, 2]]
    assert mesh.triangle_uvs().tolist() == [[0, 1, 2], [0, 2, 3], [1, 2, 3]]
    assert mesh.vertices.shape == (5, 3)


def test_topology_and_uv_survive_the_file(tmp_path):
    mesh = read_obj(obj(tmp_path, MIXED))
    again = read_mesh(write_obj(mesh, tmp_path / "again.obj"))
    for name in ("vertices", "faces", "uvs", "face_uvs"):
        assert np.array_equal(getattr(again, name), getattr(mesh, name))


def test_a_mesh_without_uv_survives_too(tmp_path):
    mesh = Mesh(np.eye(3) * 12.345678, np.array([[0, 1, 2]], np.int32))
    again = read_obj(write_obj(mesh, tmp_path / "a.obj"))
    assert again.uvs is None
    assert np.allclose(again.vertices, mesh.vertices, atol=5e-7)
    with pytest.raises(FormatError, match="uv"):
        again.triangle_uvs()


def test_a_ply_mesh_survives_its_file(tmp_path):
    rng = np.random.default_rng(0)
    mesh = Mesh(rng.normal(0, 80, (9, 3)), np.array([[0, 1, 2], [3, 4, 5], [6, 7, 8]], np.int32))
    again = read_mesh(write_ply(mesh, tmp_path / "a.ply"))
    assert np.array_equal(again.vertices, mesh.vertices)
    assert np.array_equal(again.faces, mesh.faces)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "0 vertices, 0 faces"),
        ("v 0 0 0\n", "1 vertex, 0 faces"),
        ("v 0 0 x\n", "readable OBJ"),
        ("v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n", "2 coordinates instead of 3"),
        (MIXED.replace("vt 1 1", "vt 1 nan"), "uv: found NaN"),
        (MIXED + "f 1 2 9\n", "an index of no vertex"),
        (MIXED + "f 1 2 -9\n", "an index of -9, after"),
        (MIXED + "f 1 2 3\n", "2 of 3 faces with UV"),
        (MIXED + "f 1/9 2/1 3/1\n", "an index of no vt"),
        (MIXED + "f 1 2 3 4 5\n", "line 16: found a face of 5 corners"),
        (MIXED.replace("v 2 0 0", "v nan 0 0"), "vertices: found NaN"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2\n", "a face of 2 corners"),
    ],
)
def test_a_damaged_obj_is_refused(tmp_path, text, message):
    with pytest.raises(FormatError, match=message) as caught:
        read_obj(obj(tmp_path, text))
    assert "m.obj" in str(caught.value)


def test_a_missing_mesh_or_another_suffix_is_refused(tmp_path):
    for name in ("none.obj", "none.ply", "none.stl"):
        with pytest.raises(FormatError, match=name):
            read_mesh(tmp_path / name)
    (tmp_path / "a.ply").write_bytes(b"ply\nnonsense")
    with pytest.raises(FormatError, match=r"a\.ply"):
        read_ply(tmp_path / "a.ply")


def sphere(count=1500):
    """Points of a spiral on the unit sphere, and their hull."""
    from scipy.spatial import ConvexHull

    i = np.arange(count) + 0.5
    polar, azimuth = np.arccos(1 - 2 * i / count), np.pi * (1 + 5**0.5) * i
    points = np.stack(
        [np.cos(azimuth) * np.sin(polar), np.sin(azimuth) * np.sin(polar), np.cos(polar)], 1
    )
    faces = ConvexHull(points).simplices
    first, second, third = np.moveaxis(points[faces], 1, 0)
    inward = (np.cross(second - first, third - first) * first).sum(1) < 0
    faces[inward] = faces[inward][:, ::-1]
    return points, faces


def test_normals_of_a_sphere_point_outward():
    points, faces = sphere()
    normals = vertex_normals(points, faces)
    angles_deg = np.degrees(np.arccos(np.clip((normals * points).sum(1), -1, 1)))
    assert angles_deg.max() < 3


@given(st.floats(1e-6, 1e6))
def test_normals_do_not_depend_on_scale(scale):
    points, faces = sphere(40)
    assert np.allclose(vertex_normals(points * scale, faces), vertex_normals(points, faces))


def test_degenerate_triangles_have_no_normal_and_no_nan():
    points = np.array([[0, 0, 0], [1, 1, 1], [2, 2, 2], [5, 5, 5.0]])
    normals = vertex_normals(points, np.array([[0, 1, 2], [3, 3, 3]]))
    assert (normals == 0).all()


@pytest.mark.parametrize("share", [0.5, 0.8, 0.99])
def test_a_ply_that_is_cut_short_is_refused_and_not_read_in_part(tmp_path, share):
    mesh = load_template(default_template_path()).mesh
    path = write_ply(Mesh(mesh.vertices, mesh.triangles()), tmp_path / "head.ply")
    assert len(read_ply(path).faces) == len(mesh.triangles())
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(FormatError, match=r"head\.ply.*as its header states"):
        read_ply(path)


@pytest.mark.parametrize(
    "face",
    ["1/-9 2/2 3/3", "1 2 3 -5", "0 1 2", "1/0 2/1 3/2", "1 2 99999999999", "1/-999999 2/2 3/3"],
)
def test_an_index_of_nothing_is_refused_however_it_is_written(tmp_path, face):
    path = tmp_path / "wrong.obj"
    places = "".join(f"v {k} {k % 2} {k // 2}\nvt 0.{k} 0.5\n" for k in range(1, 5))
    path.write_text(f"{places}f {face}\n")
    with pytest.raises(FormatError, match=r"wrong\.obj"):
        read_obj(path)
    path.write_text(f"f {face}\n{places}")
    with pytest.raises(FormatError, match=r"wrong\.obj"):
        read_obj(path)


def test_an_obj_is_one_smooth_surface_for_programs_that_shade_faces_flat_without_a_word(tmp_path):
    lines = write_obj(Mesh(*sphere(40)), tmp_path / "a.obj").read_text().splitlines()
    assert "s 1" in lines[: [line[:2] for line in lines].index("f ")]


def test_an_obj_is_not_written_under_another_suffix(tmp_path):
    mesh = Mesh(np.eye(3), np.array([[0, 1, 2]]))
    with pytest.raises(FormatError, match=r"found suffix '\.ply', expected \.obj"):
        write_obj(mesh, tmp_path / "mesh.ply")
    assert not list(tmp_path.iterdir())


@given(
    st.lists(st.tuples(*3 * [st.integers(0, 9)]), max_size=60),
    st.sampled_from([1, 10**6]),
    st.sampled_from([np.int32, np.int64]),
)
def test_every_edge_is_counted_once_for_each_triangle_that_has_it(faces, apart, kind):
    triangles = (np.array(faces, np.int64).reshape(-1, 3) * apart).astype(kind)
    expected = collections.Counter(
        tuple(sorted((int(face[k]), int(face[(k + 1) % 3]))))
        for face in triangles
        for k in range(3)
    )
    edges, counts = edge_counts(triangles)
    assert [tuple(edge) for edge in edges.tolist()] == sorted(expected)
    assert counts.tolist() == [expected[edge] for edge in sorted(expected)]


def test_edges_run_round_their_triangles():
    found = directed_edges(np.array([[4, 7, 2], [7, 4, 9]], np.int32))
    assert found.tolist() == [[4, 7], [7, 2], [2, 4], [7, 4], [4, 9], [9, 7]]


@given(
    count=st.integers(1, 12),
    pairs=st.lists(st.tuples(st.integers(0, 11), st.integers(0, 11)), max_size=300),
)
def test_connected_parts_are_those_of_painting_neighbours(count, pairs):
    edges = np.array(pairs, np.int64).reshape(-1, 2) % count
    colour = list(range(count))
    for _ in range(count):
        for a, b in edges:
            colour[a] = colour[b] = min(colour[a], colour[b])
    found = connected(edges, count)
    assert sorted(set(found)) == list(range(len(set(colour))))
    assert len(set(zip(found, colour, strict=True))) == len(set(colour))


@settings(max_examples=150, deadline=None)
@given(
    st.lists(
        st.sampled_from(
            ["v 1 2 3", "v -0.5 1e3 2.", "v 1e999 0 0", "v 1 2 3 0.5 0.5 0.5", "v nan 0 0",
             "v 1 2", "v  1 2 3", " v 4 5 6", "v\t7 8 9", "v 1 2 x", "v .5 0 0", "v", "vt 0.25 1",
             "vt 0 1 0", "vn 0 0 1", "vt", "# f 1 2 3", "", "usemtl v", "o \u00e4"]
        ),
        max_size=6,
    ),
    st.lists(
        st.sampled_from(
            ["f 1 2 3", "f 1 2 3 1", "f 1/1 2/1 3/1", "f 1/1/1 2/1/1 3/2/1", "f 1/1 2/2 3",
             "f 0 1 2", "f -1 -2 -3", "f 1//1 2//1 3//1", "f 1 2", "f 1/1/1 2 3/1/1",
             "f 1/1 2/1 3/1 1/2", "f", "f 99999999999 1 2", "f 1 2 3 ", "f \u0661 1 1", "v 3 2 1",
             "g f"]
        ),
        max_size=4,
    ),
)  # fmt: skip
def test_the_quick_reader_of_a_mesh_reads_what_the_thorough_one_does_or_leaves_it(
    before: list[str], faces: list[str]
) -> None:
    lines = [f"{line}\n" for line in ("v 0 0 0", "v 0 1 0", *before, "f 1 2 1", *faces)]
    if len(faces) > 1:
        lines.remove("f 1 2 1\n")
    quick = _read_plain(lines)
    if quick is None:
        return
    thorough = _read_lines(lines, Path("mesh.obj"))
    for name in ("vertices", "faces", "uvs", "face_uvs"):
        one, other = getattr(quick, name), getattr(thorough, name)
        assert (one is None) == (other is None), name
        if one is not None:
            assert one.dtype == other.dtype, name
            np.testing.assert_array_equal(one, other, strict=True)


def test_the_shipped_template_and_what_is_written_here_are_read_quickly(tmp_path: Path) -> None:
    path = default_template_path() / "mesh.obj"
    assert _read_plain(path.read_text().splitlines(keepends=True)) is not None
    corners = np.array([[0.0, 0, 0], [1e-9, 1, 0], [-1, 1e9, 0]])
    mesh = Mesh(corners, np.array([[0, 1, 2]], np.int32))
    written = write_obj(mesh, tmp_path / "m.obj").read_text().splitlines(keepends=True)
    assert _read_plain(written) is not None
    mixed = Mesh(corners, np.array([[0, 1, 2, 0], [2, 1, 0, -1]], np.int32))
    written = write_obj(mixed, tmp_path / "m.obj").read_text().splitlines(keepends=True)
    found = _read_plain(written)
    assert found is not None
    np.testing.assert_array_equal(found.faces, mixed.faces, strict=True)
