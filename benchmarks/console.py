"""The operator's page: how soon a photograph is seen, how soon a stop is dark, and what it costs.

`python -m benchmarks.console` starts `lightstage console` as a user does, and visits it as a
browser does: one stream of events, and for each photograph in it, the small picture.
"""

from __future__ import annotations

import argparse
import contextlib
import http.client
import json
import os
import queue
import re
import statistics
import subprocess
import sys
import tempfile
import threading
import time
import urllib.parse
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.acquisition_faults import trial_rig
from benchmarks.record import record
from lightstage.day import DayPlan, PlannedSubject, write_plan
from lightstage.formats.files import write_bytes
from lightstage.patterns.names import BINARY
from lightstage.rig import Rig
from lightstage.session import read_journal
from sim.camera.dng import Exif, dng_bytes
from sim.camera.sensor import Sensor, SensorConfig
from sim.devices.coded_stage import CodedStage
from sim.devices.processes import descendants

PATTERNS = ("full", *BINARY)
CAMERAS = 9
SIZE = (4016, 6016)
CONNECTIONS = 6
"""Of a browser to one server."""
SESSIONS = 200
LOOK_S = 0.15
"""The page draws itself anew at most so often (console.js)."""


class Visitor:
    """A browser without a screen.

    Args:
        address: as the console prints it.
    """

    def __init__(self, address: str) -> None:
        parts = urllib.parse.urlsplit(address)
        self._host, self._port = str(parts.hostname), int(parts.port or 0)
        self._headers: dict[str, str] = {}
        answer = self._ask("GET", f"/?{parts.query}")
        self._headers["Cookie"] = answer[1]["Set-Cookie"].partition(";")[0]
        self._csrf = re.findall(r'name="csrf" value="([^"]+)"', self.get("/plan").decode())[0]

    def get(self, path: str) -> bytes:
        """The body of an answer."""
        return self._ask("GET", path)[0]

    def press(self, path: str, **fields: str) -> str:
        """Press a button."""
        body = urllib.parse.urlencode({"csrf": self._csrf, **fields})
        origin = f"http://{self._host}:{self._port}"
        headers = {"Origin": origin, "HX-Request": "true", "HX-Target": "message"}
        return self._ask("POST", path, headers, body)[0].decode()

    def events(self, path: str, stop: threading.Event) -> Iterator[dict[str, Any]]:
        """The events of a stream, until `stop` is set."""
        connection = http.client.HTTPConnection(self._host, self._port, timeout=60)
        with contextlib.closing(connection):
            connection.request("GET", path, None, self._headers)
            told = connection.getresponse()
            while not stop.is_set() and (line := told.readline()):
                if line.startswith(b"data: "):
                    yield json.loads(line[6:])

    def _ask(
        self, method: str, path: str, headers: dict[str, str] | None = None, body: str | None = None
    ) -> tuple[bytes, Any]:
        connection = http.client.HTTPConnection(self._host, self._port, timeout=60)
        with contextlib.closing(connection):
            connection.request(method, path, body, {**self._headers, **(headers or {})})
            answer = connection.getresponse()
            return answer.read(), answer.headers


