"""A computer's clock that goes backward: handled while a capture runs, refused before the next."""

import datetime
import itertools
from pathlib import Path

import pytest

LAUNCHER = Path(__file__).with_name("clock_launcher.py")
BACK_S = -3 * 3600


@pytest.fixture
def clock(tmp_path):
    """The file that sets the captures' clock: seconds against this machine's."""
    path = tmp_path / "clock"
    path.write_text("0")
    return path


def times(lines):
    return [datetime.datetime.fromisoformat(line["time_utc"]) for line in lines]


def test_a_clock_that_is_set_back_in_the_middle_changes_no_label_and_no_order(bench, tools, clock):
    child = bench.start(launcher=(str(LAUNCHER), str(clock)))
    bench.wait_for(child, "frames/x-/cam*.dng", 2)
    beside = clock.with_name("clock.new")
    beside.write_text(str(BACK_S))
    beside.replace(clock)
    done = tools.ended(child)
    assert done.returncode == 0, done.stderr
    bench.require_whole()
    lines = tools.journal_of(bench.out)
    stated = times(lines)
    assert any(later < earlier for earlier, later in itertools.pairwise(stated))
    assert [line["id"] for line in lines] == list(range(1, len(lines) + 1))
    steady = [line["elapsed_s"] for line in lines]
    assert steady == sorted(steady)
    shots = [line["pattern"] for line in lines if line["event"] == "shot"]
    assert shots == ["full", "x+", "x-", "y+", "y-", "z+", "z-"]


def test_where_the_clock_is_before_the_last_journal_all_is_refused_until_it_is_right_again(
    bench, tools, clock
):
    clock.write_text(str(-BACK_S))
    launcher = (str(LAUNCHER), str(clock))
    child = bench.start(launcher=launcher)
    bench.wait_for(child, "frames/x-/cam*.dng", 2)
    child.kill()
    child.communicate()
    kept = bench.photographs()
    newest = max(times(tools.journal_of(bench.out))).isoformat(timespec="seconds")
    clock.write_text("0")
    states = len(bench.stage.device.states)
    message = tools.message(bench.run(launcher=launcher, out=bench.desk / "second"), "DeviceError")
    assert "this computer, clock: found" in message
    last = f"expected later than the last line of {bench.out / 'journal.jsonl'}, {newest}"
    assert last in message
    assert "--ignore-clock" in message
    assert not (bench.desk / "second").exists()
    message = tools.message(bench.run(launcher=launcher, resume=True), "DeviceError")
    assert "this computer, clock: found" in message
    assert all(not state.counts.any() for state in bench.stage.device.states[states:])
    clock.write_text(str(-BACK_S))
    done = bench.run(launcher=launcher, resume=True)
    assert done.returncode == 0, done.stderr
    bench.require_whole()
    assert {path: path.read_bytes() for path in kept} == kept
