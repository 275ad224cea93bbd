"""Cameras that somebody set otherwise or plugged in elsewhere between a stop and a resume."""

import json
import re
import signal


def stopped(bench, tools):
    child = bench.start()
    bench.wait_for(child, "frames/x-/cam*.dng", 2)
    child.send_signal(signal.SIGINT)
    assert tools.ended(child).returncode != 0
    assert not (bench.out / "session.json").exists()


def findings(lines, code):
    return [line for line in lines if line["event"] == "finding" and line["code"] == code]


def test_a_setting_that_was_changed_is_set_back_when_a_capture_goes_on(bench, tools):
    stopped(bench, tools)
    (state,) = (bench.desk / "sim").rglob("cam1/state.json")
    value = json.loads(state.read_text())
    value["changed"]["iso"] = "800"
    state.write_text(json.dumps(value))
    done = bench.run(resume=True)
    assert done.returncode == 0, done.stderr
    assert "it was set back" in done.stderr
    (finding,) = findings(tools.journal_of(bench.out), "set-back")
    assert (finding["camera"], finding["found"], finding["severity"]) == ("cam1", "800", "warn")
    assert json.loads(state.read_text())["changed"]["iso"] == finding["expected"].partition(",")[0]
    bench.require_whole()


def test_a_camera_that_was_plugged_in_elsewhere_is_found_when_a_capture_goes_on(bench, tools):
    stopped(bench, tools)
    file = bench.stage.cameras_path
    port = re.search(r'port = "(.*cam1)"', file.read_text())[1]
    file.write_text(file.read_text().replace(port, port + "-before"))
    done = bench.run(resume=True)
    assert done.returncode == 0, done.stderr
    (finding,) = findings(tools.journal_of(bench.out), "moved")
    assert finding["camera"] == "cam1"
    assert f"at {port}, and nothing that answers at {port}-before" in finding["found"]
    bench.require_whole()
