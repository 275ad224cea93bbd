"""The language of faults: names, fields, seeds, and what is told afterwards."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from lightstage.errors import ConfigError, FormatError
from sim.devices.fault_names import LEDS, NAMES
from sim.devices.faults import Fault, FaultLog, Story, read_fault_log
from sim.errors import SimError


def happening(story, device, counted, counts=range(1, 11)):
    return [[due.name for due in story.due(device, counted, count)] for count in counts]


def test_a_fault_happens_once_where_it_is_put_and_one_that_lasts_from_there_on():
    story = Story([Fault("drop", at=3), Fault("stuck-on", at=4)])
    found = happening(story, LEDS, "packet", range(1, 7))
    assert found == [[], [], ["drop"], ["stuck-on"], ["stuck-on"], ["stuck-on"]]


def test_until_ends_what_lasts_and_repeats_what_does_not():
    story = Story([Fault("stuck-on", at=2, until=3), Fault("fail", until=2)])
    assert happening(story, LEDS, "packet", range(1, 5)) == [[], ["stuck-on"], ["stuck-on"], []]
    assert happening(story, "cam4", "shot", range(1, 5)) == [["fail"], ["fail"], [], []]


def test_a_fault_concerns_its_own_camera_and_its_own_counting():
    story = Story([Fault("fail", camera="cam1"), Fault("reset-on-open"), Fault("die")])
    assert happening(story, "cam0", "shot", [1]) == [[]]
    assert happening(story, "cam1", "shot", [1]) == [["fail"]]
    assert happening(story, LEDS, "open", [1]) == [["reset-on-open"]]
    assert happening(story, LEDS, "packet", [1]) == [["die"]]


def test_what_is_drawn_follows_the_seed_and_nothing_else():
    def drawn(seed, probability=0.3):
        story = Story([Fault("drop", probability=probability)], seed)
        return [bool(found) for found in happening(story, LEDS, "packet", range(1, 2001))]

    assert drawn(1) == drawn(1)
    assert drawn(1) != drawn(2)
    assert sum(drawn(1)) == pytest.approx(600, abs=4 * (2000 * 0.3 * 0.7) ** 0.5)
    # Asked in another order, by another process: the same.
    story = Story([Fault("drop", probability=0.3)], 1)
    backwards = [bool(found) for found in happening(story, LEDS, "packet", range(2000, 0, -1))]
    assert backwards[::-1] == drawn(1)


def test_cameras_draw_each_for_itself():
    story = Story([Fault("fail", probability=0.5)], 3)
    assert happening(story, "cam0", "shot", range(1, 40)) != happening(
        story, "cam1", "shot", range(1, 40)
    )


@pytest.mark.parametrize(
    ("name", "fields", "message"),
    [
        ("dorp", {}, r"found 'dorp', expected one of battery-empty, busy, claimed, corrupt"),
        ("drop", {"when": 3}, r"drop, when: found an unknown field, expected one of at, until"),
        ("drop", {"camera": "cam1"}, r"camera: found an unknown field"),
        ("fail", {"way": "request"}, r"way: found an unknown field, expected one of at, until, "),
        ("drop", {"at": 0}, r"at: found 0, expected a whole number from 1"),
        ("drop", {"at": True}, r"at: found True"),
        ("drop", {"at": 2.5}, r"at: found 2.5"),
        ("drop", {"at": 5, "until": 4}, r"until: found 4, expected 5 or more"),
        ("drop", {"probability": 0}, r"probability: found 0"),
        ("drop", {"probability": 1.5}, r"probability: found 1.5"),
        ("drop", {"probability": float("nan")}, r"probability: found nan"),
        ("drop", {"way": "sideways"}, r'expected "request" or "answer"'),
        ("corrupt", {"bits": 0}, r"bits: found 0"),
        ("slow", {"seconds": float("inf")}, r"seconds: found inf"),
        ("slow", {"seconds": -1}, r"seconds: found -1"),
        ("stuck-on", {"lights": []}, r"lights: found \[\]"),
        ("stuck-on", {"lights": [-1]}, r"lights: found \[-1\]"),
        ("truncated", {"share": 2}, r"share: found 2"),
        ("wrong-iso", {"value": 400}, r"value: found 400, expected a text"),
    ],
)
def test_what_the_language_does_not_know_is_refused_with_what_it_knows(name, fields, message):
    with pytest.raises(SimError, match=message):
        Fault(name, **fields)


STORY = """
seed = 7

