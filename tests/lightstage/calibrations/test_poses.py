"""Pose after pose: taken again, kept, stopped, gone on with; and what calibration.json says."""

import dataclasses
import json

import pytest

from lightstage.calibrations.assistant import TerminalAssistant, UnattendedAssistant
from lightstage.calibrations.config import KIND_NAMES, CalibrationConfig
from lightstage.calibrations.folder import latest, newest_unfinished
from lightstage.calibrations.kinds import KINDS
from lightstage.calibrations.reasons import joined
from lightstage.calibrations.run import begin_shots, resume_shots, take_poses
from lightstage.errors import CaptureError, ConfigError, FormatError
from lightstage.findings import Finding
from lightstage.formats.calibration_shots import read_shots
from lightstage.formats.config import make_config
from lightstage.formats.files import sha256_file
from lightstage.formats.session import load_session
from sim.devices.target_photographer import TargetPhotographer

CONFIG = CalibrationConfig(board_poses_per_camera=1)


@pytest.fixture
def begin(bench, small_stage, tmp_path):
    """Begins shots of a kind in tmp_path/lab."""

    def begun(kind, **more):
        summaries = bench.summaries(small_stage)
        return begin_shots(
            KINDS[kind],
            tmp_path / "lab",
            small_stage,
            summaries,
            bench.leds,
            CONFIG,
            bench.now,
            **more,
        )

    return begun


def test_a_first_pose_speaks_of_none_before_it(small_stage):
    for kind in KINDS.values():
        assert "before." not in kind.instruction(small_stage, 0)
        assert "than before" not in kind.instruction(small_stage, 0)
    assert "on another spot than before" in KINDS["mirror"].instruction(small_stage, 1)
    tilted = KINDS["charuco"].instruction(small_stage, 1)
    assert "tilted another way than before, and keep" in tilted


@pytest.mark.parametrize("kind", KIND_NAMES)
def test_every_kind_is_taken_pose_by_pose_to_its_end(bench, begin, small_stage, tmp_path, kind):
    photographer = TargetPhotographer(small_stage, kind, 1, poses=3)
    shots = begin(kind)
    taker, holder = bench.taker(photographer), bench.holder(photographer)
    seen = []
    report = take_poses(
        KINDS[kind], shots, small_stage, taker, holder, CONFIG, lambda *done: seen.append(done)
    )
    count = KINDS[kind].poses(small_stage, CONFIG)
    assert (report.poses, report.now, report.again, report.warnings) == (count, count, 0, 0)
    assert set(taker.drives) == {"on-off" if kind in ("mirror", "grey") else "solid-angle"}
    assert seen == [(done, count) for done in range(count + 1)]
    again = latest(tmp_path / "lab", kind)
    assert again.root.name == f"{kind}-20260301T120000Z"
    assert again.file == shots.file
    assert again.changed() == []
    for index, pose in enumerate(again.file.poses):
        assert pose.folder == f"pose-{index + 1:02d}"
        session = load_session(again.root / pose.folder)
        assert tuple(session.file.sequence) == KINDS[kind].patterns
        assert pose.faces == (f"cam{index}" if KINDS[kind].faces else None)
        assert pose.session_sha256 == sha256_file(again.root / pose.folder / "session.json")
        assert set(pose.figures) == {"cam0", "cam1", "cam2"}
        if pose.faces:
            assert pose.faces in holder.asked[index]
    written = json.loads((again.root / "calibration.json").read_text())
    assert written["schema"] == "lightstage.calibration-shots/1"
    assert written["devices"]["leds"]["firmware"] == "leds 1.0"


def test_a_forgotten_target_is_reported_and_the_pose_taken_again_into_its_own_folder(
    bench, begin, small_stage
):
    photographer = TargetPhotographer(small_stage, "chart", 1)
    photographer.kind = "nothing"
    holder = bench.holder(photographer, ["again"])

    def mend():
        photographer.kind = "chart"

    holder.mend = mend
    taker = bench.taker(photographer)
    shots = begin("chart")
    report = take_poses(KINDS["chart"], shots, small_stage, taker, holder, CONFIG)
    assert report.again == 1
    assert [pose.folder for pose in shots.file.poses] == ["pose-01.take2", "pose-02", "pose-03"]
    # The first pose faces the first camera: the others need not see the chart.
    assert [(f.camera, f.code, f.pattern) for f in holder.findings] == [
        ("cam0", "chart-patches", "full")
    ]
    assert str(holder.findings[0]).startswith("chart, pose 1, cam0: found no colour chart")


