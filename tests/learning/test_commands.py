from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from lightstage.formats.environment import LightSet, read_lights, write_lights
from lightstage.formats.exr import read_exr, write_exr
from lightstage.formats.mesh import Mesh, read_obj, write_obj
from lightstage.formats.processed import ProcessedFolder, write_map
from lightstage.rig import Rig, default_rig, load_rig, save_rig
from tests.learning.export.called import printed, refusal
from tests.programs import run_program

TINY_TOML = """
seconds = 0.3
score_patches = 2
[generator]
width = 8
downsamplings = 2
global_blocks = 1
local_blocks = 1
[discriminator]
width = 4
[data]
patch_px = 32
stride_px = 32
shadow_rows = 24
shadow_sets = 1
"""


@pytest.fixture
def scene(people: list[ProcessedFolder], tmp_path: Path) -> dict[str, Path]:
    """A head's maps and mesh, a light set and a small rig."""
    shutil.copytree(people[0].root / "atlas", tmp_path / "atlas")
    lights = LightSet(
        "two", np.array([[600.0, 500, 900], [-900, 0, 300]]), np.ones((2, 3)) * 0.5, np.full(3, 0.1)
    )
    rig = default_rig().scaled(0.02)
    return {
        "maps": tmp_path / "atlas",
        "mesh": people[0].registered_mesh,
        "environment": write_lights(lights, tmp_path / "lights.json"),
        "rig": save_rig(Rig(rig.lights, rig.cameras), tmp_path / "rig.json"),
    }


def options(scene: dict[str, Path]) -> list[object]:
    return [word for name, path in scene.items() for word in (f"--{name}", path)]


def test_render_writes_a_picture_of_the_head(scene: dict[str, Path], tmp_path: Path) -> None:
    picture, lit = tmp_path / "head.png", tmp_path / "lit.exr"
    words = ["render", *options(scene), "--out", picture, "--camera", "cam1", "--json"]
    words += ["--background", "none"]
    facts = json.loads(printed(*words).splitlines()[-1])
    image = cv2.imread(str(picture), cv2.IMREAD_UNCHANGED)
    assert image.shape == (facts["height_px"], facts["width_px"], 4)
    # The middle pixel shows the baked texture where its ray meets the ball.
    printed("bake", *options(scene), "--camera", "cam1", "--out", lit)
    row, column = image.shape[0] // 2, image.shape[1] // 2
    camera = load_rig(scene["rig"]).camera("cam1")
    ray, eye = camera.rays_through(np.array(column + 0.5), np.array(row + 0.5)), camera.centre_mm
    radius = np.linalg.norm(read_obj(scene["mesh"]).vertices, axis=1).mean()
    away = -ray @ eye - np.sqrt((ray @ eye) ** 2 - eye @ eye + radius**2)
    x, y, z = (eye + away * ray) / radius
    texture = read_exr(lit)
    place = (np.arctan2(x, z) / (2 * np.pi) + 0.5, 0.5 - np.arcsin(y) / np.pi)
    at = [
        float(share * side - 0.5) for share, side in zip(place, texture.shape[1::-1], strict=True)
    ]
    shown = cv2.remap(texture, *(np.full((1, 1), v, np.float32) for v in at), cv2.INTER_LINEAR)
    encoded = 1.055 * shown[0, 0] ** (1 / 2.4) - 0.055
    np.testing.assert_allclose(image[row, column], [*(255 * encoded[::-1]), 255], atol=2)
    assert image[0, 0].tolist() == [0, 0, 0, 0]
    linear = tmp_path / "head.exr"
    dark = ["render", *options(scene), "--out", linear, "--background", "black"]
    printed(*dark)
    assert not read_exr(linear)[0, 0].any()


