"""The stage `decode`: windows, what is kept from the last run, exposures, dark frames."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import processing.decode.files
from lightstage.errors import FormatError
from lightstage.formats.exr import write_exr
from lightstage.formats.files import sha256_file
from lightstage.formats.flats import FlatField, write_flats
from lightstage.formats.half import LARGEST
from lightstage.formats.mesh import Mesh, write_ply
from lightstage.formats.session import Session, load_session
from processing.decode.config import DecodeConfig
from processing.decode.files import CameraJob, patterns_to_search
from processing.decode.session_photographs import LinearPhotograph, Photograph
from processing.decode.stage import decode
from processing.errors import ProcessingError
from processing.frames.drafts import BLUE, GREEN, NOT_A_NUMBER, RED
from processing.frames.read import Frames, power_of_two, read_foreground, read_frames
from processing.frames.window import Window, whole
from processing.raw.region import find_window, mesh_window, preview
from tests.processing.lit_ball import small_rig
from tests.processing.made_raw import (
    counts_of,
    replace_photograph,
    write_dng,
    write_raw_session,
)

RIG = small_rig(1, 0.04)
CAMERA = RIG.cameras[0]
SHAPE = (CAMERA.height_px, CAMERA.width_px)
COLOUR: dict[str, Any] = {
    "schema": "lightstage.colour/1",
    "cameras": {
        "cam0": {"linear_from_raw": [[2.0, -0.2, 0.0], [-0.1, 1.2, -0.1], [0.0, -0.3, 1.6]]}
    },
}
MATRIX = np.array(COLOUR["cameras"]["cam0"]["linear_from_raw"])
PATTERNS = ("full", "x+", "x-", "y+", "y-", "z+", "z-")


def photographs(patterns: tuple[str, ...] = PATTERNS) -> dict[str, dict[str, np.ndarray]]:
    """A disc, lit so that complements sum to full: shares of white by pattern and camera."""
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    y = (rows - 0.55 * SHAPE[0]) / (0.22 * SHAPE[0])
    x = (columns - 0.45 * SHAPE[1]) / (0.22 * SHAPE[0])
    disc = (x * x + y * y < 1)[..., None]
    texture = 0.05 * np.sin(rows / 3)[..., None] * np.sin(columns / 4)[..., None]
    full = np.where(disc, np.array([0.3, 0.5, 0.35]) * (1 + texture), 0.0)
    share = {
        "x": 0.5 + 0.3 * x,
        "y": 0.5 - 0.3 * y,
        "z": 0.5 + 0.3 * np.clip(1 - x * x - y * y, 0, 1),
    }
    out = {}
    for name in patterns:
        part = np.ones(SHAPE) if name == "full" else share[name[0]]
        part = 1 - part if name.endswith("-") else part
        out[name] = {"cam0": full * part[..., None]}
    return out


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return write_raw_session(tmp_path / "session", RIG, photographs(), COLOUR)


def decoded(root: Path, out: Path, config: DecodeConfig | None = None) -> tuple[Frames, Any]:
    facts = decode(load_session(root), out, config or DecodeConfig())
    return read_frames(out, "cam0"), facts


def change(root: Path, **fields: Any) -> None:
    value = json.loads((root / "session.json").read_text())
    (root / "session.json").write_text(json.dumps(value | fields))


def same(one: Frames, other: Frames) -> None:
    assert one.patterns == other.patterns
    np.testing.assert_array_equal(one.images, other.images)
    np.testing.assert_array_equal(one.valid, other.valid)


def test_a_window_holds_the_face_and_what_is_in_it_is_the_same(root: Path, tmp_path: Path) -> None:
    cropped, facts = decoded(root, tmp_path / "cropped")
    everything, _ = decoded(root, tmp_path / "whole", DecodeConfig(crop=False))
    assert everything.window == whole(SHAPE)
    assert facts["window_share_of_picture"]["cam0"] < 0.6
    inside = cropped.window.slices
    np.testing.assert_array_equal(cropped.images[:, *inside], everything.images[:, *inside])
    masks = [read_foreground(tmp_path / name, "cam0") for name in ("cropped", "whole")]
    np.testing.assert_array_equal(*masks)
    assert masks[0].any()
    exact = photographs()["x+"]["cam0"] @ MATRIX.T
    inner = cv2.erode(masks[0].astype(np.uint8), np.ones((17, 17))) > 0
    np.testing.assert_allclose(cropped.image(1)[inner], exact[inner], atol=0.02)


def test_photographs_that_did_not_change_are_not_opened_again(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before, facts = decoded(root, tmp_path / "out")
    assert facts["frames_kept_from_the_last_run"] == 0
    images = before.images
    opened: list[str] = []
    really = CameraJob.open

    def spy(job: CameraJob, pattern: str) -> Photograph:
        opened.append(pattern)
        return really(job, pattern)

    monkeypatch.setattr(CameraJob, "open", spy)
    again, facts = decoded(root, tmp_path / "out")
    assert (opened, facts["frames_kept_from_the_last_run"]) == ([], len(PATTERNS))
    np.testing.assert_array_equal(again.images, images)
    changed = photographs()["y+"]["cam0"] * 1.02
    changed[0, 0] = 1.1
    replace_photograph(root, "y+", "cam0", changed)
    third, facts = decoded(root, tmp_path / "out")
    assert opened == ["y+"]
    assert facts["frames_kept_from_the_last_run"] == len(PATTERNS) - 1
    fresh, _ = decoded(root, tmp_path / "fresh")
    same(third, fresh)


def test_a_photograph_that_was_mended_later_is_decoded_again(root: Path, tmp_path: Path) -> None:
    replace_photograph(root, "z+", "cam0", 1.1 * photographs()["z+"]["cam0"])
    before, facts = decoded(root, tmp_path / "out")
    assert facts["sums"]["cam0"]["flicker"]
    mended = before.images
    again, facts = decoded(root, tmp_path / "out")
    assert facts["frames_kept_from_the_last_run"] < len(PATTERNS)
    np.testing.assert_array_equal(again.images, mended)


def test_other_colours_flats_or_settings_decode_all_again(root: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    first = decoded(root, out)[0].images
    twice = json.loads(json.dumps(COLOUR))
    twice["cameras"]["cam0"]["linear_from_raw"] = (2 * MATRIX).tolist()
    (root / "colour.json").write_text(json.dumps(twice))
    frames, facts = decoded(root, out)
    assert facts["frames_kept_from_the_last_run"] == 0
    np.testing.assert_allclose(frames.images, 2 * first, rtol=1e-3, atol=1e-3)
    assert decoded(root, out)[1]["frames_kept_from_the_last_run"] == len(PATTERNS)
    field = FlatField(
        (SHAPE[1], SHAPE[0]), np.array([SHAPE[1] / 2, SHAPE[0] / 2]), 150.0, np.array([-0.2, 0, 0])
    )
    write_flats({"cam0": field}, root / "flats.json", {})
    kept = {"colour": "colour.json", "cameras": None, "lights": None, "flats": "flats.json"}
    change(root, calibration=kept)
    flat, facts = decoded(root, out)
    assert facts["frames_kept_from_the_last_run"] == 0
    gain = field.gain(SHAPE)[..., None]
    np.testing.assert_allclose(flat.images, 2 * first * gain, rtol=0.02, atol=5e-3)
    assert decoded(root, out, DecodeConfig(clip_share=0.9))[1]["frames_kept_from_the_last_run"] == 0
    write_flats({"cam0": dataclasses.replace(field, size_px=SHAPE)}, root / "flats.json", {})
    with pytest.raises(FormatError, match=f"expected {SHAPE[0]} x {SHAPE[1]}, as the flats of"):
        decoded(root, out)


def test_damaged_remains_of_the_last_run_are_not_trusted(root: Path, tmp_path: Path) -> None:
    before = decoded(root, tmp_path / "out")[0].images
    folder = tmp_path / "out" / "work" / "frames" / "cam0"
    for name in ("half.npy", "marks.npz", "frames.json"):
        (folder / name).write_bytes((folder / name).read_bytes()[:20])
        frames, facts = decoded(root, tmp_path / "out")
        assert facts["frames_kept_from_the_last_run"] == 0
        np.testing.assert_array_equal(frames.images, before)


def test_a_window_that_is_too_small_is_given_up(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected, _ = decoded(root, tmp_path / "whole", DecodeConfig(crop=False))
    middle = Window(SHAPE[0] // 2, SHAPE[1] // 3, 20, 20)
    monkeypatch.setattr(processing.decode.files, "find_window", lambda *_: middle)
    found, _ = decoded(root, tmp_path / "out")
    assert found.window == whole(SHAPE)
    same(found, expected)
    monkeypatch.undo()
    assert decoded(root, tmp_path / "out")[1]["frames_kept_from_the_last_run"] == len(PATTERNS)


def test_each_channel_tells_where_it_clipped(root: Path, tmp_path: Path) -> None:
    bright = photographs()["x+"]["cam0"]
    places = {RED: (60, 80), GREEN: (80, 71), BLUE: (71, 91)}
    for (row, column), colour in zip(places.values(), range(3), strict=True):
        bright[row, column, colour] = 1.3
    replace_photograph(root, "x+", "cam0", bright)
    frames, _ = decoded(root, tmp_path / "out", DecodeConfig(crop=False))
    for bit, place in places.items():
        assert frames.clipped[place] == bit
        assert not frames.valid[place]
    assert np.count_nonzero(frames.clipped) == 3 * 25


def test_unlike_exposures_are_brought_to_one_and_reported(tmp_path: Path) -> None:
    shots = photographs()
    usual = write_raw_session(tmp_path / "usual", RIG, shots, COLOUR)
    exact, _ = decoded(usual, tmp_path / "out1")
    dimmed = shots | {"y-": {"cam0": 0.25 * shots["y-"]["cam0"]}}
    values = {"y-": (1 / 60, 50, 8.0 * np.sqrt(2))}
    odd = write_raw_session(tmp_path / "odd", RIG, dimmed, COLOUR, values)
    found, facts = decoded(odd, tmp_path / "out2")
    inner = cv2.erode(read_foreground(tmp_path / "out1", "cam0").astype(np.uint8), np.ones((9, 9)))
    np.testing.assert_allclose(
        found.images[:, inner > 0], exact.images[:, inner > 0], rtol=2e-3, atol=2e-3
    )
    assert any("exposures" in warning and "y-" in warning for warning in facts["warnings"])


def test_colours_made_at_another_exposure_are_scaled_to_it(root: Path, tmp_path: Path) -> None:
    plain, _ = decoded(root, tmp_path / "plain")
    value = json.loads(json.dumps(COLOUR))
    value["cameras"]["cam0"]["exposure"] = 2 * 100 / 60 / 64
    (root / "colour.json").write_text(json.dumps(value))
    scaled, _ = decoded(root, tmp_path / "scaled")
    np.testing.assert_allclose(scaled.images, 2 * plain.images, rtol=2e-3, atol=1e-3)


def test_exposures_that_no_file_states_are_reported_as_taken_to_be_equal(
    root: Path, tmp_path: Path
) -> None:
    assert not any(
        "exposure" in warning for warning in decoded(root, tmp_path / "out")[1]["warnings"]
    )
    for name, shot in photographs().items():
        path = root / "frames" / name / "cam0.dng"
        old = sha256_file(path)
        write_dng(path, counts_of(shot["cam0"]), exposure=None)
        text = (root / "session.json").read_text()
        (root / "session.json").write_text(text.replace(old, sha256_file(path)))
    _, facts = decoded(root, tmp_path / "out")
    assert any("cam0: no photograph has its exposure" in warning for warning in facts["warnings"])


@pytest.mark.parametrize("exposure", [None, (1.0, 6400, 2.0)])
def test_exposures_unknown_or_far_off_are_refused(
    root: Path, tmp_path: Path, exposure: tuple[float, int, float] | None
) -> None:
    path = root / "frames" / "y-" / "cam0.dng"
    old = sha256_file(path)
    write_dng(path, counts_of(photographs()["y-"]["cam0"]), exposure=exposure)
    text = (root / "session.json").read_text()
    (root / "session.json").write_text(text.replace(old, sha256_file(path)))
    with pytest.raises(FormatError, match=r"y-/cam0\.dng, exposure"):
        decoded(root, tmp_path / "out")


def test_a_photograph_of_another_size_is_refused(root: Path, tmp_path: Path) -> None:
    replace_photograph(root, "x-", "cam0", photographs()["x-"]["cam0"][:, :-2])
    with pytest.raises(FormatError, match=r"x-/cam0\.dng: found"):
        decoded(root, tmp_path / "out")
    assert not (tmp_path / "out" / "work" / "frames" / "cam0").exists()


def test_dark_frames_are_taken_off_and_kept_in_mind(tmp_path: Path) -> None:
    shots = photographs()
    clean = write_raw_session(tmp_path / "clean", RIG, shots, COLOUR)
    exact, _ = decoded(clean, tmp_path / "out1")
    room = np.full((*SHAPE, 3), 0.04)
    lit = {name: {"cam0": shot["cam0"] + room} for name, shot in shots.items()}
    root = write_raw_session(tmp_path / "lit", RIG, {**lit, "dark": {"cam0": room}}, COLOUR)
    out = tmp_path / "out2"
    found, facts = decoded(root, out)
    assert facts["ambient_from"] == ["dark"]
    np.testing.assert_allclose(found.image(1), exact.image(1), atol=4e-3)
    assert decoded(root, out)[1]["frames_kept_from_the_last_run"] == len(PATTERNS) + 1
    replace_photograph(root, "dark", "cam0", 0.9 * room)
    other, facts = decoded(root, out)
    assert facts["frames_kept_from_the_last_run"] == 0
    fresh, _ = decoded(root, tmp_path / "fresh")
    same(other, fresh)
    assert not np.array_equal(other.image(0), found.image(0))


def test_linear_pictures_are_windowed_too_and_wild_values_marked(tmp_path: Path) -> None:
    root = write_raw_session(tmp_path / "session", RIG, photographs(), COLOUR)
    value = json.loads((root / "session.json").read_text())
    for frame in value["frames"]:
        picture = photographs()[frame["pattern"]]["cam0"].astype(np.float32)
        if frame["pattern"] == "z+":
            picture[120, 80, 1] = np.nan
            picture[121, 82, 0] = np.inf
        path = root / frame["path"]
        path.unlink()
        frame["path"] = frame["path"].replace(".dng", ".exr")
        write_exr(root / frame["path"], picture, half=False)
        frame |= {"sha256": sha256_file(root / frame["path"]), "encoding": "linear"}
    (root / "session.json").write_text(json.dumps(value))
    frames, facts = decoded(root, tmp_path / "out")
    assert facts["window_share_of_picture"]["cam0"] < 0.6
    assert facts["warnings"] == []
    assert np.isfinite(frames.images).all()
    corner = np.array([frames.window.top, frames.window.left])
    marked = np.argwhere(np.asarray(frames.clipped) == NOT_A_NUMBER) + corner
    assert marked.tolist() == [[120, 80], [121, 82]]
    exact = photographs()["full"]["cam0"]
    np.testing.assert_allclose(frames.image(0), exact, rtol=1e-3, atol=1e-6)


def test_photographs_without_numbers_are_not_called_dark(tmp_path: Path) -> None:
    root = write_raw_session(tmp_path / "session", RIG, photographs(("full",)), COLOUR)
    value = json.loads((root / "session.json").read_text())
    for frame in value["frames"]:
        frame |= {"path": f"frames/{frame['camera']}.exr", "encoding": "linear"}
        write_exr(root / frame["path"], np.full((*SHAPE, 3), np.nan, np.float32), half=False)
        frame["sha256"] = sha256_file(root / frame["path"])
    (root / "session.json").write_text(json.dumps(value))
    with pytest.raises(ProcessingError, match=r"cam0: found no number .* in 100% of the pixels"):
        decoded(root, tmp_path / "out")


@pytest.mark.parametrize("bright", [65504.0, 1e6, np.inf])
def test_one_mirrored_lamp_in_a_linear_picture_leaves_the_others_all_their_bits(
    bright: float,
) -> None:
    rgb = np.random.default_rng(0).uniform(0, 0.6, (60, 40, 3)).astype(np.float32)
    plain = LinearPhotograph(rgb.copy()).peak()
    rgb[3, 4] = bright
    photograph = LinearPhotograph(rgb)
    scale = power_of_two(photograph.peak())
    assert scale == power_of_two(plain)
    out, marks = np.zeros(rgb.shape, np.float16), np.zeros(rgb.shape[:2], np.uint8)
    photograph.develop(whole((60, 40)), scale, None, out, marks)
    assert (marks > 0).sum() == (bright > LARGEST)
    known = np.delete(rgb.reshape(-1, 3), 3 * 40 + 4, axis=0)
    found = np.delete(out.reshape(-1, 3), 3 * 40 + 4, axis=0).astype(float) * scale
    np.testing.assert_allclose(found, known, rtol=1 / 2048, atol=1e-7)


def test_without_light_from_all_around_every_pattern_is_looked_at(tmp_path: Path) -> None:
    pair = ("x+", "x-")
    root = write_raw_session(tmp_path / "session", RIG, photographs(pair), COLOUR)
    session = load_session(root)
    assert patterns_to_search(session, list(pair)) == list(pair)
    assert patterns_to_search(_with_all(tmp_path), list(PATTERNS)) == ["full"]
    frames, facts = decoded(root, tmp_path / "out")
    assert facts["window_share_of_picture"]["cam0"] < 0.6
    mask = read_foreground(tmp_path / "out", "cam0")
    assert not frames.window.empty
    assert mask.sum() == pytest.approx(np.pi * (0.22 * SHAPE[0]) ** 2, rel=0.05)


def _with_all(folder: Path) -> Session:
    return load_session(write_raw_session(folder / "all", RIG, photographs(), COLOUR))


def test_the_preview_is_the_brightest_colour_upright(tmp_path: Path) -> None:
    from processing.raw.raw_file import open_raw
    from sim.camera.tiff import SHORT

    rgb = photographs()["full"]["cam0"]
    path = write_dng(tmp_path / "a.dng", counts_of(rgb), more={274: (SHORT, 6)})
    raw = open_raw(path)
    look, side = preview(raw)
    raw.close()
    upright = np.rot90(rgb * np.array([2.0, 1.0, 1.5]), -1).max(axis=2)
    assert look.shape == (upright.shape[0] // side, upright.shape[1] // side)
    found = find_window(look, side, upright.shape, 0.03)
    lit = np.argwhere(upright > 0)
    assert found.top <= lit[:, 0].min()
    assert found.left <= lit[:, 1].min()
    assert found.top + found.height > lit[:, 0].max()
    assert found.left + found.width > lit[:, 1].max()
    assert found.height < 0.8 * upright.shape[0]


def test_a_black_picture_has_no_window_of_its_own() -> None:
    assert find_window(np.zeros((60, 80)), 4, (240, 320), 0.03) == whole((240, 320))


def test_a_mesh_bounds_what_is_wanted() -> None:
    corners = np.array([[x, y, z] for x in (-40.0, 40) for y in (-60.0, 60) for z in (-30.0, 30)])
    window = mesh_window(corners, CAMERA, 5.0)
    places = CAMERA.project(corners)[0]
    assert window.inside(SHAPE)
    assert window.left <= places[:, 0].min()
    assert window.left + window.width >= places[:, 0].max()
    assert window.height < SHAPE[0]
    behind = corners + 3 * CAMERA.centre_mm
    assert mesh_window(behind, CAMERA, 5.0).empty


def test_with_a_mesh_only_its_part_is_developed(root: Path, tmp_path: Path) -> None:
    everything, _ = decoded(root, tmp_path / "whole", DecodeConfig(crop=False))
    small = np.array([[x, y, 0.0] for x in (-30.0, 30) for y in (-40.0, 20)])
    mesh = tmp_path / "mesh.ply"
    write_ply(Mesh(small, np.array([[0, 1, 2], [1, 2, 3]])), mesh)
    config = DecodeConfig(mesh=str(mesh), mesh_margin_mm=8.0)
    found, facts = decoded(root, tmp_path / "out", config)
    assert facts["window_share_of_picture"]["cam0"] < 0.15
    part = found.window.slices
    np.testing.assert_array_equal(found.images[:, *part], everything.images[:, *part])
    write_ply(Mesh(small + 3 * CAMERA.centre_mm, np.array([[0, 1, 2]])), mesh)
    with pytest.raises(ProcessingError, match="cam0"):
        decoded(root, tmp_path / "other", config)
