from pathlib import Path

import cv2
import numpy as np

from processing.reconstruction.pictures import (
    UNSEEN,
    coverage,
    mesh_section,
    write_distance,
    write_pictures,
)
from processing.report import Picture
from tests.processing.shapes import ellipsoid


def test_coverage_is_red_where_nobody_agrees_and_white_where_many_do() -> None:
    agreeing = np.array([[-1, 0, 1, 3, 9, 9]])
    mask = np.array([[True, True, True, True, True, False]])
    shown = coverage(agreeing, mask)[0]
    assert tuple(shown[0]) == tuple(shown[1]) == UNSEEN
    assert 60 < shown[2, 0] < 255
    assert (shown[3:5] == 255).all()
    assert (shown[5] == 0).all()


def test_the_report_gets_a_section_where_there_is_a_mesh(tmp_path: Path) -> None:
    assert mesh_section(tmp_path) is None
    shown = {f"cam{k}": np.full((30, 20, 3), 90 + 110 * k, np.uint8) for k in (0, 1)}
    write_pictures(tmp_path, shown, ellipsoid())
    section = mesh_section(tmp_path)
    assert section is not None
    assert len(section.parts) == 2
    last = section.parts[1]
    assert isinstance(last, Picture)
    assert "cam0, cam1" in last.caption
    seen = cv2.imread(str(tmp_path / "work/geometry/coverage-cam0.png"))
    assert np.asarray(seen).mean() == 90


def test_the_distance_to_the_truth_is_shown_until_there_is_another_mesh(tmp_path: Path) -> None:
    mesh = ellipsoid()
    shown = {"cam0": np.full((30, 20, 3), 90, np.uint8)}
    write_pictures(tmp_path, shown, mesh)
    write_distance(tmp_path, mesh, np.zeros(len(mesh.vertices)))
    section = mesh_section(tmp_path)
    assert section is not None
    report_lines = [part.alt for part in section.parts if isinstance(part, Picture)]
    assert report_lines == ["mesh", "distance to the truth", "coverage"]
    write_pictures(tmp_path, shown, mesh)
    section = mesh_section(tmp_path)
    assert section is not None
    assert len(section.parts) == 2


def test_a_later_runs_pictures_replace_all_of_an_earlier_one(tmp_path: Path) -> None:
    def report_lines() -> list[str]:
        section = mesh_section(tmp_path)
        assert section is not None
        return [part.alt for part in section.parts if isinstance(part, Picture)]

    write_pictures(tmp_path, {}, ellipsoid(), ellipsoid())
    assert report_lines() == ["mesh", "occluders"]
    write_pictures(tmp_path, {"cam0": np.zeros((30, 20, 3), np.uint8)}, ellipsoid())
    assert report_lines() == ["mesh", "coverage"]
    write_pictures(tmp_path, {}, ellipsoid())
    assert report_lines() == ["mesh"]
