"""Faults of simulated sessions are found and named; good photographs pass; nothing crashes."""

import dataclasses
import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.check_faults import BINARY, POLARISED
from lightstage.checks import ChecksConfig, ShotChecks
from lightstage.checks.photo_measures import measure_counts
from lightstage.errors import ConfigError
from lightstage.formats.config import make_config
from lightstage.formats.exr import write_exr
from lightstage.formats.orientation import of_libraw
from lightstage.patterns import pattern_levels
from lightstage.rig import default_rig
from lightstage.sequence import Shot, plan_shots
from sim.camera.dng import Exif, dng_bytes
from sim.camera.optics import defocus

DARK_FIRST = ("dark", *BINARY)


def codes_found(stage, patterns=BINARY, **changed):
    """Findings of a session; `changed` maps a pattern's name to (camera, expected one) -> photo."""

    def make(camera, pattern):
        return changed["make"](camera, pattern) or stage.photo(camera, pattern)

    return stage.found(patterns, make if changed else stage.photo)


def named(findings, code):
    return {(finding.pattern, finding.camera) for finding in findings if finding.code == code}


def only(camera, pattern, photo):
    """Replaces one photograph."""
    return lambda c, p: photo if (c, p) == (camera, pattern) else None


def ball(camera, levels, directions):
    """(h, w) light of a matte ball before a camera."""
    x, y = np.meshgrid(np.arange(camera.width_px) + 0.5, np.arange(camera.height_px) + 0.5)
    x, y = (x - camera.width_px / 2) / 150, (y - camera.height_px / 2) / 150
    toward = -np.sqrt(np.clip(1 - x * x - y * y, 0, 1))
    normal = np.stack([x, y, toward], axis=-1) @ camera.cam_from_world[:, :3]
    lit = np.maximum(normal @ directions.T, 0) @ levels / 30
    return np.where(x * x + y * y < 1, lit, 0)


@pytest.mark.parametrize("flip", [0, 3, 5, 6])
def test_a_camera_is_judged_upright_however_it_is_mounted(flip):
    """LibRaw's flips: landscape, upside down, and portrait on either side."""
    rig = default_rig()
    cameras = [dataclasses.replace(c, width_px=360, height_px=540) for c in rig.cameras[:3]]
    rig = dataclasses.replace(rig, cameras=tuple(cameras))
    directions = rig.positions_mm / np.linalg.norm(rig.positions_mm, axis=1, keepdims=True)
    shots, mounted = plan_shots(("full", "x+", "x-", "y+", "y-"), rig), of_libraw(flip)
    checks, rng = ShotChecks(rig, shots), np.random.default_rng(0)
    found = []
    for shot in shots:
        for camera in rig.cameras:
            upright = 512 + 3000 * ball(camera, shot.levels, directions)
            read = mounted.as_read(upright + rng.normal(0, 5, upright.shape))
            counts = np.ascontiguousarray(np.round(read), np.uint16)
            photo = measure_counts(
                counts,
                np.array([[0, 1], [1, 2]]),
                512.0,
                16383.0,
                (360, 540),
                "raw",
                Path(camera.id),
                span=16383.0 - 512.0,
                orientation=mounted,
            )
            assert photo.light.shape[0] > photo.light.shape[1]
            found += checks.add(shot.pattern, camera.id, photo)
        found += checks.shot(shot.pattern)
    assert [finding.code for finding in found if finding.severity == "retake"] == []


@pytest.mark.parametrize("person", ["light", "dark"])
@pytest.mark.parametrize("patterns", [BINARY, DARK_FIRST, BINARY[:3], ("full",), ("x+", "x-")])
def test_a_good_session_of_any_skin_has_no_findings(stages, person, patterns):
    assert codes_found(stages[person], patterns) == []


def test_polarised_photographs_pass_and_swapped_banks_are_reported(stage):
    assert not named(codes_found(stage, POLARISED), "bank-swapped")

    def swapped(camera, pattern):
        base, kind = pattern.split("@")
        other = {"cross": "parallel", "parallel": "cross"}[kind]
        return stage.expose(camera, stage.see(camera, f"{base}@{other}"), seed=1)

    found = codes_found(stage, POLARISED, make=swapped)
    assert named(found, "bank-swapped") == {("full@cross", None), ("x+@cross", None)}


def test_an_old_picture_is_reported_at_once_and_one_of_another_shot_by_its_light(stage):
    stale = stage.photo("cam1", "x+")
    checks = stage.checks(BINARY)
    checks.add("x+", "cam1", stale)
    found = checks.add("x-", "cam1", stale)
    assert [(f.code, f.severity, f.camera) for f in found] == [("stale", "retake", "cam1")]
    late = stage.expose("cam1", stage.see("cam1", "y+"), seed=1)
    found = codes_found(stage, make=only("cam1", "z+", late))
    assert named(found, "wrong-picture") == {("z+", "cam1")}
    assert len(found) == 1


