"""A photograph to a head: light, texture, what was filled, what is refused."""

from __future__ import annotations

import io
import json
import shutil
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh

from learning import avatar
from learning.errors import MapsError
from learning.photo.command import OWN, FitRequest
from learning.photo.fit import joined
from learning.photo.picture import read_photograph
from learning.photo.shape_fit import Places, detector_places
from learning.photo.unwrap import unwrap
from learning.render.uv import rasterise
from lightstage.commands import quiet
from lightstage.exif import FILM_DIAGONAL_MM
from lightstage.formats.environment import read_lights
from lightstage.formats.exr import read_exr, write_exr
from lightstage.formats.files import others_below, write_json
from lightstage.formats.landmarks import write_points_px
from lightstage.formats.mesh import read_obj
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.template import Template, default_template_path, save_template
from tests.learning.export.called import printed, refusal
from tests.learning.photo.scene import FOCAL_PX, HEIGHT_PX, KEY, WIDTH_PX, Shot
from tests.programs import run_program

ROWS = 192
FILM_MM = FILM_DIAGONAL_MM * FOCAL_PX / np.hypot(WIDTH_PX, HEIGHT_PX)


def called(*words: str | Path) -> tuple[int, dict[str, Any]]:
    """Exit code and what the last line says as JSON."""
    ended = run_program("learning", *words, "--json")
    assert "Traceback" not in ended.err, ended.err
    return ended.code, json.loads(ended.out.strip().splitlines()[-1])


