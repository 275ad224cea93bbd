"""A scan's mesh before it is believed: size, outside, holes, slivers, UV."""

from __future__ import annotations

import dataclasses

import hypothesis
import hypothesis.strategies as st
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lightstage.formats.mesh import Mesh
from sim.errors import SimError
from sim.scans.checks import (
    CheckConfig,
    check_scan,
    openings_mm,
    outward_share,
    turned_edges,
    unit_of,
)

UP = np.array([0.0, 1.0, 0.0])
scales = st.floats(-6, 6).map(lambda power: 10.0**power)


def without(mesh: Mesh, gone: np.ndarray) -> Mesh:
    return dataclasses.replace(mesh, faces=mesh.faces[~gone], face_uvs=mesh.face_uvs[~gone])


def punched(mesh: Mesh, radius_mm: float) -> Mesh:
    """A hole around the nose."""
    middle = mesh.vertices[mesh.faces].mean(axis=1)
    return without(mesh, np.linalg.norm(middle - [0, 0, 90], axis=1) < radius_mm)


def turned_over(mesh: Mesh) -> Mesh:
    return dataclasses.replace(mesh, faces=mesh.faces[:, ::-1], face_uvs=mesh.face_uvs[:, ::-1])


def test_a_sound_scan_passes_untouched_and_its_neck_is_no_hole(egg):
    mesh, report = check_scan(egg, "egg")
    assert mesh.faces is egg.faces
    assert (report.zero_area, report.holes_mm, report.turned) == (0, (), 0)
    assert 60 < report.neck_mm < 100


def test_centimetres_taken_for_millimetres_are_recognised_by_the_heads_size(egg):
    small = egg.with_vertices(egg.vertices / 10)
    with pytest.raises(
        SimError, match=r"scan.obj, size: found 18.9\d mm .*150 to 700 mm.*--units cm"
    ):
        unit_of(small, None, 1.0, "scan.obj")
    assert unit_of(small, None, 10.0, "scan.obj") == 10.0
    with pytest.raises(SimError, match="--units mm"):
        unit_of(egg, None, 1000.0, "scan.glb")
    with pytest.raises(SimError, match=r"--units with the millimetres of one unit, about \d"):
        unit_of(egg.with_vertices(egg.vertices / 77), None, 1.0, "scan.obj")


def test_landmarks_tell_the_size_of_a_head_with_its_body(egg):
    tall = egg.with_vertices(egg.vertices * [1, 8, 1])
    marks = np.full((68, 3), np.nan)
    marks[36], marks[45] = [-45, 0, 80], [45, 0, 80]
    assert unit_of(tall, marks, 1.0, "body") == 1.0
    with pytest.raises(SimError, match=r"9 mm \(eyes' outer corners.*--units cm"):
        unit_of(tall, marks / 10, 1.0, "body")
    with pytest.raises(SimError, match="scan's box"):
        unit_of(tall, np.full((68, 3), np.nan), 1.0, "body")


def test_small_holes_are_counted_and_large_ones_refused_unless_allowed(egg):
    holed = punched(egg, 25.0)
    _, report = check_scan(holed, "egg", CheckConfig(largest_hole_mm=80))
    assert len(report.holes_mm) == 1
    assert 20 < report.holes_mm[0] < 80
    assert report.neck_mm > 0
    with pytest.raises(SimError, match=r"holes: found 1 hole,.*at most 30 mm.*--largest-hole-mm"):
        check_scan(punched(egg, 40.0), "egg")


def test_triangles_that_look_inward_are_refused_and_turned_over_on_request(egg):
    inward = turned_over(egg)
    with pytest.raises(SimError, match=r"normals: found .*look inward \(9\d|100.*--flip-normals"):
        check_scan(inward, "egg")
    mesh, report = check_scan(inward, "egg", flip=True)
    assert report.flipped
    np.testing.assert_array_equal(mesh.faces, egg.faces)
    np.testing.assert_array_equal(mesh.face_uvs, egg.face_uvs)
    with pytest.raises(SimError, match="Leave --flip-normals away"):
        check_scan(egg, "egg", flip=True)


def test_triangles_that_disagree_about_the_outside_are_refused(egg):
    faces = egg.faces.copy()
    faces[::5] = faces[::5, ::-1]
    with pytest.raises(SimError, match="disagree about the outside"):
        check_scan(dataclasses.replace(egg, faces=faces), "egg")
    faces = egg.faces.copy()
    faces[400] = faces[400, ::-1]
    assert turned_edges(faces)[0] == 3