def test_another_pattern_in_all_cameras_is_the_light(stage):
    def other(camera, pattern):
        return stage.expose(camera, stage.see(camera, "x+"), seed=1) if pattern == "y-" else None

    found = codes_found(stage, make=other)
    assert named(found, "wrong-light") == {("y-", None)}
    assert "looks like x+" in found[0].found
    assert len(found) == 1


@pytest.mark.parametrize("gain", [0.5, 0.9, 1.1, 2.0, 4.0])
def test_a_camera_that_drifts_is_named_and_the_others_are_not(stage, gain):
    def drifted(camera, pattern):
        late = camera == "cam4" and BINARY.index(pattern) >= 3
        return stage.expose(camera, stage.see(camera, pattern), gain) if late else None

    found = codes_found(stage, make=drifted)
    assert {f.camera for f in found} == {"cam4"}
    assert "y+" in {f.pattern for f in found}
    assert not {f.pattern for f in found} & {"full", "x+", "x-"}
    assert all(f.hint for f in found)
    assert "retake" in {f.severity for f in found}


def test_a_pattern_that_was_lit_too_weakly_is_the_light(stage):
    def weak(camera, pattern):
        light = stage.see(camera, pattern) * np.float32(0.9)
        return stage.expose(camera, light) if pattern == "y+" else None

    assert named(codes_found(stage, make=weak), "light-level") == {("y+", None)}


def test_a_hidden_lamp_that_stays_on_is_distinguished_from_the_room(stage):
    number = max(
        (int(name.split("-")[1]) for name in stage.lamps),
        key=lambda k: stage.rig.positions_mm[k, 2],
    )

    def stuck(camera, pattern):
        if stage.levels(pattern)[number] > 0:
            return None
        lamp = stage.see(camera, f"olat-{number:03d}")
        return stage.expose(camera, stage.see(camera, pattern) + lamp)

    found = codes_found(stage, DARK_FIRST, make=stuck)
    assert "lamp-on" in {f.code for f in found}
    room = stage.see("cam0", "dark").max()

    def lit_room(camera, pattern):
        more = stage.see(camera, "dark") * np.float32(9)
        return stage.expose(camera, stage.see(camera, pattern) + more)

    assert room > 0
    found = codes_found(stage, DARK_FIRST, make=lit_room)
    assert {f.code for f in found} == {"dark-leak"}
    assert {f.code for f in codes_found(stage, make=lit_room)} == {"ambient"}


def test_a_blurred_photograph_is_reported_and_another_light_is_no_blur(stage):
    light = stage.see("cam1", "y+")
    soft = stage.expose("cam1", defocus(light, np.full(light.shape[:2], 3.0)))
    found = codes_found(stage, make=only("cam1", "y+", soft))
    assert named(found, "blurred") == {("y+", "cam1")}
    assert [f.severity for f in found] == ["retake"]


@pytest.mark.parametrize(("code", "who"), [("motion", None), ("camera-moved", "cam1")])
def test_motion_is_reported_in_millimetres_and_pixels(stage, code, who):
    def moved(camera, pattern):
        if pattern != "z-" or who not in (None, camera):
            return None
        light = stage.see(camera, pattern)
        matrix = np.array([[1, 0, 4.0], [0, 1, 2.0]])
        turned = cv2.warpAffine(light, matrix, light.shape[1::-1], flags=cv2.INTER_CUBIC)
        return stage.expose(camera, np.maximum(turned, 0))

    found = codes_found(stage, make=moved)
    assert named(found, code) == {("z-", who)}
    assert all("px" in f.found for f in found if f.code == code)


def test_over_and_underexposure_are_reported_by_camera(stage):
    def bright(camera, pattern):
        return stage.expose(camera, stage.see(camera, pattern), 3.0) if camera == "cam0" else None

    found = codes_found(stage, ("full",), make=bright)
    assert named(found, "clipped") == {("full", "cam0")}
    assert named(found, "unlike-others") == {("full", "cam0")}

    def dim(camera, pattern):
        return stage.expose(camera, stage.see(camera, pattern), 0.02) if camera == "cam0" else None

    found = codes_found(stage, ("full",), make=dim)
    assert named(found, "underexposed") == {("full", "cam0")}
    assert "retake" in {f.severity for f in found}


def test_a_take_that_was_rejected_counts_no_more(stage):
    checks = stage.checks(BINARY[:3])
    for pattern in BINARY[:3]:
        for camera in stage.cameras:
            photo = stage.photo(camera, pattern)
            if (camera, pattern) == ("cam1", "x+"):
                photo = stage.expose(camera, stage.see(camera, "x+"), 0.8)
            checks.add(pattern, camera, photo)
        found = checks.shot(pattern)
    assert named(found, "exposure") == {("x+", "cam1")}
    checks.forget("x+", "cam1")
    assert checks.shot("x+") == []
    assert checks.add("x+", "cam1", stage.photo("cam1", "x+")) == []
    assert checks.shot("x+") == []


