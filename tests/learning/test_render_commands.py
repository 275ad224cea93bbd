from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from learning.commands import RenderRequest, _lit_head
from learning.errors import MapsError
from learning.map_folders import require_texture_maps
from learning.relight import about_y, turned_camera, write_picture
from learning.render.occlusion_model import OcclusionTable
from learning.render.uv import rasterise
from lightstage.commands import quiet
from lightstage.formats.environment import LightSet, write_lights
from lightstage.formats.exr import read_exr, write_exr
from lightstage.formats.files import write_json
from lightstage.formats.mesh import read_obj, write_obj
from lightstage.formats.processed import ProcessedFolder
from lightstage.rig import Rig, default_rig, save_rig
from processing.colour import srgb_from_linear
from tests.learning.export.called import printed, refusal


def rig_file(folder: Path) -> Path:
    rig = default_rig().scaled(0.02)
    return save_rig(Rig(rig.lights, rig.cameras), folder / "rig.json")


def panorama(path: Path) -> Path:
    """Blue all round, red from +x."""
    picture = np.zeros((16, 32, 3), np.float32)
    picture[..., 2] = 0.3
    picture[6:10, 23:26] = [20, 0, 0]
    return write_exr(path, picture)


def table_of(person: ProcessedFolder, folder: Path) -> Path:
    """Random shadows: a ball's own are none."""
    raster = rasterise(read_obj(person.registered_mesh), 24, 16)
    size = (64, -(-int(raster.covered.sum()) // 8))
    bits = np.random.default_rng(2).integers(0, 256, size, np.uint8)
    return OcclusionTable(bits, raster.covered, raster.face).save(folder / "own.npz")


def test_render_takes_a_picture_of_light_turns_it_and_goes_round_the_head(
    people: list[ProcessedFolder], tmp_path: Path
) -> None:
    base = ["render", "--maps", people[0].root / "atlas", "--rig", rig_file(tmp_path)]
    base += ["--environment", panorama(tmp_path / "room.exr"), "--lights", 12, "--json"]

    def picture(name: str, *words: object) -> np.ndarray:
        out = tmp_path / name
        printed(*base, "--out", out, *words)
        return read_exr(out)

    def redness(image: np.ndarray) -> float:
        """Red light on the right half over red light on the left."""
        half = image.shape[1] // 2
        return float(image[:, half:, 0].sum() / image[:, :half, 0].sum())

    black = ("--background", "black")
    facts = json.loads(printed(*base, "--out", tmp_path / "right.exr", *black).splitlines()[-1])
    assert redness(read_exr(tmp_path / "right.exr")) > 1.5
    assert facts["lights"] == 12
    assert facts["notes"] == []
    assert redness(picture("left.exr", "--rotate", 180, *black)) < 0.7
    own = table_of(people[0], tmp_path)
    table = picture("table.exr", "--shadows", f"table:{own}", "--mode", "ggx", *black)
    assert np.isfinite(table).all()
    unshadowed = picture("none.exr", "--shadows", "none", "--mode", "ggx", *black)
    assert 0.1 * unshadowed.sum() < table.sum() < 0.9 * unshadowed.sum()
    # Without a file it is our own template's, whose texture is another.
    assert "show the triangle of the head to render" in refusal(
        *base, "--out", tmp_path / "x.exr", "--shadows", "table"
    )
    for wrong in ("table:", f"table:{tmp_path / 'none.npz'}", "table:own", "tables"):
        message = refusal(*base, "--out", tmp_path / "x.exr", "--shadows", wrong)
    assert "table:FILE" in message
    assert not (tmp_path / "x.exr").exists()
    printed(*base, "--out", tmp_path / "t.png", "--turntable", 3)
    names = sorted(p.name for p in tmp_path.glob("t*.png"))
    assert names == ["t_000.png", "t_001.png", "t_002.png"]
    assert cv2.imread(str(tmp_path / "t_001.png"), cv2.IMREAD_UNCHANGED).shape[2] == 3


def test_under_a_picture_of_light_the_printed_formulas_are_about_as_bright_as_others(
    people: list[ProcessedFolder], tmp_path: Path
) -> None:
    """The ambient intensity, which multiplies there, is 1: a picture has none."""
    base = ["render", "--maps", people[0].root / "atlas", "--rig", rig_file(tmp_path), "--json"]
    base += ["--background", "black", "--shadows", "none", "--out", tmp_path / "o.exr"]
    window = np.full((16, 32, 3), 0.2, np.float32)
    window[3:7, 14:20] = 20  # before the face and above
    picture = write_exr(tmp_path / "window.exr", window)

    def green(light: Path, mode: str) -> tuple[float, list[str]]:
        facts = json.loads(printed(*base, "--environment", light, "--mode", mode).splitlines()[-1])
        return float(read_exr(tmp_path / "o.exr")[..., 1].mean()), facts["notes"]

    usual, _ = green(picture, "physical")
    paper, notes = green(picture, "paper")
    assert notes == []
    assert 0.5 * usual < paper < 2 * usual
    # Of a light set the user states it.
    lamp = np.array([[0.0, 300.0, 900.0]]), np.ones((1, 3))
    dark = write_lights(LightSet("lamp", *lamp, np.zeros(3)), tmp_path / "dark.json")
    one = write_lights(LightSet("lamp", *lamp, np.ones(3)), tmp_path / "one.json")
    (black, noted), (lit, none) = green(dark, "paper"), green(one, "paper")
    assert black < 0.1 * lit
    assert "by which mode paper multiplies" in noted[0]
    assert none == []
    assert green(dark, "physical")[1] == []


def test_pngs_are_over_their_background_and_without_one_keep_the_surfaces_colour_at_edges(
    tmp_path: Path,
) -> None:
    skin, alpha = np.array([0.1, 0.2, 0.4]), np.array([[1.0, 0.5, 0.0]])

    def read(name: str) -> np.ndarray:
        return np.asarray(cv2.imread(str(tmp_path / name), cv2.IMREAD_UNCHANGED))

    over_white = alpha[..., None] * skin + (1 - alpha[..., None])
    write_picture(tmp_path / "white.png", over_white)
    known = np.round(255 * srgb_from_linear(over_white))[..., ::-1]
    np.testing.assert_array_equal(read("white.png"), known)
    write_picture(tmp_path / "none.png", alpha[..., None] * skin, alpha)
    found = read("none.png")
    np.testing.assert_array_equal(found[0, 0, :3], np.round(255 * srgb_from_linear(skin))[::-1])
    np.testing.assert_array_equal(found[0, 1, :3], found[0, 0, :3])
    np.testing.assert_array_equal(found[0, :, 3], [255, 128, 0])


def test_a_picture_without_a_background_is_a_png(
    people: list[ProcessedFolder], tmp_path: Path
) -> None:
    base = ["render", "--maps", people[0].root / "atlas", "--rig", rig_file(tmp_path)]
    base += ["--environment", panorama(tmp_path / "room.exr"), "--lights", 2]
    none = [*base, "--background", "none", "--out"]
    assert "--background: found none, for x.exr" in refusal(*none, tmp_path / "x.exr")
    assert not (tmp_path / "x.exr").exists()
    printed(*none, tmp_path / "x.png")
    picture = cv2.imread(str(tmp_path / "x.png"), cv2.IMREAD_UNCHANGED)
    assert picture.shape[2] == 4
    assert 0 < picture[..., 3].mean() < 255


def test_occlusion_writes_a_table(tmp_path: Path) -> None:
    out = tmp_path / "table.npz"
    assert "16 directions at 12 x 8 texels" in printed(
        "occlusion", "--out", out, "--rows", 12, "--directions", 16
    )
    assert out.is_file()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--shadows", "soft"), "expected baked, table, none"),
        (("--lights", "0"), "expected 1 to 4096"),
        (("--turntable", "0"), "expected 1 to 999 pictures"),
    ],
)
def test_what_cannot_be_rendered_is_refused(
    words: tuple[str, str], message: str, people: list[ProcessedFolder], tmp_path: Path
) -> None:
    base = ["render", "--maps", people[0].root / "atlas", "--out", tmp_path / "never.png"]
    base += ["--environment", panorama(tmp_path / "room.exr"), *words]
    assert message in refusal(*base)
    assert not (tmp_path / "never.png").exists()