def test_a_few_triangles_without_area_are_dropped_and_many_refused(egg):
    slivers = np.repeat(egg.faces[:9, :1], 3, axis=1)
    dirty = dataclasses.replace(
        egg,
        faces=np.concatenate([egg.faces, slivers]),
        face_uvs=np.concatenate([egg.face_uvs, egg.face_uvs[:9]]),
    )
    mesh, report = check_scan(dirty, "egg")
    assert report.zero_area == 9
    assert len(mesh.faces) == len(egg.faces) == len(mesh.face_uvs)
    flat = egg.with_vertices(egg.vertices * [1.0, 0.0, 0.0])
    with pytest.raises(SimError, match=r"triangles: found \d+ of \d+ without area"):
        check_scan(flat, "egg")


def test_uv_must_be_there_finite_and_in_one_tile(egg):
    with pytest.raises(SimError, match=r"uv: found none.*Unwrap"):
        check_scan(Mesh(egg.vertices, egg.faces), "egg")
    for bad, message in (
        (egg.uvs * 2, r"from 0\.?\d* to 2, expected one tile.*UDIM"),
        (egg.uvs - 0.5, "from -0"),
        (np.where(egg.uvs > 0.5, np.nan, egg.uvs), "NaN"),
        (np.full_like(egg.uvs, 0.3), "an unwrapping"),
    ):
        with pytest.raises(SimError, match=message):
            check_scan(dataclasses.replace(egg, uvs=bad), "egg")
    nearly, _ = check_scan(dataclasses.replace(egg, uvs=egg.uvs * 1.00005), "egg")
    assert nearly.uvs.max() == 1.0


def test_nan_vertices_are_refused(egg):
    places = egg.vertices.copy()
    places[5, 1] = np.nan
    with pytest.raises(SimError, match="vertices: found NaN"):
        check_scan(egg.with_vertices(places), "egg")


def signed_volume(mesh: Mesh) -> float:
    """Plain sum of tetrahedra over a closed mesh."""
    return sum(float(np.dot(a, np.cross(b, c))) for a, b, c in mesh.vertices[mesh.faces]) / 6


@hypothesis.given(
    seed=st.integers(0, 2**16), scale=scales, over=st.booleans(), shift=st.floats(-1e3, 1e3)
)
@hypothesis.settings(max_examples=30)
def test_outside_is_the_side_of_positive_volume_whatever_the_place_and_scale(
    egg, seed, scale, over, shift
):
    turn = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    mesh = turned_over(egg) if over else egg
    mesh = mesh.with_vertices((mesh.vertices @ turn.T + shift) * scale)
    centred = mesh.with_vertices(mesh.vertices - mesh.vertices.mean(axis=0))
    assert (outward_share(mesh) > 0.5) == (signed_volume(centred) > 0) == (not over)


@hypothesis.given(seed=st.integers(0, 2**16), scale=scales, count=st.integers(0, 4))
@hypothesis.settings(max_examples=30)
def test_holes_are_found_whatever_the_order_of_vertices_and_the_scale(egg, seed, scale, count):
    rng = np.random.default_rng(seed)
    middle = egg.vertices[egg.faces].mean(axis=1)
    spots = np.array([[70, 20, 0], [-70, 20, 0], [0, 20, 90], [0, 20, -90.0]])[:count]
    gone = np.zeros(len(egg.faces), bool)
    for spot in spots:
        gone |= np.linalg.norm(middle - spot, axis=1) < 18
    mesh = without(egg, gone)
    order = rng.permutation(len(mesh.vertices))
    mixed = Mesh(mesh.vertices[np.argsort(order)] * scale, order[mesh.faces])
    holes, neck = openings_mm(mixed, UP)
    assert len(holes) == count
    assert neck == pytest.approx(openings_mm(egg, UP)[1] * scale)
    assert all(10 * scale < hole < 60 * scale for hole in holes)


def test_no_size_of_mesh_breaks_the_checks():
    corner = Mesh(
        np.array([[0, 0, 0], [200, 0, 0], [0, 200, 0.0]]),
        np.array([[0, 1, 2]], np.int32),
        np.array([[0, 0], [1, 0], [0, 1.0]]),
        np.array([[0, 1, 2]], np.int32),
    )
    assert openings_mm(corner, UP) == ((200.0,), 0.0)
    assert turned_edges(corner.faces) == (0, 0)
    assert 0 <= outward_share(corner) <= 1
