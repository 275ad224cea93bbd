from pathlib import Path

import cv2
import numpy as np

from lightstage.formats.mesh import Mesh
from processing.reconstruction.pictures import (
    SIDE_PX,
    UNSEEN,
    coverage,
    mesh_section,
    three_sides,
    write_pictures,
)
from processing.report import Picture

NOSE = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]], np.int32)


def ball() -> Mesh:
    import open3d

    shape = open3d.geometry.TriangleMesh.create_sphere(80.0, 20)
    return Mesh(np.asarray(shape.vertices), np.asarray(shape.triangles).astype(np.int32))


def test_coverage_is_red_where_nobody_agrees_and_white_where_many_do() -> None:
    agreeing = np.array([[-1, 0, 1, 3, 9, 9]])
    mask = np.array([[True, True, True, True, True, False]])
    shown = coverage(agreeing, mask)[0]
    assert tuple(shown[0]) == tuple(shown[1]) == UNSEEN
    assert 60 < shown[2, 0] < 255
    assert (shown[3:5] == 255).all()
    assert (shown[5] == 0).all()


def test_a_ball_is_lit_from_above_on_white_and_its_inside_is_blue() -> None:
    shown = three_sides(ball()).astype(int)
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
    view = three_sides(nose)[:, 2 * SIDE_PX :]
    across = np.flatnonzero((view.min(axis=2) < 255).any(axis=0))
    tall = (view.min(axis=2) < 255).sum(axis=0)
    assert tall[across[0] + 5] < tall[across[-1] - 5]
    inside_out = three_sides(Mesh(ball().vertices, ball().faces[:, ::-1].copy()))
    assert (inside_out[SIDE_PX // 2, SIDE_PX // 2] == (60, 80, 160)).all()


def test_the_report_gets_a_section_where_there_is_a_mesh(tmp_path: Path) -> None:
    assert mesh_section(tmp_path) is None
    shown = [np.full((30, 20, 3), 90, np.uint8), np.full((30, 20, 3), 200, np.uint8)]
    write_pictures(tmp_path, ["cam0", "cam1"], shown, ball())
    section = mesh_section(tmp_path)
    assert section is not None
    assert len(section.parts) == 2
    last = section.parts[1]
    assert isinstance(last, Picture)
    assert "cam0, cam1" in last.caption
    seen = cv2.imread(str(tmp_path / "work/geometry/coverage-cam0.png"))
    assert np.asarray(seen).mean() == 90
