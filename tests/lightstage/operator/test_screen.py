"""The picture: readable on small terminals, without colours, without Unicode, for many cameras."""

import io
import re
import time
from xml.etree import ElementTree

import pytest
from rich.console import Console

from lightstage.operator.command import drawn
from lightstage.operator.screen import Ask, Screen
from lightstage.operator.view import View
from lightstage.operator.words import Notice, notice_of

RUNNING = ("retake", "pause", "abort")


def shown(lines):
    view = View("sessions/P1")
    for line in lines:
        view.receive(line)
    return view


def picture(view, ask=None, columns=60, rows=24, encoding="utf-8", **more):
    file = io.TextIOWrapper(io.BytesIO(), encoding=encoding, errors="strict")
    console = Console(file=file, width=columns, height=rows, legacy_windows=False, **more)
    console.print(Screen(view, ask or Ask(keys=RUNNING)))
    file.seek(0)
    return file.read().rstrip("\n").split("\n")


@pytest.fixture
def busy(story):
    journal = story(9)
    journal.begin()
    for pattern in journal.patterns[:3]:
        journal.shoot(pattern)
    journal.light("y+")
    for camera in journal.cameras[:5]:
        journal.keep("y+", camera)
    journal.expose("y+", "cam5")
    why = "no answer within 30 s, " * 20
    journal.add("failed", pattern="y+", camera="cam8", take=1, said=why)
    return journal


@pytest.mark.parametrize("columns", [60, 80, 120, 200])
@pytest.mark.parametrize("rows", [24, 50])
def test_nine_cameras_their_states_and_the_keys_fit(busy, columns, rows):
    lines = picture(shown(busy.lines), None, columns, rows)
    assert len(lines) < rows
    assert max(map(len, lines)) <= columns
    text = "\n".join(lines)
    for camera in busy.cameras:
        assert len(re.findall(rf"^{camera} ", text, re.M)) == 1
    assert text.count("kept") >= 5
    for part in ("downloading", "triggering", "FAILED", "TAKING y+", "acknowledged"):
        assert part in text
    for part in ("32 of 63 photographs", "left", "no answer within 30 s", " q ", "dark at once"):
        assert part in text
    assert ("6012305" in text) == (columns >= 100)


@pytest.mark.parametrize("columns", [60, 100])
def test_a_question_states_what_was_found_what_to_do_and_which_keys(busy, columns):
    line = busy.not_taken("y+", "cam8", "no answer within 30 s")
    view = shown(busy.lines)
    text = " ".join(picture(view, Ask([notice_of(line)], ("retake", "abort")), columns))
    text = " ".join(text.split())
    for part in ("y+ by cam8: no answer within 30 s.", "Look at its cable and battery"):
        assert part in text
    assert "What now?" in text
    assert " r retake it q stop now, resume later" in text
    assert "accept" not in text


@pytest.mark.parametrize("columns", [40, 60, 61, 62, 72, 100])
@pytest.mark.parametrize("asked", [True, False])
def test_every_key_stands_with_its_words_on_one_line(busy, columns, asked):
    busy.add("asked", pattern="y+")
    question = [Notice("problem", "photograph 1 is blurred", "Do something.")] if asked else []
    keys = ("retake", "accept", "pause", "abort")
    lines = picture(shown(busy.lines), Ask(question, keys), columns, 24)
    assert len(lines) < 24
    assert max(map(len, lines)) <= columns
    retake = "retake it" if asked else "this pattern again"
    end = "stop now, resume later" if asked else "stop, dark at once"
    for part in (f" r  {retake}", " a  accept as it is", " p  pause", f" q  {end}"):
        assert sum(part in line for line in lines) == 1, (part, lines)


def test_very_many_findings_leave_room_for_cameras_and_keys(busy):
    findings = [Notice("problem", f"photograph {i} is blurred", "Do something.") for i in range(90)]
    lines = picture(shown(busy.lines), Ask(findings, RUNNING), 60, 24)
    text = "\n".join(lines)
    assert len(lines) < 24
    assert "photograph 0 is blurred" in text
    # Of 180 lines of findings ten are shown, and the others are counted.
    assert "photograph 4 is blurred" in text
    assert "  170 more lines below: arrow keys" in lines
    assert re.search(r"^cam8 +FAILED", text, re.M)
    assert lines[-1].rstrip() == " r  retake it   p  pause   q  stop now, resume later"


