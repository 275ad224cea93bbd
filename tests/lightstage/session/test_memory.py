"""A capture of very many shots stays small in memory: its lines are on the disk, not held."""

import dataclasses
import gc
import hashlib
import io
import os
import tracemalloc

import pytest
from rich.console import Console

from lightstage.cameras.camera import CardFile
from lightstage.operator import EventServer
from lightstage.operator.terminal import TerminalOperator
from lightstage.rig import Rig
from lightstage.session import SessionPlan, SessionState, SessionWriter, read_journal

CAMERAS = tuple(f"cam{index}" for index in range(9))
LIGHTS, WARM, SHOTS = 168, 10, 100
MOST_BYTES = 1000
"""A photograph; about 600 are held of it now, and one line of it, or a part of its light's levels
(168 numbers for nine photographs), would be 600 more."""


@pytest.fixture
def nine(tmp_path, small_rig, monkeypatch):
    """A session of nine cameras whose journal need not reach the disk."""
    monkeypatch.setattr(os, "fsync", lambda _: None)
    one = small_rig.cameras[0]
    rig = Rig(small_rig.lights, tuple(dataclasses.replace(one, id=name) for name in CAMERAS))
    names = tuple(f"pattern-{number}" for number in range(WARM + SHOTS))
    levels = {name: [0.5] * LIGHTS for name in names}
    writer = SessionWriter.new(tmp_path / "S", rig, SessionPlan(names, levels=levels))
    yield writer
    writer.close()


def shoot(writer, numbers):
    """Lines of whole shots, each camera's photograph among them."""
    for number in numbers:
        pattern = f"pattern-{number}"
        levels = [(number + light) / 1000 for light in range(LIGHTS)]
        writer.lit(pattern, levels, acknowledged=True)
        writer.trigger(pattern, {name: writer.next_take(pattern, name) for name in CAMERAS})
        for name in CAMERAS:
            sha256 = hashlib.sha256(f"{pattern} {name}".encode()).hexdigest()
            file = CardFile(f"/DCIM/100TEST/{name}_{number:04d}.DNG", 50_000_000 + number)
            path = writer.root / "frames" / pattern / f"{name}.dng"
            writer.exposed(pattern, 1, name, file)
            assert writer.claim(sha256, (pattern, name, 1)) is None
            writer.frame(pattern, name, 1, path, file, sha256, "raw", download_s=0.1 + number)
        writer.shot(pattern, acknowledged=True)


def held_bytes():
    gc.collect()
    return tracemalloc.get_traced_memory()[0]


def test_a_photograph_costs_a_capture_less_memory_than_its_lines(nine):
    console = Console(file=io.StringIO(), force_terminal=False)
    operator = TerminalOperator(console, nine.root)
    operator.receive(read_journal(nine.journal.path)[0])
    nine.listeners.append(operator.receive)
    with EventServer(nine.journal.path, operator.request) as server:
        nine.listeners.append(server.receive)
        tracemalloc.start()
        try:
            shoot(nine, range(WARM))
            before = held_bytes()
            shoot(nine, range(WARM, WARM + SHOTS))
            held = held_bytes() - before
        finally:
            tracemalloc.stop()
    assert operator.view.kept == len(nine.state.frames()) == len(CAMERAS) * (WARM + SHOTS)
    assert held < MOST_BYTES * len(CAMERAS) * SHOTS


def test_a_capture_that_goes_on_holds_no_lines_of_before(nine):
    shoot(nine, range(WARM + SHOTS))
    tracemalloc.start()
    try:
        before = held_bytes()
        state = SessionState(read_journal(nine.journal.path))
        held = held_bytes() - before
    finally:
        tracemalloc.stop()
    assert len(state.frames()) == len(CAMERAS) * (WARM + SHOTS)
    assert held < MOST_BYTES * len(state.frames())


def test_what_is_held_of_a_photograph_is_what_its_line_says(nine):
    shoot(nine, range(2))
    nine.trigger("pattern-0", {"cam3": nine.next_take("pattern-0", "cam3")})
    elsewhere = nine.root / "frames" / "elsewhere"
    file = CardFile("/DCIM/again.DNG", 7)
    nine.frame("pattern-0", "cam3", 2, elsewhere, file, "ab" * 32, "raw")
    lines = [line for line in read_journal(nine.journal.path) if line["event"] == "frame"]
    assert [
        (kept.pattern, kept.camera, kept.take, kept.path, kept.sha256, kept.file.name)
        for kept in nine.state.frames()
    ] == [
        tuple(line[name] for name in ("pattern", "camera", "take", "path", "sha256", "file"))
        for line in lines
    ]
    assert nine.state.accepted("pattern-0", "cam3").path == "frames/elsewhere"
    assert nine.next_take("pattern-0", "cam3") == 3
    nine.rejected("pattern-0", "cam3", "blurred")
    assert nine.state.accepted("pattern-0", "cam3").take == 1
    assert nine.next_take("pattern-0", "cam3") == 3


def test_the_same_bytes_are_of_one_take_only(nine):
    shoot(nine, range(1))
    first = nine.state.frames()[0]
    own = ("pattern-1", "cam0", 1)
    assert nine.claim(first.sha256, own) == "pattern-0 by cam0"
    assert nine.claim("cd" * 32, own) is None
    assert nine.claim("cd" * 32, own) is None  # downloaded again
    assert nine.claim("cd" * 32, ("pattern-1", "cam1", 1)) == "pattern-1 by cam0"