def test_a_session_before_tells_of_lamps_that_have_gone(stage):
    shots = [Shot(name, stage.levels(name)) for name in BINARY]
    first = stage.checks(BINARY)
    for pattern in BINARY:
        for camera in stage.cameras:
            first.add(pattern, camera, stage.photo(camera, pattern))
        first.shot(pattern)
    facts = json.loads(json.dumps(first.facts()))
    later = ShotChecks(stage.rig, shots, baseline=facts)
    for camera in stage.cameras:
        later.add("full", camera, stage.photo(camera, "full"))
        light = stage.see(camera, "z+") * np.float32(0.8)
        later.add("z+", camera, stage.expose(camera, light))
    assert named(later.shot("z+"), "unlike-before") == {("z+", None)}


# What may lie under a photograph's name.


def write_dng(stage, path, counts):
    sensor = stage.sensors["cam0"]
    path.write_bytes(dng_bytes(counts, sensor, Exif("Nikon DSC D750", "1", 16.0, 105.0)))
    return path


@pytest.mark.parametrize(
    ("kind", "code"),
    [
        ("missing", "unreadable"),
        ("empty", "unreadable"),
        ("jpeg", "unreadable"),
        ("cut", "unreadable"),
        ("other-size", "size"),
        ("zeros", "blank"),
        ("white", "blank"),
        ("clipped", "clipped"),
        ("nan", "not-finite"),
        ("one-pixel", "unreadable"),
        ("black", "underexposed"),
    ],
)
def test_garbage_is_a_finding_and_the_rest_goes_on(stage, tmp_path, kind, code):
    camera = stage.rig.camera("cam0")
    shape = camera.height_px, camera.width_px
    rng = np.random.default_rng(0)
    path = tmp_path / "a.dng"
    counts = rng.normal(3000, 30, shape).astype(np.uint16)
    if kind in ("empty", "jpeg"):
        path.write_bytes(b"" if kind == "empty" else b"\xff\xd8\xff\xe0" * 100)
    elif kind == "cut":
        write_dng(stage, path, counts)
        path.write_bytes(path.read_bytes()[:300])
    elif kind == "nan":
        image = np.full((*shape, 3), 0.5, np.float32)
        image[5:9] = np.nan
        write_exr(path, image)
    elif kind == "one-pixel":
        write_exr(path, np.ones((1, 1, 3)))
    elif kind != "missing":
        made = {
            "other-size": counts[:-16],
            "zeros": np.zeros_like(counts),
            "white": np.full_like(counts, 16383),
            "clipped": np.where(rng.random(shape) < 0.9, 16383, counts),
            "black": rng.normal(600, 3, shape).astype(np.uint16),
        }
        write_dng(stage, path, made[kind])
    checks = stage.checks(BINARY[:3])
    found = checks.photograph("full", "cam0", path)
    assert code in {f.code for f in found}
    assert all((f.pattern, f.camera) == ("full", "cam0") for f in found)
    assert "retake" in {f.severity for f in found}
    for pattern in BINARY[:3]:
        for other in stage.cameras:
            if (pattern, other) != ("full", "cam0"):
                checks.add(pattern, other, stage.photo(other, pattern))
        assert not {f.camera for f in checks.shot(pattern)} - {"cam0", None}
    json.dumps(checks.facts())


def test_photographs_of_all_cameras_are_checked_at_once(stage, tmp_path):
    paths = {}
    for camera in stage.cameras:
        light = stage.see(camera, "full")
        counts = stage.sensors[camera].expose(light, np.random.default_rng(1))
        paths[camera] = write_dng(stage, tmp_path / f"{camera}.dng", counts)
    checks = stage.checks(("full",))
    with ThreadPoolExecutor(8) as pool:
        jobs = [
            pool.submit(checks.photograph, "full", camera, path)
            for _ in range(4)
            for camera, path in paths.items()
        ]
        assert all(job.result() == [] for job in jobs)
    assert checks.facts()["photographs"] == len(paths)


def test_a_thousand_shots_keep_a_bounded_number_of_pictures(stage):
    names = [f"olat-{k % 168:03d}" for k in range(1000)]
    shots = [Shot("full", stage.levels("full"))]
    shots += [Shot(f"one-{k}", pattern_levels(name, stage.rig)) for k, name in enumerate(names)]
    checks = ShotChecks(stage.rig, shots, ChecksConfig(kept_photographs=5))
    for shot in shots:
        for camera in stage.cameras:
            checks.add(shot.pattern, camera, stage.photo(camera, "full"))
    facts = checks.facts()
    assert facts["photographs"] == 1001 * len(stage.cameras)
    assert facts["kept"] == 6 * len(stage.cameras)


def test_limits_come_from_one_place_and_an_unknown_one_is_refused():
    assert make_config(ChecksConfig, {"warn_motion_mm": 2}, "here").warn_motion_mm == 2.0
    with pytest.raises(ConfigError, match="an unknown key"):
        make_config(ChecksConfig, {"max_motion": 2}, "here")
