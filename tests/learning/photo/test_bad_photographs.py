"""Photographs as people have them: each is read rightly, or refused in one message."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile

from learning.checkpoint import load_whole_face, shipped_weights
from learning.photo import command
from learning.photo import fit as fitting
from learning.photo import picture as reading
from learning.photo.command import FitRequest, Marks, _coloured
from learning.photo.config import FitConfig
from learning.photo.grey import coloured, has_no_colour
from learning.photo.picture import read_photograph
from learning.photo.shape_fit import Photograph
from lightstage.errors import LightstageError
from lightstage.exif import Exif
from lightstage.faces.detect import Face
from lightstage.formats.files import write_json
from lightstage.formats.srgb import LUMINANCE
from lightstage.formats.template import default_template_path, load_template

SIZE = 70


def picture() -> np.ndarray:
    """(70, 80, 3) of 8 bits, red brighter than blue."""
    rng = np.random.default_rng(0)
    return rng.integers(40, 200, (SIZE, SIZE + 10, 1), np.uint8) + np.uint8([0, 20, 40])


def refusal(path: Path) -> str:
    with pytest.raises(LightstageError) as caught:
        read_photograph(path)
    return str(caught.value)


def chunk(kind: bytes, content: bytes) -> bytes:
    whole = kind + content
    return struct.pack(">I", len(content)) + whole + struct.pack(">I", zlib.crc32(whole))


def png_header(width: int, height: int) -> bytes:
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    body = chunk(b"IDAT", zlib.compress(bytes(1000))) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + body


def test_a_header_that_claims_more_pixels_than_a_camera_has_is_refused_before_decoding(
    tmp_path: Path,
) -> None:
    bomb = tmp_path / "bomb.png"
    bomb.write_bytes(png_header(60_000, 60_000))
    assert "300 megapixels" in refusal(bomb)
    jpeg = bytearray(cv2.imencode(".jpg", picture())[1].tobytes())
    place = jpeg.index(b"\xff\xc0") + 5
    jpeg[place : place + 4] = struct.pack(">HH", 65_000, 65_000)
    large = tmp_path / "large.jpg"
    large.write_bytes(bytes(jpeg))
    assert "65000 x 65000" in refusal(large)


def test_a_forty_pixel_picture_and_a_truncated_one_are_refused_by_name(tmp_path: Path) -> None:
    small, cut = tmp_path / "small.png", tmp_path / "cut.jpg"
    cv2.imwrite(str(small), picture()[:40, :40])
    assert "40 x 40 px" in refusal(small)
    cut.write_bytes(cv2.imencode(".jpg", picture())[1].tobytes()[:-400])
    assert "cut.jpg" in refusal(cut)


def test_files_of_other_kinds_are_named_as_what_they_are(tmp_path: Path) -> None:
    whole = tmp_path / "whole.tif"
    tifffile.imwrite(whole, picture(), photometric="rgb")
    kinds = {
        b"": "an empty file",
        b"\0\0\0\x18ftypheic" + bytes(20): "a HEIC or AVIF",
        whole.read_bytes()[:-100]: "a TIFF that is truncated",
        b"GIF89a" + bytes(20): "another kind of file",
    }
    for data, named in kinds.items():
        (tmp_path / "a.jpg").write_bytes(data)
        found = refusal(tmp_path / "a.jpg")
        assert (named in found, "export it as one of these" in found) == (True, True), found


def test_printing_inks_and_cut_out_people_are_refused(tmp_path: Path) -> None:
    inks, clear = tmp_path / "inks.tif", tmp_path / "clear.png"
    four = np.dstack([picture(), np.full((SIZE, SIZE + 10), 9, np.uint8)])
    tifffile.imwrite(inks, four, photometric="separated")
    assert "CMYK" in refusal(inks)
    cv2.imwrite(str(clear), four)
    assert "transparent" in refusal(clear)
    opaque = tmp_path / "opaque.png"
    cv2.imwrite(str(opaque), np.dstack([picture(), np.full((SIZE, SIZE + 10), 255, np.uint8)]))
    assert read_photograph(opaque).rgb_linear.shape == (SIZE, SIZE + 10, 3)


def test_sixteen_bits_and_eight_give_the_same_light(tmp_path: Path) -> None:
    deep, plain = tmp_path / "deep.png", tmp_path / "plain.png"
    cv2.imwrite(str(plain), picture())
    cv2.imwrite(str(deep), picture().astype(np.uint16) * 257)
    np.testing.assert_allclose(
        read_photograph(deep).rgb_linear, read_photograph(plain).rgb_linear, atol=1e-5
    )


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tif"])
def test_a_grey_file_is_read_as_three_equal_colours(tmp_path: Path, suffix: str) -> None:
    path, three = tmp_path / f"grey{suffix}", tmp_path / "three.png"
    grey = np.full((SIZE, SIZE + 10), 90, np.uint8)
    cv2.imwrite(str(path), grey)
    cv2.imwrite(str(three), np.repeat(grey[..., None], 3, axis=2))
    np.testing.assert_allclose(
        read_photograph(path).rgb_linear, read_photograph(three).rgb_linear, atol=0.01
    )


def test_black_and_white_gets_the_mean_persons_colour_and_a_note(tmp_path: Path) -> None:
    network, _ = load_whole_face(shipped_weights())
    grey = np.repeat(np.random.default_rng(0).random((20, 20, 1)), 3, axis=2).astype(np.float32)
    assert has_no_colour(grey)
    assert has_no_colour(np.zeros((4, 4, 3)))
    assert not has_no_colour(grey * [1.0, 0.8, 0.7])
    # In any exposure, such as that of a linear file.
    assert not has_no_colour(0.01 * grey * [1.0, 0.8, 0.7])
    assert has_no_colour(0.01 * grey)
    found = coloured(grey, network)
    np.testing.assert_allclose(found @ LUMINANCE, grey[..., 0], rtol=1e-4)
    assert (found[..., 0] > found[..., 2]).all()  # skin is red more than blue
    notes: list[str] = []
    points = np.zeros((68, 2))
    kept = _coloured(Photograph("old.jpg", grey, points), network, notes)
    assert "old.jpg is black and white" in notes[0]
    np.testing.assert_array_equal(kept.rgb_linear, found)
    assert not has_no_colour(found)


def test_of_two_faces_the_larger_is_taken_and_a_third_is_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "two.png"
    cv2.imwrite(str(path), picture())

    def face(size: float) -> Any:
        points = size * np.random.default_rng(1).random((468, 2))
        return Face(points, np.zeros(468), 1.0, np.array([0, 0, size, size]))

    monkeypatch.setattr(command, "detect_faces", lambda _: [face(60.0), face(20.0)])
    template = load_template(default_template_path())
    file = read_photograph(path)

    def points(number: int, notes: list[str]) -> np.ndarray:
        request = FitRequest((path,), default_template_path(), tmp_path / "F", face=number)
        return Marks(request, template).photograph(path, file, notes).landmarks_px

    notes: list[str] = []
    largest = points(1, notes)
    assert "shows 2 faces: the largest was taken" in notes[0]
    assert np.nanmax(points(2, notes)) < np.nanmax(largest)
    assert sum("faces" in note for note in notes) == 1
    with pytest.raises(LightstageError, match=r"two\.png: .*2 faces.*3 faces \(--face\)"):
        points(3, notes)


def stated(tmp_path: Path, names: list[str], points: np.ndarray) -> Marks:
    """Landmarks of a file, the same for each name."""
    file = tmp_path / "L.json"
    content = {"schema": "lightstage.landmarks/1", "scheme": "ibug68"}
    write_json(file, {**content, "points_px": {name: points.tolist() for name in names}})
    request = FitRequest((), default_template_path(), tmp_path / "F", landmarks=file)
    return Marks(request, load_template(default_template_path()))


def test_landmarks_of_a_file_go_with_a_photograph_that_is_made_smaller(tmp_path: Path) -> None:
    path = tmp_path / "wide.png"
    cv2.imwrite(str(path), np.resize(picture(), (SIZE, 6600, 3)))
    points = np.random.default_rng(0).uniform(0, [6600, SIZE], (68, 2))
    file = read_photograph(path)
    assert file.rgb_linear.shape[1] == 6000
    marks = stated(tmp_path, ["wide.png"], points)
    found = marks.photograph(path, file, []).landmarks_px
    np.testing.assert_allclose(found, points * 6000 / 6600)


def doubtful(size: float, presence: float) -> Face:
    return Face(np.full((468, 2), size), np.zeros(468), presence, (0.0, 0.0, size, size))


@pytest.mark.parametrize(
    ("whole", "in_parts", "leniently", "taken"),
    [
        ([0.95], [], [], "whole"),
        ([0.6], [0.99], [], "in_parts"),
        ([0.6], [], [], "whole"),
        ([], [], [0.2], "leniently"),
    ],
)
def test_a_sure_face_however_small_is_taken_before_a_doubtful_one(
    monkeypatch: pytest.MonkeyPatch,
    whole: list[float],
    in_parts: list[float],
    leniently: list[float],
    taken: str,
) -> None:
    found = {
        name: [doubtful(size, presence) for presence in presences]
        for size, (name, presences) in enumerate(
            {"whole": whole, "in_parts": in_parts, "leniently": leniently}.items(), 1
        )
    }
    monkeypatch.setattr(
        command, "detect_faces", lambda _, *least: found["leniently" if least else "whole"]
    )
    monkeypatch.setattr(command, "small_faces", lambda _: found["in_parts"])
    assert command._faces(np.zeros((9, 9, 3), np.uint8)) == found[taken]


@pytest.mark.parametrize(
    ("sizes", "asked", "note"),
    [
        ((1.0,), [(3, 12.0)], ""),
        ((1.6, 1.0), [(3, 12.0), (0, 12.0)], "the landmarks alone gave its shape"),
        ((1.6, 1.5, 1.0), [(3, 12.0), (0, 12.0), (0, 48.0)], "the mean head's shape"),
    ],
)
def test_a_photograph_that_gives_no_persons_head_is_trusted_less(
    monkeypatch: pytest.MonkeyPatch,
    sizes: tuple[float, ...],
    asked: list[tuple[int, float]],
    note: str,
) -> None:
    template, network = load_template(default_template_path()), load_whole_face(shipped_weights())
    called = []

    def sized(*given: Any, **_: Any) -> Any:
        called.append((given[3].pixel_rounds, given[3].landmark_percent))
        grown = template.mesh.with_vertices(sizes[len(called) - 1] * template.mesh.vertices)
        return SimpleNamespace(meshes=(grown,), model=None)

    monkeypatch.setattr(fitting, "fit_shape", sized)
    notes: list[str] = []
    places: Any = None
    found = fitting._likely_shape([], template, places, network[0], FitConfig(), notes)
    assert called == asked
    np.testing.assert_array_equal(found.meshes[0].vertices, template.mesh.vertices)
    assert len(notes) == bool(note)
    assert note in "".join(notes)


def test_two_photographs_of_one_name_do_not_share_landmarks(tmp_path: Path) -> None:
    points = np.random.default_rng(0).uniform(0, SIZE, (68, 2))
    marks = stated(tmp_path, ["x"], points)
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        cv2.imwrite(str(tmp_path / folder / "x.png"), picture())
    first, second = (tmp_path / folder / "x.png" for folder in ("a", "b"))
    marks.photograph(first, read_photograph(first), [])
    with pytest.raises(LightstageError, match=r"one entry for .*Rename one"):
        marks.photograph(second, read_photograph(second), [])


def test_the_focal_length_that_a_file_states_is_in_the_pixels_that_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "photo.png"
    cv2.imwrite(str(path), picture())
    monkeypatch.setattr(reading, "read_exif", lambda _: Exif(focal_35mm_mm=72.0))
    monkeypatch.setattr(reading, "LARGEST_PX", SIZE // 2)
    file = read_photograph(path)
    height, width = cv2.imread(str(path)).shape[:2]
    assert file.scale == SIZE // 2 / max(height, width)
    share = 72 / np.hypot(36, 24)
    assert file.focal_px == pytest.approx(share * np.hypot(height, width) * file.scale)
    assert read_photograph(path, 36.0).focal_px == pytest.approx(file.focal_px / 2)
