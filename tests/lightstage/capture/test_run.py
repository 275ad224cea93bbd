"""The state machine, with devices that record what is asked of them."""

import dataclasses
import json
import threading
import time
import types

import numpy as np
import pytest

from lightstage.capture import run
from lightstage.errors import CaptureError, DeviceError, StoppedError
from lightstage.findings import Finding
from lightstage.formats.session import load_session
from lightstage.leds.controller import LightLostError
from lightstage.operator import Wish


def bad(code, camera=None, pattern=None, severity="retake"):
    return Finding(severity, code, f"{pattern} by {camera}", "x", "y", "z", pattern, camera)


def finished(bench):
    bench.writer.finish()
    return load_session(bench.root)


def test_every_photograph_is_lit_intended_exposed_and_kept_in_this_order(bench):
    report = bench.run()
    assert report.frames == 9
    assert report.retakes == 0
    kinds = [line["event"] for line in bench.events("lit", "trigger", "exposed", "frame", "shot")]
    for shot in range(3):
        part = kinds[9 * shot : 9 * shot + 9]
        assert part[:2] == ["lit", "trigger"]
        assert sorted(part[2:8]) == ["exposed"] * 3 + ["frame"] * 3
        assert part[-2:] == ["frame", "shot"]
    session = finished(bench)
    assert session.file.sequence == ["full", "x+", "x-"]
    assert np.array_equal(session.levels("x+"), bench.shots[1].levels)
    for camera in session.camera_ids():
        lines = bench.events("exposed", "frame")
        own = [line["event"] for line in lines if line["camera"] == camera]
        assert own == ["exposed", "frame"] * 3


def test_the_light_is_confirmed_after_each_exposure_and_before_its_download(bench):
    bench.run()
    for camera in bench.cameras:
        for place, message in enumerate(bench.log):
            if message == f"download {camera.id}":
                before = bench.log[:place]
                trigger = len(before) - before[::-1].index(f"trigger {camera.id}")
                assert "confirm" in before[trigger:]


def test_only_the_camera_that_failed_takes_the_pattern_again(bench):
    bench.cameras[1].faults[2] = "fail"
    report = bench.run()
    assert [camera.shots for camera in bench.cameras] == [3, 4, 3]
    assert report.retakes == 1
    assert report.frames == 9
    assert bench.kept("x+") == ["cam0.dng", "cam1.take2.dng", "cam2.dng"]
    assert [f.camera for f in bench.operator.asked[0]] == ["cam1"]


def test_seconds_until_an_operator_answers_are_a_pause_and_no_overhead(bench, monkeypatch):
    thought_s, decide = 1000.0, bench.operator.decide
    passed = [0.0]

    def decide_late(*question):
        passed[0] += thought_s
        return decide(*question)

    clock = types.SimpleNamespace(monotonic=lambda: time.monotonic() + passed[0], sleep=time.sleep)
    monkeypatch.setattr(run, "time", clock)
    bench.operator.decide = decide_late
    bench.cameras[1].faults[2] = "fail"
    report = bench.run()
    assert len(bench.operator.asked) == 1
    assert report.paused_s >= thought_s
    assert report.overhead_s < thought_s


def test_a_picture_taken_before_its_camera_died_is_found_on_the_card_and_counts(bench):
    bench.cameras[2].faults[1] = "after"
    report = bench.run()
    assert bench.cameras[2].restarts == 1
    assert bench.cameras[2].shots == 3
    assert report.retakes == 0
    assert bench.kept("full") == ["cam0.dng", "cam1.dng", "cam2.dng"]


def test_two_pictures_of_one_trigger_are_both_kept_and_neither_counts(bench):
    bench.cameras[0].faults[2] = "two"
    bench.run()
    recovered = bench.events("recovered")
    assert [line["camera"] for line in recovered] == ["cam0", "cam0"]
    on_disk = {p.read_bytes() for p in (bench.root / "recovered" / "cam0").iterdir()}
    card = bench.cameras[0].on_card
    assert on_disk == {card["/DCIM/DSC_0002.DNG"], card["/DCIM/DSC_0003.DNG"]}
    assert bench.kept("x+") == ["cam0.take2.dng", "cam1.dng", "cam2.dng"]