def test_what_the_operator_keeps_though_it_is_amiss_is_written_down(bench, begin, small_stage):
    photographer = TargetPhotographer(small_stage, "nothing", 1)
    holder = bench.holder(photographer, ["keep"])
    shots = begin("flat", poses=1)
    report = take_poses(
        KINDS["flat"], shots, small_stage, bench.taker(photographer), holder, CONFIG
    )
    assert report.warnings == 1
    [accepted] = shots.file.poses[0].accepted
    assert "flat, pose 1, cam0: found" in accepted
    assert "% of white in the mean" in accepted


def test_a_board_that_one_camera_alone_sees_is_not_enough(bench, begin, small_stage):
    photographer = TargetPhotographer(small_stage, "charuco", 1)
    taker = bench.taker(photographer)
    take = taker.__call__

    class OneEyed:
        def __call__(self, root, patterns, drive):
            take(root, patterns, drive)
            for camera in ("cam1", "cam2"):
                dark = TargetPhotographer(small_stage, "nothing", 1)
                data = dark.photograph(small_stage.camera(camera), bench.dark)
                (root / f"frames/full/{camera}.dng").write_bytes(data)

    holder = bench.holder(photographer, ["stop"])
    with pytest.raises(CaptureError, match="stopped after 0 of 3 poses"):
        take_poses(KINDS["charuco"], begin("charuco"), small_stage, OneEyed(), holder, CONFIG)
    [finding] = holder.findings
    assert finding.code == "board-cameras"
    assert "in the pictures of cam0, expected at least 2 cameras" in str(finding)


def test_stopped_shots_count_for_nothing_and_go_on_where_they_stopped(
    bench, begin, small_stage, tmp_path
):
    kind, lab = KINDS["chart"], tmp_path / "lab"
    photographer = TargetPhotographer(small_stage, "chart", 1)
    holder = bench.holder(photographer, stop_at=3)
    with pytest.raises(CaptureError, match=r"stopped after 2 of 3 poses"):
        take_poses(kind, begin("chart"), small_stage, bench.taker(photographer), holder, CONFIG)
    assert latest(lab, "chart") is None
    shots = resume_shots(kind, lab, small_stage, bench.summaries(small_stage), bench.leds)
    taker = bench.taker(photographer)
    report = take_poses(kind, shots, small_stage, taker, bench.holder(photographer), CONFIG)
    assert taker.taken == ["pose-03"]
    assert (report.poses, report.now) == (3, 1)
    assert latest(lab, "chart").file.id == shots.file.id
    with pytest.raises(FormatError, match="no unfinished chart shots"):
        newest_unfinished(lab, "chart")


def test_a_capture_that_fails_in_a_pose_goes_on_in_the_same_folder(
    bench, begin, small_stage, tmp_path
):
    kind = KINDS["chart"]
    photographer = TargetPhotographer(small_stage, "chart", 1)
    taker = bench.taker(photographer, fail={"pose-02"})
    with pytest.raises(CaptureError, match="a cable that was pulled"):
        take_poses(kind, begin("chart"), small_stage, taker, bench.holder(photographer), CONFIG)
    summaries = bench.summaries(small_stage)
    shots = resume_shots(kind, tmp_path / "lab", small_stage, summaries, bench.leds)
    take_poses(kind, shots, small_stage, taker, bench.holder(photographer), CONFIG)
    assert taker.taken == ["pose-01", "pose-02", "pose-02", "pose-03"]


def test_shots_do_not_go_on_with_another_lens_setting(bench, begin, small_stage, tmp_path):
    begin("chart")
    summaries = bench.summaries(small_stage)
    summaries["cam1"] = dataclasses.replace(summaries["cam1"], aperture="f/11")
    with pytest.raises(CaptureError, match=r"cam1 with aperture f/11, expected aperture f/8"):
        resume_shots(KINDS["chart"], tmp_path / "lab", small_stage, summaries, bench.leds)


def test_a_damaged_calibration_file_is_refused_field_by_field(begin):
    shots = begin("dark")
    path = shots.root / "calibration.json"
    value = json.loads(path.read_text())
    del value["kind"]
    value["poses_wanted"] = "many"
    path.write_text(json.dumps(value))
    with pytest.raises(FormatError) as error:
        read_shots(shots.root)
    assert "calibration.json, kind: found no such field" in str(error.value)
    assert "calibration.json, poses_wanted: found 'many'" in str(error.value)
    value |= {"kind": "dark", "poses_wanted": 1, "created_utc": "2026-03-01T12:00:00"}
    path.write_text(json.dumps(value))
    with pytest.raises(FormatError, match="a time without its zone"):
        read_shots(shots.root)
    value["schema"] = "lightstage.calibration-shots/2"
    path.write_text(json.dumps(value))
    with pytest.raises(FormatError, match="newer version"):
        read_shots(shots.root)


