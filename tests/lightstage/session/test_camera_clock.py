"""Whether the time in a photograph is that of its shot."""

import datetime

import pytest

from lightstage.session.camera_clock import JUMP_S, CameraClock, Verdict, judge_time

SHOT = datetime.datetime(2026, 3, 1, 12, 0, 0, 500_000, datetime.UTC)


def at(seconds, zoned=True):
    taken = (SHOT + datetime.timedelta(seconds=seconds)).replace(microsecond=0)
    return taken if zoned else taken.replace(tzinfo=None)


@pytest.mark.parametrize("zoned", [True, False])
@pytest.mark.parametrize(
    ("seconds", "says"),
    [
        (0, Verdict.FITS),
        (-2, Verdict.FITS),
        (2.5, Verdict.FITS),
        (-10, Verdict.DIFFERS),
        (-60, Verdict.DIFFERS),
        (30, Verdict.DIFFERS),
        (2 * 3600, Verdict.UNKNOWN),
        (-5.5 * 3600, Verdict.UNKNOWN),
        (2 * 3600 - 60, Verdict.DIFFERS),
        (-86400, Verdict.DIFFERS),
    ],
)
def test_a_picture_of_another_moment_is_reported_and_another_zone_states_nothing(
    zoned, seconds, says
):
    assert judge_time(at(seconds, zoned), SHOT, 0.5) is says


def test_a_long_exposure_fits_from_its_first_second_to_its_last():
    for seconds in (0, 15, 30):
        assert judge_time(at(seconds), SHOT, 30.0) is Verdict.FITS
        assert judge_time(at(seconds + 3600), SHOT, 30.0) is Verdict.UNKNOWN
    assert judge_time(at(40), SHOT, 30.0) is Verdict.DIFFERS


def test_a_file_without_a_time_states_nothing():
    assert judge_time(None, SHOT, 0.5) is Verdict.UNKNOWN


def test_a_clock_hours_off_is_carried_by_the_steady_clock_and_known_to_be_set():
    clock = CameraClock.read_now(7200.4)
    shown = clock.at(clock.read_s + 60)
    assert (shown - clock.read_utc).total_seconds() == pytest.approx(7260.4, abs=1e-5)
    assert not clock.was_set_since(7200.4 + JUMP_S / 2)
    assert clock.was_set_since(7200.4 - 2 * JUMP_S)
    assert CameraClock.read_now(None) is None
