"""Photographs that say who took them under which light: read back, and never misread."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.formats.files import sha256_file, write_bytes
from lightstage.formats.session import Driven, Frame, SessionFile, save_session
from lightstage.patterns import pattern_levels
from lightstage.rig import Rig, default_rig, save_rig
from sim.camera.exposure import expose_again
from sim.devices.body_folder import NEXT, put, write_body
from sim.devices.camera_settings import CameraSettings
from sim.devices.coded_photographer import Code, CodedPhotographer, read_code
from sim.devices.coded_stage import CodedStage
from sim.devices.faults import Fault, FaultLog, Story
from sim.devices.simulated_camera import SimulatedCamera
from sim.errors import SimError


@pytest.fixture(scope="module")
def rig() -> Rig:
    whole = default_rig()
    small = [dataclasses.replace(c.scaled(0.01), width_px=48, height_px=64) for c in whole.cameras]
    return Rig(whole.lights, tuple(small[:3]))


@pytest.fixture(scope="module")
def photographer(rig):
    return CodedPhotographer(rig, 5)


@given(
    level=st.floats(0.0, 1.0),
    camera=st.integers(0, 2),
    gain=st.sampled_from([0.25, 0.5, 1.0, 2.0, 8.0]),
    data=st.randoms(use_true_random=False),
)
def test_the_code_is_read_under_any_light_and_setting(
    tmp_path_factory, rig, photographer, level, camera, gain, data
):
    levels = np.array([level * data.random() for _ in rig.lights])
    light = photographer.lit(levels)
    dng = photographer.photograph(rig.cameras[camera], light)
    path = tmp_path_factory.mktemp("code") / "p.dng"
    path.write_bytes(expose_again(dng, gain, "100"))
    found = read_code(path)
    # So bright that the code's rows clip, nothing can be read; something wrong never is.
    assert found == Code(camera, light) or (found is None and gain * level > 1)


def test_pictures_without_a_code_have_none(tmp_path, rig, photographer):
    dng = photographer.photograph(rig.cameras[0], photographer.lit(np.ones(168)))
    rng = np.random.default_rng(1)
    for k in range(50):
        damaged = bytearray(dng)
        place = len(dng) - 48 * 64 * 2
        damaged[place : place + 48 * 12 * 2] = rng.bytes(48 * 12 * 2)
        (tmp_path / f"{k}.dng").write_bytes(damaged)
        assert read_code(tmp_path / f"{k}.dng") is None
    (tmp_path / "no.dng").write_bytes(b"no photograph")
    assert read_code(tmp_path / "no.dng") is None


def test_too_small_pictures_are_refused():
    whole = default_rig()
    camera = dataclasses.replace(whole.cameras[0].scaled(0.01), width_px=40, height_px=64)
    with pytest.raises(SimError, match="found 40 x 64 pixels, expected at least 48 x 24"):
        CodedPhotographer(Rig(whole.lights, (camera,)), 1)


def test_a_camera_never_repeats_a_photograph_but_a_stale_one(tmp_path, rig, photographer):
    camera = rig.cameras[0]
    dng = photographer.photograph(camera, photographer.lit(np.ones(168)))
    story = Story([Fault("stale", at=3)])
    folder = tmp_path / "cam0"
    settings = CameraSettings(camera.serial, camera.model)
    write_body(folder, "cam0", settings, story, FaultLog())
    put(folder / NEXT, dng)
    driver = SimulatedCamera(str(folder))
    driver.open()
    hashes = []
    for shot in range(4):
        exposure = driver.trigger(0.0)
        path = tmp_path / f"{shot}.dng"
        hashes.append(driver.download(exposure.files[0].name, path).sha256)
        assert read_code(path) == Code(0, len(photographer.states))
    assert hashes[1] == hashes[2]
    assert len({hashes[0], hashes[1], hashes[3]}) == 3


def test_labels_tell_right_from_wrong(tmp_path, rig):
    stage = CodedStage(tmp_path / "desk", rig)
    root = tmp_path / "S"
    save_rig(rig, root / "rig.json")
    frames, driven, files = [], {}, {}
    for pattern in ("full", "x+", "x-", "y+"):
        levels = pattern_levels(pattern, rig)
        driven[pattern] = Driven(levels=levels.tolist())
        shown = levels.copy()
        if pattern == "y+":
            shown[7] = 1 - shown[7]  # a lamp that does as it likes
        stage._show(shown)
        stage._commanded[-1] = np.round(levels * 65535).astype(np.uint16)
        for camera in rig.cameras:
            data = (stage.cameras.folder(camera.id) / NEXT).read_bytes()
            files[pattern, camera.id] = data
    files["x+", "cam1"], files["x-", "cam1"] = files["x-", "cam1"], files["x+", "cam1"]
    files["full", "cam2"] = files["full", "cam0"]
    files["x-", "cam2"] = files["x+", "cam2"]
    for (pattern, camera), data in files.items():
        path = f"frames/{pattern}/{camera}.dng"
        write_bytes(root / path, data)
        digest = sha256_file(root / path)
        frames.append(
            Frame(pattern=pattern, camera=camera, path=path, sha256=digest, encoding="raw")
        )
    save_session(
        root,
        SessionFile(
            id="t",
            created_utc="2026-03-01T12:00:00+00:00",
            subject="s",
            expression="e",
            sequence=["full", "x+", "x-", "y+"],
            frames=frames[:-1],
            patterns=driven,
        ),
    )
    labels = stage.labels(root)
    assert [text.split(" (")[0] for text in labels.mislabelled] == [
        "full by cam2", "x+ by cam1", "x- by cam1", "x- by cam2"
    ]  # fmt: skip
    assert "taken by cam0" in labels.mislabelled[0]
    assert "taken when x- was asked for" in labels.mislabelled[1]
    assert [text.split(" (")[0] for text in labels.wrong_light] == ["y+ by cam0", "y+ by cam1"]
    assert "1 lamp shone otherwise than reported" in labels.wrong_light[0]
    assert len(labels.doubled) == 2
    assert labels.missing == ("y+ by cam2",)
    assert labels.right == 12 - 4 - 2 - 1
