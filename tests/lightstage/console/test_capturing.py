"""A day captured from the page: real processes, a simulated stage, a server that dies."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from lightstage.checks import check_session
from lightstage.console.runner import Runner
from sim.browser import Browser, chromium
from sim.devices.faults import Fault
from sim.devices.processes import descendants
from tests.lightstage.console.conftest import (
    Visitor,
    events_of,
    served,
    together,
    wait_until,
)

needs_chromium = pytest.mark.skipif(
    chromium() is None, reason="no Chromium: install Debian's package chromium"
)

pytestmark = pytest.mark.usefixtures("forked")


def errors_of(browser: Browser) -> list[str]:
    """What the page reports, without what htmx logs of requests that its next page cut short."""
    ends = [each for each in browser.errors if "htmx:afterRequest" in each]
    aborts = [each for each in browser.errors if "htmx:sendAbort" in each]
    cut_short = [*aborts, *ends[: len(aborts)]]
    return [each for each in browser.errors if not any(each is one for one in cut_short)]


@pytest.fixture(autouse=True)
def no_capture_outlives_its_test(plan):
    yield
    runner = Runner(plan.parent / "sessions", plan.parent)
    runner.stop("stage")
    wait_until(lambda: not (state := runner.state("stage")) or not state.running, "the end of all")


def test_a_take_is_captured_whole_and_the_next_one_follows(staged, plan) -> None:
    stage, options = staged()
    with served(plan, options) as site:
        visitor = site.visitor()
        assert visitor.post("/start").headers["HX-Redirect"] == "/live"
        busy = visitor.post("/start")
        assert "HX-Redirect" not in busy.headers
        assert "an idle one" in busy.text
        root = site.desk.folder / "P1+neutral"
        wait_until(lambda: events_of(root, "end"), "the session's end")
        wait_until(lambda: not site.desk.running(), "an idle stage")
        assert check_session(root).frames == 9
        begin = events_of(root, "begin")[0]
        assert (begin["subject"], begin["consent"]) == ("P1", "C-2026-0041")
        page = visitor.get("/session/P1+neutral").text
        assert "COMPLETE" in page
        assert "Start P1/smile" in page
        assert page.count("/small") == 9
        picture = visitor.get("/session/P1+neutral/x+/cam1/1/small")
        assert picture.body.startswith(b"\xff\xd8")
        added = visitor.get("/session/P1+neutral/x+/cam1/1/sum")
        assert re.search(r"x\+ and x- together differ from full by|too little is lit", added.text)
        assert "sum.jpg" in added.text
        picture = visitor.get("/session/P1+neutral/x+/cam1/1/sum.jpg")
        assert picture.body.startswith(b"\xff\xd8")
        assert visitor.post("/session/P1+neutral/check").headers["HX-Redirect"] == "/sessions"
        wait_until(lambda: (root / "checked.json").exists(), "the check's note")
        assert "✓ passed" in visitor.get("/sessions").text
        assert "1 of 4 sessions done" in visitor.get("/plan").text
        stamp = site.desk.stamp()
        visitor.post("/plan/again", take="P1/neutral", stamp=stamp)
        assert "wanted again" in visitor.get("/plan").text
        assert stage.device.dark


def test_two_browsers_abort_at_once_and_the_session_goes_on_later(staged, plan) -> None:
    lit = []
    stage, options = staged(Fault("hang", camera="cam1", at=2), shown=lambda v: lit.append(v.any()))
    with served(plan, options) as site:
        visitors = [site.visitor(), site.visitor()]
        visitors[0].post("/start")
        root = site.desk.folder / "P1+neutral"
        wait_until(lambda: len(events_of(root, "trigger")) == 2, "the second pattern")
        answers = together(
            *(lambda v=v: v.post("/session/P1+neutral/do", do="abort") for v in visitors)
        )
        assert all(answer.status == 200 for answer in answers)
        assert all("STOPPING" in answer.text or "Not now" in answer.text for answer in answers), [
            answer.text for answer in answers
        ]
        assert stage.device.dark
        wait_until(lambda: events_of(root, "aborted"), "the stop")
        wait_until(lambda: not site.desk.running(), "an idle stage")
        assert len(events_of(root, "aborted")) == 1
        late = visitors[0].post("/session/P1+neutral/do", do="abort")
        assert "no capture runs" in late.text
        assert "STOPPED" in visitors[1].get("/session/P1+neutral/part").text
        assert visitors[1].post("/session/P1+neutral/resume").headers["HX-Redirect"] == "/live"
        # Until its capture speaks, what the page shows is no old state, and it can be stopped.
        part = visitors[1].get("/session/P1+neutral/part").text
        assert "STARTING" in part
        assert "STOPPED" not in part
        assert 'data-key="q"' in part
        wait_until(lambda: events_of(root, "end"), "the session's end")
        assert check_session(root).frames == 9


def test_a_question_waits_dark_for_the_page(staged, plan) -> None:
    faults = [Fault("fail", camera="cam1", at=2, until=4)]
    stage, options = staged(*faults)
    with served(plan, options) as site:
        visitor = site.visitor()
        visitor.post("/start")
        root = site.desk.folder / "P1+neutral"
        wait_until(lambda: events_of(root, "asked"), "a question")
        visitor.shows("/session/P1+neutral/part", "retake it", "WAITING FOR YOU")
        assert stage.device.dark
        devices = visitor.get("/devices/part").text
        assert "news warning" not in devices  # nothing is near its budget
        assert re.search(
            r"at [0-9]+ % of full power's heat at most \(90 % are allowed\).* "
            r"[0-9]+ s at full level \(600 s are allowed\)",
            devices,
        ), devices
        time.sleep(0.5)
        assert not events_of(root, "answered")
        assert "there is no photograph" in visitor.post("/session/P1+neutral/do", do="accept").text
        other = visitor.post("/session/P1+neutral/do", do="retake", pattern="x-", answer="1").text
        assert "a question about x+ waits" in other
        visitor.post("/session/P1+neutral/do", do="retake")
        wait_until(lambda: len(events_of(root, "asked")) == 2, "the second question")
        again = visitor.shows("/session/P1+neutral/part", "question 2 about it")
        assert "no picture was taken" in again
        assert ".." not in re.sub("<[^>]+>", "", again)
        while not events_of(root, "end"):
            if len(events_of(root, "asked")) > len(events_of(root, "answered")):
                visitor.post("/session/P1+neutral/do", do="retake")
            time.sleep(0.1)
        assert check_session(root).frames == 9


def test_a_stop_before_the_first_light_is_a_stop(staged, plan) -> None:
    stage, options = staged()
    with served(plan, options) as site:
        visitor = site.visitor()
        visitor.post("/start")
        assert "STARTING" in visitor.get("/live").text
        answer = visitor.post("/session/P1+neutral/do", do="abort")
        assert "STOPPING" in answer.text, answer.text
        wait_until(lambda: not site.desk.running(), "an idle stage")
        assert stage.device.dark
        assert not events_of(site.desk.folder / "P1+neutral", "end")


def test_a_capture_that_cannot_start_gives_the_reason(staged, plan) -> None:
    _, options = staged()
    options.rig.write_text("{}")
    with served(plan, options) as site:
        visitor = site.visitor()
        visitor.post("/start")
        page = visitor.shows("/live", "NOT STARTED")
        assert "rig.json" in page
        assert not (site.desk.folder / "P1+neutral").exists()


def command_of(pid: int) -> str:
    """What a process was started with; empty where it is no more."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_text().replace("\0", " ")
    except OSError:
        return ""


