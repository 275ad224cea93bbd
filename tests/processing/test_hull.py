"""The coarse hull of what stereo cannot reconstruct."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage.errors import FormatError
from lightstage.formats.mesh import Mesh, edge_counts, write_ply
from lightstage.formats.processed import ProcessedFolder
from lightstage.rig import default_rig
from processing.closest import ClosestPoints
from processing.rays import MeshRays
from processing.reconstruction.hull import (
    CLOTH_MM,
    KEEP_MM,
    LEAST_VIEWS,
    Silhouette,
    carved,
    found_hull,
    larger,
    sides_of,
)
from processing.reconstruction.pictures import write_pictures
from processing.reconstruction.views import View
from processing.reconstruction.worn import joined
from processing.refinement.stage import measured_alone
from tests.processing.test_given_meshes import ball_mesh, plate

CAMERAS = default_rig().scaled(300 / 6016).cameras
SKIN = ball_mesh(90.0)


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> Mesh:
    """A closed box; mm."""
    size = np.subtract(high, low)
    one = sides_of(np.ones((1, 1, 1), bool), np.zeros(3), 1.0)
    return Mesh(one.vertices * size + low, one.faces)


SHOULDER = box((-60.0, -150.0, -60.0), (60.0, -110.0, 40.0))


def views_of(shown: Mesh, count: int = len(CAMERAS)) -> list[View]:
    """What cameras see: a foreground wherever a mesh is."""
    rays, out = MeshRays(shown.vertices, shown.triangles()), []
    for camera in CAMERAS[:count]:
        shape = (camera.height_px, camera.width_px)
        mask = rays.cast_camera(camera).face.reshape(shape) >= 0
        empty = np.zeros((*shape, 4), np.float32), np.zeros((*shape, 3), np.float32)
        out.append(View(camera, empty[0], mask, empty[1]))
    return out


def shadowed(points: np.ndarray, others: Mesh, toward: np.ndarray) -> np.ndarray:
    """(n,) bool: points whose rays along (3,) meet a mesh."""
    rays = MeshRays(others.vertices, others.triangles())
    return rays.cast(points, np.broadcast_to(toward, points.shape)).face >= 0


def test_a_block_that_nothing_was_matched_on_casts_its_shadow_by_its_hull() -> None:
    hull = found_hull(views_of(joined(SKIN, SHOULDER)), SKIN, None)
    assert hull is not None
    rng = np.random.default_rng(5)
    low, high = SHOULDER.vertices.min(axis=0), SHOULDER.vertices.max(axis=0)
    places = rng.uniform(low - 30, high + 30, (4000, 3)) * (1, 0, 1) + (0, -95, 0)
    for toward in ((0.0, -1.0, 0.0), (0.0, -0.8, -0.6), (0.6, -0.8, 0.0)):
        true = shadowed(places, SHOULDER, np.array(toward))
        found = shadowed(places, hull.mesh, np.array(toward))
        assert 0.2 < true.mean() < 0.8
        assert (found & true).sum() > 0.97 * true.sum(), toward
        # Behind the block no camera looks: the hull reaches farther back than it does.
        assert (found & ~true).sum() < 0.5 * true.sum(), toward
    area_cm2 = 2 * (12 * 4 + 12 * 10 + 4 * 10)
    assert 0.8 * area_cm2 < hull.area_cm2 < 1.6 * area_cm2


def test_the_hull_keeps_off_the_skin_and_hides_none_of_it_from_any_camera() -> None:
    # The block reaches into the ball: there the hull has to end before the skin.
    deep = box((-60.0, -150.0, -60.0), (60.0, -60.0, 40.0))
    views = views_of(joined(SKIN, deep))
    for view in views:
        # What is seen of the ball was measured, what is before it too.
        hit = MeshRays(SKIN.vertices, SKIN.triangles()).cast_camera(view.camera).face >= 0
        assert hit.any()
    hull = found_hull(views, SKIN, None)
    assert hull is not None
    closest = ClosestPoints(SKIN.vertices, SKIN.triangles())
    assert closest.query(hull.mesh.vertices).distance_mm.min() > KEEP_MM
    # Inside of the ball is no cell, however far from its surface.
    assert np.linalg.norm(hull.mesh.vertices, axis=1).min() > 89
    alone = MeshRays(SKIN.vertices, SKIN.triangles())
    both = MeshRays(SKIN.vertices, SKIN.triangles(), hull.mesh)
    for view in views:
        seen = alone.cast_camera(view.camera, view.mask).face >= 0
        np.testing.assert_array_equal(
            both.cast_camera(view.camera, view.mask).face >= 0, seen, view.camera.id
        )


def test_cloth_that_was_measured_carves_the_space_before_it() -> None:
    shape = (CAMERAS[0].height_px, CAMERAS[0].width_px)
    every, none = np.ones(shape, bool), np.zeros(shape, np.float32)
    found = []
    for camera in CAMERAS[:3]:
        lens = np.array(
            [[camera.fx_px, 0, camera.cx_px], [0, camera.fy_px, camera.cy_px], [0, 0, 1]]
        )
        shown = lens @ camera.cam_from_world, camera.centre_mm
        found.append(Silhouette(*shown, every, every, none, none, 4))
    low, counts = np.full(3, -10.0), (20, 20, 20)
    assert carved(found, low, 1.0, counts).all()
    away_mm = float(np.linalg.norm(CAMERAS[2].centre_mm))
    behind = np.full(shape, away_mm, np.float32)
    found[2] = found[2]._replace(unknown=~every, cloth_mm=behind)
    middles = np.stack(np.meshgrid(*[np.arange(20) - 9.5] * 3, indexing="ij"), axis=-1)
    distance = np.linalg.norm(middles - CAMERAS[2].centre_mm, axis=-1)
    cells = carved(found, low, 1.0, counts)
    np.testing.assert_array_equal(cells, distance >= np.float32(away_mm) - CLOTH_MM)
    assert 0.2 < cells.mean() < 0.9


def test_what_was_measured_is_not_filled_again() -> None:
    views = views_of(joined(SKIN, SHOULDER))
    found = found_hull(views, SKIN, SHOULDER)
    bare = found_hull(views, SKIN, None)
    assert bare is not None
    assert found is None or found.area_cm2 < 0.1 * bare.area_cm2


def test_nothing_is_added_where_the_skin_covers_what_is_shown() -> None:
    assert found_hull(views_of(SKIN), SKIN, None) is None
    # A block of 20 mm is less than 2 % of what is shown; beside a smaller head it is more.
    block, large = box((-10.0, -160.0, -10.0), (10.0, -140.0, 10.0)), ball_mesh(115.0)
    assert found_hull(views_of(joined(large, block)), large, None) is None
    assert found_hull(views_of(joined(SKIN, block)), SKIN, None) is not None
    # What is left of a crumb is under 2 cm3, however small the head.
    crumb, tiny = box((-4.0, -60.0, -4.0), (4.0, -52.0, 4.0)), ball_mesh(20.0)
    assert found_hull(views_of(joined(tiny, crumb)), tiny, None) is None


def test_fewer_than_two_views_of_something_add_nothing() -> None:
    views = views_of(joined(SKIN, SHOULDER))
    black = [dataclasses.replace(view, mask=np.zeros_like(view.mask)) for view in views]
    assert found_hull([], SKIN, None) is None
    assert found_hull(views[:1], SKIN, None) is None
    assert found_hull(black, SKIN, None) is None
    assert found_hull([views[0], *black[1:]], SKIN, None) is None
    some = found_hull([*views[:5], *black[5:]], SKIN, None)
    same = found_hull(views[:5], SKIN, None)
    assert some is not None
    assert same is not None
    np.testing.assert_array_equal(some.mesh.vertices, same.mesh.vertices)


def test_a_foreground_without_an_outline_adds_nothing() -> None:
    views = views_of(joined(SKIN, SHOULDER))
    whole = [dataclasses.replace(view, mask=np.ones_like(view.mask)) for view in views]
    assert found_hull(whole, SKIN, None) is None


def plainly(
    found: list[Silhouette], low: np.ndarray, cell_mm: float, counts: tuple[int, int, int]
) -> np.ndarray:
    """`carved` once more, cell by cell."""
    out = np.zeros(counts, bool)
    for index in np.ndindex(*counts):
        middle = low + cell_mm * (np.array(index) + 0.5)
        unknown = 0
        for one in found:
            across, down, depth = one.camera[:, :3] @ middle + one.camera[:, 3]
            if depth <= 0:
                continue
            x, y = int(np.floor(across / depth)), int(np.floor(down / depth))
            h, w = one.lit.shape
            if max(-x, x - w + 1, -y, y - h + 1) > one.foot_px:
                continue
            inside = 0 <= x < w and 0 <= y < h
            at = min(max(y, 0), h - 1), min(max(x, 0), w - 1)
            away = float(np.linalg.norm(middle - one.centre_mm))
            skin, cloth = float(one.skin_mm[at]), float(one.cloth_mm[at])
            if away - cell_mm * 3**0.5 / 2 < skin:
                break
            if inside and (not one.lit[at] or away < cloth - CLOTH_MM):
                break
            unknown += inside and bool(one.unknown[at])
        else:
            out[index] = unknown >= LEAST_VIEWS
    return out


@given(st.integers(0, 2**32 - 1), st.integers(0, 4), st.sampled_from([0.0, 0.4, 1.0]))
@settings(max_examples=40, deadline=None)
def test_cells_are_those_that_a_plain_search_leaves(seed: int, count: int, lit: float) -> None:
    rng = np.random.default_rng(seed)
    found = []
    for k in range(count):
        shape = int(rng.integers(1, 9)), int(rng.integers(1, 9))
        centre = rng.uniform(-40, 40, 3)
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        lens = np.array([[6.0, 0, shape[1] / 2], [0, 6.0, shape[0] / 2], [0, 0, 1]])
        camera = lens @ np.column_stack([turn, -turn @ centre])
        some, likely = [0.0, np.nan, np.inf, 15.0, 40.0, -5.0], [0.8, 0.04, 0.04, 0.04, 0.04, 0.04]
        depths = rng.choice(some, (2, *shape), p=likely)
        masks = rng.random((2, *shape)) < (lit, 0.7)[k % 2]
        found.append(
            Silhouette(
                camera, centre, masks[0] | (lit == 1), masks[1], *depths.astype(np.float32), 1
            )
        )
    low, cell_mm, counts = rng.uniform(-30, 0, 3), 6.0, (5, 4, 6)
    if not found:
        with pytest.raises(ValueError, match="max"):
            carved(found, low, cell_mm, counts)
        return
    cells = carved(found, low, cell_mm, counts)
    np.testing.assert_array_equal(cells, plainly(found, low, cell_mm, counts))


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_the_sides_of_cells_are_closed_face_outward_and_hold_their_volume(seed: int) -> None:
    cells = np.random.default_rng(seed).random((4, 3, 5)) < 0.5
    if not cells.any():
        return
    mesh = sides_of(cells, np.array([5.0, -3.0, 2.0]), 2.0)
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    volume = float(np.einsum("nk,nk->n", a, np.cross(b, c)).sum() / 6)
    assert volume == pytest.approx(8.0 * cells.sum())
    assert (edge_counts(mesh.faces)[1] % 2 == 0).all()
    inside = np.argwhere(cells) * 2.0 + (5.0, -3.0, 2.0)
    assert mesh.vertices.min(axis=0).tolist() == inside.min(axis=0).tolist()


def test_small_pieces_are_left_out() -> None:
    cells = np.zeros((8, 8, 8), bool)
    cells[:3, :3, :3] = cells[6, 6, 6] = True
    assert larger(cells, 2).sum() == 27
    assert larger(cells, 28).sum() == 0
    assert not larger(np.zeros((2, 2, 2), bool), 1).any()


def test_refine_takes_the_hull_for_shadows_and_not_for_a_surface_that_is_seen(
    tmp_path: Path,
) -> None:
    folder, wall = ProcessedFolder(tmp_path), plate(150, 60)
    assert measured_alone(None, folder) is None
    assert measured_alone(wall, folder) is wall
    folder.hull.parent.mkdir()
    write_ply(SHOULDER, folder.hull)
    seen = measured_alone(joined(wall, SHOULDER), folder)
    assert seen is not None
    np.testing.assert_array_equal(seen.vertices, wall.vertices)
    np.testing.assert_array_equal(seen.faces, wall.faces)
    assert measured_alone(SHOULDER, folder) is None
    for other in (wall, joined(SHOULDER, wall)):
        with pytest.raises(FormatError, match=r"hull\.ply.*reconstruct.*again"):
            measured_alone(other, folder)


def test_the_report_draws_the_hull_in_a_colour_of_its_own(tmp_path: Path) -> None:
    import cv2

    both = joined(plate(150, 60), SHOULDER)
    write_pictures(tmp_path, {}, SKIN, both, len(SHOULDER.faces))
    shown = cv2.imread(str(tmp_path / "work" / "geometry" / "occluders.png")).astype(int)
    yellow = shown[..., 2] > 1.5 * shown[..., 0]
    assert 0.01 < yellow.mean() < 0.9
    write_pictures(tmp_path, {}, SKIN, both)
    shown = cv2.imread(str(tmp_path / "work" / "geometry" / "occluders.png")).astype(int)
    assert not (shown[..., 2] > 1.5 * shown[..., 0]).any()