[[fault]]
name = "drop"
probability = 0.05
way = "answer"

[[fault]]
name = "stale"
camera = "cam1"
at = 2
"""


def test_a_story_is_read_from_toml_and_survives_being_handed_on(tmp_path):
    path = tmp_path / "faults.toml"
    path.write_text(STORY)
    story = Story.read(path)
    assert story.seed == 7
    assert repr(story.faults[1]) == "Fault('stale', camera='cam1', at=2)"
    again = Story.from_dict(story.as_dict(), "memory")
    assert again.as_dict() == story.as_dict()
    counts = range(1, 200)
    assert happening(again, LEDS, "packet", counts) == happening(story, LEDS, "packet", counts)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[[fault]]\nname = 'drip'", r"f.toml, \[\[fault\]\] 1.*found 'drip', expected one of"),
        ("[[fault]]\nat = 3", r"\[\[fault\]\] 1.*name: found ''"),
        ("[[fault]]\nname = 3", r"\[\[fault\]\] 1.*name: found 3"),
        ("[[fault]]\nname = 'drop'\n[[fault]]\nname = 'fail'\nat = 'x'", r"\[\[fault\]\] 2.*at"),
        ("[[fault]]\nname = 'drop'\nwhere = 3", r"where: found an unknown field"),
        ("faults = []", "faults: found an unknown key, expected seed or"),
        ("fault = 3", r"expected \[\[fault\]\] tables"),
        ("seed = -1", "seed: found -1, expected a whole number from 0"),
        ("seed = 'x'", "seed: found 'x'"),
    ],
)
def test_a_story_file_with_a_mistake_is_refused_at_its_place(tmp_path, text, message):
    path = tmp_path / "f.toml"
    path.write_text(text)
    with pytest.raises(SimError, match=message):
        Story.read(path)


def test_no_story_file_is_an_error_and_an_empty_one_is_a_quiet_day(tmp_path):
    with pytest.raises(ConfigError, match="no such file"):
        Story.read(tmp_path / "none.toml")
    (tmp_path / "f.toml").write_text("")
    assert Story.read(tmp_path / "f.toml").faults == ()


def test_the_log_tells_what_happened_when_to_whom(tmp_path):
    log = FaultLog(tmp_path / "log.jsonl")
    story = Story([Fault("drop", at=2), Fault("fail", camera="cam0")])
    log.write(LEDS, story.due(LEDS, "packet", 2)[0], 2, "request")
    # Another process would append to the same file.
    FaultLog(tmp_path / "log.jsonl").write("cam0", story.due("cam0", "shot", 1)[0], 1)
    happened = read_fault_log(tmp_path / "log.jsonl")
    assert [(t.device, t.name, t.counted, t.count, t.detail) for t in happened] == [
        ("leds", "drop", "packet", 2, "request"),
        ("cam0", "fail", "shot", 1, ""),
    ]
    assert all(re.fullmatch(r"\d{4}-\d\d-\d\dT[\d:.]+\+00:00", t.time_utc) for t in happened)
    assert log.names() == ["drop"]
    assert read_fault_log(tmp_path / "none") == []
    for line, message in (("noise", FormatError), ('{"device": "leds"}', SimError)):
        (tmp_path / "log.jsonl").write_text(line + "\n")
        with pytest.raises(message, match="line 1"):
            read_fault_log(tmp_path / "log.jsonl")


def test_every_name_and_field_is_in_the_documentation_and_its_example_is_read(tmp_path):
    text = (Path(__file__).parents[4] / "docs" / "faults.md").read_text()
    rows = dict(re.findall(r"^\| `([\w-]+)` \| ((?:once|lasts) .*) \|$", text, re.MULTILINE))
    for name, known in NAMES.items():
        assert rows[name].startswith(f"{'lasts' if known.lasts else 'once'} | {known.effect} |"), (
            name
        )
        for field in known.fields:
            assert f"`{field}`" in rows[name], (name, field)
    assert set(rows) == set(NAMES)
    (example,) = re.findall(r"```toml\n(.*?)```", text, re.DOTALL)
    (tmp_path / "f.toml").write_text(example)
    assert len(Story.read(tmp_path / "f.toml").faults) >= 3
