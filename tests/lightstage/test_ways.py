"""How a message's reader resumes, follows and retakes: in a terminal, and on the console's page."""

from __future__ import annotations

import pytest

from lightstage.operator.words import notice_of
from lightstage.ways import CONSOLE, PRESSED, READER, TYPED, readers_ways

OPTIONS = ["--leds", "pty:///dev/pts/1?timeout_s=3&attempts=5"]


def test_a_terminals_user_gets_commands_to_paste() -> None:
    folder = "a folder/P1"
    assert TYPED.resume(folder, OPTIONS) == (
        "To resume: lightstage capture --resume --out 'a folder/P1' --leds "
        "'pty:///dev/pts/1?timeout_s=3&attempts=5'"
    )
    assert TYPED.follow(folder) == "Anyone here can follow with: lightstage watch 'a folder/P1'"
    assert TYPED.retake(folder, ["x+", "y-"], ["cam0"], OPTIONS).startswith(
        "To retake: lightstage retake 'a folder/P1' x+,y- cam0 --leds "
    )


def test_a_pages_user_gets_keys_and_clicks_and_no_command() -> None:
    assert PRESSED.resume("P1", OPTIONS) == "Press g on the session's page to resume it."
    assert PRESSED.follow("P1") == ""
    whose = {"cam0, cam2": ["cam0", "cam2"], "all cameras": []}
    for words, cameras in whose.items():
        assert PRESSED.retake("P1", ["x+", "y-"], cameras, OPTIONS) == (
            f"To retake x+, y- by {words}: on the session's page click each one, then its button."
        )


@pytest.mark.parametrize(("value", "ways"), [(CONSOLE, PRESSED), ("", TYPED), ("other", TYPED)])
def test_the_environment_names_the_reader(value, ways, monkeypatch) -> None:
    monkeypatch.setenv(READER, value)
    assert readers_ways() is ways
    monkeypatch.delenv(READER)
    assert readers_ways() is TYPED


def test_a_line_of_the_journal_is_worded_for_its_reader() -> None:
    stopped = {"event": "aborted", "why": "the disk is full", "resume_with": OPTIONS}
    assert notice_of(stopped, "P1", PRESSED).todo == (
        "Nothing that was kept is lost. Press g on the session's page to resume it."
    )
    assert "To resume: lightstage capture --resume --out P1" in notice_of(stopped, "P1").todo
    socket = {"event": "note", "socket": "/run/1"}
    assert notice_of(socket, "P1").text == "Anyone here can follow with: lightstage watch P1"
    assert (notice_of(socket, "P1", PRESSED).text, notice_of(socket, "P1", PRESSED).tone) == (
        "",
        "quiet",
    )
