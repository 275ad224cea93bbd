"""This computer's clock beside the journals that lie beside the session."""

import dataclasses
import datetime
import json
import os

import pytest

from lightstage.preflight.clock import computer_clock_findings, newest_journal
from lightstage.preflight.config import PreflightConfig

CONFIG = PreflightConfig()
NOW = datetime.datetime(2026, 5, 1, 12, tzinfo=datetime.UTC)


def journal(folder, *times, tail=b""):
    folder.mkdir()
    lines = [json.dumps({"id": i, "time_utc": t}) + "\n" for i, t in enumerate(times)]
    (folder / "journal.jsonl").write_bytes("".join(lines).encode() + tail)


def test_the_newest_line_of_all_journals_is_found_past_half_a_line(tmp_path):
    journal(tmp_path / "a", "2026-04-01T00:00:00.000+00:00", "2026-04-02T00:00:00.000+00:00")
    journal(tmp_path / "b", "2026-04-03T00:00:00.000+00:00", tail=b'{"id": 2, "time_ut')
    journal(tmp_path / "c")
    (tmp_path / "d").mkdir()
    found = newest_journal(tmp_path / "new")
    assert found.path == tmp_path / "b" / "journal.jsonl"
    assert found.time == datetime.datetime(2026, 4, 3, tzinfo=datetime.UTC)


@pytest.mark.parametrize("tail", [b"\xff\xfe\n", b"[]\n", b'{"time_utc": 7}\n', b"null\n"])
def test_damaged_lines_are_passed_over(tmp_path, tail):
    journal(tmp_path / "a", "2026-04-01T00:00:00+00:00", tail=tail)
    assert newest_journal(tmp_path / "new").time.day == 1


def test_a_clock_behind_a_journal_or_in_the_past_is_refused(tmp_path):
    journal(tmp_path / "a", "2026-05-01T11:59:59+00:00")
    assert computer_clock_findings(tmp_path / "new", CONFIG, NOW) == []
    hour = datetime.timedelta(hours=1)
    (finding,) = computer_clock_findings(tmp_path / "new", CONFIG, NOW - hour)
    assert "/a/journal.jsonl" in finding.expected
    (finding,) = computer_clock_findings(
        tmp_path / "new", CONFIG, datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC)
    )
    assert finding.severity == "refuse"
    assert finding.expected == "2025 or later"
    assert finding.found == "1970-01-01T00:00:00+00:00"


def test_the_sessions_own_journal_counts_when_it_is_resumed(tmp_path):
    journal(tmp_path / "own", "2026-05-01T12:00:30+00:00")
    assert [f.code for f in computer_clock_findings(tmp_path / "own", CONFIG, NOW)] == [
        "computer-clock"
    ]


def test_no_journal_is_no_fault(tmp_path):
    assert computer_clock_findings(tmp_path / "none" / "new", CONFIG, NOW) == []
    assert computer_clock_findings(tmp_path / "new", CONFIG) == []


FUTURE = "2027-01-01T00:00:00+00:00"


def test_a_journal_of_the_future_is_named_and_ignored_where_that_is_asked_for(tmp_path):
    journal(tmp_path / "a", FUTURE)
    (finding,) = computer_clock_findings(tmp_path / "new", CONFIG, NOW)
    assert finding.severity == "refuse"
    assert str(tmp_path / "a" / "journal.jsonl") in finding.expected
    assert "--ignore-clock" in finding.hint
    asked = dataclasses.replace(CONFIG, ignore_clock=True)
    (finding,) = computer_clock_findings(tmp_path / "new", asked, NOW)
    assert finding.severity == "warn"


def test_a_clock_in_the_past_is_refused_whatever_is_ignored(tmp_path):
    asked = dataclasses.replace(CONFIG, ignore_clock=True)
    past = datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC)
    (finding,) = computer_clock_findings(tmp_path / "new", asked, past)
    assert finding.severity == "refuse"


@pytest.mark.parametrize(
    "damage",
    [
        lambda path: path.write_bytes(b"[" * 200_000),
        lambda path: path.write_bytes(b'{"time_utc": ' + b"9" * 9000 + b"}"),
        lambda path: path.write_bytes(b"\0" * 5000),
        lambda path: path.write_bytes(b'{"time_utc": "2026-04-01T00:00:00"}'),
        lambda path: os.mkfifo(path),
        lambda path: path.mkdir(),
        lambda path: path.symlink_to("/dev/zero"),
    ],
)
def test_a_damaged_neighbour_is_passed_over_with_a_warning_that_names_it(tmp_path, damage):
    (tmp_path / "a").mkdir()
    damage(tmp_path / "a" / "journal.jsonl")
    journal(tmp_path / "b", "2026-04-03T00:00:00.000+00:00")
    (finding,) = computer_clock_findings(tmp_path / "new", CONFIG, NOW)
    assert (finding.severity, finding.code) == ("warn", "journal-unread")
    assert finding.where == str(tmp_path / "a" / "journal.jsonl")
    assert newest_journal(tmp_path / "new").path == tmp_path / "b" / "journal.jsonl"