def test_render_leaves_out_what_was_not_captured_when_told(
    scene: dict[str, Path], tmp_path: Path
) -> None:
    confidence = read_exr(scene["maps"] / "confidence.exr")
    confidence[: len(confidence) // 2] = 0
    write_exr(scene["maps"] / "confidence.exr", confidence)
    shown = []
    for flag in ([], ["--captured-only"]):
        words = ["render", *options(scene), "--out", tmp_path / "head.png", *flag, "--json"]
        shown.append(json.loads(printed(*words).splitlines()[-1])["surface_percent"])
    assert 0.3 * shown[0] < shown[1] < 0.7 * shown[0]


def test_bake_writes_the_lit_texture(scene: dict[str, Path], tmp_path: Path) -> None:
    printed("bake", *options(scene), "--out", tmp_path / "lit.exr")
    lit = read_exr(tmp_path / "lit.exr", finite=True)
    albedo = read_exr(scene["maps"] / "diffuse_albedo.exr")
    assert lit.shape == albedo.shape
    # The ball's back sees neither light: ambient alone, a tenth of the albedo.
    back = (slice(40, 56), slice(0, 3))
    np.testing.assert_allclose(lit[back], 0.1 * albedo[back], rtol=0.05)
    assert lit[40, 40].mean() > 3 * lit[40, 1].mean()


def test_train_then_infer_writes_the_maps(
    store_path: Path, people: list[ProcessedFolder], tmp_path: Path
) -> None:
    (tmp_path / "tiny.toml").write_text(TINY_TOML)
    train = [
        "train",
        "--preset",
        "demo",
        "--data",
        store_path,
        "--out",
        tmp_path / "run",
        "--config",
        tmp_path / "tiny.toml",
    ]
    trained = printed(*train)
    saved = json.loads((tmp_path / "run" / "checkpoint.json").read_text())
    assert f"PSNR {saved['metrics']['psnr_db']:.2f} dB;" in trained
    assert "a run that is there already" in refusal(*train)
    printed(*train, "--resume", "--seconds", 0.2)
    texture = people[1].atlas_path("diffuse_albedo")
    base = ["infer", "--mesh", people[1].registered_mesh, "--checkpoint", tmp_path / "run"]
    pose = ["--head-pose", people[1].head_pose]
    out = tmp_path / "maps"
    printed(*base, "--texture", texture, "--out", out, *pose)
    assert sorted(p.stem for p in out.iterdir()) == [
        "confidence",
        "diffuse_albedo",
        "diffuse_normal",
        "specular_albedo",
        "specular_normal",
    ]
    small = write_exr(tmp_path / "small.exr", read_exr(texture)[::2, ::2])
    assert "resampled from 48 x 32 texels to the 96 rows" in printed(
        *base, "--texture", small, "--out", out
    )
    bad = read_exr(texture)
    bad[5, 7, 1] = np.nan
    refused = tmp_path / "refused"
    nan = write_exr(tmp_path / "nan.exr", bad)
    assert "found a folder that holds dataset.json" in refusal(
        *base, "--texture", texture, "--out", store_path
    )
    assert "element (5, 7, 1): found 1 NaN or infinite value," in refusal(
        *base, "--texture", nan, "--out", refused
    )
    assert not refused.exists()


def test_whole_faces_are_the_default_and_infer_keeps_a_textures_size(
    store_path: Path, people: list[ProcessedFolder], tmp_path: Path
) -> None:
    small = "steps = 2\ndetail_pairs = 1\ndoubt_faces = 8\n"
    network = "[network]\nrows = 48\ncolumns = 32\nwidth = 2\n"
    (tmp_path / "small.toml").write_text(small + network)
    run_folder = tmp_path / "run"
    train = [
        "train",
        "--data",
        store_path,
        "--out",
        run_folder,
        "--config",
        tmp_path / "small.toml",
    ]
    assert "after the best gain a channel" in printed(*train)
    texture = read_exr(people[1].atlas_path("diffuse_albedo"))
    odd = write_exr(
        tmp_path / "odd.exr", cv2.resize(texture, (50, 75), interpolation=cv2.INTER_AREA)
    )
    base = ["infer", "--mesh", people[1].registered_mesh, "--texture", odd]
    printed(*base, "--out", tmp_path / "maps", "--checkpoint", run_folder)
    assert read_exr(tmp_path / "maps" / "diffuse_albedo.exr").shape == (75, 50, 3)
    assert np.isfinite(read_lights(tmp_path / "maps" / "light.json").ambient_rgb).all()
    # Without refinement no light is known, and none of an earlier call stays.
    again = [*base, "--out", tmp_path / "maps", "--checkpoint", run_folder, "--refine", "0"]
    printed(*again)
    assert not (tmp_path / "maps" / "light.json").exists()
    assert "--refine: found nan, expected 0 to 3600 seconds" in refusal(
        *base, "--out", tmp_path / "nan", "--refine", "nan"
    )
    # The shipped weights know our template's layout, and a ball's is another.
    large = write_exr(tmp_path / "large.exr", np.tile(texture, (2, 2, 1)))
    other = ["infer", "--mesh", people[1].registered_mesh, "--texture", large]
    assert "mm from where the people trained on have them" in refusal(
        *other, "--out", tmp_path / "other"
    )
    assert not (tmp_path / "other").exists()


def test_infer_refuses_a_captures_atlas_and_replaces_maps_all_at_once(
    strangers: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    captured = ProcessedFolder(shutil.copytree(strangers[0], tmp_path / "captured"))
    atlas = captured.root / "atlas"
    base = ["infer", "--mesh", captured.registered_mesh, "--refine", "0"]
    base += ["--texture", captured.atlas_path("diffuse_albedo")]

    def content(folder: Path) -> dict[str, bytes]:
        return {path.name: path.read_bytes() for path in folder.iterdir()}

    before = content(atlas)
    assert "found a folder that holds ambient_occlusion.exr" in refusal(*base, "--out", atlas)
    assert content(atlas) == before
    out = tmp_path / "maps"
    printed(*base, "--out", out)
    first = content(out)
    calls = []

    def interrupted(*given: object) -> None:
        calls.append(given)
        if len(calls) == 3:
            raise KeyboardInterrupt
        write_map(*given)  # type: ignore[arg-type]

    monkeypatch.setattr("learning.commands.write_map", interrupted)
    darker = write_exr(tmp_path / "darker.exr", 0.5 * read_exr(base[-1]))
    assert run_program("learning", *base[:-1], darker, "--out", out).code == 130
    assert len(calls) == 3
    assert content(out) == first
    assert sorted(path.name for path in tmp_path.iterdir()) == ["captured", "darker.exr", "maps"]


def test_a_folder_that_is_another_commands_is_refused_before_any_work(
    people: list[ProcessedFolder], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def never(*_: object, **__: object) -> None:
        raise AssertionError("began to work")

    taken = tmp_path / "taken"
    taken.mkdir()
    (taken / "thesis.txt").write_text("mine")
    for where in ("learning.detail.command.read_source", "learning.photo.command.whole_face_of"):
        monkeypatch.setattr(where, never)
    for words in (("detail", people[0].root), ("fit", tmp_path / "photo.jpg")):
        assert "expected a new folder, or one made by the same command" in refusal(
            *words, "--out", taken
        )
    assert [path.name for path in taken.iterdir()] == ["thesis.txt"]


def test_a_configuration_that_states_a_trainings_length_twice_is_refused(
    store_path: Path, tmp_path: Path
) -> None:
    (tmp_path / "long.toml").write_text("steps = 30000\nseconds = 1.0\n")
    message = refusal(
        "train", "--data", store_path, "--out", tmp_path / "run", "--config", tmp_path / "long.toml"
    )
    assert "long.toml, seconds, steps: found 1.0, 30000, expected one of" in message


def test_a_light_set_beside_a_configuration_without_a_table_of_lights_is_refused(
    scene: dict[str, Path], store_path: Path, tmp_path: Path
) -> None:
    (tmp_path / "lights.toml").write_text("lights = 3\n")
    words = ["train", "--data", store_path, "--out", tmp_path / "run"]
    words += ["--config", tmp_path / "lights.toml", "--environment", scene["environment"]]
    assert "lights.toml, lights: found 3" in refusal(*words)


def test_bad_input_is_one_message_and_exit_2(
    scene: dict[str, Path], store_path: Path, tmp_path: Path
) -> None:
    out = tmp_path / "never.png"

    def refused(expected: str, *words: object, **changed: Path) -> None:
        message = refusal(*words, *options({**scene, **changed}), "--out", out)
        assert expected in message
        assert "Traceback" not in message
        assert not out.exists()

    mesh = read_obj(scene["mesh"])
    bare = write_obj(Mesh(mesh.vertices, mesh.faces), tmp_path / "bare.obj")
    refused("uv: found none", "render", mesh=bare)
    refused("found no such file", "render", environment=tmp_path / "missing.json")
    refused("found no cam99", "render", "--camera", "cam99")
    refused("expected white or black", "render", "--background", "pink")
    refused("expected 'dielectric', 'physical', 'paper' or 'ggx'", "render", "--mode", "glossy")
    small = read_exr(scene["maps"] / "specular_albedo.exr")[:48]
    write_exr(scene["maps"] / "specular_albedo.exr", small)
    refused("found 48 x 64 texels, expected 96 x 64", "render")
    broken = small.copy()
    broken[0, 0] = np.inf
    write_exr(scene["maps"] / "specular_albedo.exr", broken, half=False)
    refused("NaN or infinite", "render")

    infer = ["infer", "--texture", scene["maps"] / "diffuse_albedo.exr", "--mesh", scene["mesh"]]
    for checkpoint, expected in (
        (tmp_path / "nowhere", "found no such file"),
        (scene["rig"], "expected 'lightstage.checkpoint/1'"),
        (scene["mesh"], "found a file with the suffix '.obj'"),
    ):
        assert expected in refusal(*infer, "--checkpoint", checkpoint, "--out", tmp_path / "x")
    train = ["train", "--data", store_path, "--out", tmp_path / "run"]
    assert "one of modern, paper, demo, avatarme" in refusal(*train, "--preset", "huge")
    refusal("train", "--data", tmp_path, "--out", tmp_path / "run")
    assert not (tmp_path / "run").exists()
