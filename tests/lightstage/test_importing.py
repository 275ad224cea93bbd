"""`lightstage import`: photographs taken elsewhere become a session, whole or not at all."""

import dataclasses
import json
import os
import stat

import numpy as np
import OpenEXR
import pytest

from lightstage.checks import check_session
from lightstage.errors import CaptureError, FormatError
from lightstage.formats.exr import write_exr
from lightstage.formats.landmarks import write_points_px
from lightstage.formats.session import load_session
from lightstage.importing import find_photographs, import_session, named_cameras
from lightstage.opening import open_photograph
from lightstage.patterns import pattern_levels
from lightstage.rig import save_rig
from tests.programs import run_program

PATTERNS = ["x-", "full", "x+"]


@pytest.fixture
def folder(tmp_path, small_rig):
    """Linear EXR photographs: every pixel is the mean level."""
    for pattern in PATTERNS:
        value = pattern_levels(pattern, small_rig).mean()
        for camera in small_rig.cameras:
            image = np.full((48, 32, 3), value, np.float32)
            write_exr(tmp_path / "in" / pattern / f"{camera.id}.exr", image)
    return tmp_path / "in"


def test_linear_photographs_become_a_session_that_passes_its_check(folder, tmp_path, small_rig):
    out = tmp_path / "S"
    assert import_session(folder, small_rig, out, "p1", "smile").frames == 9
    session = load_session(out)
    assert session.file.sequence == ["full", "x+", "x-"]
    assert {frame.encoding for frame in session.file.frames} == {"linear"}
    assert session.file.patterns == {}
    assert np.array_equal(session.levels("x+"), pattern_levels("x+", small_rig))
    for frame in session.file.frames:
        original = folder / frame.pattern / f"{frame.camera}.exr"
        assert session.frame_path(frame).read_bytes() == original.read_bytes()
    assert check_session(out).sums == 3


def test_an_import_names_which_emitters_were_driven(folder, tmp_path, small_rig, run_command):
    colours = ["warm", "cool"]
    lights = tuple(
        dataclasses.replace(light, colour=colours[k % 2])
        for k, light in enumerate(small_rig.lights)
    )
    rig = dataclasses.replace(small_rig, lights=lights)
    save_rig(rig, tmp_path / "rig.json")
    words = ["lightstage", "import", folder, "--rig", tmp_path / "rig.json"]
    done = run_command(*words, "--out", tmp_path / "S", "--emitters", "warm")
    assert done.code == 0, done.err
    session = load_session(tmp_path / "S")
    for pattern in PATTERNS:
        expected = pattern_levels(pattern, rig) * rig.colours["warm"]
        assert np.array_equal(session.levels(pattern), expected)
    unknown = run_command(*words, "--out", tmp_path / "T", "--emitters", "warm,blue")
    assert unknown.code == 2
    assert "'blue', expected some of warm, cool" in unknown.err
    bare = run_command(*words[:3], "--out", tmp_path / "T", "--emitters", "warm")
    assert bare.code == 2
    assert "--emitters: found without --rig" in bare.err
    assert not (tmp_path / "T").exists()


@pytest.mark.parametrize("lost", ["nothing", "session.json"])
def test_a_session_is_refused_with_what_to_do_and_its_photographs_alone_are_taken(
    folder, tmp_path, small_rig, lost
):
    import_session(folder, small_rig, tmp_path / "S", "p1", "neutral")
    (tmp_path / "S" / lost).unlink(missing_ok=True)
    with pytest.raises(FormatError, match=r"S: found a session, .*processing run .*/S/frames"):
        import_session(tmp_path / "S", small_rig, tmp_path / "T", "p1", "neutral")
    assert not (tmp_path / "T").exists()
    with pytest.raises(FormatError, match="found a session"):
        named_cameras(tmp_path / "S")
    assert (
        import_session(tmp_path / "S" / "frames", small_rig, tmp_path / "T", "p1", "a").frames == 9
    )