def test_no_lights_at_all_leave_the_ambient_light(
    people: list[ProcessedFolder], tmp_path: Path
) -> None:
    none = LightSet("none", np.zeros((0, 3)), np.zeros((0, 3)), np.full(3, 0.25))
    words = ["bake", "--maps", people[0].root / "atlas", "--mesh", people[0].registered_mesh]
    words += ["--environment", write_lights(none, tmp_path / "e.json")]
    printed(*words, "--out", tmp_path / "lit.exr", "--rig", rig_file(tmp_path))
    albedo = read_exr(people[0].atlas_path("diffuse_albedo"))
    assert read_exr(tmp_path / "lit.exr").mean() == pytest.approx(0.25 * albedo.mean(), rel=0.02)


def test_cameras_go_round_a_point_and_keep_looking_at_it() -> None:
    camera = default_rig().cameras[0]
    centre = camera.centre_mm + 900 * camera.cam_from_world[2, :3]
    for angle in (0.0, 90.0, 200.0):
        moved = turned_camera(camera, angle, centre)
        expected = centre + about_y(angle) @ (camera.centre_mm - centre)
        np.testing.assert_allclose(moved.centre_mm, expected, atol=1e-6)
        pixels, depth = moved.project(centre[None])
        before, far = camera.project(centre[None])
        np.testing.assert_allclose(pixels, before, atol=1e-6)
        np.testing.assert_allclose(depth, far, atol=1e-6)