@pytest.fixture(scope="session")
def marks(shot: Shot, template: Template, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The photograph's true points in the detector's scheme, where the template has them."""
    points = np.full((468, 2), np.nan)
    known = detector_places(template)
    assert known is not None
    points[known[1]] = shot.landmarks_px
    path = tmp_path_factory.mktemp("marks") / "points.json"
    return write_points_px({shot.path.name: points}, path, "mediapipe468")


@pytest.fixture(scope="session")
def fitted(shot: Shot, marks: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Any]:
    """An avatar's folder and facts."""
    out = tmp_path_factory.mktemp("avatar") / "A"
    (marks.parent / "fit.toml").write_text("rounds = 1\n")
    code, facts = called(*words(shot, marks, out))
    assert code == 0, facts
    return out, facts


def words(shot: Shot, marks: Path, out: Path) -> list[str | Path]:
    """The command line of that avatar."""
    asked: list[str | Path] = ["avatar", shot.path, "--template", default_template_path()]
    asked += ["--landmarks", marks, "--out", out, "--rows", str(ROWS), "--refine", "60"]
    asked += ["--config", marks.parent / "fit.toml"]
    return [*asked, "--focal-35mm", str(FILM_MM), "--format", "gltf"]


def test_the_lamp_of_a_photograph_is_found(fitted: tuple[Path, Any], shot: Shot) -> None:
    light = read_lights(fitted[0] / "fit" / "light.json")
    strongest = light.position_mm[light.rgb.sum(axis=1).argmax()]
    true = KEY.position_mm[0]
    cosine = strongest @ true / np.linalg.norm(strongest) / np.linalg.norm(true)
    assert np.degrees(np.arccos(cosine)) < 4


def test_the_texture_is_the_photographs_where_it_is_seen_and_whole_elsewhere(
    fitted: tuple[Path, Any], shot: Shot
) -> None:
    folder = fitted[0] / "fit"
    texture = read_exr(folder / "texture.exr")
    assert texture.shape == (ROWS, ROWS * 2 // 3, 3)
    mesh = read_obj(folder / "registered_mesh.obj")
    raster = rasterise(mesh, *texture.shape[:2])
    covered = raster.covered
    assert (texture[covered].max(axis=1) > 0.003).mean() > 0.999
    confidence = read_exr(folder / "atlas" / "confidence.exr")
    assert 0.25 < (confidence[covered] > 0).mean() < 0.45
    # What turns away from the camera, and from the lamp, is the same skin.
    place = raster.interpolate(mesh.vertices)
    face = covered & (place[..., 2] > 40) & (np.abs(place[..., 1] + 20) < 50)
    filled, shown = face & (confidence == 0), face & (confidence > 0)
    assert filled.sum() > 50
    albedo = read_exr(folder / "atlas" / "diffuse_albedo.exr")
    assert 0.9 < np.median(albedo[filled]) / np.median(albedo[shown]) < 1.1
    assert 0.2 < np.median(texture[filled]) / np.median(texture[shown]) < 0.4


def require_exported(file: Path, mesh: Path) -> None:
    """A glTF file holds a mesh, in metres."""
    loaded = trimesh.load(io.BytesIO(file.read_bytes()), file_type="glb")
    (found,) = loaded.geometry.values()
    shape = read_obj(mesh)
    corners = 0.001 * shape.vertices[shape.triangles()]
    np.testing.assert_allclose(found.vertices[found.faces], corners, atol=1e-6)


def test_the_head_lies_over_its_photograph(fitted: tuple[Path, Any], shot: Shot) -> None:
    facts = json.loads((fitted[0] / "fit" / "fit.json").read_text())
    taken = facts["photographs"][0]
    assert taken["landmark_px"] < 0.8
    assert taken["focal_px"] == pytest.approx(FOCAL_PX, rel=0.01)
    assert (fitted[0] / "fit" / "fit.html").stat().st_size > 10_000
    assert (fitted[0] / "export" / "head.glb").stat().st_size > 10_000


def test_what_is_up_to_date_is_skipped_and_a_changed_option_is_not(
    fitted: tuple[Path, Any], shot: Shot, marks: Path
) -> None:
    out = fitted[0]
    before = (out / "fit" / "texture.exr").stat().st_mtime_ns
    code, facts = called(*words(shot, marks, out))
    assert (code, facts["skipped"]) == (0, ["fit", "detail", "export"])
    assert (out / "fit" / "texture.exr").stat().st_mtime_ns == before
    line = [*words(shot, marks, out)[:-1], "obj"]
    code, facts = called(*line)
    assert (code, facts["skipped"]) == (0, ["fit", "detail"])
    assert (out / "export" / "head.obj").exists()
    assert not (out / "export" / "head.glb").exists()
    page = (out / "avatar.html").read_text()
    assert 'href="export/head.obj"' in page
    assert "head.glb" not in page
    assert page.index("The photograph and the head") < page.index("The neutral head")
    assert "What is guessed" in page
    shapes = [read_obj(out / "fit" / f"{name}_mesh.obj") for name in ("neutral", "registered")]
    for shape, words_more in zip(shapes, ([], ["--expression", "photo"]), strict=True):
        code, facts = called(*line, *words_more)
        assert code == 0
        assert {"fit", "detail"} <= set(facts["skipped"])
        exported = read_obj(out / "export" / "head.obj").vertices
        np.testing.assert_allclose(exported, shape.vertices, atol=1e-3)


def test_a_fit_that_is_killed_before_it_is_recorded_is_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown = []

    def fit(request: FitRequest, _: object) -> None:
        shown.append(request.photographs[0].name)
        about = {"rows": 6, "columns": 4, "lamps": None, "notes": []}
        write_json(request.out / "fit.json", about)
        if request.photographs[0].name == "two.png":
            raise KeyboardInterrupt

    monkeypatch.setattr(avatar, "fit_command", fit)
    monkeypatch.setattr(avatar, "write_avatar_page", lambda path, *_: path.touch())

    def made(photograph: str) -> None:
        path = tmp_path / photograph
        path.write_text(photograph)
        request = FitRequest((path,), default_template_path(), tmp_path / "A")
        avatar.avatar_command(request, "fit", "gltf", lambda _: nullcontext(quiet))

    (tmp_path / "A" / "fit").mkdir(parents=True)
    made("one.png")
    made("one.png")
    with pytest.raises(KeyboardInterrupt):
        made("two.png")
    made("one.png")
    assert shown == ["one.png", "two.png", "one.png"]


@pytest.mark.parametrize("name", ["notes.txt", "atlas/mine.txt"])
def test_a_fit_with_a_file_of_the_user_is_not_replaced(
    fitted: tuple[Path, Any], shot: Shot, marks: Path, tmp_path: Path, name: str
) -> None:
    out = shutil.copytree(fitted[0], tmp_path / "A")
    assert others_below(out / "fit", OWN) == []
    mine = out / "fit" / name
    mine.write_text("mine")
    code, _ = called(*words(shot, marks, out))
    assert code == 0  # nothing is made anew
    line = [*words(shot, marks, out), "--rows", "195"]
    code, stated = called(*line)
    assert (code, mine.read_text()) == (2, "mine")
    assert f"fit: found {name}, which the command did not make" in str(stated["error"])
    code, stated = called("fit", *line[1:-4], "--out", mine.parents[name.count("/")])
    assert (code, mine.read_text()) == (2, "mine")
    assert "Move what is yours elsewhere" in str(stated["error"])


def test_two_avatars_are_never_made_in_one_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    refusals = []
    for name in ("one.png", "two.png"):
        (tmp_path / name).write_text(name)

    def made(photograph: str) -> None:
        request = FitRequest((tmp_path / photograph,), default_template_path(), tmp_path / "A")
        avatar.avatar_command(request, "fit", "gltf", lambda _: nullcontext(quiet))

    def fit(request: FitRequest, _: object) -> None:
        # While the first is at work, one of another person begins.
        with pytest.raises(MapsError, match="another avatar that is made there now") as raised:
            made("two.png")
        refusals.append(raised.value)
        raise KeyboardInterrupt

    monkeypatch.setattr(avatar, "fit_command", fit)
    with pytest.raises(KeyboardInterrupt):
        made("one.png")
    assert len(refusals) == 1
    # One that made nothing leaves nothing.
    assert not (tmp_path / "A").exists()


def test_relief_becomes_heights_and_a_mesh_and_small_textures_have_none(
    fitted: tuple[Path, Any],
    shot: Shot,
    marks: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert "no detail" in " ".join(fitted[1]["notes"])
    out = shutil.copytree(fitted[0], tmp_path / "A")
    assert not (out / "detail").exists()
    monkeypatch.setattr(avatar, "TIMES", 1)
    # Waves in the normals, as a texture of more rows has them.
    path = out / "fit" / "atlas" / "specular_normal.exr"
    normal = read_exr(path)
    waves = 0.2 * np.sin(np.arange(ROWS) * 1.3)[:, None, None] * (normal != 0)
    write_exr(path, (normal + waves).astype(np.float32))
    record = json.loads((out / "avatar.json").read_text())
    assert record["stages"].pop("detail")
    write_json(out / "avatar.json", record)
    line = [*words(shot, marks, out), "--until", "detail", "--json"]
    facts = json.loads(printed(*line).splitlines()[-1])
    assert facts["skipped"] == ["fit"]
    assert "detail" in facts["parts"]
    assert "no detail" not in " ".join(facts["notes"])
    height = read_exr(out / "detail" / "displacement.exr")
    assert height.shape == (ROWS, ROWS * 2 // 3)
    assert height.std() > 0.001
    mesh = read_obj(out / "fit" / "registered_mesh.obj")
    finer = (out / "detail" / "embossed.obj").read_text()
    assert finer.count("\nf ") == 4 * len(mesh.triangles())
    page = (out / "avatar.html").read_text()
    assert 'href="detail/embossed.obj"' in page
    assert 'href="fit/fit.html"' in page
    facts = json.loads(printed(*line).splitlines()[-1])
    assert facts["skipped"] == ["fit", "detail"]


def test_a_photograph_comes_back_to_the_texels_that_it_shows(
    shot: Shot, template: Template, places: Places
) -> None:
    file = read_photograph(shot.path, FILM_MM)
    rgb = file.rgb_linear
    assert file.focal_px == pytest.approx(FOCAL_PX)
    assert file.scale == 1
    raster = rasterise(shot.mesh, ROWS, ROWS * 2 // 3)
    found = unwrap(rgb, shot.mesh, raster, shot.camera)
    position = raster.interpolate(shot.mesh.vertices)
    place, _ = shot.camera.project(position[found.seen].astype(float))
    column, row = np.floor(place).astype(int).T
    # Within the range of the pixels around, as means over a texel are.
    low = cv2.erode(rgb, np.ones((7, 7)))[row, column]
    high = cv2.dilate(rgb, np.ones((7, 7)))[row, column]
    texels = found.texture[found.seen]
    assert ((texels >= low - 1e-6) & (texels <= high + 1e-6)).all()
    assert not found.texture[~found.seen].any()
    # From the left of the face, its right ear is behind the head.
    left, right = position[..., 0] > 60, position[..., 0] < -60
    assert found.seen[left & raster.covered].mean() > 2 * found.seen[right & raster.covered].mean()


def test_a_filled_texture_has_no_step_at_the_photographs_border() -> None:
    rows, columns = 60, 40
    seen = np.zeros((rows, columns), bool)
    seen[:, :20] = True
    shown = np.full((rows, columns, 3), 0.3, np.float32)
    model = np.full((rows, columns, 3), 0.6, np.float32)
    found = joined(shown * seen[..., None], seen, np.ones_like(seen), model)
    np.testing.assert_allclose(found, 0.3, rtol=1e-3)
    alone = joined(shown * seen[..., None], seen, np.ones_like(seen), None)
    np.testing.assert_allclose(alone, 0.3, rtol=1e-3)
    nothing = joined(np.zeros_like(shown), np.zeros_like(seen), np.ones_like(seen), model)
    np.testing.assert_allclose(nothing, 0.6, rtol=1e-5)


def refused(shot: Shot, out: Path, *more: str | Path, photo: Path | None = None) -> str:
    """The message of a refusal; nothing is written."""
    code, stated = called(
        "fit", photo or shot.path, "--template", default_template_path(), "--out", out, *more
    )
    assert code == 2
    assert not out.exists()
    return str(stated["error"])


def test_bad_input_is_refused_in_words_that_name_it(shot: Shot, tmp_path: Path) -> None:
    out = tmp_path / "F"
    wall = tmp_path / "wall.png"
    cv2.imwrite(str(wall), np.full((200, 200, 3), 90, np.uint8))
    grey = tmp_path / "grey.png"
    cv2.imwrite(str(grey), np.full((200, 200), 90, np.uint8))
    tiny = tmp_path / "tiny.png"
    cv2.imwrite(str(tiny), np.zeros((5, 5, 3), np.uint8))
    cut = tmp_path / "cut.png"
    cut.write_bytes(shot.path.read_bytes()[:900])
    assert "found a folder, expected a photograph" in refused(shot, out, photo=tmp_path)
    assert "64 px" in refused(shot, out, photo=tiny)
    assert "grey.png" in refused(shot, out, photo=grey)
    assert "cut.png" in refused(shot, out, photo=cut)
    assert "--focal-35mm" in refused(shot, out, "--focal-35mm", "0")
    empty = write_json(
        tmp_path / "none.json",
        {"schema": "lightstage.landmarks/1", "scheme": "mediapipe468", "points_px": {}},
    )
    assert "no person one.png" in refused(shot, out, "--landmarks", empty)
    idle = refused(shot, out, "--landmarks", empty, "--face", "2")
    assert "--face: found 2, given with --landmarks" in idle
    rows = "--rows: found 200, expected a multiple of 3"
    assert rows in refused(shot, out, "--rows", "200")


def test_a_captured_heads_maps_are_an_avatar_without_a_fit(
    people: list[ProcessedFolder], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = shutil.copytree(people[0].root, tmp_path / "captured")
    captured = ProcessedFolder(root)
    normal = captured.read_atlas("specular_normal")
    waves = 0.2 * np.sin(np.arange(len(normal)) * 1.3)[:, None, None] * (normal != 0)
    captured.write_atlas("specular_normal", normal + waves)
    mesh = read_obj(captured.registered_mesh)
    template = save_template(
        Template("ball", mesh, np.arange(68), {}, "CC0", "test", None), tmp_path / "T"
    )
    out = tmp_path / "A"
    monkeypatch.setattr(avatar, "TIMES", 1)
    line = ["avatar", "--maps", root, "--template", template, "--out", out, "--format", "gltf"]

    def facts(*more: str | Path) -> dict[str, Any]:
        found: dict[str, Any] = json.loads(printed(*line, *more, "--json").splitlines()[-1])
        return found

    first = facts()
    assert first["parts"] == ["detail", "export"]
    assert (first["rows"], first["skipped"]) == (normal.shape[0], [])
    require_exported(out / "export" / "head.glb", captured.registered_mesh)
    assert read_exr(out / "detail" / "displacement.exr").shape == normal.shape[:2]
    assert "the captured head captured" in (out / "avatar.html").read_text()
    again = facts()
    assert again["skipped"] == ["detail", "export"]
    assert again["notes"] == first["notes"] != []
    captured.write_atlas("diffuse_albedo", 0.5 * captured.read_atlas("diffuse_albedo"))
    assert facts()["skipped"] == []
    # Another head's export does not stay where only detail is made anew.
    captured.write_atlas("diffuse_albedo", 0.9 * captured.read_atlas("diffuse_albedo"))
    again = facts("--until", "detail")
    assert (again["parts"], again["skipped"]) == (["detail"], [])
    assert "head.glb" not in (out / "avatar.html").read_text()
    assert not (out / "export").exists()
    # Files of the user stay, and a note names the folder.
    facts()
    (out / "export" / "thesis.txt").write_text("mine")
    captured.write_atlas("diffuse_albedo", 0.9 * captured.read_atlas("diffuse_albedo"))
    assert str(out / "export") in " ".join(facts("--until", "detail")["notes"])
    assert (out / "export" / "thesis.txt").read_text() == "mine"
    # Nor does a new export take their place: the command refuses before it makes anything.
    captured.write_atlas("diffuse_albedo", 0.9 * captured.read_atlas("diffuse_albedo"))
    before = {path: path.stat().st_mtime_ns for path in out.rglob("*")}
    text = "export: found thesis.txt, which the command did not make"
    assert text in refusal(*line)
    assert {path: path.stat().st_mtime_ns for path in out.rglob("*")} == before
    (out / "export" / "thesis.txt").rename(tmp_path / "thesis.txt")
    (out / "export" / ".DS_Store").touch()
    assert facts()["parts"] == ["detail", "export"]
    for words, message in (
        ([*line, captured.registered_mesh], "found both"),
        ([word for word in line if word not in ("--maps", root)], "found neither"),
        ([*line, "--until", "fit"], "detail or export"),
        ([*line, "--expression", "photo"], "--expression: found given with --maps"),
        ([*line, "--rows", "768", "--face", "2"], "--face, --rows: found given with --maps"),
        ([*line, "--landmarks", tmp_path / "none.json"], "--landmarks: found given with --maps"),
    ):
        assert message in refusal(*words)


def test_an_avatar_refuses_before_it_writes_anything(shot: Shot, tmp_path: Path) -> None:
    out = tmp_path / "A"

    def refusal(*more: str | Path, photo: Path = shot.path) -> str:
        words = ("avatar", photo, "--template", default_template_path(), "--out", out)
        code, stated = called(*words, *more)
        assert code == 2
        return str(stated["error"])

    assert "found a folder, expected a photograph" in refusal(photo=tmp_path)
    assert "found 'smile', expected neutral or photo" in refusal("--expression", "smile")
    assert "--until" in refusal("--until", "page")
    assert "--format" in refusal("--format", "fbx")
    assert "--rows: found 200, expected a multiple of 3" in refusal("--rows", "200")
    assert not out.exists()
    out.mkdir()
    (out / "thesis.txt").write_text("mine")
    assert "thesis.txt" in refusal()
    assert [path.name for path in out.iterdir()] == ["thesis.txt"]


def test_a_wall_holds_no_face(shot: Shot, tmp_path: Path) -> None:
    wall = tmp_path / "wall.png"
    cv2.imwrite(str(wall), np.full((200, 200, 3), 90, np.uint8))
    assert "no face" in refused(shot, tmp_path / "F", photo=wall)
