"""A page's server in this process, somebody who visits it, and a stage that it can capture with."""

from __future__ import annotations

import contextlib
import http.client
import json
import re
import secrets
import threading
import time
import urllib.parse
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from lightstage.console.app import guarded
from lightstage.console.config import ConsoleConfig
from lightstage.console.desk import Desk, StageOptions
from lightstage.console.server import listen, serving
from lightstage.day import DayPlan, PlannedSubject, write_plan
from sim.devices.coded_stage import CodedStage
from sim.devices.faults import Story
from sim.devices.kill_trial import CONFIG, small_rig

PATTERNS = "full,x+,x-"


class Answer:
    """What a server said."""

    def __init__(self, response: http.client.HTTPResponse) -> None:
        self.status = response.status
        self.headers = response.headers
        self.body = response.read()
        self.text = self.body.decode(errors="replace")


class Visitor:
    """A browser without a screen.

    Attributes:
        origin: of the server.
        cookie: what the server set.
    """

    def __init__(self, port: int) -> None:
        self.port = port
        self.origin = f"http://127.0.0.1:{port}"
        self.cookie = ""

    def get(self, path: str, **headers: str) -> Answer:
        return self.ask("GET", path, headers)

    def enter(self, token: str) -> Visitor:
        """Come with the printed address."""
        answer = self.get(f"/?token={token}")
        assert answer.status == 303, answer.text
        self.cookie = answer.headers["Set-Cookie"].partition(";")[0]
        return self

    def csrf(self) -> str:
        """The second token, as a page of ours has it."""
        found = re.search(r'name="csrf" value="([^"]+)"', self.get("/plan").text)
        assert found is not None
        return found[1]

    def post(self, path: str, **fields: str) -> Answer:
        """Press a button, as htmx does."""
        body = urllib.parse.urlencode({"csrf": self.csrf(), **fields})
        headers = {"Origin": self.origin, "HX-Request": "true"}
        return self.ask("POST", path, headers, body)

    def shows(self, path: str, *parts: str) -> str:
        """A page as soon as it shows these parts."""

        def found() -> str:
            text = self.get(path).text
            return text if all(part in text for part in parts) else ""

        return wait_until(found, f"{parts} at {path}")

    def ask(self, method: str, path: str, headers: dict[str, str], body: str = "") -> Answer:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)
        given = {"Cookie": self.cookie, **headers} if self.cookie else headers
        if body:
            given = {**given, "Content-Type": "application/x-www-form-urlencoded"}
        with contextlib.closing(connection):
            connection.request(method, path, body or None, given)
            return Answer(connection.getresponse())

    def stream(self, path: str) -> http.client.HTTPConnection:
        """A stream of events that is open, and that nobody reads on."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)
        connection.request("GET", path, None, {"Cookie": self.cookie})
        assert connection.getresponse().read1(10)
        return connection

    def events(self, path: str, until: Callable[[dict[str, Any]], bool], **headers: str) -> list:
        """Server-sent events until one is as wanted: pairs of id and data."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)
        with contextlib.closing(connection):
            connection.request("GET", path, None, {"Cookie": self.cookie, **headers})
            response = connection.getresponse()
            assert response.status == 200, response.read()
            found, number = [], ""
            while True:
                line = response.readline().decode().strip()
                if line.startswith("id: "):
                    number = line[4:]
                if line.startswith("data: "):
                    found.append((number, json.loads(line[6:])))
                    if until(found[-1][1]):
                        return found


class Site:
    """A desk that is served.

    Attributes:
        desk: what the answers are made of.
        token: of the printed address.
        port: where.
    """

    def __init__(self, desk: Desk, token: str, port: int) -> None:
        self.desk, self.token, self.port = desk, token, port

    @property
    def url(self) -> str:
        """As the command prints it."""
        return f"http://127.0.0.1:{self.port}/?token={self.token}"

    def visitor(self) -> Visitor:
        """Somebody who has the printed address."""
        return Visitor(self.port).enter(self.token)


@contextlib.contextmanager
def served(plan: Path, stage: StageOptions | None = None, processed: Path | None = None):
    desk = Desk(plan, stage, processed, ConsoleConfig())
    sockets = listen(["127.0.0.1"], 0)
    port = sockets[0].getsockname()[1]
    token = secrets.token_urlsafe(32)
    hosts = [f"127.0.0.1:{port}", f"localhost:{port}"]
    try:
        with serving(guarded(desk, token, hosts), sockets, desk.closing):
            yield Site(desk, token, port)
    finally:
        desk.album.close()


@pytest.fixture
def plan(tmp_path) -> Path:
    """A day of two people with two expressions each, of three patterns."""
    people = [PlannedSubject("P1", "C-2026-0041"), PlannedSubject("P2", "C-2026-0042")]
    day = DayPlan(tuple(people), ("neutral", "smile"), PATTERNS)
    return write_plan(tmp_path / "day" / "plan.toml", day)


@pytest.fixture
def site(plan) -> Iterator[Site]:
    """A page without a stage."""
    with served(plan) as site:
        yield site


@pytest.fixture
def staged(tmp_path, plan, runtime) -> Iterator[Callable[..., tuple[CodedStage, StageOptions]]]:
    """Starts a small stage of real processes; faults may be given."""
    config = tmp_path / "fast.toml"
    config.write_text(CONFIG)
    with contextlib.ExitStack() as stack:

        def start(*faults: Any, **keys: Any) -> tuple[CodedStage, StageOptions]:
            story = Story(list(faults)) if faults else None
            stage = CodedStage(tmp_path / "desk", small_rig(), story, **keys)
            stack.enter_context(stage)
            url = stage.device.url(20.0, 3)
            return stage, StageOptions(stage.rig_path, url, str(stage.cameras_path), config)

        yield start


@pytest.fixture
def runtime(monkeypatch: pytest.MonkeyPatch, tmp_path_factory) -> Path:
    """A runtime folder of its own, for sockets."""
    folder = tmp_path_factory.mktemp("run")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))
    return folder / "lightstage"


def wait_until(done: Callable[[], Any], what: str, seconds: float = 60.0) -> Any:
    """Wait for something; what it gave."""
    until = time.monotonic() + seconds
    while not (found := done()):
        assert time.monotonic() < until, f"not within {seconds:g} s: {what}"
        time.sleep(0.02)
    return found


def events_of(root: Path, *kinds: str) -> list[dict[str, Any]]:
    """Whole lines of a session's journal of these kinds."""
    try:
        data = (root / "journal.jsonl").read_bytes()
    except FileNotFoundError:
        return []
    lines = [json.loads(raw) for raw in data.split(b"\n")[:-1]]
    return [line for line in lines if line["event"] in kinds]


def together(*calls: Callable[[], Any]) -> list[Any]:
    """What calls give that begin at the same moment."""
    gate, results = threading.Barrier(len(calls)), [None] * len(calls)

    def run(index: int) -> None:
        gate.wait()
        results[index] = calls[index]()

    threads = [threading.Thread(target=run, args=(i,)) for i in range(len(calls))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return results