def test_a_picture_that_comes_after_its_trigger_had_failed_gets_nobody_elses_label(bench):
    bench.cameras[0].faults = {1: "tardy", 3: "fail"}
    bench.run()
    first = bench.cameras[0].on_card["/DCIM/DSC_0001.DNG"]
    on_disk = [p.read_bytes() for p in (bench.root / "recovered" / "cam0").iterdir()]
    assert on_disk == [first]
    assert first not in [p.read_bytes() for p in bench.root.glob("frames/*/*.dng")]
    assert len(finished(bench).file.frames) == 9


def test_a_picture_under_a_light_that_may_have_gone_is_recovered_and_taken_again(bench):
    lost = LightLostError("LED device", found="another boot id")
    bench.lights.fail["confirm"] = (4, 6, lost)  # the second pattern's three
    report = bench.run()
    assert "recover" in bench.log
    assert len(bench.events("recovered")) == 3
    assert bench.kept("x+") == ["cam0.take2.dng", "cam1.take2.dng", "cam2.take2.dng"]
    assert report.frames == 9


def test_without_acknowledgement_no_camera_is_triggered(bench):
    lost = LightLostError("LED device", found="another boot id")
    bench.lights.fail["light"] = (1, 99, lost)
    with pytest.raises(CaptureError, match="another boot id"):
        bench.run()
    assert not [text for text in bench.log if text.startswith("trigger")]


def test_an_old_picture_is_never_kept_under_a_new_name(bench):
    bench.cameras[1].faults[2] = "stale"
    bench.run()
    assert bench.kept("x+") == ["cam0.dng", "cam1.take2.dng", "cam2.dng"]
    hashes = [line["sha256"] for line in bench.events("frame")]
    assert len(set(hashes)) == 9
    assert "the bytes of" in str(bench.operator.asked[0][0])


def test_a_download_that_was_cut_is_asked_for_again_without_another_shot(bench):
    bench.cameras[0].cut = 1
    bench.run()
    assert bench.cameras[0].shots == 3
    assert len(bench.events("failed")) == 1
    assert bench.log.count("download cam0") == 4


def test_a_camera_that_is_gone_ends_the_capture_and_the_others_are_kept(bench):
    bench.cameras[1].faults[2] = "after"
    bench.cameras[1].restart = lambda: (_ for _ in ()).throw(
        DeviceError("camera cam1", found="gone")
    )
    with pytest.raises(CaptureError, match=r"(?s)x\+ by cam1.*gone"):
        bench.run()
    assert bench.kept("x+") == ["cam0.dng", "cam2.dng"]
    assert bench.writer.state.wanted() == {"x+": ("cam1",), "x-": ("cam0", "cam1", "cam2")}


def test_what_was_taken_is_not_taken_again_when_a_capture_goes_on(bench):
    bench.cameras[1].faults = dict.fromkeys(range(2, 9), "fail")
    with pytest.raises(CaptureError):
        bench.run()
    bench.cameras[1].faults = {}
    before = [camera.shots for camera in bench.cameras]
    report = bench.run()
    assert [camera.shots - b for camera, b in zip(bench.cameras, before, strict=True)] == [1, 2, 1]
    assert (report.taken, report.frames) == (4, 9)
    assert len(finished(bench).file.frames) == 9


def test_what_a_photograph_showed_before_a_crash_is_not_forgotten(bench):
    bench.cameras[1].faults = dict.fromkeys(range(1, 9), "fail")
    with pytest.raises(CaptureError):
        bench.run()
    bench.cameras[1].faults = {}
    bench.run({"full": [bad("underexposed", "cam0", "full")]})
    assert bench.kept("full")[:2] == ["cam0.dng", "cam0.take2.dng"]
    assert finished(bench).frame("full", "cam0").path == "frames/full/cam0.take2.dng"


def test_an_earlier_pattern_that_turns_out_wrong_is_taken_again_and_the_old_file_stays(bench):
    bench.checks.of_shots["x-"] = [[bad("sum", "cam1", "x+")]]
    bench.run()
    assert bench.kept("x+") == ["cam0.dng", "cam1.dng", "cam1.take2.dng", "cam2.dng"]
    assert ("x+", "cam1") in bench.checks.forgotten
    assert [(e["pattern"], e["camera"], e["take"]) for e in bench.events("rejected")] == [
        ("x+", "cam1", 1)
    ]
    frame = finished(bench).frame("x+", "cam1")
    assert frame.path == "frames/x+/cam1.take2.dng"


