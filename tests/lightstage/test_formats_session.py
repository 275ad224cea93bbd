"""session.json: what is wrong with one is named before a photograph is opened."""

import json
import shutil

import numpy as np
import pytest

from lightstage.errors import FormatError, LightstageError
from lightstage.formats.files import sha256_file, write_bytes
from lightstage.formats.session import (
    Driven,
    Frame,
    SessionFile,
    changed_frames,
    load_session,
    missing_frames,
    save_session,
    session_id,
)
from lightstage.patterns import pattern_levels
from lightstage.rig import save_rig


@pytest.fixture
def root(tmp_path, small_rig):
    root = tmp_path / "S"
    save_rig(small_rig, root / "rig.json")
    frames = []
    for pattern in ("full", "x+"):
        for camera in small_rig.cameras:
            relative = f"frames/{pattern}/{camera.id}.dng"
            path = write_bytes(root / relative, f"{pattern} {camera.id}".encode())
            frame = {"pattern": pattern, "camera": camera.id, "path": relative, "encoding": "raw"}
            frames.append(Frame(**frame, sha256=sha256_file(path)))
    save_session(
        root,
        SessionFile(
            id="1",
            created_utc="2026-01-01T00:00:00+00:00",
            subject="p1",
            expression="neutral",
            sequence=["full", "x+"],
            frames=frames,
            patterns={"x+": Driven(levels=[0.25] * 8)},
        ),
    )
    return root


def change(root, **fields):
    value = json.loads((root / "session.json").read_text()) | fields
    (root / "session.json").write_text(json.dumps(value))


def change_frame(root, **fields):
    value = json.loads((root / "session.json").read_text())
    value["frames"][1] |= fields
    (root / "session.json").write_text(json.dumps(value))


def test_a_session_survives_its_file_with_fields_that_others_added(root):
    change(root, weather="dry")
    session = load_session(root)
    assert session.file.model_dump()["weather"] == "dry"
    assert session.camera_ids() == ["cam0", "cam1", "cam2"]
    assert session.frame_path(session.frame("x+", "cam1")) == root / "frames/x+/cam1.dng"
    save_session(root, session.file)
    assert load_session(root).file == session.file


def test_recorded_levels_are_believed_and_else_the_name(root, small_rig):
    session = load_session(root)
    assert session.levels("x+").tolist() == [0.25] * 8
    assert np.array_equal(session.levels("full"), pattern_levels("full", small_rig))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"schema": "lightstage.session/2"}, "newer version"),
        ({"subject": None}, "subject: found None, expected a text"),
        ({"subject": "../../etc"}, r"subject: found '\.\./\.\./etc', expected letters, digits"),
        ({"expression": "smile\x1b[2J"}, "expression: found 'smile.x1b.2J', expected letters"),
        (
            {"frames": [{"pattern": "full"}]},
            r"(?s)4 problems:.*frames\[0\]\.sha256: found no such field",
        ),
        ({"sequence": ["full", "x+", "zz"]}, r"pattern 'zz': found an unknown name"),
        ({"sequence": []}, "sequence: found no pattern, expected at least one"),
        ({"sequence": ["full", "x+", "full"]}, r"sequence\[2\]: found full again"),
        ({"calibration": None}, "calibration: found None, expected a table"),
        ({"patterns": {"y+": {"levels": [1]}}}, r"patterns\.y\+\.levels: found 1 level, expec"),
        ({"sequence": ["full", "x+", "../z"]}, r"sequence\[2\]: found '\.\./z', expected a name"),
        (
            {"calibration": {"colour": "../../.."}},
            r"calibration\.colour: found .*leaves the folder",
        ),
        ({"calibration": {"lights": "/etc"}}, r"calibration\.lights: found .*an absolute path"),
        ({"calibration": {"flats": ["a"]}}, r"calibration\.flats: found .*no path"),
        ({"patterns": {"x+": {"levels": [0.5] * 7}}}, "found 7 levels, expected 8"),
        (
            {"patterns": {"x+": {"levels": [0.5] * 7 + [1.5]}}},
            r"patterns\.x\+\.levels\[7\]: found 1\.5, expected 0\.\.1",
        ),
        (
            {"calibration": {"colour": "calibration/gone.json"}},
            r"calibration\.colour: found no file calibration/gone\.json",
        ),
    ],
)
def test_a_malformed_session_is_refused(root, fields, message):
    change(root, **fields)
    with pytest.raises(LightstageError, match=message):
        load_session(root)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"camera": "cam9"}, r"frames\[1\]: found cam9, expected a camera of rig.json"),
        ({"pattern": "y+"}, r"frames\[1\]: found y\+, expected a pattern of the sequence"),
        ({"camera": "cam0"}, "full by cam0 twice"),
        ({"path": "../../etc/passwd"}, "expected a relative path that stays inside the folder"),
        ({"path": "/etc/passwd"}, "expected a relative path that stays inside the folder"),
        ({"encoding": "jpeg"}, r"frames\[1\]\.encoding: found 'jpeg', expected 'raw' or 'linear'"),
    ],
)
def test_a_frame_that_does_not_fit_is_named(root, fields, message):
    change_frame(root, **fields)
    with pytest.raises(FormatError, match=message):
        load_session(root)


def test_missing_and_changed_frames_are_each_named(root):
    (root / "frames/full/cam2.dng").unlink()
    (root / "frames/x+/cam0.dng").write_bytes(b"x+ cam")
    session = load_session(root)
    assert [str(p) for p in missing_frames(session)] == [
        f"{root}/frames/full/cam2.dng: found no such file, expected the photograph of full by cam2."
        " Copy it back from the camera or take that shot again."
    ]
    (changed,) = changed_frames(session)
    assert changed.where == f"{root}/frames/x+/cam0.dng"
    assert changed.field == "sha256"
    assert "of 6 bytes" in changed.found


def test_a_hash_in_capitals_is_the_same_hash(root):
    value = json.loads((root / "session.json").read_text())
    for frame in value["frames"]:
        frame["sha256"] = frame["sha256"].upper()
    (root / "session.json").write_text(json.dumps(value))
    assert changed_frames(load_session(root)) == []


def test_a_frame_absent_from_the_grid_is_missing(root):
    value = json.loads((root / "session.json").read_text())
    del value["frames"][4]
    (root / "session.json").write_text(json.dumps(value))
    (missing,) = missing_frames(load_session(root))
    assert "no photograph of pattern x+ by cam1" in str(missing)


def test_a_folder_without_session_or_rig_is_refused(root):
    (root / "rig.json").unlink()
    with pytest.raises(FormatError, match=r"rig\.json: found no such file"):
        load_session(root)
    (root / "session.json").unlink()
    (root / "report.json").write_text("{}")
    with pytest.raises(FormatError, match=r"found a processed folder, or .*lightstage-sim"):
        load_session(root)
    shutil.rmtree(root)
    with pytest.raises(FormatError, match="found no such folder, expected a session folder"):
        load_session(root)


def test_ids_differ_by_subject_expression_and_time():
    ids = {session_id(s, e, t) for s in "ab" for e in "cd" for t in "ef"}
    assert len(ids) == 8
    assert session_id("a", "b", "c") == session_id("a", "b", "c")
