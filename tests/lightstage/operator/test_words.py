"""Every line of a journal reads well, says what to do, and carries nothing dangerous."""

import typing

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.findings import Severity
from lightstage.operator.plain import THEN, cause, plain
from lightstage.operator.view import State, View
from lightstage.operator.words import (
    _WORDS,
    FINDING,
    HEARD,
    KEYS,
    ON_CARD,
    SIGNS,
    STATES,
    Tone,
    duration,
    merged,
    notice_of,
)
from lightstage.printable import printable

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=30),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner),
    max_leaves=8,
)
EVENTS = [*_WORDS]
FIELDS = [
    "id",
    "time_utc",
    "elapsed_s",
    "pattern",
    "camera",
    "take",
    "takes",
    "cameras",
    "sequence",
    "subject",
    "severity",
    "code",
    "where",
    "found",
    "expected",
    "hint",
    "said",
    "why",
    "path",
    "size",
    "told",
    "led_device",
    "acknowledged",
    "frames",
    "socket",
]


def test_every_severity_state_and_tone_has_words():
    assert set(FINDING) == set(typing.get_args(Severity))
    assert set(STATES) == set(typing.get_args(State))
    assert set(SIGNS) == set(typing.get_args(Tone))
    assert set(HEARD) <= set(KEYS)
    assert len({key for key, _ in KEYS.values()}) == len(KEYS) - 1  # leaving is q, too


@pytest.mark.parametrize("severity", ["refuse", "retake", "warn"])
def test_what_is_wrong_always_states_what_to_do(severity):
    line = {"event": "finding", "severity": severity, "where": "cam3", "found": "ISO 400"}
    words = notice_of(line | {"expected": "ISO 100"})
    assert words.todo
    assert "cam3: ISO 400 (wanted: ISO 100)" in words.text
    assert notice_of(line | {"hint": "Set ISO 100."}).todo == "Set ISO 100."


@pytest.mark.parametrize("event", ["failed", "recovered", "aborted"])
def test_what_went_wrong_states_what_to_do(event):
    words = notice_of({"event": event, "said": "no answer", "camera": "cam3"}, "S/1")
    assert words.todo
    assert words.tone in ("warning", "problem", "stop")


def test_an_abort_states_how_to_go_on():
    words = notice_of({"event": "aborted", "said": "camera cam3 is gone"}, "sessions/P1")
    assert "lightstage capture --resume --out sessions/P1" in words.todo
    assert "camera cam3 is gone" in words.text


def test_braces_in_what_devices_say_stay_as_they_are():
    assert "{session}" not in notice_of({"event": "aborted", "said": "x"}, "S").todo
    assert "{0} {x}" in str(notice_of({"event": "failed", "said": "{0} {x}"}))


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (None, "time left not known yet"),
        (0.2, "nearly done"),
        (1.2, "about 1 s left"),
        (89.0, "about 89 s left"),
        (600.0, "about 10 min left"),
        (9000.0, "about 2.5 h left"),
    ],
)
def test_time_left_in_words(seconds, words):
    assert duration(seconds) == words


def test_the_same_of_several_cameras_is_reported_once():
    lines = [
        {"event": "failed", "pattern": "x+", "camera": camera, "said": f"{camera} is gone"}
        for camera in ("cam1", "cam10", "cam1")
    ]
    other = {"event": "failed", "pattern": "x-", "camera": "cam1", "said": "it hangs"}
    words = merged([notice_of(each) for each in [lines[0], other, *lines[1:]]])
    assert [each.text for each in words] == [
        "x-, cam1: it hangs",
        "x+, cam1, cam10: cam1, cam10 is gone",
    ]
    assert words[1].todo


