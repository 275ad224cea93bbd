"""Lines of sight meet on the mesh; a bare template is seen as a face and keeps its points."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from learning.errors import LearningError
from learning.points import command, find
from learning.points.find import PointsConfig, find_points
from learning.points.paint import painted
from learning.points.pictures import Coloured, Lamp, camera_at, direction, pictures_of
from lightstage.formats.mesh import Mesh
from lightstage.formats.population import POINTS_FILE
from lightstage.formats.template import default_template_path, load_template, save_template


@pytest.fixture(scope="module")
def template():
    return load_template(default_template_path())


@pytest.fixture(scope="module")
def head(template) -> Coloured:
    middle = template.mesh.vertices[template.landmarks[17:]].mean(axis=0)
    return Coloured(template.mesh, painted(template), middle)


def quick() -> PointsConfig:
    return PointsConfig(
        yaws_deg=(-40.0, 0.0, 40.0), pitches_deg=(0.0,), lamps=(Lamp(10.0, 25.0, 0.5),),
        fewest_views=2,
    )  # fmt: skip


def test_few_views_find_the_points_that_the_template_ships(template, head):
    points, counts = find_points(head, quick())
    assert counts == {"pictures": 3, "faces": 3}
    away = points.on(template.mesh.vertices) - template.face_points.on(template.mesh.vertices)
    away = np.linalg.norm(away, axis=1)
    assert np.isfinite(away).sum() > 400
    assert np.nanmedian(away) < 3
    assert np.nanquantile(away, 0.9) < 8


def test_exact_lines_of_sight_give_back_their_places(template, head):
    true = template.face_points.on(template.mesh.vertices)
    there = np.isfinite(true).all(axis=1)
    places = [camera_at(head.middle_mm, yaw, pitch) for yaw in (-40, 0, 40) for pitch in (-15, 15)]
    origins = np.array([camera.centre_mm for camera in places])
    lines = np.where(there[:, None], true, 0.0)[None] - origins[:, None]
    lines /= np.linalg.norm(lines, axis=2, keepdims=True)
    wrong = lines.copy()
    wrong[0] = np.roll(lines[0], 200, axis=0)  # one view in which the detector slipped
    for given, limit in ((lines, 0.01), (wrong, 1.5)):
        found = find._surface_points(head, origins, given, quick())
        away = np.linalg.norm(found.on(template.mesh.vertices) - true, axis=1)[there]
        assert np.isfinite(away).mean() > 0.9
        assert np.nanmedian(away) < limit


def test_a_mesh_without_a_face_is_refused():
    corners = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    mesh = Mesh(90 * corners, np.array([[0, 1, 2, 3]], np.int32))
    sheet = Coloured(mesh, np.full((4, 3), 0.3), np.zeros(3))
    with pytest.raises(LearningError, match="found a face in 0 of 3 pictures"):
        find_points(sheet, quick())


def test_light_falls_from_where_the_lamp_is(head):
    camera = dataclasses.replace(camera_at(head.middle_mm, 0.0, 0.0).scaled(0.2))
    lamps = [Lamp(60.0, 0.0, 0.1), Lamp(-60.0, 0.0, 0.1)]
    one, other = (p.astype(float).mean(axis=2) for p in pictures_of(head, camera, lamps))
    half = one.shape[1] // 2
    middle = slice(half - 20, half), slice(half, half + 20)
    assert one[30:60, middle[1]].mean() > one[30:60, middle[0]].mean() + 10
    assert other[30:60, middle[0]].mean() > other[30:60, middle[1]].mean() + 10
    assert np.allclose(direction(90, 0), [1, 0, 0])
    assert np.allclose(direction(0, 90), [0, 1, 0])


def test_a_template_of_no_regions_is_all_skin_but_for_brows(template):
    bare = dataclasses.replace(template, regions={})
    colours = painted(bare)
    assert np.isfinite(colours).all()
    light = np.allclose(np.median(colours, axis=0), (0.50, 0.30, 0.22))
    assert light
    assert (colours[template.landmarks[19]] < 0.1).all()


def test_points_are_found_on_the_peoples_mean_head_too(template, tmp_path, monkeypatch):
    folder = save_template(template, tmp_path / "T")
    (folder / POINTS_FILE).unlink()
    seen = []

    def found(head, progress):
        seen.append(head.mesh.vertices)
        return template.face_points, {"pictures": 1, "faces": 1}

    monkeypatch.setattr(command, "find_points", found)
    monkeypatch.setattr(command, "FINER", 0.5)  # a small picture will do
    facts = command.template_points(folder, None, tmp_path / "seen.png", lambda *_: None)
    mesh, mean = seen
    assert np.allclose(mesh, template.mesh.vertices, atol=1e-3)
    assert np.allclose(mean, template.population.mean_mm, atol=1e-3)
    assert facts["found_on_people"] == facts["found"]
    again = load_template(folder).population.face_points
    assert np.array_equal(again.triangles, template.face_points.triangles)
    assert (tmp_path / "seen.png").is_file()


def test_points_for_another_place_leave_the_folder_alone(template, tmp_path, monkeypatch):
    folder = save_template(template, tmp_path / "T")
    before = (folder / POINTS_FILE).read_bytes()

    def found(head, progress):
        return template.face_points, {"pictures": 1, "faces": 1}

    monkeypatch.setattr(command, "find_points", found)
    facts = command.template_points(folder, tmp_path / "points.json", None, lambda *_: None)
    assert facts["found_on_people"] is None
    assert (folder / POINTS_FILE).read_bytes() == before
    assert (tmp_path / "points.json").is_file()
