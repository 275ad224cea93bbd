from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage.formats.mesh import vertex_normals
from sim.errors import SimError
from sim.head.grid import ROW_LID_LOW, ROW_LID_UP, ROW_MOUTH, head_rays
from sim.head.mesh import grid_vertices, landmarks, neutral_mesh, regions
from sim.head.modes import (
    EXPRESSIONS,
    IDENTITY_MODES,
    expression_modes,
    identity_fields,
    identity_modes,
)
from sim.head.parametric import random_head
from sim.head.shape import base_distance, cast, ellipsoid
from sim.people.traits import SEXES, Traits

MESH = neutral_mesh()
TRIANGLES = MESH.triangles()
MARKS = MESH.vertices[landmarks()]


def face_normals(vertices: np.ndarray) -> np.ndarray:
    corner = vertices[TRIANGLES]
    return np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])


def angles_deg(corners: np.ndarray) -> np.ndarray:
    out = []
    for k in range(3):
        a = corners[:, (k + 1) % 3] - corners[:, k]
        b = corners[:, (k + 2) % 3] - corners[:, k]
        cosine = (a * b).sum(1) / np.linalg.norm(a, axis=1) / np.linalg.norm(b, axis=1)
        out.append(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
    return np.stack(out, axis=1)


def flipped(vertices: np.ndarray) -> np.ndarray:
    """Triangles that turn by a right angle or more against the neutral head."""
    return (face_normals(vertices) * face_normals(MESH.vertices)).sum(axis=1) <= 0


def may_turn(expression: str) -> np.ndarray:
    """What turns by more than a right angle when lips part, and the cleft behind closed lids."""
    inside = {
        "jaw_open": grid_vertices()[ROW_MOUTH],
        "eyes_closed": np.union1d(regions()["eyes"], grid_vertices()[[ROW_LID_UP, ROW_LID_LOW]]),
    }
    return np.isin(TRIANGLES, inside.get(expression, [])).any(axis=1)


def test_mesh_has_the_size_of_a_template_and_only_quads():
    assert 8_000 <= len(MESH.vertices) <= 14_000
    assert MESH.faces.shape[1] == 4
    assert MESH.faces.min() >= 0
    assert len(np.unique(MESH.faces)) == len(MESH.vertices)


def test_no_triangle_is_degenerate_or_a_sliver():
    area = 0.5 * np.linalg.norm(face_normals(MESH.vertices), axis=1)
    assert area.min() > 0.1  # mm^2
    least = angles_deg(MESH.vertices[TRIANGLES]).min(axis=1)
    assert least.min() > 3.0
    assert np.percentile(least, 1) > 5.0
    assert np.median(least) > 20.0


def test_mesh_is_one_disc_whose_only_border_is_the_neck():
    edges = TRIANGLES[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    directed, counts = np.unique(edges, axis=0, return_counts=True)
    assert counts.max() == 1  # so neighbours agree in orientation
    known = {tuple(edge) for edge in directed.tolist()}
    border = [edge for edge in known if edge[::-1] not in known]
    undirected = len({tuple(sorted(edge)) for edge in known})
    assert len(MESH.vertices) - undirected + len(TRIANGLES) == 1
    following = dict(border)
    start = border[0][0]
    here, steps = following[start], 1
    while here != start:
        here, steps = following[here], steps + 1
    assert steps == len(border)
    assert MESH.vertices[[edge[0] for edge in border], 1].max() < -120


def test_surface_faces_outward():
    normals = vertex_normals(MESH.vertices, TRIANGLES)
    assert np.allclose(np.linalg.norm(normals, axis=1), 1)
    assert normals[landmarks()[30], 2] > 0.8
    crown = MESH.vertices[:, 1].argmax()
    assert normals[crown, 1] > 0.9
    # The divergence theorem, with the neck closed by a fan: a head holds 3 to 6 litres.
    corners = MESH.vertices[TRIANGLES]
    volume = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    assert 3e6 < volume < 7e6


def test_uv_fills_one_tile_without_overlap_or_flip():
    corners = MESH.uvs[MESH.triangle_uvs()]
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = 0.5 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    assert area.min() > 0
    assert area.sum() == pytest.approx(1.0)
    assert MESH.uvs.min() == 0.0
    assert MESH.uvs.max() == 1.0
    # Positive areas that sum to the tile's could still overlap: count triangles over some points.
    for point in np.random.default_rng(3).uniform(0, 1, (200, 2)):
        d = corners - point
        turn = [
            d[:, k, 0] * d[:, (k + 1) % 3, 1] - d[:, k, 1] * d[:, (k + 1) % 3, 0] for k in range(3)
        ]
        assert (np.min(turn, axis=0) >= 0).sum() == 1


def test_most_of_the_tile_is_face():
    corners = MESH.vertices[TRIANGLES]
    front = corners[:, :, 2].mean(axis=1) > 20
    uv = MESH.uvs[MESH.triangle_uvs()]
    a, b = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    area = 0.5 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    assert area[front].sum() > 0.5
    surface = 0.5 * np.linalg.norm(face_normals(MESH.vertices), axis=1)
    # Less than two fifths of the skin: the map is spread in the face's favour.
    assert surface[front].sum() / surface.sum() < 0.4


def test_neutral_head_is_mirror_symmetric():
    index = grid_vertices()
    mirrored = MESH.vertices[index[:, ::-1]] * (-1, 1, 1)
    assert np.abs(mirrored - MESH.vertices[index]).max() < 1e-12


def test_head_has_adult_measures():
    index = grid_vertices()
    chin, crown = MARKS[8, 1], MESH.vertices[:, 1].max()
    assert 215 < crown - chin < 245
    no_ears = np.setdiff1d(np.arange(len(MESH.vertices)), regions()["ears"])
    assert 145 < np.ptp(MESH.vertices[no_ears][:, 0]) < 165
    assert 185 < np.ptp(MESH.vertices[index[:100]][..., 2]) < 225
    assert 60 < np.linalg.norm(0.5 * (MARKS[36] + MARKS[39] - MARKS[42] - MARKS[45])) < 67
    assert 44 < np.linalg.norm(MARKS[48] - MARKS[54]) < 58
    assert abs(MARKS[27, 1]) < 3  # the origin is at the height of the nose's bridge


def test_landmarks_follow_ibug_order():
    assert len(set(landmarks().tolist())) == 68
    x, y, z = MARKS.T
    assert np.all(np.diff(x[:17]) > 0)
    assert x[8] == 0
    assert y[8] == y[:17].min()
    assert np.all(np.diff(x[17:27]) > 0)
    assert np.all(np.diff(y[27:31]) < 0)
    assert np.all(x[27:31] == 0)
    assert z[30] > MESH.vertices[:, 2].max() - 0.5
    assert np.all(np.diff(x[31:36]) > 0)
    for outer, top, inner, bottom in ((36, (37, 38), 39, (40, 41)), (45, (43, 44), 42, (46, 47))):
        assert abs(x[outer]) > abs(x[inner])
        assert y[list(top)].min() > y[list(bottom)].max() + 5
    assert np.all(np.diff(x[48:55]) > 0)
    assert np.all(np.diff(x[54:60]) < 0)
    assert np.all(np.diff(x[60:65]) > 0)
    assert np.all(y[[61, 62, 63]] > y[[67, 66, 65]])


def test_landmarks_are_mirror_pairs():
    pairs = list(zip(range(17), range(16, -1, -1), strict=True))
    pairs += list(zip(range(17, 27), range(26, 16, -1), strict=True))
    pairs += [(31, 35), (32, 34), (33, 33), (36, 45), (37, 44), (38, 43), (39, 42), (40, 47)]
    pairs += [(41, 46), (48, 54), (49, 53), (50, 52), (59, 55), (58, 56), (60, 64), (61, 63)]
    for right, left in pairs:
        assert np.allclose(MARKS[right] * (-1, 1, 1), MARKS[left])


def test_regions_share_out_the_vertices():
    found = np.concatenate(list(regions().values()))
    assert sorted(found.tolist()) == list(range(len(MESH.vertices)))
    assert set(landmarks()[[50, 51, 52, 57]]) <= set(regions()["lips"].tolist())
    assert np.abs(MESH.vertices[regions()["ears"], 0]).min() > 55
    assert MESH.vertices[regions()["hair"]][:, 2].min() < -80


def test_every_ray_of_the_grid_leaves_the_head_once():
    rays = head_rays()
    points = cast(rays.origins, rays.directions)
    assert np.abs(base_distance(points)).max() < 1e-4
    for part in (0.1, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99):
        assert base_distance(rays.origins + part * (points - rays.origins)).max() < 0
    for beyond_mm in (0.5, 2.0, 5.0, 10.0, 20.0):
        assert base_distance(points + beyond_mm * rays.directions).min() > 0


@given(st.tuples(*[st.floats(-200, 200)] * 3), st.tuples(*[st.floats(0.5, 200)] * 3))
def test_ellipsoid_distance_has_the_right_sign(point, radii):
    inside = float(((np.array(point) / radii) ** 2).sum())
    found = float(ellipsoid(np.array([point]), (0, 0, 0), radii)[0])
    assert np.isfinite(found)
    if abs(inside - 1) > 1e-6:
        assert (found > 0) == (inside > 1)


def test_identity_modes_are_the_principal_components_of_the_fields():
    _, fields = identity_fields()
    flat = fields.reshape(len(fields), -1)
    _, sizes, right = np.linalg.svd(flat, full_matrices=False)
    modes = identity_modes().reshape(IDENTITY_MODES, -1)
    assert np.allclose(np.linalg.norm(modes, axis=1), sizes[:IDENTITY_MODES])
    for k in range(IDENTITY_MODES):
        assert abs(modes[k] @ right[k]) == pytest.approx(sizes[k])
    assert (sizes[:IDENTITY_MODES] ** 2).sum() / (sizes**2).sum() > 0.8


@pytest.mark.parametrize("mode", range(IDENTITY_MODES))
def test_identity_modes_flip_no_triangle_at_two_deviations(mode):
    for amount in (-2.0, 2.0):
        assert not flipped(MESH.vertices + amount * identity_modes()[mode]).any()


@settings(max_examples=20, deadline=None)
@given(st.lists(st.floats(-3, 3), min_size=0, max_size=IDENTITY_MODES))
def test_heads_of_the_model_are_finite_and_of_human_size(identity):
    modes = identity_modes()[: len(identity)]
    vertices = MESH.vertices + np.tensordot(np.array(identity, float), modes, axes=1)
    assert 180 < np.ptp(vertices[grid_vertices()[:104], 1]) < 280
    assert 0.5 * np.linalg.norm(face_normals(vertices), axis=1).min() > 0.005


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_random_heads_have_no_flipped_triangle(seed):
    head = random_head(np.random.default_rng(seed))
    assert flipped(head.vertices).sum() == 0


def test_random_heads_differ_and_leave_the_modes_span():
    one, two = (random_head(np.random.default_rng(seed)).vertices for seed in (1, 2))
    assert np.linalg.norm(one - two, axis=1).mean() > 1.0
    modes = identity_modes().reshape(IDENTITY_MODES, -1)
    offset = (one - MESH.vertices).ravel()
    fit = np.linalg.lstsq(modes.T, offset, rcond=None)[0]
    assert np.abs(offset - fit @ modes).max() > 0.3


def test_expressions_do_what_they_say():
    moved = dict(zip(EXPRESSIONS, expression_modes()[:, landmarks()], strict=True))
    assert moved["smile"][[48, 54], 1].min() > 3
    assert moved["smile"][54, 0] > 3 > -3 > moved["smile"][48, 0]
    assert moved["jaw_open"][8, 1] < -10
    assert moved["jaw_open"][57, 1] < -10
    assert np.abs(moved["jaw_open"][[30, 33, 51]]).max() < 0.5
    assert moved["brow_raise"][18:26, 1].min() > 2
    assert moved["brow_furrow"][[21, 22], 1].max() < -1.5
    assert moved["brow_furrow"][22, 0] < -1 < 1 < moved["brow_furrow"][21, 0]
    assert moved["pucker"][54, 0] < -4
    assert moved["pucker"][[51, 57], 2].min() > 3
    open_mm = MARKS[37, 1] - MARKS[41, 1]
    closed_mm = open_mm + moved["eyes_closed"][37, 1] - moved["eyes_closed"][41, 1]
    assert 0 < closed_mm < 0.08 * open_mm


@pytest.mark.parametrize("name", EXPRESSIONS)
def test_expressions_fold_nothing_but_the_edges_of_lips_and_lids(name):
    vertices = MESH.vertices + expression_modes()[EXPRESSIONS.index(name)]
    assert 0.5 * np.linalg.norm(face_normals(vertices), axis=1).min() > 0.005
    assert not (flipped(vertices) & ~may_turn(name)).any()


@settings(max_examples=25, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from(("neutral", *EXPRESSIONS)),
    st.sampled_from(SEXES),
    st.floats(16, 85),
)
def test_nobody_of_any_sex_and_age_has_a_flipped_triangle(seed, expression, sex, age_years):
    traits = Traits(sex, age_years, tone=3)
    head = random_head(np.random.default_rng(seed), expression, traits)
    assert not (flipped(head.vertices) & ~may_turn(expression)).any()
    assert 0.5 * np.linalg.norm(face_normals(head.vertices), axis=1).min() > 0.002


def test_an_expression_that_is_none_is_refused():
    with pytest.raises(SimError, match="smile"):
        random_head(np.random.default_rng(0), "sneer")
