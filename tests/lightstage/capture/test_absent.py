"""A camera that could not be started again is looked for before the next light goes on."""

import threading

import pytest

from lightstage.errors import DeviceError, StoppedError


def test_a_camera_that_is_gone_is_reported_by_its_first_failure_and_nobody_is_lit_for_it(bench):
    camera = bench.cameras[1]
    camera.faults[2] = "after"
    bench.operator.answers = ["retake"]
    gone = [True]
    restart = camera.restart

    def unplugged():
        if gone[0]:
            gone[0] = len(bench.operator.asked) == 0
            raise DeviceError("camera cam1", found="no camera at any port")
        return restart()

    camera.restart = unplugged
    bench.run()
    first, second = (str(each[0]) for each in bench.operator.asked)
    assert "found its process ended" in first
    assert first == second
    # Lit for the first try and for the one after it answered, not for the one in between.
    assert [line["pattern"] for line in bench.events("lit")] == ["full", "x+", "x+", "x-"]
    # The picture that it had taken is of no certain light: it is kept apart.
    assert [line["camera"] for line in bench.events("recovered")] == ["cam1"]
    assert bench.kept("x+") == ["cam0.dng", "cam1.take2.dng", "cam2.dng"]


def test_a_search_for_a_camera_that_is_gone_ends_at_a_stop(bench):
    camera = bench.cameras[1]
    camera.faults[2] = "after"
    searched, over = threading.Event(), threading.Event()

    def restart():
        if bench.operator.asked:
            bench.operator.wishes = ["abort"]
            searched.set()
            over.wait(10.0)
        raise DeviceError("camera cam1", found="no camera at any port")

    camera.restart = restart
    with pytest.raises(StoppedError):
        bench.run()
    assert searched.is_set()
    over.set()
