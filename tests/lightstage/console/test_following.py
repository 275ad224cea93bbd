"""A session as the page sees it: a capture that has just begun, one that was killed, its limits."""

from __future__ import annotations

import datetime
import json
import os
import time
from pathlib import Path

import pytest

from lightstage.checks.config import ChecksConfig
from lightstage.checks.sums import Sum
from lightstage.console.following import GRACE_S, Following
from lightstage.console.showing import desk_values, sum_words
from lightstage.console.sums import SumFacts


class Journal:
    """A journal that is being written."""

    def __init__(self, root: Path) -> None:
        self.root = root
        root.mkdir()
        self._path = root / "journal.jsonl"
        self._number = 0

    def add(self, event: str, **fields: object) -> None:
        self._number += 1
        now = datetime.datetime.now(datetime.UTC).isoformat()
        with self._path.open("a") as file:
            line = {"id": self._number, "event": event, "time_utc": now, **fields}
            file.write(json.dumps(line) + "\n")

    def begin(self, **fields: object) -> None:
        self.add("begin", subject="P1", sequence=["full", "x+"], cameras=["cam0"], **fields)

    def was_written(self, seconds_ago: float) -> None:
        then = self._path.stat().st_mtime - seconds_ago
        os.utime(self._path, (then, then))


@pytest.fixture
def journal(tmp_path: Path) -> Journal:
    return Journal(tmp_path / "P1+neutral")


def test_a_capture_that_has_not_named_its_socket_yet_is_not_taken_for_a_killed_one(
    journal: Journal,
) -> None:
    journal.begin()
    following = Following(10)
    assert following.of(journal.root).view.phase == "running"
    journal.add("finding", severity="warn", code="x", where="a", found="b", expected="c", hint="")
    assert following.of(journal.root).view.phase == "running"


def test_a_capture_that_was_killed_is_seen_at_once_where_its_socket_does_not_answer(
    journal: Journal, tmp_path: Path
) -> None:
    journal.begin()
    journal.add("note", said="others can follow", socket=str(tmp_path / "none.sock"))
    assert Following(10).of(journal.root).view.phase == "gone"


def test_a_capture_that_was_killed_before_it_named_a_socket_is_seen_as_such(
    journal: Journal,
) -> None:
    journal.begin()
    journal.was_written(2 * GRACE_S)
    assert Following(10).of(journal.root).view.phase == "gone"


def test_an_older_take_that_comes_home_late_is_not_shown_in_place_of_the_one_that_counts(
    journal: Journal,
) -> None:
    journal.begin()
    for take in (2, 1):
        path = "frames/x+/cam0.dng" if take == 1 else "frames/x+/cam0.take2.dng"
        journal.add("frame", pattern="x+", camera="cam0", take=take, path=path, sha256=str(take))
    followed = Following(10).of(journal.root)
    shown = followed.photograph("x+", "cam0")
    assert shown is not None
    assert shown.take == 2
    assert followed.view.takes == {("x+", "cam0"): 2}


def test_the_page_and_the_heat_know_that_the_light_is_out_while_a_camera_is_late(
    journal: Journal,
) -> None:
    journal.begin()
    journal.add("lit", pattern="x+", levels=[1.0, 1.0], acknowledged=True)
    followed = Following(10).of(journal.root)
    assert desk_values(followed, None, 9)["words"] == "LIT: x+"
    journal.add("waiting", pattern="x+", cameras=["cam0"], lit=True, dark_in_s=5.0)
    followed.update()
    assert desk_values(followed, None, 9)["words"] == "LIT: x+"
    journal.add("waiting", pattern="x+", cameras=["cam0"], lit=False, ended_in_s=25.0)
    followed.update()
    assert desk_values(followed, None, 9)["words"] == "DARK, at work"
    first = followed.budget()
    time.sleep(0.3)
    second = followed.budget()
    assert first is not None
    assert second is not None
    assert second.on_s == first.on_s
    assert second.heat < first.heat
    journal.add("exposed", pattern="x+", camera="cam0", take=1)
    journal.add("lit", pattern="x+", levels=[1.0, 1.0], acknowledged=True)
    journal.add("exposed", pattern="x+", camera="cam0", take=2)
    followed.update()
    # The only camera has exposed: the light may go out while it is read.
    assert desk_values(followed, None, 9)["words"] == "TAKING: x+"


def test_the_page_states_the_limit_of_sums_that_the_capture_itself_keeps(journal: Journal) -> None:
    which = Sum("x+", "x-", "full")
    facts = SumFacts(off=0.05, misfit=0.05, moved_px=None, error_px=0.0)

    def words() -> str:
        followed = Following(10).of(journal.root)
        return " ".join(sum_words(facts, which, followed.max_misfit))

    journal.begin()
    default = ChecksConfig().max_misfit_share
    assert default < 0.05
    assert words().startswith("! ")
    journal.add("resume", config={"checks": {"max_misfit_share": 0.08}})
    assert "the checks allow 8 % of that" in words()
    assert not words().startswith("! ")
    journal.add("resume", config={"checks": "none"})
    assert words().startswith("! ")