def test_a_folder_of_several_maps_is_reported_with_what_each_is(tmp_path: Path) -> None:
    def maps(*names: str) -> None:
        for name in names:
            write_exr(tmp_path / "OUT" / name / "diffuse_albedo.exr", np.ones((2, 2, 3)))

    maps("views/cam0", "views/cam1")
    with pytest.raises(MapsError, match=r"2 folders of maps below: .*Run the stage atlas"):
        require_texture_maps(tmp_path / "OUT")
    maps("atlas")
    with pytest.raises(MapsError, match=r"atlas \(the texture of one.*views/cam0 \(one camera's"):
        require_texture_maps(tmp_path / "OUT")
    with pytest.raises(MapsError, match="OUT/atlas"):
        require_texture_maps(tmp_path / "OUT")
    with pytest.raises(MapsError, match=r"one camera's maps, .*OUT/atlas"):
        require_texture_maps(tmp_path / "OUT" / "views" / "cam0")
    require_texture_maps(tmp_path / "OUT" / "atlas")
    (tmp_path / "empty").mkdir()
    with pytest.raises(MapsError, match="no diffuse_albedo"):
        require_texture_maps(tmp_path / "empty")


def test_render_of_a_processed_folder_names_which_maps_it_means(
    people: list[ProcessedFolder], tmp_path: Path
) -> None:
    words = ("render", "--maps", people[0].root, "--out", tmp_path / "never.png")
    assert "the texture of one person" in refusal(
        *words, "--environment", panorama(tmp_path / "room.exr")
    )


def test_a_table_of_shadows_takes_the_head_pose_that_is_beside_the_mesh(
    people: list[ProcessedFolder], tmp_path: Path
) -> None:
    upright, turn = people[0], about_y(100.0)
    # As `infer` leaves them: maps in a folder of their own, in the axes of a mesh that is turned.
    maps = tmp_path / "inferred" / "maps"
    maps.mkdir(parents=True)
    for path in (upright.root / "atlas").iterdir():
        image = read_exr(path)
        write_exr(maps / path.name, image @ turn.T if image.ndim == 3 else image)
    albedo = read_exr(upright.atlas_path("diffuse_albedo"))
    write_exr(maps / "diffuse_albedo.exr", albedo)
    person = ProcessedFolder(tmp_path / "person")
    person.root.mkdir()
    mesh = read_obj(upright.registered_mesh)
    write_obj(mesh.with_vertices(mesh.vertices @ turn.T), person.registered_mesh)
    back = np.column_stack([turn.T, np.zeros(3)])
    write_json(person.head_pose, {"head_from_world": back.tolist()})
    place = np.array([[700.0, 300.0, 500.0]])
    table = f"table:{table_of(upright, tmp_path)}"

    def seen(folder: Path, shape: Path, place_mm: np.ndarray) -> np.ndarray:
        light = LightSet("one", place_mm, np.ones((1, 3)), np.zeros(3))
        environment = write_lights(light, tmp_path / "e.json")
        out = tmp_path / "never.exr"
        request = RenderRequest(
            folder, shape, environment, out, None, "cam0", None, "dielectric", 1, 0.0, table
        )
        found = _lit_head(request, quiet)[2]
        assert found is not None
        return found.numpy()

    found = seen(maps, person.registered_mesh, place @ turn.T)
    expected = seen(upright.root / "atlas", upright.registered_mesh, place)
    np.testing.assert_allclose(found, expected, atol=1e-4)
    assert expected.std() > 0.1
