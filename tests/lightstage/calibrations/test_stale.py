"""A session refuses calibration shots that no longer hold, and records those that do."""

import dataclasses
import datetime
import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.calibrations.config import CalibrationConfig, DaysConfig
from lightstage.calibrations.fingerprint import devices
from lightstage.calibrations.folder import new_shots, shots_id
from lightstage.calibrations.kinds import KINDS
from lightstage.calibrations.listing import list_lab
from lightstage.calibrations.stale import duration, stale, use_calibrations
from lightstage.errors import ConfigError, FormatError
from lightstage.formats.calibration_shots import CalibrationFile, Pose
from lightstage.formats.files import sha256_file, write_json
from lightstage.rig import MEASURED_WITH, Rig, rig_sha256

CONFIG = CalibrationConfig(wanted=("charuco", "chart", "dark"))
DAY = datetime.timedelta(days=1)


@pytest.fixture
def lab(bench, small_stage, tmp_path):
    """A lab with fresh shots of the wanted kinds."""
    for kind in CONFIG.wanted:
        add(bench, tmp_path / "lab", small_stage, kind)
    return tmp_path / "lab"


def add(bench, lab, rig, kind, created=None, finished=True):
    created = created or bench.now
    days = getattr(CONFIG.days, kind)
    file = CalibrationFile(
        id=shots_id(kind, created.isoformat(), rig_sha256(rig)),
        kind=kind,
        created_utc=created.isoformat(),
        finished_utc=created.isoformat() if finished else None,
        expires_utc=(created + days * DAY).isoformat(),
        rig_sha256=rig_sha256(rig),
        devices=devices(bench.summaries(rig), bench.leds),
        patterns=list(KINDS[kind].patterns),
        poses_wanted=1,
    )
    shots = new_shots(lab, file)
    session = write_json(shots.root / "pose-01" / "session.json", {"kind": kind})
    pose = Pose(
        index=0,
        folder="pose-01",
        faces=None,
        session_sha256=sha256_file(session),
        manifest_sha256=None,
        figures={},
    )
    shots.file = file.model_copy(update={"poses": [pose]})
    shots.save()
    return shots


def found(bench, lab, rig, **changed):
    summaries = changed.get("told", bench.summaries(rig))
    leds = changed.get("leds", bench.leds)
    return stale(lab, rig, summaries, leds, changed.get("now", bench.now), CONFIG)


def test_fresh_shots_are_recorded_with_id_place_hash_and_age(bench, lab, small_stage):
    now = bench.now + 2.5 * DAY
    summaries = bench.summaries(small_stage)
    used = use_calibrations(lab, small_stage, summaries, bench.leds, (), CONFIG, now)
    assert used.findings == []
    assert list(used.facts) == ["charuco", "chart", "dark"]
    fact = used.facts["chart"]
    assert fact["path"] == "chart-20260301T120000Z"
    assert fact["sha256"] == sha256_file(lab / fact["path"] / "calibration.json")
    assert fact["id"] == json.loads((lab / fact["path"] / "calibration.json").read_text())["id"]
    assert fact["age_days"] == 2.5
    assert fact["stale"] == []
    json.dumps(used.facts)


def test_a_missing_kind_is_refused_by_name_with_the_way_out(bench, small_stage, tmp_path):
    lab = tmp_path / "lab"
    add(bench, lab, small_stage, "charuco")
    add(bench, lab, small_stage, "dark")
    add(bench, lab, small_stage, "chart", finished=False)
    [finding] = found(bench, lab, small_stage)
    assert (finding.severity, finding.code) == ("refuse", "calibration-missing")
    assert str(finding) == (
        f"calibration chart: found no finished shots in {lab}, expected some. Take them again "
        "(lightstage calibrate chart), or continue without the cameras' colours "
        "(--allow-stale chart)."
    )


def test_expiry_is_by_days_of_each_kind(bench, lab, small_stage):
    assert found(bench, lab, small_stage, now=bench.now + 6.9 * DAY) == []
    week = found(bench, lab, small_stage, now=bench.now + 7 * DAY)
    assert [f.where for f in week] == ["calibration dark"]
    assert "dark-20260301T120000Z, 7 days old, expected at most 7 days" in str(week[0])
    month = found(bench, lab, small_stage, now=bench.now + 31 * DAY)
    assert [f.where.split()[1] for f in month] == ["charuco", "chart", "dark"]
    assert {f.code for f in month} == {"calibration-expired"}


def test_the_newest_finished_shots_count(bench, lab, small_stage):
    later = bench.now + 6 * DAY
    add(bench, lab, small_stage, "dark", later)
    add(bench, lab, small_stage, "dark", later + DAY, finished=False)
    now = bench.now + 8 * DAY
    assert found(bench, lab, small_stage, now=now) == []
    summaries = bench.summaries(small_stage)
    used = use_calibrations(lab, small_stage, summaries, bench.leds, (), CONFIG, now)
    assert used.facts["dark"]["age_days"] == 2.0