@pytest.mark.parametrize(
    ("raw", "read"),
    [
        (
            "camera cam1 (usb:001,004), connect: found libgphoto2 error -53 (Could not claim the "
            "USB device). Another program has the camera: stop it.",
            "camera cam1, connect: found another program has the camera. "
            "Another program has the camera: stop it.",
        ),
        (
            "camera cam1 (/tmp/stage/cam1), trigger: found error -1 (its battery is empty). Charge",
            "camera cam1, trigger: found its battery is empty. Charge",
        ),
        (
            "camera cam1, trigger: found its process ended, exit status 1, RuntimeError: a fault, "
            "expected an answer. Switch it off",
            "camera cam1, trigger: found its process ended, expected an answer. Switch it off",
        ),
        (
            "LED device at socket://x:1, SET: found lights not as set (type 0x20, state "
            "ced5f03aa911..), expected the levels sent (LIT, state 000000000000..). Check it.",
            "LED device at socket://x:1, SET: found lights not as set, expected the "
            "levels sent. Check it.",
        ),
        ("x+ by cam0: found a blurred eye (f/2.8)", "x+ by cam0: found a blurred eye (f/2.8)"),
    ],
)
def test_a_drivers_codes_ports_and_class_names_are_reported_in_plain_words(raw, read):
    assert plain(raw) == read
    line = {"event": "finding", "severity": "retake", "code": "not-taken", "found": raw}
    assert read in notice_of(line).text


def test_why_a_camera_gave_no_photograph_is_reported_without_what_stands_beside_it():
    why = (
        "camera cam5 (/tmp/cam5), trigger: found error -1 (no picture was taken), expected one. "
        "Try the shot again."
    )
    said_why = "no picture was taken. Try the shot again."
    assert cause(why, "cam5") == said_why
    assert cause(f"DSC_1 is on its card, though: {why}", "cam5").endswith(f"though: {said_why}")
    assert cause(why, "cam1") == plain(why)


def test_a_camera_that_does_not_start_again_is_reported_by_why_it_failed_first():
    port = "/tmp/a-stage-with-a-rather-long-name/of-a-lab/cameras/cam7"
    first = (
        f"camera cam7 ({port}), trigger: found error -7 (the camera switched itself off, its "
        "battery is empty). Put in a full battery and switch it on."
    )
    then = (
        "camera cam7, restart: found no camera at any port, expected the camera with serial 607. "
        "Check its cable, power and battery."
    )
    line = {"event": "finding", "severity": "retake", "code": "not-taken", "camera": "cam7"}
    line |= {"where": "x+ by cam7", "found": f"{first}{THEN}{then}", "expected": "a photograph"}
    assert notice_of(line).text == (
        "Not good: x+ by cam7: the camera switched itself off, its battery is empty. Put in a full "
        "battery and switch it on. It does not start again: no camera at any port."
    )
    other = f"{first}{THEN}camera cam7, restart: found {port}: found serial 608. Check its cable."
    assert cause(other, "cam7").endswith("found serial 608.")


def test_a_picture_found_on_a_cards_folder_is_told_without_its_path():
    raw = "/DCIM/100SIM/DSC_0001.DNG is on its card, though: camera cam4, trigger: found nothing"
    words = notice_of(
        {"event": "note", "about": ON_CARD, "pattern": "full", "camera": "cam4", "said": raw}
    )
    assert str(words) == "full, cam4: it answers again, and its picture is on its card."


def test_control_characters_never_reach_the_terminal():
    text = printable("a\x1b[2Jb\x07\r\n\tc\u202ed\x9b31m")
    assert text.isprintable()
    assert len(printable("x" * 10_000)) == 300


@given(
    st.sampled_from(EVENTS) | st.text(max_size=10),
    st.dictionaries(st.sampled_from(FIELDS), JSON | st.text(max_size=500)),
)
def test_any_line_reads_as_one_printable_line_and_can_be_reported(event, fields):
    line = {**fields, "event": event}
    words = notice_of(line)
    assert str(words).isprintable()
    assert len(str(words)) < 2000
    view = View()
    view.receive({"event": "begin", "sequence": ["x+", "x-"], "cameras": ["cam0", "cam1"]})
    view.receive(line)
    assert 0 <= view.kept <= view.wanted
    assert view.progress().isprintable()