@contextlib.contextmanager
def console(plan: Path, *options: str) -> Iterator[tuple[subprocess.Popen[str], Visitor]]:
    """The command, and somebody who visits it."""
    words = [sys.executable, "-m", "lightstage", "console", "--plan", str(plan), "--port", "0"]
    process = subprocess.Popen([*words, *options], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        address = process.stdout.readline().removeprefix("Open ").strip()
        yield process, Visitor(address)
    finally:
        process.terminate()
        process.wait(30)


def day(folder: Path, people: int, patterns: tuple[str, ...] = PATTERNS) -> Path:
    """A plan of people with one expression each."""
    subjects = tuple(PlannedSubject(f"P{n}", f"C-{n:04}") for n in range(1, people + 1))
    plan = DayPlan(subjects, ("neutral",), ",".join(patterns))
    return write_plan(folder / "plan.toml", plan)


class FakeSession:
    """A session whose journal this benchmark writes, as a capture would.

    Args:
        root: a new folder.
        lights: of the rig.
        name: of the person.
    """

    def __init__(self, root: Path, lights: int, name: str) -> None:
        self.root = root
        root.mkdir(parents=True)
        self._number = 0
        self._file = (root / "journal.jsonl").open("a")
        cameras = [f"cam{n}" for n in range(CAMERAS)]
        levels = {pattern: [0.123456789] * lights for pattern in PATTERNS}
        self.add(
            "begin", schema="lightstage.journal/2", session=name, subject=name,
            expression="neutral", created_utc="2031-05-06T10:00:00+00:00", cameras=cameras,
            sequence=list(PATTERNS), levels=levels, led_device={}, consent="C-1",
        )  # fmt: skip

    def add(self, event: str, **facts: Any) -> float:
        """One line; when it was written."""
        self._number += 1
        line = {"id": self._number, "event": event, "elapsed_s": float(self._number), **facts}
        self._file.write(json.dumps(line) + "\n")
        self._file.flush()
        return time.monotonic()

    def frame(self, pattern: str, camera: str, path: str) -> float:
        """A photograph that is there."""
        told = {"pattern": pattern, "camera": camera, "take": 1, "path": path, "size": 1}
        return self.add("frame", **told, sha256=f"{pattern}{camera}")


def photograph() -> bytes:
    """A DNG of 24 megapixels."""
    rng = np.random.default_rng(0)
    config = SensorConfig()
    mosaic = rng.integers(config.black_dn, config.white_dn, SIZE, dtype=np.uint16)
    exif = Exif("Nikon DSC D750", "6012345", 8.0, 85.0)
    return dng_bytes(mosaic, Sensor(config, np.eye(3), 1 / 60), exif)


def to_thumbnail_s(desk: Path) -> list[float]:
    """For each pattern, seconds from its nine photographs' lines to the last one's picture."""
    plan, data = day(desk, 1), photograph()
    session = FakeSession(desk / "sessions" / "P1+neutral", 168, "P1")
    seconds = []
    with console(plan) as (_, visitor):
        where = f"/session/{urllib.parse.quote(session.root.name)}"
        told: queue.Queue[dict[str, Any]] = queue.Queue()
        stop = threading.Event()

        def follow() -> None:
            for event in visitor.events(f"{where}/events?after=0", stop):
                told.put(event)

        threading.Thread(target=follow, daemon=True).start()
        with ThreadPoolExecutor(CONNECTIONS) as pool:
            for pattern in PATTERNS:
                names = [f"cam{n}" for n in range(CAMERAS)]
                for name in names:
                    write_bytes(session.root / "frames" / pattern / f"{name}.dng", data)
                began = min([session.frame(pattern, n, f"frames/{pattern}/{n}.dng") for n in names])
                while told.get(timeout=60).get("event") != "frame":
                    pass
                # The page asks for its part, which names the pictures, and then for these.
                part = visitor.get(f"{where}/part").decode()
                quoted = urllib.parse.quote(pattern)
                paths = re.findall(rf'src="([^"]+/{re.escape(quoted)}/[^"]+/small)"', part)
                while len(paths) < CAMERAS:
                    part = visitor.get(f"{where}/part").decode()
                    paths = re.findall(rf'src="([^"]+/{re.escape(quoted)}/[^"]+/small)"', part)
                pictures = list(pool.map(visitor.get, paths))
                seconds.append(time.monotonic() - began)
                assert all(each.startswith(b"\xff\xd8") for each in pictures)
                session.add("shot", pattern=pattern)
                while not told.empty():
                    told.get()
        stop.set()
        session.add("end")
    return seconds


def memory_mb(process: int) -> float:
    """What a process holds in memory, MB."""
    text = Path(f"/proc/{process}/status").read_text()
    found = re.search(r"VmRSS:\s+(\d+)", text)
    return 0.0 if found is None else int(found[1]) / 1024


def listing(desk: Path) -> tuple[float, float, float]:
    """The server's memory before and after 200 sessions were listed ten times; seconds a list."""
    plan = day(desk, 1)
    for number in range(SESSIONS):
        session = FakeSession(desk / "sessions" / f"Q{number}+neutral", 168, f"Q{number}")
        for pattern in PATTERNS:
            for camera in range(CAMERAS):
                session.frame(pattern, f"cam{camera}", f"frames/{pattern}/cam{camera}.dng")
        session.add("end", frames=len(PATTERNS) * CAMERAS)
    with console(plan) as (process, visitor):
        visitor.get("/plan")
        before = memory_mb(process.pid)
        seconds = []
        for _ in range(10):
            began = time.monotonic()
            page = visitor.get("/sessions")
            seconds.append(time.monotonic() - began)
        assert page.decode().count("✓ whole") == SESSIONS
        return before, memory_mb(process.pid), statistics.median(seconds)


class Stage:
    """A simulated stage, when its lamps changed, and how a console is started with it."""

    def __init__(self, desk: Path, rig: Rig) -> None:
        self.dark_s = 0.0
        self.stage = CodedStage(desk / "sim", rig, shown=self._shown)

    def _shown(self, levels: np.ndarray) -> None:
        if not levels.any():
            self.dark_s = time.monotonic()

    def options(self) -> list[str]:
        """Of `console`."""
        stage = self.stage
        words = ["--leds", stage.device.url(20.0, 3), "--cameras", str(stage.cameras_path)]
        return ["--rig", str(stage.rig_path), *words]


def _lines(root: Path, event: str) -> int:
    try:
        return sum(f'"event": "{event}"' in line for line in (root / "journal.jsonl").open())
    except FileNotFoundError:
        return 0


def _wait(root: Path, event: str, count: int = 1) -> None:
    until = time.monotonic() + 120
    while _lines(root, event) < count:
        assert time.monotonic() < until, f"no {event} in {root}"
        time.sleep(0.005)


def to_dark_s(desk: Path, times: int) -> list[float]:
    """Seconds from the stop's request to dark lamps, of captures in the middle of a pattern."""
    seconds = []
    stage = Stage(desk, trial_rig())
    with stage.stage, console(day(desk, times), *stage.options()) as (_, visitor):
        for number in range(1, times + 1):
            name = f"P{number}+neutral"
            root = desk / "sessions" / name
            visitor.press("/start", take=f"P{number}/neutral")
            _wait(root, "lit", 2)
            began = time.monotonic()
            assert "STOPPING" in visitor.press(
                f"/session/{urllib.parse.quote(name)}/do", do="abort"
            )
            while stage.dark_s < began:
                time.sleep(0.001)
            seconds.append(stage.dark_s - began)
            _wait(root, "aborted")
            time.sleep(1.0)
    return seconds


def _taking_s(root: Path) -> float:
    """From the first light to the session's end."""
    lines = read_journal(root / "journal.jsonl")
    lit = next(line["elapsed_s"] for line in lines if line["event"] == "lit")
    return float(lines[-1]["elapsed_s"] - lit)


def _browse(visitor: Visitor, name: str, stop: threading.Event) -> None:
    """What an open page does: events, its part for each, the pictures that it does not have."""
    where = f"/session/{urllib.parse.quote(name)}"
    seen: set[str] = set()
    with ThreadPoolExecutor(CONNECTIONS) as pool:
        last = 0.0
        for _ in visitor.events(f"{where}/events?after=0", stop):
            if time.monotonic() - last < LOOK_S:
                continue
            last = time.monotonic()
            part = visitor.get(f"{where}/part").decode()
            new = set(re.findall(r'src="([^"]+/small)"', part)) - seen
            seen |= new
            list(pool.map(visitor.get, sorted(new)))


def processor_s(pid: int) -> float:
    """Processor time of a server and of what makes its pictures; not of what it started."""
    made = [each.pid for each in descendants(pid) if "spawn_main" in " ".join(each.command)]
    ticks = 0
    for each in (pid, *made):
        fields = Path(f"/proc/{each}/stat").read_text().rpartition(")")[2].split()
        ticks += int(fields[11]) + int(fields[12])
    return ticks / os.sysconf("SC_CLK_TCK")


def added_share(desk: Path, times: int) -> tuple[list[float], list[float], list[float]]:
    """Seconds of captures that nobody looks at, of those that a page is open for, by turns.

    Third, the processor time of the page's server and of what makes its pictures.
    """
    alone, watched, worked = [], [], []
    stage = Stage(desk, trial_rig())
    plan = day(desk, 2 * times)
    with stage.stage:
        for number in range(1, 2 * times + 1):
            name = f"P{number}+neutral"
            root = desk / "sessions" / name
            words = ["capture", "--plan", str(plan), "--take", f"P{number}/neutral", "--attended"]
            if number % 2:
                command = [sys.executable, "-m", "lightstage", *words, *stage.options()]
                subprocess.run(command, check=True, capture_output=True)
                alone.append(_taking_s(root))
                continue
            with console(plan, *stage.options()) as (process, visitor):
                visitor.press("/start", take=f"P{number}/neutral")
                _wait(root, "begin")
                before = processor_s(process.pid)
                stop = threading.Event()
                browser = threading.Thread(target=_browse, args=(visitor, name, stop), daemon=True)
                browser.start()
                _wait(root, "end")
                stop.set()
                worked.append(processor_s(process.pid) - before)
                watched.append(_taking_s(root))
                time.sleep(1.0)
    return alone, watched, worked


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--times", type=int, default=5, help="Captures of each kind.")
    times = parser.parse_args().times
    with tempfile.TemporaryDirectory(prefix="lightstage-console-") as name:
        desk = Path(name)
        shown = to_thumbnail_s(desk / "thumbnails")
        print(f"pictures: {shown}", file=sys.stderr)
        before, after, seconds = listing(desk / "list")
        print(f"list: {before:.0f} MB, {after:.0f} MB, {seconds:.2f} s", file=sys.stderr)
        (desk / "dark").mkdir()
        (desk / "time").mkdir()
        dark = to_dark_s(desk / "dark", times)
        print(f"dark: {dark}", file=sys.stderr)
        alone, watched, worked = added_share(desk / "time", times)
    share = statistics.median(watched) / statistics.median(alone) - 1
    spread = max(alone) / min(alone) - 1
    record(
        "Console: what the operator's page shows and costs",
        ("what", "median", "worst", "target"),
        [
            (
                f"nine photographs of 24 MP to their pictures, s ({len(shown)} patterns)",
                f"{statistics.median(shown):.2f}", f"{max(shown):.2f}", "under 2",
            ),
            (
                f"stop on the page to dark lamps, s ({len(dark)} captures)",
                f"{statistics.median(dark):.3f}", f"{max(dark):.3f}", "under .2",
            ),
            (
                f"memory of the server, MB: at its start, with {SESSIONS} sessions listed",
                f"{before:.0f}", f"{after:.0f}", "",
            ),
            (f"list of {SESSIONS} sessions, s", f"{seconds:.2f}", "", ""),
            (
                f"capture alone, s ({len(alone)})",
                f"{statistics.median(alone):.2f}", f"{max(alone):.2f}", "",
            ),
            (
                f"the same with an open page, s ({len(watched)})",
                f"{statistics.median(watched):.2f}", f"{max(watched):.2f}", "",
            ),
            (
                "of it processor time of the page's server and pictures, s",
                f"{statistics.median(worked):.2f}", f"{max(worked):.2f}", "",
            ),
            ("time that the page adds, %", f"{100 * share:.1f}", "", "under 2"),
        ],
        "Simulated lights and cameras (captures: nine of tiny pictures, seven patterns); the page "
        "is visited over HTTP as a browser does, without drawing. Captures alone differ among each "
        f"other by {100 * spread:.1f} %.",
    )  # fmt: skip


if __name__ == "__main__":
    main()