@pytest.mark.parametrize(("columns", "rows"), [(60, 15), (80, 24), (120, 40)])
def test_the_failing_camera_the_question_and_its_keys_are_always_in_view(busy, columns, rows):
    long = "another program has the camera, and says so at great length, " * 12
    lines = [busy.not_taken("y+", "cam8", long), busy.not_taken("y+", "cam3", "no answer")]
    busy.add("asked", pattern="y+")
    ask = Ask([notice_of(line) for line in lines], ("retake", "abort"))
    shown_lines = picture(shown(busy.lines), ask, columns, rows)
    text = "\n".join(shown_lines)
    assert len(shown_lines) < rows
    for part in (r"^cam8 +FAILED", r"^cam3 +", "DARK, waiting for you", "What now?"):
        assert re.search(part, text, re.M), text
    assert " r  retake it   q  stop now, resume later" in text


def test_findings_that_do_not_fit_are_scrolled_by_keys_to_their_end(busy):
    findings = [Notice("problem", f"photograph {i} is blurred", "Do it.") for i in range(9)]
    view, ask = shown(busy.lines), Ask(findings, RUNNING)
    assert "more lines below: arrow keys" in "\n".join(picture(view, ask, 60, 15))
    seen = set()
    for _ in range(40):
        seen.update(re.findall(r"photograph \d", "\n".join(picture(view, ask, 60, 15))))
        ask.scroll.at += 1
    assert len(seen) == 9
    end = "\n".join(picture(view, ask, 60, 15))
    assert "below" not in end
    ask.scroll.at -= 1  # what was pressed beyond the end does not count
    assert "below" in "\n".join(picture(view, ask, 60, 15))


def test_the_seconds_until_the_lights_go_dark_are_counted_down(busy, monkeypatch):
    values = {"pattern": "y+", "cameras": ["cam7"], "ended_in_s": 28.0}
    busy.add("waiting", **values, lit=True, dark_in_s=3.0)
    view = shown(busy.lines)
    assert "TAKING y+, cam7 late: dark in 3 s" in "\n".join(picture(view, None, 80))
    now_s = time.monotonic()
    monkeypatch.setattr(time, "monotonic", lambda: now_s + 2.0)
    assert "dark in 1 s" in "\n".join(picture(view, None, 80))
    assert re.search(r"^cam7 +LATE", "\n".join(picture(view, None, 80)), re.M)
    view.receive(busy.add("waiting", **values, lit=False))
    assert "DARK, waiting for cam7: started again in 28 s" in "\n".join(picture(view, None, 80))
    busy.expose("y+", "cam7")
    view.receive(busy.lines[-1])
    assert "late" not in "\n".join(picture(view, None, 80))


def test_more_cameras_than_rows_show_those_that_need_somebody(story):
    journal = story(60)
    journal.begin()
    journal.light("full")
    for camera in journal.cameras[:50]:
        journal.keep("full", camera)
    journal.add("failed", pattern="full", camera="cam57", take=1, said="gone")
    lines = picture(shown(journal.lines), rows=24)
    text = "\n".join(lines)
    assert len(lines) < 24
    assert re.search(r"cam57 +FAILED", text)
    assert re.search(r"\+\d+ +more cameras", text)


def test_cameras_that_failed_and_do_not_fit_are_counted(story):
    journal = story(9)
    journal.begin()
    journal.light("full")
    lines = [journal.not_taken("full", camera, "it is gone") for camera in journal.cameras]
    journal.add("asked", pattern="full")
    rows = picture(
        shown(journal.lines), Ask([notice_of(line) for line in lines], ("retake", "abort")), 60, 15
    )
    assert len(rows) < 15
    in_view = sum("FAILED" in row and row.startswith("cam") for row in rows)
    assert in_view >= 2
    assert f"+{9 - in_view} more cameras, {9 - in_view} FAILED" in rows


def test_of_a_camera_that_failed_what_looked_well_before_is_not_shown(story):
    journal = story(9)
    journal.begin()
    journal.light("full")
    for camera in ("cam0", "cam8"):
        journal.not_taken("full", camera, "it is gone")
    lines = picture(shown(journal.lines), None, 80, 40)
    cells = {line.split()[0]: line.split()[2:4] for line in lines if line.startswith("cam")}
    assert cells["cam0"] == ["-", "-"]
    assert cells["cam8"] == ["18%!", "-"]  # a low battery may be why
    assert cells["cam1"] == ["81%", "54"]


def test_what_was_accepted_has_a_sign_of_its_own_and_rare_signs_are_explained_where_they_are(story):
    journal = story(9)
    journal.begin()
    journal.shoot("full")
    journal.light("x+")
    journal.keep("x+", "cam1", 4)
    before = "\n".join(picture(shown(journal.lines), None, 80, 40))
    assert "accepted" not in before
    assert "2..9 which take" in before
    journal.keep("x+", "cam0")
    journal.add("finding", severity="retake", code="bright", pattern="x+", camera="cam0", found="x")
    journal.add("accepted", pattern="x+", findings=[{}])
    lines = picture(shown(journal.lines), None, 80, 40)
    rows = {line.split()[0]: line for line in lines if line.startswith("cam")}
    assert re.search(r"✓ +a +·", rows["cam0"])
    assert re.search(r"✓ +4 +·", rows["cam1"])
    assert sum("a accepted" in line for line in lines) == 1