def test_photographs_that_name_a_person_or_a_place_are_refused(folder, tmp_path, small_rig, dng):
    camera = small_rig.cameras[0]
    rig = dataclasses.replace(small_rig, cameras=(camera,))
    header = {"type": OpenEXR.scanlineimage, "owner": "A. Person", "latitude": 51.5}
    path = tmp_path / "one" / "full" / f"{camera.id}.exr"
    path.parent.mkdir(parents=True)
    with OpenEXR.File(header, {"RGB": np.ones((48, 32, 3), np.float32)}) as file:
        file.write(str(path))
    with pytest.raises(FormatError, match="headers: found owner, latitude, not empty"):
        import_session(tmp_path / "one", rig, tmp_path / "S", "p1", "neutral")
    path.with_suffix(".dng").write_bytes(dng(1000, tags=[(315, 2, 0, "A. Person", True)]))
    path.unlink()
    with pytest.raises(FormatError, match="headers: found Artist, not empty") as caught:
        import_session(tmp_path / "one", rig, tmp_path / "S", "p1", "neutral")
    assert "Person" not in str(caught.value)
    assert not (tmp_path / "S").exists()


def test_linear_photographs_of_other_colours_than_srgbs_are_refused(tmp_path, small_rig):
    camera = small_rig.cameras[0]
    rig = dataclasses.replace(small_rig, cameras=(camera,))
    path = tmp_path / "one" / "full" / f"{camera.id}.exr"
    path.parent.mkdir(parents=True)
    srgb = (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329)
    acescg = (0.713, 0.293, 0.165, 0.83, 0.128, 0.044, 0.32168, 0.33767)
    for number, colours in enumerate((srgb, acescg)):
        header = {"type": OpenEXR.scanlineimage, "chromaticities": colours}
        with OpenEXR.File(header, {"RGB": np.ones((48, 32, 3), np.float32)}) as file:
            file.write(str(path))
        if colours is srgb:
            import_session(tmp_path / "one", rig, tmp_path / f"S{number}", "p1", "neutral")
            continue
        with pytest.raises(FormatError, match=r"chromaticities: found red \(0.713, 0.293\), green"):
            import_session(tmp_path / "one", rig, tmp_path / f"S{number}", "p1", "neutral")
        assert not (tmp_path / f"S{number}").exists()


def test_photographs_in_a_folder_frames_import_too(folder, tmp_path, small_rig):
    (tmp_path / "card").mkdir()
    folder.rename(tmp_path / "card" / "frames")
    assert import_session(tmp_path / "card", small_rig, tmp_path / "S", "p1", "neutral").frames == 9


def test_raw_photographs_are_named_by_their_bytes(tmp_path, small_rig, dng):
    for camera in small_rig.cameras:
        path = tmp_path / "in" / "full" / f"{camera.id}.NEF"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(dng(1000))
    import_session(tmp_path / "in", small_rig, tmp_path / "S", "p1", "neutral")
    names = sorted(os.listdir(tmp_path / "S" / "frames" / "full"))
    assert names == ["cam0.dng", "cam1.dng", "cam2.dng"]


def test_a_path_that_is_not_utf8_is_named_as_such(tmp_path, dng):
    folder = tmp_path / os.fsdecode(b"\xff")
    write_exr(tmp_path / "a.exr", np.ones((48, 32, 3)))
    (tmp_path / "a.dng").write_bytes(dng(1000))
    folder.mkdir()
    for name in ("a.exr", "a.dng"):
        os.rename(tmp_path / name, folder / name)
        with pytest.raises(FormatError, match="found a path that is not UTF-8"):
            open_photograph(folder / name)


