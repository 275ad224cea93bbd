"""What a folder of sessions holds, told from the files alone; what a plan still wants."""

from __future__ import annotations

import json
import socket
from pathlib import Path

import pytest

from lightstage.day import DayPlan, PlannedSubject, next_open, planned, sessions_of, write_plan
from lightstage.day.sessions import seen_session
from lightstage.errors import CaptureError, FormatError
from lightstage.formats.files import sha256_file, write_json
from lightstage.formats.session import Frame, SessionFile, save_session
from lightstage.rig import Rig, save_rig


def write_journal(
    root: Path, *events: dict, subject: str = "P1", began: str = "2031-05-06"
) -> Path:
    begin = {
        "event": "begin", "schema": "lightstage.journal/2", "session": f"id-{root.name}",
        "created_utc": f"{began}T10:00:00+00:00", "subject": "P1", "expression": "smile",
        "sequence": ["full", "x+"], "cameras": ["cam0", "cam1"], "led_device": {}, "consent": "C-1",
    }  # fmt: skip
    lines = [{"id": n, **line} for n, line in enumerate([begin, *events], 1)]
    root.mkdir(parents=True)
    (root / "journal.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    return root


END = {"event": "end", "frames": 4, "capture": {"accepted": 1}}
FRAME = {"event": "frame", "pattern": "full", "camera": "cam0", "take": 1, "path": "frames/a"}


def write_photographs(root: Path, *paths: str) -> None:
    (root / "frames").mkdir()
    for path in paths:
        (root / path).write_bytes(b"light")


def test_each_state_follows_from_the_journal_alone(tmp_path: Path) -> None:
    write_journal(tmp_path / "whole", FRAME, END)
    write_photographs(tmp_path / "whole", FRAME["path"])
    write_journal(
        tmp_path / "stopped", FRAME, {"event": "aborted", "said": "x"}, began="2031-05-07"
    )
    write_journal(tmp_path / "killed", FRAME, began="2031-05-05")
    (tmp_path / "damaged").mkdir()
    (tmp_path / "damaged" / "journal.jsonl").write_text("{")
    (tmp_path / "other").mkdir()
    (tmp_path / ".hidden").mkdir()
    seen = {each.root.name: each for each in sessions_of(tmp_path)}
    assert list(seen) == ["damaged", "killed", "whole", "stopped"]
    assert {name: each.state for name, each in seen.items()} == {
        "damaged": "damaged", "killed": "unfinished", "whole": "whole", "stopped": "unfinished",
    }  # fmt: skip
    assert (seen["whole"].kept, seen["whole"].wanted, seen["whole"].accepted) == (4, 4, 1)
    assert (seen["stopped"].kept, seen["stopped"].wanted) == (1, 4)
    assert seen["whole"].date == "2031-05-06 10:00"
    assert seen["damaged"].said


def test_a_session_of_very_many_levels_is_whole(tmp_path: Path) -> None:
    root = write_journal(tmp_path / "S", FRAME, END)
    write_photographs(root, FRAME["path"])
    begin, rest = (root / "journal.jsonl").read_text().split("\n", 1)
    many = json.dumps(json.loads(begin) | {"levels": {"olat-000": [0.0] * (1 << 20)}})
    (root / "journal.jsonl").write_text(f"{many}\n{rest}")
    assert seen_session(root).state == "whole"


@pytest.mark.parametrize("imported", [False, True])
def test_a_session_that_ended_is_damaged_where_a_photograph_went_or_was_cut_since(
    tmp_path: Path, run_command, imported: bool
) -> None:
    taken = [
        {**FRAME, "take": take, "path": f"frames/{take}", "size": 5, "camera": camera}
        for camera, take in (("cam0", 1), ("cam0", 2), ("cam0", 3), ("cam1", 4))
    ]
    rejected = {**FRAME, "event": "rejected", "take": 3}
    root = write_journal(tmp_path / "S", *taken, rejected, *([] if imported else [END]))
    if imported:
        text = (root / "journal.jsonl").read_text()
        (root / "journal.jsonl").write_text(text.replace('"led_device"', '"imported"'))
        (root / "session.json").write_text("{}")
    write_photographs(root, "frames/2", "frames/4")  # 1 and 3 do not count
    assert seen_session(root).state == "whole"
    (root / "frames" / "2").write_bytes(b"lig")
    seen = seen_session(root)
    assert (seen.state, seen.kept, seen.wanted, seen.subject) == ("damaged", 3, 4, "P1")
    (root / "frames" / "4").unlink()
    seen = seen_session(root)
    assert (seen.state, seen.kept) == ("damaged", 2)
    assert "found frames/2 and 1 other missing or of another size" in seen.said
    assert "X damaged, 2 of 4" in run_command("lightstage", "sessions", str(root)).out
    for name in ("2", "4"):
        (root / "frames" / name).write_bytes(b"light")
    assert seen_session(root).state == "whole"


def test_a_session_without_a_journal_is_whole_while_its_photographs_are_there(
    tmp_path: Path, small_rig: Rig
) -> None:
    root = tmp_path / "S"
    save_rig(small_rig, root / "rig.json")
    frames = []
    for camera in small_rig.cameras:
        (root / f"{camera.id}.dng").write_bytes(b"")
        frames.append(
            Frame(pattern="full", camera=camera.id, path=f"{camera.id}.dng", sha256="0" * 64,
                  encoding="raw")
        )  # fmt: skip
    about = {"id": "S", "created_utc": "2031", "subject": "P1", "expression": "smile"}
    save_session(root, SessionFile(**about, consent="C-1", sequence=["full"], frames=frames))

    def seen() -> tuple[str, int, int, str | None]:
        each = seen_session(root)
        return each.state, each.kept, each.wanted, each.consent

    assert seen() == ("whole", 3, 3, "C-1")
    (root / "cam1.dng").unlink()
    assert seen() == ("unfinished", 2, 3, "C-1")
    save_session(root, SessionFile(**about, consent="C-1", sequence=["full"], frames=frames[2:]))
    assert seen() == ("unfinished", 1, 3, "C-1")


def test_a_session_whose_capture_answers_runs(tmp_path: Path) -> None:
    path = tmp_path / "run.sock"
    root = write_journal(tmp_path / "S", {"event": "note", "said": "x", "socket": str(path)})
    assert seen_session(root).state == "unfinished"
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as listener:
        listener.bind(str(path))
        listener.listen()
        assert seen_session(root).state == "running"
    assert seen_session(root).state == "unfinished"


def test_a_check_counts_for_the_session_json_that_it_was_made_of(tmp_path: Path) -> None:
    root = write_journal(tmp_path / "S", END)
    write_json(root / "session.json", {"schema": "lightstage.session/1"})
    assert seen_session(root).checked == "not checked"
    note = {"schema": "lightstage.checked/1", "passed": True}
    note["session_sha256"] = sha256_file(root / "session.json")
    write_json(root / "checked.json", note)
    assert seen_session(root).checked == "passed"
    write_json(root / "checked.json", {**note, "passed": False})
    assert seen_session(root).checked == "failed"
    write_json(root / "session.json", {"schema": "lightstage.session/1", "more": 1})
    assert seen_session(root).checked == "changed since"
    (root / "checked.json").write_text("garbage")
    assert seen_session(root).checked == "not checked"


def test_a_processed_folder_is_found_by_its_sessions_id(tmp_path: Path) -> None:
    write_journal(tmp_path / "sessions" / "S", END)
    for name, session in (("A", "id-S"), ("B", "id-other"), ("C", "id-S")):
        (tmp_path / "out" / name).mkdir(parents=True)
        write_json(tmp_path / "out" / name / "report.json", {"session": session})
    (tmp_path / "out" / "D").mkdir()
    (tmp_path / "out" / "D" / "report.json").write_text("[")
    (seen,) = sessions_of(tmp_path / "sessions", tmp_path / "out")
    assert [path.name for path in seen.processed] == ["A", "C"]


def test_a_folder_that_is_not_there_is_reported(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="no such folder"):
        sessions_of(tmp_path / "none")


def test_the_command_lists_them(tmp_path: Path, run_command) -> None:
    write_journal(tmp_path / "S" / "a", END)
    write_journal(tmp_path / "S" / "b", FRAME)
    ended = run_command("lightstage", "sessions", str(tmp_path / "S"))
    assert ended.code == 0, ended.err
    assert "+ whole" in ended.out
    assert "- unfinished, 1 of 4" in ended.out
    assert "2 sessions, 1 whole, 0 checked, 0 processed" in ended.out
    message = json.loads(run_command("lightstage", "sessions", str(tmp_path / "S"), "--json").out)
    assert [each["state"] for each in message["sessions"]] == ["whole", "unfinished"]
    empty = tmp_path / "empty"
    empty.mkdir()
    ended = run_command("lightstage", "sessions", str(empty))
    assert ended.code == 2
    assert "no session in it" in ended.err


def test_a_plan_is_done_take_by_take(tmp_path: Path) -> None:
    people = (PlannedSubject("P1", "C-1"), PlannedSubject("P2", "C-2"))
    day = DayPlan(people, ("neutral", "smile"))
    path = write_plan(tmp_path / "plan.toml", day)
    folder = tmp_path / "sessions"

    def stands() -> list[str]:
        return [each.stand for each in planned(day, path)]

    assert stands() == ["to come"] * 4
    assert next_open(day, path).folder == folder / "P1+neutral"
    write_journal(folder / "P1+neutral", END)
    write_journal(folder / "P1+smile", FRAME)
    assert stands() == ["done", "begun", "to come", "to come"]
    assert next_open(day, path).folder == folder / "P1+smile"
    assert next_open(day, path, "P2/smile").folder == folder / "P2+smile"
    with pytest.raises(CaptureError, match=r"which is done.*takes.*= 2"):
        next_open(day, path, "P1/neutral")
    day = day.wanting("P1/neutral", 2)
    assert stands()[0] == "again"
    assert next_open(day, path).folder == folder / "P1+neutral+2"
    write_journal(folder / "P1+neutral+2", END)
    assert stands()[0] == "done"
    for name in ("P2+neutral", "P2+smile"):
        write_journal(folder / name, END)
    (folder / "P1+smile" / "journal.jsonl").write_text("{")
    with pytest.raises(CaptureError, match=r"4 done|3 done, 1 damaged"):
        next_open(day, path)
    with pytest.raises(CaptureError, match="no subject"):
        next_open(DayPlan(), path)