def test_a_finding_about_no_single_camera_takes_the_whole_pattern_again(bench):
    bench.checks.of_shots["full"] = [[bad("not-lit", None, "full")]]
    report = bench.run()
    assert report.retakes == 3
    assert [camera.shots for camera in bench.cameras] == [4, 4, 4]


def test_retakes_end_when_the_operator_is_out_of_them(bench):
    bench.checks.of_shots["full"] = [[bad("blurred", "cam0", "full")]] * 9
    with pytest.raises(CaptureError, match=r"^full by cam0: found x, expected y"):
        bench.run()
    assert bench.cameras[0].shots == 1 + bench.config.operator.retakes


def test_an_operator_may_accept_what_a_check_refuses_but_never_a_missing_photograph(bench):
    bench.checks.of_shots["full"] = [[bad("blurred", "cam0", "full")]]
    bench.operator.answers = ["accept"]
    report = bench.run()
    assert (report.retakes, report.accepted, report.accepted_findings) == (0, 1, 1)
    (accepted,) = bench.events("accepted")
    assert accepted["pattern"] == "full"
    assert [each["code"] for each in accepted["findings"]] == ["blurred"]


def test_the_stage_is_dark_while_a_question_waits(bench):
    bench.checks.of_shots["full"] = [[bad("blurred", "cam0", "full")]]
    decide = bench.operator.decide

    def decide_in_the_dark(findings, left):
        assert not bench.lights.levels.any()
        return decide(findings, left)

    bench.operator.decide = decide_in_the_dark
    assert bench.run().retakes == 1


def test_pictures_of_another_size_by_all_cameras_end_the_capture_at_the_first_pattern(bench):
    wrong = [
        Finding(
            "retake", "size", f"{c.id}, pattern full", "8 x 8 pixels", "16 x 16", "", "full", c.id
        )
        for c in bench.cameras
    ]
    bench.checks.of_shots["full"] = [wrong]
    with pytest.raises(CaptureError, match=r"found 8 x 8 pixels by all .*rig.json of this stage\?"):
        bench.run()
    assert [camera.shots for camera in bench.cameras] == [1, 1, 1]
    assert bench.operator.asked == []
    bench.checks.of_shots["full"] = [wrong[:2]]
    bench.checks.of_shots["x+"] = []
    assert bench.run().retakes == 2


def test_accepting_does_not_make_a_photograph(bench):
    bench.cameras[0].faults[1] = "fail"
    bench.operator.answers = ["accept"]
    with pytest.raises(CaptureError, match="full by cam0"):
        bench.run()


def test_an_abort_makes_the_stage_dark_first_and_what_was_exposed_still_comes_home(bench):
    bench.cameras[2].faults[1] = "late"
    bench.operator.wishes = [None, None, "abort"]
    with pytest.raises(StoppedError):
        bench.run()
    assert bench.log.index("dark") < bench.log.index("download cam2")
    assert not bench.lights.levels.any()


def test_a_stop_while_a_light_waits_for_its_turn_is_a_stop_and_no_cameras_failure(bench):
    lost = LightLostError("lights", found="put out by another thread", expected="a light to stay")
    bench.lights.fail["light"] = (2, 2, lost)
    bench.operator.command = lambda: Wish("abort") if bench.log.count("light") == 2 else None
    with pytest.raises(StoppedError, match=r"^Stopped by the operator\.$"):
        bench.run()
    assert bench.events("finding", "failed") == []
    assert bench.operator.asked == []


def test_a_stop_at_a_question_is_a_stop(bench):
    bench.cameras[1].faults = {1: "fail"}
    bench.operator.decide = lambda *_: "abort"
    bench.operator.command = lambda: Wish("abort") if bench.events("finding") else None
    with pytest.raises(StoppedError, match=r"^Stopped by the operator\.$"):
        bench.run()