def test_every_misnamed_or_missing_photograph_is_reported_at_once(folder, small_rig):
    (folder / "z*").mkdir()
    (folder / "full" / "cam7.exr").write_bytes(b"")
    (folder / "full" / "cam0.dng").write_bytes(b"")
    (folder / "x+" / "cam1.exr").unlink()
    with pytest.raises(Exception, match="4 problems") as caught:
        find_photographs(folder, small_rig)
    message = str(caught.value)
    assert "cam7.exr: found no camera of the rig" in message
    assert "found a second photograph" in message
    assert "x+/cam1: found no photograph" in message
    assert "pattern 'z*'" in message


def test_what_is_wrong_with_many_photographs_alike_is_one_problem(folder, tmp_path, small_rig):
    """Eight were cropped in one way, one is grey."""
    for path in folder.rglob("*.exr"):
        write_exr(path, np.ones((40, 32, 3), np.float32))
    write_exr(folder / "x+" / "cam1.exr", np.ones((48, 32), np.float32))
    with pytest.raises(FormatError) as caught:
        import_session(folder, small_rig, tmp_path / "S", "p1", "neutral")
    first, *lines = str(caught.value).splitlines()
    assert first == "2 problems:"
    assert lines[0].startswith(
        f"  {folder}/full/cam0.exr and 7 more photographs: found 32 x 40 pixels, expected 32 x 48, "
        "as the rig has its camera. "
    )
    assert lines[1].startswith(f"  {folder}/x+/cam1.exr: found one channel")
    assert len(lines) == 2


def test_files_that_are_named_after_no_camera_are_one_problem_and_missing_ones_are_each_named(
    folder, small_rig
):
    for path in (folder / "x+").iterdir():
        path.rename(path.with_name(f"DSC_{path.name}"))
    with pytest.raises(FormatError) as caught:
        find_photographs(folder, small_rig)
    first, *lines = str(caught.value).splitlines()
    assert first == "4 problems:"
    assert "x+/DSC_cam0.exr and 2 more files: found no camera of the rig" in lines[0]
    assert [f"x+/cam{k}: found no photograph" in lines[k + 1] for k in range(3)] == [True] * 3


@pytest.mark.parametrize("damage", ["nan", "cut", "jpeg", "empty"])
def test_a_damaged_photograph_leaves_nothing_behind(folder, tmp_path, small_rig, damage):
    path = folder / "x+" / "cam1.exr"
    if damage == "nan":
        write_exr(path, np.full((48, 32, 3), np.nan))
    elif damage == "cut":
        path.write_bytes(path.read_bytes()[:-20])
    else:
        path.write_bytes(b"\xff\xd8\xff\xe0" if damage == "jpeg" else b"")
    before = sorted(os.listdir(tmp_path))
    with pytest.raises(FormatError, match=r"x\+/cam1.exr"):
        import_session(folder, small_rig, tmp_path / "S", "p1", "neutral")
    assert sorted(os.listdir(tmp_path)) == before


def test_landmarks_of_another_camera_are_refused_before_they_are_kept(folder, tmp_path, small_rig):
    marks = write_points_px({"cam9": np.zeros((68, 2))}, tmp_path / "landmarks.json")
    with pytest.raises(FormatError, match="cam9, expected cameras of rig"):
        import_session(folder, small_rig, tmp_path / "S", "p1", "smile", landmarks=marks)
    import_session(folder, small_rig, tmp_path / "S", "p1", "smile")
    (tmp_path / "S" / "landmarks.json").write_bytes(marks.read_bytes())
    with pytest.raises(FormatError, match="cam9, expected cameras of rig"):
        check_session(tmp_path / "S")


def test_a_link_to_an_empty_folder_holds_the_session(folder, tmp_path, small_rig):
    (tmp_path / "disk" / "S").mkdir(parents=True)
    (tmp_path / "S").symlink_to(tmp_path / "disk" / "S")
    import_session(folder, small_rig, tmp_path / "S", "p1", "smile")
    assert load_session(tmp_path / "disk" / "S").file.subject == "p1"
    assert os.listdir(tmp_path / "disk") == ["S"]


