"""A mesh's three sides: what is up, left, inside, near and far is drawn there."""

from __future__ import annotations

import numpy as np

from lightstage.formats.mesh import Mesh
from processing.report import display_error
from processing.sides import INSIDE, UNKNOWN, coloured_sides, lit_sides
from tests.processing.shapes import ellipsoid

SIDE_PX = 120
NOSE = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]], np.int32)


def test_an_ellipsoid_is_lit_from_above_on_white_and_its_inside_is_blue() -> None:
    shown = lit_sides(ellipsoid(), SIDE_PX).astype(int)
    assert shown.shape == (SIDE_PX, 3 * SIDE_PX, 3)
    for side in range(3):
        view = shown[:, side * SIDE_PX : (side + 1) * SIDE_PX]
        skin = view.min(axis=2) < 255
        assert 0.2 < skin.mean() < 0.7
        rows = np.flatnonzero(skin.any(axis=1))
        upper, lower = view[rows[0] : SIDE_PX // 2], view[SIDE_PX // 2 : rows[-1]]
        assert upper[upper < 255].mean() > lower[lower < 255].mean()
    # From the right hand a nose that points to the front points to the left.
    nose = Mesh(np.array([[0, 40.0, 0], [0, -40, 0], [0, 0, 90], [-1, 0, 0]]), NOSE)
    view = lit_sides(nose, SIDE_PX)[:, 2 * SIDE_PX :]
    across = np.flatnonzero((view.min(axis=2) < 255).any(axis=0))
    tall = (view.min(axis=2) < 255).sum(axis=0)
    assert tall[across[0] + 5] < tall[across[-1] - 5]
    inside_out = lit_sides(Mesh(ellipsoid().vertices, ellipsoid().faces[:, ::-1].copy()), SIDE_PX)
    assert (inside_out[SIDE_PX // 2, SIDE_PX // 2] == INSIDE).all()


def test_values_stand_where_their_vertices_are_and_what_has_none_is_grey() -> None:
    mesh = ellipsoid()
    upper = np.where(mesh.vertices[:, 1] > 0, 2.0, 0.0)
    shown = coloured_sides(mesh, upper, 1.0, SIDE_PX)
    assert shown.shape == (SIDE_PX, 3 * SIDE_PX, 3)
    dark, bright = display_error(np.array([[0.0, 1.0]]), 1.0)[0]
    half = SIDE_PX // 2
    for side in range(3):
        middle = side * SIDE_PX + half
        assert (shown[half - 20, middle] == bright).all()
        assert (shown[half + 20, middle] == dark).all()
        assert (shown[0, middle] == 255).all()
    none = coloured_sides(mesh, np.full(len(mesh.vertices), np.nan), 1.0, SIDE_PX)
    assert (none[half, half] == UNKNOWN).all()
