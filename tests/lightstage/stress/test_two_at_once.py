"""Two captures on one LED device or on one session folder: the second is refused."""

import signal

import pytest

LONG = ",".join(["full", *(f"olat-{light:03d}" for light in range(168))])


@pytest.fixture
def running(bench, tools):
    """A long capture that has begun; it ends as by Ctrl-C."""
    child = bench.start(sequence=LONG)
    bench.wait_for(child, "frames/olat-000/cam*.dng", 2)
    yield child
    before = len(bench.photographs())
    bench.wait_for(child, "frames/*/cam*.dng", before + 4)  # it never noticed
    child.send_signal(signal.SIGINT)
    done = tools.ended(child)
    assert "Traceback" not in done.stderr
    assert bench.stage.device.dark
    # What it had taken is its own, and right.
    lines = [line for line in tools.journal_of(bench.out) if line["event"] == "frame"]
    assert {bench.out / line["path"] for line in lines} <= set(bench.photographs())


def test_a_second_capture_on_one_device_or_one_session_is_refused_and_the_first_goes_on(
    bench, tools, running, tmp_path
):
    second = bench.run(out=bench.desk / "second")
    message = tools.message(second, "DeviceError")
    assert f"LED device at {bench.stage.device.path}: found another program" in message
    assert "expected" in message
    assert not (bench.desk / "second").exists()
    # Another stage's devices, all free, on the same folder.
    (tmp_path / "other").mkdir()
    with tools.bench_of(tmp_path / "other", tools.small_rig()) as other:
        resumed = tools.message(other.run(out=bench.out, resume=True), "CaptureError")
        begun = tools.message(other.run(out=bench.out), "CaptureError")
    assert f"{bench.out / 'journal.jsonl'}: found another capture" in resumed
    assert f"{bench.out}: found something there already, expected a new folder" in begun
    assert running.poll() is None