def test_an_existing_folder_is_never_touched(folder, tmp_path, small_rig):
    (tmp_path / "S").mkdir()
    (tmp_path / "S" / "a").write_text("mine")
    with pytest.raises(CaptureError, match="something there already"):
        import_session(folder, small_rig, tmp_path / "S", "p1", "neutral")
    assert os.listdir(tmp_path / "S") == ["a"]


def test_the_command_imports_and_states_how_many(folder, tmp_path, small_rig, run_command):
    rig = save_rig(small_rig, tmp_path / "rig.json")

    def run(source, out):
        return run_command("lightstage", "import", source, "--rig", rig, "--out", out, "--json")

    done = run(folder, tmp_path / "S")
    assert done.code == 0, done.err
    assert json.loads(done.out)["frames"] == 9
    again = run(folder, tmp_path / "S")
    assert again.code == 2
    assert "something there already" in again.err
    nothing = run(tmp_path / "none", tmp_path / "T")
    assert nothing.code == 2
    assert "no such folder" in nothing.err


def imported(folder, tmp_path, small_rig, *more):
    rig = save_rig(small_rig, tmp_path / "rig.json")
    words = ["import", folder, "--rig", rig, "--out", tmp_path / "S", "--json", *more]
    before = os.umask(0)
    try:
        return run_program("lightstage", *words)
    finally:
        os.umask(before)


def test_an_imported_face_is_nobody_elses_and_reports_that_consent_is_missing(
    folder, tmp_path, small_rig
):
    (tmp_path / "S").mkdir(mode=0o777)
    done = imported(folder, tmp_path, small_rig)
    assert done.code == 0, done.err
    assert done.err.count("no record of this person's consent") == 1
    facts = json.loads(done.out.splitlines()[-1])
    assert facts["consent"] is None
    assert "no record of this person's consent" in facts["warnings"][0]
    out = tmp_path / "S"
    assert json.loads((out / "session.json").read_text())["consent"] is None
    assert '"no-consent"' in (out / "journal.jsonl").read_text()
    for path in (out, *out.rglob("*")):
        assert stat.S_IMODE(path.stat().st_mode) == (0o700 if path.is_dir() else 0o600), path


def test_an_import_keeps_the_consent_record_and_may_require_one(folder, tmp_path, small_rig):
    config = tmp_path / "config.toml"
    config.write_text('[session]\nrequire_consent = true\ngroup = "read"\n')
    done = imported(folder, tmp_path, small_rig, "--config", str(config))
    assert done.code == 2
    assert "--consent: found no id" in done.err
    assert not (tmp_path / "S").exists()
    more = ("--config", str(config), "--consent", "C-17")
    done = imported(folder, tmp_path, small_rig, *more)
    assert done.code == 0
    assert "warning" not in done.err
    assert load_session(tmp_path / "S").file.model_extra["consent"] == "C-17"
    assert stat.S_IMODE((tmp_path / "S").stat().st_mode) == 0o750


@pytest.mark.parametrize("wrong", ["rig", "photograph", "calibration"])
def test_an_import_that_fails_gives_the_reason_and_nothing_of_consent(
    folder, tmp_path, small_rig, wrong
):
    more = ("--length", "cam0:cam1=100") if wrong == "rig" else ()
    if wrong == "photograph":
        (folder / "full" / "cam1.exr").write_bytes(b"")
    if wrong == "calibration":
        more = ("--colour", str(tmp_path / "none"))
    done = imported(folder, tmp_path, small_rig, *more)
    assert done.code == 2
    assert "consent" not in done.err
    assert not (tmp_path / "S").exists()


def test_an_import_of_a_subject_that_the_labs_table_lacks_is_refused(folder, tmp_path, small_rig):
    config = tmp_path / "config.toml"
    config.write_text('[session]\npseudonyms = "known.txt"\n')
    (tmp_path / "known.txt").write_text("P08\n")
    done = imported(folder, tmp_path, small_rig, "--config", str(config))
    assert done.code == 2
    assert "known.txt, subject: found no" in done.err
    assert not (tmp_path / "S").exists()