@pytest.mark.parametrize(("columns", "message"), [(60, "7 patterns, 1 done"), (56, "1 of 7 done")])
def test_the_count_above_the_signs_states_of_what(story, columns, message):
    journal = story(9)
    journal.begin()
    journal.shoot("full")
    lines = picture(shown(journal.lines), None, columns, 24)
    assert max(map(len, lines)) <= columns
    (head,) = (line for line in lines if line.startswith("Camera"))
    assert head.endswith(message)


def test_a_long_sequence_is_shown_around_the_present_pattern(story):
    journal = story(9, [f"olat-{i:03}" for i in range(168)])
    journal.begin()
    for pattern in journal.patterns[:100]:
        journal.shoot(pattern)
    journal.light("olat-100")
    lines = picture(shown(journal.lines), None, 80)
    row = next(line for line in lines if line.startswith("cam3"))
    assert max(map(len, lines)) <= 80
    # Of the 41 signs that fit, the twenty before the present pattern's are of what is kept.
    assert re.fullmatch(r"cam3 +triggering +\d+% +\d+ GB  ✓{20}▶·{20}", row)
    (head,) = (line for line in lines if line.startswith("Camera"))
    assert head.rstrip().endswith("  patterns 81-121 of 168")


@pytest.mark.parametrize("encoding", ["ascii", "latin-1"])
def test_a_terminal_without_unicode_gets_plain_signs(busy, encoding):
    text = "\n".join(picture(shown(busy.lines), None, 100, 40, encoding))
    row = next(line for line in text.split("\n") if line.startswith("cam0"))
    assert text.isascii()
    assert re.search(r"\+ +\+ +\+ +\+ +\. +\. +\.", row)


def test_no_colour_carries_a_meaning_alone(busy):
    """The same text, without any control code, on a terminal without colour."""
    view = shown(busy.lines)
    plain = picture(view, None, 100, 40)
    colours = picture(view, None, 100, 40, force_terminal=True, color_system="truecolor")
    bare = [re.sub(r"\x1b\[[0-9;]*m", "", line) for line in colours]
    assert any("\x1b[" in line for line in colours)
    assert bare == plain
    row = next(line for line in plain if line.startswith("cam8"))
    assert re.match(r"cam8 +FAILED +18%! .* ✓ +✓ +✓ +✗ +· +· +·", row)


def test_no_color_is_respected(busy, monkeypatch):
    monkeypatch.setenv("NO_COLOR", "1")
    lines = picture(shown(busy.lines), force_terminal=True, color_system="truecolor")
    codes = set(re.findall(r"\x1b\[([0-9;]*)m", "\n".join(lines)))
    assert all(int(part or 0) < 10 for code in codes for part in code.split(";"))


def test_lights_that_do_not_acknowledge_are_reported(story):
    journal = story(2)
    journal.begin()
    journal.add("lit", pattern="full", acknowledged=False)
    assert "! NOT acknowledged" in "\n".join(picture(shown(journal.lines)))


def test_what_devices_say_is_no_markup_and_no_control_code(story):
    journal = story(2)
    journal.cameras = ["[bold]x[/bold]", "\x1b[31mred"]
    journal.begin()
    journal.add("failed", pattern="[link=http://x]", camera="\x1b[31mred", said="[/] \x1b[2J \x07")
    lines = picture(shown(journal.lines), None, 120, 40)
    text = "\n".join(lines)
    assert "\x1b" not in text
    assert "\x07" not in text
    assert "[bold]x[/bold]" in text


def test_each_end_is_reported(story, replay):
    journal = story(2)
    assert "being checked" in "\n".join(picture(View("S"), Ask()))
    journal.begin()
    journal.shoot("full")
    journal.add("note", said="paused, the lights are dark")
    assert "DARK (paused)" in "\n".join(picture(shown(journal.lines)))
    journal.add("aborted", said="capture: found the operator's wish to end it")
    text = " ".join(" ".join(picture(shown(journal.lines), Ask())).split())
    assert "STOPPED" in text
    assert "DARK (stopped)" in text
    assert "lightstage capture --resume --out sessions/P1" in text
    assert "COMPLETE" in "\n".join(picture(shown(replay), Ask()))


@pytest.mark.parametrize("columns", [40, 100])
def test_a_picture_is_a_whole_svg(busy, columns):
    svg = drawn(Screen(shown(busy.lines)), columns)
    assert ElementTree.fromstring(svg).tag.endswith("svg")
    assert "cam8" in svg
