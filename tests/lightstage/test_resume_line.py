"""Lines to paste: quoted by the shell's rules, and complete."""

import shlex

import pytest

from lightstage.capture.run import _suspected
from lightstage.findings import Finding
from lightstage.resume_line import resume_line, retake_line

OPTIONS = ["--leds", "serial:///dev/tty X?baud=9600", "--cameras", "/a b/cameras.toml"]


@pytest.mark.parametrize("session", ["/s/plain", "/s/it's a (new) $HOME & S; rm"])
def test_a_pasted_line_has_the_same_words_whatever_the_folder_is_called(session):
    words = shlex.split(retake_line(session, ["x-", "full"], ["cam0", "cam1"], OPTIONS))
    assert words == ["lightstage", "retake", session, "x-,full", "cam0", "cam1", *OPTIONS]
    words = shlex.split(resume_line(session, OPTIONS))
    assert words == ["lightstage", "capture", "--resume", "--out", session, *OPTIONS]


def test_a_line_whose_options_are_not_known_reports_it():
    assert retake_line("/s", ["full"]).endswith("(with --leds and --cameras as before)")


def suspicion(camera, suspects):
    return Finding("retake", "code", "", "", "", "", "x+", camera, suspects)


def test_what_is_suspected_is_every_pattern_that_takes_part_once_and_the_cameras_that_said_so():
    found = [suspicion("cam4", ("x-", "full")), suspicion("cam1", ("full",)), suspicion("cam2", ())]
    assert _suspected(found) == (["x-", "full"], ["cam1", "cam4"])


def test_what_all_cameras_see_suspects_all_of_them():
    found = [suspicion("cam4", ("full",)), suspicion(None, ("x-", "full"))]
    assert _suspected(found) == (["full", "x-"], [])


def test_nothing_is_suspected_where_nothing_contradicts():
    assert _suspected([suspicion("cam0", ())]) == ([], [])
