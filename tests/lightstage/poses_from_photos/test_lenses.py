"""Several focal lengths among the photographs: told by EXIF, by a file, or found."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tifffile
from hypothesis import given
from hypothesis import strategies as st

from lightstage.errors import FormatError, MotionError
from lightstage.exif import Exif
from lightstage.formats.exr import write_exr
from lightstage.poses_from_photos.cameras import FoundCameras, find_cameras
from lightstage.poses_from_photos.grouping import BETTER, JobLens, Outcome, apart, best, parted
from lightstage.poses_from_photos.lengths import Length
from lightstage.poses_from_photos.lenses import Lens, TypedLens, read_lenses, shared_lenses
from lightstage.poses_from_photos.pictures import GreyPicture
from lightstage.poses_from_photos.solving import Doubted, Solved
from lightstage.poses_from_photos.suspects import lens_warnings
from lightstage.poses_from_photos.world import turn_between
from lightstage.rig import Camera, default_rig
from tests.lightstage.poses_from_photos import ball

ODD, SHARE = "cam2", 115 / 155
"""One camera has a lens of 115 mm, the others of 155."""
OTHERS = ("cam0", "cam1", "cam3", "cam4")
CAMERAS = [
    dataclasses.replace(camera, fx_px=camera.fx_px * SHARE, fy_px=camera.fy_px * SHARE)
    if camera.id == ODD
    else camera
    for camera in ball.cameras((0, 1, 2, 3, 4))
]


def srgb16(light: np.ndarray) -> np.ndarray:
    light = np.clip(light, 0, 1)
    curve = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    return np.round(curve * 65535).astype(np.uint16)


@pytest.fixture(scope="module")
def light() -> dict[str, np.ndarray]:
    return {camera.id: ball.photograph(camera, balls=ball.DEEP) for camera in CAMERAS}


@pytest.fixture(scope="module")
def shots(
    light: dict[str, np.ndarray], tmp_path_factory: pytest.TempPathFactory
) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("lenses")
    for name, picture in light.items():
        write_exr(folder / f"{name}.exr", picture)
    return {name: folder / f"{name}.exr" for name in light}


def with_exif(
    folder: Path, light: dict[str, np.ndarray], focal_mm: Callable[[str], int]
) -> dict[str, Path]:
    """TIFFs of 16 bits whose EXIF tells a model and a focal length, and nothing of the sensor."""
    for name, picture in light.items():
        tags = [(272, 2, 0, "Made", True), (37386, 5, 1, (focal_mm(name), 1), True)]
        tifffile.imwrite(
            folder / f"{name}.tif", srgb16(picture), photometric="rgb", metadata=None,
            extratags=tags,
        )  # fmt: skip
    return {name: folder / f"{name}.tif" for name in light}


def find(shots: dict[str, Path], lenses: list[TypedLens] | None = None) -> FoundCameras:
    apart_mm = float(np.linalg.norm(CAMERAS[0].centre_mm - CAMERAS[-1].centre_mm))
    length = Length(CAMERAS[0].id, CAMERAS[-1].id, apart_mm)
    return find_cameras(shots, default_rig().lights, [length], lenses=lenses or [])


def off_mm(found: FoundCameras) -> dict[str, float]:
    """How far each camera stands from its true place, the odd one aside laid onto these."""
    here = np.array([camera.centre_mm for camera in found.rig.cameras])
    there = np.array([camera.centre_mm for camera in CAMERAS])
    same = np.array([camera.id != ODD for camera in CAMERAS])
    turn, _ = turn_between(here[same], there[same])
    laid = (here - here[same].mean(axis=0)) @ turn.T
    apart_mm = np.linalg.norm(laid - (there - there[same].mean(axis=0)), axis=1)
    return {camera.id: float(d) for camera, d in zip(CAMERAS, apart_mm, strict=True)}


def groups(found: FoundCameras) -> set[tuple[str, ...]]:
    return {tuple(lens["cameras"]) for lens in found.facts["lenses"]}


def require_right(found: FoundCameras) -> None:
    assert groups(found) == {(ODD,), OTHERS}
    for camera, true in zip(found.rig.cameras, CAMERAS, strict=True):
        assert abs(camera.fx_px / true.fx_px - 1) < 0.01
    assert max(off_mm(found).values()) < 8


def test_another_focal_length_is_found(shots: dict[str, Path]) -> None:
    found = find(shots)
    require_right(found)
    (warning,) = found.warnings
    assert "not taken with one focal length" in warning
    assert f"by {ODD};" in warning
    assert {lens["by"] for lens in found.facts["lenses"]} == {"found"}


def test_another_focal_length_is_reported_by_exif(
    light: dict[str, np.ndarray], tmp_path: Path
) -> None:
    found = find(with_exif(tmp_path, light, lambda name: 115 if name == ODD else 155))
    require_right(found)
    assert not found.warnings
    assert {lens["by"] for lens in found.facts["lenses"]} == {"EXIF"}


def test_another_focal_length_is_reported_by_a_file(shots: dict[str, Path], tmp_path: Path) -> None:
    path = tmp_path / "lenses.json"
    entries = [{"cameras": [ODD], "focal_mm": 78, "sensor_mm": 36}, {"cameras": [*OTHERS]}]
    path.write_text(json.dumps({"schema": "lightstage.lenses/1", "lenses": entries}))
    found = find(shots, read_lenses(path))
    require_right(found)
    assert not found.warnings
    assert {lens["by"] for lens in found.facts["lenses"]} == {"file"}


def test_a_camera_that_bends_the_others_is_named(
    light: dict[str, np.ndarray], tmp_path: Path
) -> None:
    """EXIF tells one focal length of all, which is wrong."""
    with pytest.raises(MotionError, match=rf"camera {ODD}: .*bends the others.*with 130\d px"):
        find(with_exif(tmp_path, light, lambda _: 155))


def test_a_lens_that_is_none_is_named_and_not_taken(tmp_path: Path) -> None:
    """A small ball before long lenses fits as well with a lens that bends its corners."""
    cams = ball.cameras((0, 1, 2, 3, 4, 5, 6))
    apart_mm = float(np.linalg.norm(cams[0].centre_mm - cams[1].centre_mm))
    found = find_cameras(
        ball.put(tmp_path, cams), default_rig().lights, [Length("cam0", "cam1", apart_mm)]
    )
    (warning,) = found.warnings
    assert "implausible; its distortion was left out" in warning
    for one, true in zip(found.rig.cameras, cams, strict=True):
        assert one.dist == (0, 0, 0, 0, 0)
        assert abs(one.fx_px / true.fx_px - 1) < 0.03


def picture(width: int = 600, height: int = 400) -> GreyPicture:
    return GreyPicture(
        np.zeros((height // 4, width // 4), np.uint8), np.zeros((1, 1), bool), 4, width, height
    )


def test_what_files_tell_parts_photographs() -> None:
    pictures = dict.fromkeys("abcde", picture()) | {"f": picture(400, 600)}
    exifs = dict.fromkeys(pictures, Exif()) | {
        "a": Exif(model="M", focal_mm=50.0, focal_plane_px_per_mm=30.0, longer_px=600),
        "b": Exif(model="M", focal_mm=50.0, focal_plane_px_per_mm=30.0, longer_px=600),
        "c": Exif(focal_35mm_mm=72.0),
    }
    lenses = shared_lenses(pictures, exifs)
    assert [(lens.cameras, lens.focal_px, lens.by) for lens in lenses] == [
        (("a", "b"), 1500.0, "EXIF"),
        (("c",), pytest.approx(1200.0), "EXIF"),
        (("d", "e"), None, "found"),
        (("f",), None, "found"),
    ]
    typed = [TypedLens(("a", "d"), 72.0, 36.0)]
    lenses = shared_lenses(pictures, exifs, typed)
    assert (lenses[0].cameras, lenses[0].focal_px, lenses[0].by) == (("a", "d"), 1200.0, "file")
    assert [lens.cameras for lens in lenses[1:]] == [("b",), ("c",), ("e",), ("f",)]
    with pytest.raises(MotionError, match=r"--lenses: found no photograph of z"):
        shared_lenses(pictures, exifs, [TypedLens(("z",), None, 36.0)])
    with pytest.raises(MotionError, match=r"unlike sizes for a, f"):
        shared_lenses(pictures, exifs, [TypedLens(("a", "f"), None, 36.0)])


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ({"lenses": []}, "lenses: found list, expected a non-empty list"),
        ({"lenses": [3]}, r"lenses\[0\]: found 3, expected an object"),
        ({"lenses": [{"focal_mm": 50}]}, r"lenses\[0\].cameras: found None"),
        ({"lenses": [{"cameras": ["a"]}, {"cameras": ["b", "a"]}]}, r"a, which lenses\[0\] has"),
        ({"lenses": [{"cameras": ["a"], "focal_mm": 0}]}, r"focal_mm: found 0, expected 0.5 to"),
        ({"lenses": [{"cameras": ["a"], "focal_mm": "50"}]}, "expected a finite number"),
        ({"lenses": [{"cameras": ["a"], "sensor_mm": 1e8}]}, "sensor_mm: found 1e"),
        ({"schema": "lightstage.lenses/99", "lenses": []}, "newer"),
    ],
)
def test_a_file_of_lenses_that_cannot_be_is_one_message(
    tmp_path: Path, value: dict[str, object], message: str
) -> None:
    path = tmp_path / "lenses.json"
    path.write_text(json.dumps({"schema": "lightstage.lenses/1"} | value))
    with pytest.raises(FormatError, match=message) as caught:
        read_lenses(path)
    assert "lenses.json" in str(caught.value)


def job(*names: str, opened: bool = True) -> JobLens:
    return JobLens(names, None, opened, (75.0, 50.0))


def test_lenses_part_where_their_focal_lengths_leave_a_gap() -> None:
    stated = [job("a", "b", "c", "d"), job("e", "f", opened=False)]
    lengths = {"a": 100.0, "b": 101.0, "c": 140.0, "d": 150.0, "e": 100.0, "f": 200.0}
    two, three = parted(stated, lengths)
    assert [lens.cameras for lens in two] == [("a", "b"), ("c", "d"), ("e", "f")]
    assert [lens.focal_px for lens in two] == [101.0, 150.0, None]
    assert [lens.cameras for lens in three] == [("a", "b"), ("c",), ("d",), ("e", "f")]
    assert parted(stated, dict.fromkeys("abcdef", 100.0)) == []
    assert parted(stated, {}) == []
    assert [lens.cameras for lens in apart(stated)] == [("a",), ("b",), ("c",), ("d",), ("e", "f")]


@given(
    st.dictionaries(st.sampled_from("abcdefgh"), st.floats(1.0, 1e6), min_size=1),
    st.lists(st.booleans(), min_size=2, max_size=2),
)
def test_every_grouping_holds_each_camera_once(
    lengths: dict[str, float], opened: list[bool]
) -> None:
    stated = [job(*"abcde", opened=opened[0]), job(*"fgh", opened=opened[1])]
    for grouping in [*parted(stated, lengths), apart(stated)]:
        assert sorted(name for lens in grouping for name in lens.cameras) == [*"abcdefgh"]
        assert all(lens in grouping for lens in stated if not lens.open)
        assert all(lens.focal_px is None or lens.focal_px > 0 for lens in grouping)


def test_more_lenses_need_a_clearly_better_explanation() -> None:
    one = Outcome(1, 7, 3000, 0.2)
    assert best([one, Outcome(2, 7, 3000, 0.2 * BETTER + 0.001)]) == 0
    assert best([one, Outcome(2, 7, 3000, 0.2 * BETTER - 0.001)]) == 1
    assert best([one, Outcome(2, 7, 3000, 0.1), Outcome(3, 7, 3000, 0.099)]) == 1
    assert best([one, Outcome(2, 6, 3000, 0.1)]) == 0
    assert best([one, Outcome(2, 7, 2000, 0.1)]) == 0


def solved(**more: object) -> Solved:
    camera = default_rig().scaled(0.1).camera("cam0")
    short = dataclasses.replace(camera, fx_px=50.0, fy_px=50.0)
    cameras: dict[str, Camera] = {"cam0": camera, "cam1": dataclasses.replace(short, id="cam1")}
    stated: dict[str, float | None] = {"cam0": 1000.0, "cam1": None}
    known = dataclasses.fields(Solved)
    values = {field.name: {} for field in known} | {"lenses": [], "doubted": None}
    values |= {"cameras": cameras, "told_px": stated, "together_px": None, "bent": {}}
    return Solved(**(values | more))  # type: ignore[arg-type]


def test_implausible_focal_lengths_are_named() -> None:
    warnings = lens_warnings(solved())
    assert len(warnings) == 2
    assert warnings[0].startswith("cam0: the focal length came out as")
    assert "+76 % off the 1000 px" in warnings[0]
    assert warnings[1].startswith("cam1: a focal length of 0.083 times")


def test_lenses_that_fit_better_than_those_told_are_a_warning() -> None:
    odd, most = Lens(("cam1",), 1300.0, "found"), Lens(("cam0", "cam2"), 1760.0, "found")
    (warnings, *_) = lens_warnings(solved(doubted=Doubted([odd, most], 0.26, 0.17)))
    assert warnings.startswith("cam1: bends the others")
    assert "(0.17 px in place of 0.26 px) with 1300 px by cam1; 1760 px by cam0, cam2" in warnings