@pytest.mark.parametrize("folder", ["../elsewhere", "/etc", "", "link"])
def test_a_pose_that_leads_out_of_its_folder_is_refused(begin, tmp_path, folder):
    shots = begin("dark")
    (shots.root / "link").symlink_to(tmp_path)
    path = shots.root / "calibration.json"
    value = json.loads(path.read_text())
    value["poses"] = [
        {
            "index": 0,
            "folder": folder,
            "faces": None,
            "session_sha256": "0",
            "manifest_sha256": None,
            "figures": {},
        }
    ]
    path.write_text(json.dumps(value))
    with pytest.raises(FormatError, match=r"poses\[0\].folder: found .* stays inside the folder"):
        read_shots(shots.root)


def test_shots_of_the_same_second_are_not_mixed(begin):
    begin("dark")
    with pytest.raises(CaptureError, match="shots of this very second"):
        begin("dark")


BAD = {
    "kind": ({"wanted": ["charuco", "ball"]}, "found 'ball', expected one of charuco, mirror"),
    "board": ({"board": {"marker_mm": 30.0}}, "markers smaller than squares"),
    "dictionary": ({"board": {"dictionary": "CharucoBoard"}}, "such as DICT_4X4_50"),
    "days": ({"days": {"dark": 0.0}}, "days, dark: found 0.0, expected above 0"),
    "poses": ({"dark_poses": 0}, "dark_poses: found 0, expected from 1 to 1000"),
    "takes": ({"takes_per_pose": 2}, "found 2, 2, expected more takes"),
    "key": ({"expiry": 3}, "expiry: found an unknown key"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_configuration_without_sense_is_refused(name):
    values, message = BAD[name]
    with pytest.raises(ConfigError) as error:
        make_config(CalibrationConfig, values, "lab.toml")
    assert message in str(error.value)


def test_the_terminal_asks_until_it_understands_and_stops_where_nobody_is():
    lines, answers = [], iter(["what?", "", "K", "x", " q "])
    asks = TerminalAssistant(lines.append, lambda _: next(answers))
    assert asks.ready(2, 5, "Hold it.") is True
    assert lines == ["Pose 2 of 5: Hold it."]
    finding = Finding("retake", "clipped", "chart, pose 2, cam0", "much", "little", "Less.")
    assert asks.judge(2, [finding], 3) == "keep"
    assert lines[-1] == "  chart, pose 2, cam0: found much, expected little. Less."
    assert asks.ready(3, 5, "Hold it.") is False

    def nobody(_):
        raise EOFError

    asks = TerminalAssistant(lines.append, nobody)
    assert asks.ready(1, 5, "Hold it.") is False
    assert asks.judge(1, [finding], 3) == "stop"


def test_unattended_waits_before_each_pose_and_gives_up_after_its_retakes():
    lines, slept = [], []
    nobody = UnattendedAssistant(lines.append, 3.0, 2, slept.append)
    assert nobody.ready(1, 2, "Cap it.")
    assert slept == [3.0]
    assert lines == ["Pose 1 of 2 in 3 s: Cap it."]
    assert [nobody.judge(1, [], 3) for _ in range(3)] == ["again", "again", "stop"]
    assert nobody.judge(2, [], 1) == "again"
    assert nobody.judge(3, [], 0) == "stop"


def test_a_pose_that_never_does_stops_with_what_each_take_showed(bench, begin, small_stage):
    photographer = TargetPhotographer(small_stage, "nothing", 1)
    holder = bench.holder(photographer, ["again"] * 99)
    taker = bench.taker(photographer)
    shots = begin("chart")
    with pytest.raises(CaptureError) as error:
        take_poses(KINDS["chart"], shots, small_stage, taker, holder, CONFIG)
    assert len(taker.taken) == CONFIG.takes_per_pose == 6
    assert holder.left == [5, 4, 3, 2, 1, 0]
    assert (
        "found stopped after 0 of 3 poses: pose 1 was not usable in 6 takes: cam0: no colour "
        "chart, expected its 24 patches. Turn the chart toward this camera"
    ) in str(error.value)


def test_what_takes_showed_is_reported_once_with_its_takes():
    def board(camera, found):
        return Finding("retake", "board-corners", "pose", found, "28", "Turn it.", camera=camera)

    takes = [[board("cam1", "9 corners")], [board("cam1", "8 corners")], []]
    takes[2] = [*takes[0], board("cam2", "none")]
    assert joined(takes) == (
        "cam1: 9 corners (takes 1, 3), 8 corners (take 2); cam2: none (take 3)",
        "28",
        "Turn it.",
    )


def test_the_last_take_is_kept_or_stops():
    lines, asked = [], []

    def ask(question):
        asked.append(question)
        return ""

    assert TerminalAssistant(lines.append, ask).judge(2, [], 0) == "stop"
    assert asked == ["Pose 2: this was its last take. k keeps it, Enter or q stops: "]
    assert TerminalAssistant(lines.append, ask).judge(2, [], 2) == "again"
    assert "at most 2 more" in asked[1]
