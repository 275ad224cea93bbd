"""Photographs of the sessions beside one, found by their bytes."""

import json
import os

from lightstage.session.neighbours import Neighbours

OWN, THEIRS, LATER = "a" * 64, "b" * 64, "c" * 64


def journal(folder, session, *lines):
    folder.mkdir()
    begin = {"event": "begin", "session": session}
    text = "".join(json.dumps(line) + "\n" for line in (begin, *lines))
    (folder / "journal.jsonl").write_text(text)


def frame(sha256):
    return {"event": "frame", "pattern": "full", "camera": "cam0", "sha256": sha256}


def test_a_photograph_of_a_session_beside_is_reported_and_an_own_one_is_not(tmp_path):
    journal(tmp_path / "A", "a", frame(OWN))
    journal(tmp_path / "B", "b", frame(THEIRS), {"event": "recovered", "sha256": LATER})
    beside = Neighbours(tmp_path / "A")
    assert len(beside) == 2
    assert beside.whose(OWN) is None
    assert beside.whose(THEIRS) == "full by cam0 in the session B"
    assert beside.whose(LATER) == "a photograph in the session B"


def test_a_copy_of_a_session_is_no_neighbour_of_it(tmp_path):
    journal(tmp_path / "A", "a", frame(OWN))
    journal(tmp_path / "copy of A", "a", frame(OWN))
    assert Neighbours(tmp_path / "A").whose(OWN) is None


def test_damaged_journals_and_what_is_none_hold_nothing_up(tmp_path):
    journal(tmp_path / "B", "b", frame(THEIRS))
    path = tmp_path / "B" / "journal.jsonl"
    path.write_bytes(b"\xff\0{half\n" + path.read_bytes() + b'{"event": "frame", "sha')
    (tmp_path / "pipe").mkdir()
    os.mkfifo(tmp_path / "pipe" / "journal.jsonl")
    (tmp_path / "folder" / "journal.jsonl").mkdir(parents=True)
    (tmp_path / "gone").symlink_to(tmp_path / "nowhere")
    (tmp_path / "file").write_text("x")
    assert Neighbours(tmp_path / "new").whose(THEIRS) == "full by cam0 in the session B"


def test_no_folder_has_no_neighbours(tmp_path):
    assert len(Neighbours(tmp_path / "nowhere" / "new")) == 0