CHANGES = {
    "serial": ("99", {"charuco", "chart", "dark"}, "camera-changed"),
    "aperture": ("f/11", {"charuco", "chart"}, "setting-changed"),
    "focus": ("Auto", {"charuco"}, "setting-changed"),
    "iso": ("400", {"chart", "dark"}, "setting-changed"),
    "shutter": (None, {"chart", "dark"}, "setting-changed"),
    "white_balance": ("Auto", set(), ""),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_changed_camera_ends_what_rests_on_that_setting_at_once(bench, lab, small_stage, name):
    value, kinds, code = CHANGES[name]
    summaries = bench.summaries(small_stage)
    summaries["cam1"] = dataclasses.replace(summaries["cam1"], **{name: value})
    findings = found(bench, lab, small_stage, told=summaries)
    assert {f.where.split()[1] for f in findings} == kinds
    assert {f.code for f in findings} == ({code} if code else set())
    for finding in findings:
        assert f"cam1 with {name} {value or 'not known'}" in finding.found


def test_what_is_other_of_many_cameras_is_one_line_a_kind(bench, lab, small_stage):
    few = bench.summaries(small_stage)
    for count, named in ((2, "cam0, cam1"), (9, "all 9 cameras"), (8, "8 cameras")):
        values = {f"cam{index}": few["cam0"] for index in range(9)}
        for shots in lab.glob("*/calibration.json"):
            value = json.loads(shots.read_text())
            one = value["devices"]["cameras"]["cam0"]
            value["devices"]["cameras"] = dict.fromkeys(values, one)
            shots.write_text(json.dumps(value))
        for index in range(count):
            values[f"cam{index}"] = dataclasses.replace(few["cam0"], iso="200", aperture="f/11")
        [board, chart, dark] = found(bench, lab, small_stage, told=values)
        assert board.found == f"{named} with aperture f/11, since charuco-20260301T120000Z"
        assert chart.found.startswith(f"{named} with iso 200; {named} with aperture f/11, since")
        assert chart.expected == "iso 100; aperture f/8"
        assert (dark.code, dark.expected) == ("setting-changed", "iso 100")
    values = {
        f"cam{index}": dataclasses.replace(few["cam0"], serial=str(index)) for index in range(9)
    }
    [board, *_] = found(bench, lab, small_stage, told=values)
    assert board.found.startswith("all 9 cameras with another serial, since")


def test_all_reasons_of_a_kind_are_one_line(bench, lab, small_stage):
    summaries = bench.summaries(small_stage)
    summaries["cam1"] = dataclasses.replace(summaries["cam1"], iso="400")
    now = bench.now + 8 * DAY
    [chart, dark] = found(bench, lab, small_stage, told=summaries, now=now)
    assert (chart.code, dark.code) == ("setting-changed", "calibration-stale")
    assert dark.found == (
        "dark-20260301T120000Z, 8 days old; cam1 with iso 400, since dark-20260301T120000Z"
    )


def test_another_rig_ends_all_and_another_led_firmware_what_shows_its_light(
    bench, lab, small_stage
):
    moved = dataclasses.replace(small_stage.lights[0], position_mm=(1.0, 2.0, 3.0))
    rig = Rig((moved, *small_stage.lights[1:]), small_stage.cameras)
    findings = found(bench, lab, rig)
    assert [f.code for f in findings] == ["rig-changed"] * 3
    leds = dataclasses.replace(bench.leds, firmware="leds 2.0")
    [finding] = found(bench, lab, small_stage, leds=leds)
    assert finding.where == "calibration chart"
    assert "LED firmware 'leds 2.0', since chart-20260301T120000Z" in finding.found


def test_a_camera_that_was_not_there_then_is_reported(bench, lab, small_stage):
    summaries = bench.summaries(small_stage)
    summaries["cam9"] = summaries["cam0"]
    findings = found(bench, lab, small_stage, told=summaries)
    assert {f.code for f in findings} == {"camera-new"}
    assert "no photographs of cam9" in findings[0].found


def test_shots_from_the_future_are_reported_and_never_trusted(bench, lab, small_stage):
    # A minute is what clocks of one lab may differ; an hour is a clock that went backward.
    assert found(bench, lab, small_stage, now=bench.now - DAY / 1440 / 2) == []
    findings = found(bench, lab, small_stage, now=bench.now - DAY / 8)
    assert [f.code for f in findings] == ["clock-backward"] * 3
    assert "made 3 hours after now" in findings[0].found
    assert "is the computer's clock right?" in findings[0].expected


def test_what_is_allowed_becomes_a_warning_and_is_recorded(bench, lab, small_stage):
    now = bench.now + 10 * DAY
    summaries = bench.summaries(small_stage)
    used = use_calibrations(lab, small_stage, summaries, bench.leds, ("dark",), CONFIG, now)
    [finding] = used.findings
    assert finding.severity == "warn"
    assert "black and hot pixels may be wrong in this session" in finding.hint
    assert used.facts["dark"]["stale"] == ["dark-20260301T120000Z, 10 days old"]
    with pytest.raises(ConfigError, match="--allow-stale: found 'drak', expected one of charuco"):
        use_calibrations(lab, small_stage, summaries, bench.leds, ("drak",), CONFIG, now)


def test_what_was_changed_or_lost_since_is_reported(bench, lab, small_stage):
    (lab / "dark-20260301T120000Z" / "pose-01" / "session.json").unlink()
    (lab / "chart-20260301T120000Z" / "pose-01" / "session.json").write_text("{}")
    (lab / "charuco-20260301T120000Z" / "calibration.json").write_text("{")
    findings = {f.where.split()[1]: f for f in found(bench, lab, small_stage)}
    assert findings["dark"].code == findings["chart"].code == "calibration-damaged"
    assert "no such file" in findings["dark"].found
    assert "another file" in findings["chart"].found
    assert findings["charuco"].code == "calibration-missing"
    assert "calibration.json: found Expecting" in findings["charuco"].found


def test_a_lab_that_is_not_there_is_refused(bench, small_stage, tmp_path):
    with pytest.raises(FormatError, match="found no such folder, expected a lab's folder"):
        found(bench, tmp_path / "none", small_stage)


@given(
    age=st.floats(-1e4, 1e4),
    days=st.floats(1e-6, 1e4),
)
def test_age_alone_decides_by_its_sign_and_the_days(
    tmp_path_factory, small_stage, bench, age, days
):
    lab = tmp_path_factory.mktemp("lab")
    config = CalibrationConfig(wanted=("dark",), days=DaysConfig(dark=days))
    shots = add(bench, lab, small_stage, "dark")
    expires = bench.now + datetime.timedelta(days=days)
    shots.file = shots.file.model_copy(update={"expires_utc": expires.isoformat()})
    shots.save()
    now = bench.now + datetime.timedelta(days=age)
    codes = [
        f.code
        for f in stale(lab, small_stage, bench.summaries(small_stage), bench.leds, now, config)
    ]
    if age < -config.clock_slack_s / 86400:
        assert codes == ["clock-backward"]
    elif now >= expires:
        assert codes == ["calibration-expired"]
    else:
        assert codes == []


def test_durations_are_plain_words():
    assert [duration(d) for d in (30.0, 2.0, 1.5, 0.1, 0.01)] == [
        "30 days",
        "2 days",
        "36 hours",
        "2 hours",
        "14 minutes",
    ]


def test_a_rigs_hash_is_of_its_content(small_stage):
    again = Rig(tuple(small_stage.lights), tuple(small_stage.cameras))
    assert rig_sha256(again) == rig_sha256(small_stage)
    assert rig_sha256(small_stage.scaled(0.5)) != rig_sha256(small_stage)


def test_shots_hold_for_the_rig_whose_cameras_were_measured_from_them(bench, lab, small_stage):
    moved = [
        dataclasses.replace(camera, cam_from_world=camera.cam_from_world + 0.01)
        for camera in small_stage.cameras
    ]
    more = {MEASURED_WITH: rig_sha256(small_stage)}
    measured = Rig(tuple(small_stage.lights), tuple(moved), more)
    assert found(bench, lab, measured) == []
    for another in (Rig(measured.lights, measured.cameras), measured.scaled(0.5)):
        codes = {finding.code for finding in found(bench, lab, another)}
        assert codes == {"rig-changed"}


def test_a_lab_is_listed_in_plain_words(bench, lab, small_stage):
    add(bench, lab, small_stage, "dark", bench.now - 9 * DAY)
    add(bench, lab, small_stage, "chart", bench.now + 1 * DAY, finished=False)
    (lab / "broken").mkdir()
    (lab / "broken" / "calibration.json").write_text("[]")
    entries, damaged = list_lab(lab, bench.now + 8 * DAY, CONFIG)
    text = [(e.kind, e.folder[-17:], e.state, e.says) for e in entries]
    day = "-20260301T120000Z"
    assert text == [
        ("charuco", day, "holds", "8 days old, holds 22 days more"),
        ("mirror", "", "missing", "none yet"),
        ("grey", "", "missing", "none yet"),
        (
            "chart",
            "-20260302T120000Z",
            "unfinished",
            "1 of 1 pose, begun 7 days ago; calibrate chart with --resume and its other options "
            "resumes them",
        ),
        ("chart", day, "holds", "8 days old, holds 6 days more"),
        ("dark", day, "expired", "8 days old, expired 24 hours ago"),
        ("dark", "-20260220T120000Z", "replaced", "17 days old, newer ones count"),
        ("flat", "", "missing", "none yet"),
    ]
    assert len(damaged) == 1
    assert "broken/calibration.json, schema: found None" in damaged[0]
    with pytest.raises(FormatError, match="found a session, expected a lab's folder"):
        list_lab(next(lab.glob("dark-*/pose-01")), bench.now, CONFIG)
    future, _ = list_lab(lab, bench.now - DAY, CONFIG)
    assert future[0].state == "future"