def console(plan, options, port: int = 0) -> tuple[subprocess.Popen, str, Visitor]:
    """The command as somebody starts it; its address, and a visitor."""
    words = ["console", "--plan", str(plan), "--port", str(port), *options.capture()]
    process = subprocess.Popen(
        [sys.executable, "-m", "lightstage", *words],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stdout is not None
    url = process.stdout.readline().removeprefix("Open ").strip()
    port = int(url.split(":")[2].split("/")[0])
    return process, url, Visitor(port).enter(url.partition("token=")[2])


def test_a_server_that_is_killed_changes_nothing_of_a_capture(staged, plan) -> None:
    _, options = staged()
    process, _, visitor = console(plan, options)
    root = plan.parent / "sessions" / "P1+neutral"
    try:
        visitor.post("/start")
        wait_until(lambda: events_of(root, "lit"), "the first light")
        second = subprocess.run(
            [sys.executable, "-m", "lightstage", "console", "--plan", str(plan), "--port", "0"],
            capture_output=True, text=True, timeout=60,
        )  # fmt: skip
        assert second.returncode == 2
        assert "another console" in second.stderr
        found = [each.pid for each in descendants(process.pid)]
        makers = [pid for pid in found if "spawn_main" in command_of(pid)]
        assert makers
        process.kill()
        process.wait()
        wait_until(lambda: not any(map(command_of, makers)), "the end of what made pictures")
        process, _, again = console(plan, options, visitor.port)
        assert visitor.get("/live").status == 401  # of the killed one
        live = again.get("/live")
        assert live.headers.get("Location") == "/session/P1%2Bneutral"
        wait_until(lambda: events_of(root, "end"), "the session's end")
        assert "COMPLETE" in again.get("/session/P1+neutral/part").text
        assert check_session(root).frames == 9
        assert len(events_of(root, "begin", "resume", "aborted")) == 1
        # A stream that somebody follows does not hold the end up, and nothing is said of it.
        stream = again.stream("/session/P1+neutral/events?after=0")
        process.send_signal(signal.SIGINT)
        printed, wrong = process.communicate(timeout=30)
        assert (process.returncode, wrong) == (0, "")
        assert "page closed" in printed
        stream.close()
    finally:
        process.kill()
        process.wait()


@needs_chromium
def test_a_real_browser_runs_a_capture_by_keys(staged, plan, tmp_path) -> None:
    held = []

    def slow(levels) -> None:
        held.append(levels.any())
        time.sleep(0.4 if levels.any() else 0.0)

    stage, options = staged(shown=slow)
    with served(plan, options) as site, Browser(tmp_path / "profile", 800, 1000) as browser:
        browser.go(site.url)
        assert "token" not in browser.js("location.href")
        browser.press("s")
        browser.wait('location.pathname.startsWith("/session/P1")')
        browser.wait("document.querySelectorAll('.photo img').length >= 3")
        browser.press("p")
        browser.wait('document.body.innerText.includes("PAUSED")')
        assert stage.device.dark
        # Nothing is wider than a tablet held upright.
        assert browser.js("document.documentElement.scrollWidth") <= 800
        # In a pause r takes again the pattern that was shown, and says which.
        shown = browser.js("document.querySelector('[data-key=r]').innerText.split(' ')[1]")
        browser.press("r")
        browser.wait(
            f"document.getElementById('message').innerText.includes('{shown} will be retaken')"
        )
        browser.press("c")
        browser.wait('document.body.innerText.includes("COMPLETE")')
        taken = [each["pattern"] for each in events_of(site.desk.folder / "P1+neutral", "lit")]
        assert taken.count(shown) == 2
        assert len(taken) == 4
        browser.wait('document.body.dataset.sound === "done"')
        browser.wait("[...document.images].filter(i => i.naturalWidth > 0).length === 9")
        browser.js("document.querySelector('.photo').click()")
        browser.wait("document.getElementById('look').open")
        browser.wait("document.querySelector('#look img').naturalWidth > 0")
        browser.wait("/Focus figure|too little/.test(document.getElementById('focus').innerText)")
        browser.wait("/together|too little/.test(document.getElementById('sum').innerText)")
        browser.wait("document.querySelector('#sum img').naturalWidth > 0")
        assert browser.js("document.documentElement.scrollWidth") <= 800
        assert errors_of(browser) == []
        root = site.desk.folder / "P1+neutral"
        assert check_session(root).frames == 9
        assert browser.js("document.querySelector('#look .side').scrollWidth") <= 800
        # Without its stream of events the page comes to know all the same.
        browser.js("window.EventSource = class { close() {} }; 1")
        browser.js("document.getElementById('look').close(); 1")
        browser.wait("document.querySelector('[data-key=s]')")
        browser.press("s")
        browser.wait('location.pathname.startsWith("/session/P1%2Bsmile")')
        browser.wait("document.querySelector('[data-key=q]')")
        browser.press("q")
        browser.wait('document.body.innerText.includes("STOPPED")')
        assert stage.device.dark
        # g resumes it; s, beside it on the keyboard, only reports that.
        browser.wait("document.querySelector('button[data-key=g]')")
        assert "Press g on the session's page to resume it." in browser.js(
            "document.body.innerText"
        )
        assert "lightstage capture" not in browser.js("document.body.innerText")
        wait_until(lambda: not site.desk.running(), "an idle stage")
        browser.press("s")
        browser.wait(
            "document.getElementById('message').innerText.includes('Press g to resume it, or')"
        )
        assert browser.js("location.pathname").startswith("/session/P1%2Bsmile")
        assert not site.desk.running()
        for key, path in (("1", "/plan"), ("3", "/devices"), ("4", "/sessions")):
            browser.press(key)
            browser.wait(f"location.pathname === '{path}' && document.readyState === 'complete'")
            assert browser.js("document.documentElement.scrollWidth") <= 800, path
            # Nor wider than a telephone: what does not fit moves within its own table.
            browser.resize(375, 812)
            assert browser.js("document.documentElement.scrollWidth") <= 375, path
            browser.resize(800, 1000)
        # A stop while devices are opened is a stop, and no page of its own.
        wait_until(lambda: not site.desk.running(), "an idle stage")
        browser.press("1")
        browser.wait("location.pathname === '/plan' && document.querySelector('[data-key=g]')")
        browser.press("s")
        browser.wait(
            "document.getElementById('message').innerText.includes('press g to resume it')"
        )
        browser.press("g")
        browser.wait('document.body.innerText.includes("COMPLETE")')
        assert "Stopped by the operator" not in browser.js(
            "document.querySelector('main').innerText"
        )
        browser.wait("document.querySelector('[data-key=s]')")
        browser.press("s")
        browser.wait("location.pathname === '/live' && document.querySelector('[data-key=q]')")
        browser.press("q")
        browser.wait('document.body.innerText.includes("STOPPED")')
        assert "no such page" not in browser.js("document.body.innerText")
        assert "Mend this" not in browser.js("document.body.innerText")
        assert errors_of(browser) == []
        # A console that was started again does not know this page: what it shows is old.
        browser.go(f"http://127.0.0.1:{site.port}/session/P1+neutral")
        assert browser.js("document.getElementById('unknown').hidden")
        browser.forget_cookies()
        browser.wait("!document.getElementById('unknown').hidden")
        assert browser.js("document.body.classList.contains('old')")


@needs_chromium
def test_a_question_shows_its_photograph_and_reports_that_the_camera_is_set_back(
    staged, plan, tmp_path
) -> None:
    fault = Fault("wrong-iso", camera="cam1", at=2, value="400")
    _, options = staged(fault)
    with served(plan, options) as site, Browser(tmp_path / "profile", 1280, 800) as browser:
        browser.go(site.url)
        browser.press("s")
        browser.wait('document.body.innerText.includes("WAITING FOR YOU")')
        browser.wait("document.querySelector('.concerned img').naturalWidth > 0")
        for part in (".concerned img", "[data-key=r]", "[data-key=a]"):
            # The page is drawn anew meanwhile, so that for a moment a part may be missing.
            browser.wait(f"document.querySelector('{part}')?.getBoundingClientRect().bottom <= 800")
        text = browser.js("document.querySelector('main').innerText")
        assert text.count("ISO in the file") == 1
        assert text.count("The setting is set back on the camera in any case") == 1
        assert "no pulse frequency" not in text  # of the stage, not of this session
        browser.resize(800, 1000)
        assert browser.js("document.documentElement.scrollWidth") <= 800
        browser.press("a")
        browser.wait('document.body.innerText.includes("COMPLETE")')
        root = site.desk.folder / "P1+neutral"
        assert len(events_of(root, "asked")) == 1  # x- is taken with the right ISO
        assert [each["said"] for each in events_of(root, "note")].count("iso set back") == 1
        browser.press("1")
        browser.wait("document.body.innerText.includes('findings accepted')")
        row = browser.js("document.querySelector('.stand-done').innerText")
        assert "done, with" in row
        assert errors_of(browser) == []