def test_a_signal_in_the_middle_of_an_exposure_is_a_stop_after_which_no_line_comes(bench):
    bench.cameras[2].faults[1] = "late"

    def interrupt():
        if bench.log.count("trigger cam2"):
            raise KeyboardInterrupt
        return None

    bench.operator.command = interrupt
    with pytest.raises(KeyboardInterrupt):
        bench.run()
    assert not bench.lights.levels.any()
    last = bench.events("exposed", "frame", "recovered", "note")[-1]["id"]
    bench.writer.abort(said="Stopped by the operator.")
    time.sleep(0.1)
    assert bench.events("aborted")[0]["id"] > last
    assert "download cam2" in bench.log


def test_a_stop_does_not_wait_for_a_camera_that_hangs_and_no_thread_writes_after_the_last_line(
    bench,
):
    # Pools that other tests in this process left behind wait for work for ever.
    before = set(threading.enumerate())
    bench.config = dataclasses.replace(bench.config, late_camera_grace_s=0.5)
    camera = bench.cameras[2]
    camera.faults[1] = "hangs"

    def once_the_others_exposed():
        exposed = all(each.on_card for each in bench.cameras[:2])
        return Wish("abort") if camera.hanging and exposed else None

    bench.operator.command = once_the_others_exposed
    with pytest.raises(StoppedError):
        bench.run()
    assert camera.hanging
    bench.writer.abort(said="Stopped by the operator.")
    camera.answer.set()
    for thread in set(threading.enumerate()) - before:
        if thread.name.startswith("ThreadPoolExecutor"):
            thread.join()
    assert camera.shots == 1
    assert bench.events("aborted", "note")[-1]["event"] == "aborted"
    assert bench.kept("full") == ["cam0.dng", "cam1.dng"]


def test_a_camera_that_hung_takes_the_pattern_again_alone_and_nobody_is_asked(bench):
    bench.config = dataclasses.replace(bench.config, late_camera_grace_s=0.5)
    camera = bench.cameras[2]
    camera.faults[2] = "hangs"
    dark = bench.lights.dark

    def watched():
        dark()
        if camera.hanging:
            camera.answer.set()

    bench.lights.dark = watched
    report = bench.run()
    assert bench.operator.asked == []
    assert report.retakes == camera.restarts == 1
    assert [each.shots for each in bench.cameras] == [3, 3, 4]
    assert bench.kept("x+") == ["cam0.dng", "cam1.dng", "cam2.take2.dng"]
    (finding,) = bench.events("finding")
    assert (finding["code"], finding["camera"]) == ("not-taken", "cam2")


def test_a_camera_that_hangs_for_ever_is_asked_about_in_the_end(bench):
    bench.config = dataclasses.replace(bench.config, late_camera_grace_s=0.5)
    camera = bench.cameras[2]
    camera.faults = dict.fromkeys(range(2, 9), "hangs")
    camera.answer.wait = lambda _: time.sleep(0.8)
    with pytest.raises(CaptureError, match="no picture when the light was put out"):
        bench.run()
    assert len(bench.operator.asked) == 1
    assert camera.shots == 4


def test_a_picture_taken_after_the_lights_were_put_out_is_never_kept_as_the_patterns(bench):
    camera = bench.cameras[1]
    trigger = camera.trigger

    def busy(*asked):
        bench.lights.dark()  # somebody aborts, from another thread
        return trigger(*asked)

    camera.trigger = busy
    bench.operator.answers = ["abort"]
    with pytest.raises(CaptureError, match="put out meanwhile"):
        bench.run()
    assert "cam1.dng" not in bench.kept("full")
    assert "cam1" in [line["camera"] for line in bench.events("recovered")]


def test_a_pause_is_dark_and_goes_on_where_it_was(bench):
    bench.operator.wishes = ["pause", None, None, None, "resume"]
    report = bench.run()
    assert "dark" in bench.log
    assert report.frames == 9


def test_the_operator_gets_the_last_pattern_again_for_asking(bench):
    bench.operator.wishes = ["retake"]
    report = bench.run()
    assert report.retakes == 3
    assert bench.kept("full") == sorted(
        f"cam{i}{take}.dng" for i in range(3) for take in ("", ".take2")
    )


def test_a_pattern_that_is_named_is_taken_again_whatever_came_after_it(bench):
    # Heard while x+ is taken: the one that the page showed.
    bench.operator.wishes = [None] * 8 + ["retake full"]
    bench.run()
    twice = sorted(f"cam{i}{take}.dng" for i in range(3) for take in ("", ".take2"))
    assert bench.kept("full") == twice
    assert bench.kept("x+") == ["cam0.dng", "cam1.dng", "cam2.dng"]


