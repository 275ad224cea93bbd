"""The journal as a stream: whole lines only, each once, whatever is just being written."""

import json
import os

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lightstage.errors import FormatError
from lightstage.operator.journal_stream import JournalTail


def as_bytes(*lines):
    return b"".join(json.dumps(line).encode() + b"\n" for line in lines)


def test_a_line_is_given_only_when_it_ends(tmp_path):
    path = tmp_path / "journal.jsonl"
    first, second = as_bytes({"id": 1, "event": "begin"}), as_bytes({"id": 2, "event": "lit"})
    path.write_bytes(first + second[:-1])
    with JournalTail(path) as tail, path.open("ab") as file:
        assert [line["id"] for line in tail.read()] == [1]
        assert tail.read() == []
        file.write(b"\n")
        file.flush()
        assert [line["id"] for line in tail.read()] == [2]


def test_a_cut_line_is_passed_over_whether_it_is_removed_or_ended(tmp_path):
    whole, cut = as_bytes({"id": 1, "event": "begin"}), b'{"id": 2, "event": "fra'
    after = as_bytes({"id": 2, "event": "resume"})
    for mended in (whole + after, whole + cut + b"\n" + after):
        path = tmp_path / "journal.jsonl"
        path.write_bytes(whole + cut)
        with JournalTail(path) as tail:
            assert [line["event"] for line in tail.read()] == ["begin"]
            with path.open("r+b") as file:
                file.write(mended)
                file.truncate()
            assert [line["event"] for line in tail.read()] == ["resume"]


def test_lines_without_ids_get_their_place(tmp_path):
    path = tmp_path / "journal.jsonl"
    path.write_bytes(as_bytes({"event": "begin", "id": "P1-neutral"}, {"event": "end"}))
    with JournalTail(path) as tail:
        assert [line["id"] for line in tail.read()] == [1, 2]


def test_no_journal_is_reported(tmp_path):
    with pytest.raises(FormatError, match="no such file, expected the journal"):
        JournalTail(tmp_path / "journal.jsonl")


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(
    st.lists(st.binary(max_size=40) | st.just(as_bytes({"id": 1})[:-1]), max_size=20),
    st.lists(st.integers(1, 9), min_size=1, max_size=40),
)
def test_any_bytes_in_any_pieces_give_their_json_objects_once(tmp_path, texts, sizes):
    data = b"\n".join(texts)
    path = tmp_path / "journal.jsonl"
    path.write_bytes(b"")
    got, place, turn = [], 0, 0
    with JournalTail(path) as tail, path.open("ab") as file:
        while place < len(data):
            size = sizes[turn % len(sizes)]
            os.write(file.fileno(), data[place : place + size])
            place, turn = place + size, turn + 1
            got += tail.read()
    wanted = 0
    for raw in data.split(b"\n")[:-1]:
        try:
            wanted += isinstance(json.loads(raw), dict)
        except ValueError:
            continue
    assert len(got) == wanted