def test_a_retake_that_is_wished_in_a_pause_comes_after_it(bench):
    bench.operator.wishes = ["pause", None, "retake full", None, "resume"]
    report = bench.run()
    assert report.frames == 9
    assert report.retakes == 3
    events = bench.events("note", "rejected", "lit")
    paused = next(i for i, line in enumerate(events) if "paused" in line.get("said", ""))
    assert events[paused + 1]["event"] == "rejected"
    lit = [line["pattern"] for line in events[paused:] if line["event"] == "lit"]
    assert lit == ["full", "x+", "x-"]


def test_photographs_stay_on_the_cameras_unless_the_lab_wants_otherwise(bench):
    bench.run()
    assert [len(camera.on_card) for camera in bench.cameras] == [3, 3, 3]


def test_a_photograph_is_deleted_on_the_camera_only_after_its_line_is_on_the_disk(bench):
    bench.config = dataclasses.replace(bench.config, delete_from_cameras=True)
    journal = bench.root / "journal.jsonl"
    for camera in bench.cameras:
        delete = camera.delete

        def checked(name, camera=camera, delete=delete):
            # What another camera's thread is writing just now has no end yet.
            lines = [json.loads(line) for line in journal.read_text().split("\n")[:-1]]
            own = [e for e in lines if e["event"] == "frame" and e["camera"] == camera.id]
            assert own[-1]["file"] == name
            delete(name)

        camera.delete = checked
    bench.run()
    assert [len(camera.on_card) for camera in bench.cameras] == [0, 0, 0]
    assert len(bench.events("deleted")) == 9


def test_a_full_disk_ends_the_capture_and_the_other_photographs_are_kept(bench):
    full = CaptureError("disk", found="no space left", expected="space")
    bench.cameras[1].download = lambda *_: (_ for _ in ()).throw(full)
    with pytest.raises(CaptureError, match="no space left"):
        bench.run()
    assert bench.kept("full") == ["cam0.dng", "cam2.dng"]


@pytest.mark.parametrize(
    ("name", "message"), [("owner", "The field is cleared"), ("iso", "The setting is set back")]
)
def test_a_setting_that_either_answer_mends_reports_it(bench, name, message):
    camera = bench.cameras[1]
    changed = dataclasses.replace(camera.open(), **{name: "800"})
    camera.summary = lambda: camera.open() if "retake" in bench.log else changed
    bench.operator.decide = lambda *_: bench.log.append("retake") or "retake"
    bench.run()
    hints = [line["hint"] for line in bench.events("finding") if line["code"] == "drift"]
    assert hints
    assert all(
        hint
        == f"{message} on the camera in any case: r then takes this photograph again, a keeps it."
        for hint in hints
    )


def test_a_setting_that_drifted_is_set_back_where_the_photograph_is_accepted(bench):
    camera = bench.cameras[0]
    found = camera.open()
    changed: list[tuple[str, str]] = []

    def summary():
        drifted = camera.shots >= 2 and not changed
        return dataclasses.replace(found, iso="400") if drifted else found

    camera.summary = summary
    camera.change = lambda name, value: changed.append((name, value))
    bench.operator.answers = ["accept"]
    bench.run()
    assert changed == [("iso", found.iso)]
    assert len(bench.operator.asked) == 1  # the patterns after it are not in question
    assert bench.kept("x+") == ["cam0.dng", "cam1.dng", "cam2.dng"]
    assert [line["said"] for line in bench.events("note")].count("iso set back") == 1


def test_a_setting_that_drifted_is_told_set_back_and_the_photograph_taken_again(bench):
    camera = bench.cameras[0]
    found = camera.open()
    camera.told = found
    drifted = dataclasses.replace(found, white_balance="Auto")

    def summary():
        return drifted if camera.shots == 2 and not camera.changed else found

    camera.changed = []
    camera.summary = summary
    camera.change = lambda name, value: camera.changed.append((name, value))
    bench.run()
    assert camera.changed == [("white_balance", "Daylight")]
    assert bench.kept("x+") == ["cam0.dng", "cam0.take2.dng", "cam1.dng", "cam2.dng"]
