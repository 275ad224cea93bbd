"""What the pages show of files that somebody changed, broke or wrote HTML into."""

from __future__ import annotations

import html
import json
import re
from pathlib import Path

from lightstage.console.runner import Runner
from lightstage.console.showing import device_values, when_words
from lightstage.day import read_plan
from lightstage.formats.files import write_bytes, write_json
from tests.lightstage.console.conftest import served, together, wait_until

EVIL = '<script>alert(1)</script>"><img src=x onerror=alert(2)>'


def write_session(root: Path, dng: bytes | None = None, **begin: object) -> Path:
    """A finished session of two photographs; with `dng`, the second leads out of its folder."""
    second = "frames/x+/cam0.dng" if dng is None else "../../secret.dng"
    lines: list[dict] = [
        {
            "event": "begin", "schema": "lightstage.journal/2", "session": "s1", "subject": "P1",
            "created_utc": "2031-05-06T10:00:00+00:00", "expression": "neutral",
            "sequence": ["full", "x+"], "cameras": ["cam0"], "led_device": {}, **begin,
        },
        {"event": "lit", "pattern": "full", "levels": [1.0]},
        {"event": "frame", "pattern": "full", "camera": "cam0", "take": 1, "sha256": "a",
         "path": "frames/full/cam0.dng"},
        {"event": "frame", "pattern": "x+", "camera": "cam0", "take": 1, "sha256": "b",
         "path": second},
        {"event": "finding", "severity": "warn", "code": "x", "where": EVIL, "found": EVIL,
         "expected": EVIL, "hint": EVIL},
        {"event": "end", "frames": 2},
    ]  # fmt: skip
    root.mkdir(parents=True)
    text = "".join(json.dumps({"id": n, **line}) + "\n" for n, line in enumerate(lines, 1))
    (root / "journal.jsonl").write_text(text)
    for path in ("frames/full/cam0.dng", second):
        write_bytes((root / path).resolve(), dng or b"light")
    return root


def test_html_in_a_journal_is_shown_as_letters(site) -> None:
    write_session(site.desk.folder / "P1+neutral", subject=EVIL, expression=EVIL, cameras=[EVIL])
    visitor = site.visitor()
    for path in ("/session/P1+neutral", "/session/P1+neutral/part", "/sessions", "/plan"):
        page = visitor.get(path)
        assert page.status == 200, page.text
        assert "<script>alert" not in page.text
        assert "<img src=x" not in page.text
    assert "&lt;script&gt;" in visitor.get("/sessions").text
    answer = visitor.get(f"/session/{'%3Cscript%3E'}/part", **{"HX-Request": "true"})
    assert "<script>" not in answer.text


def test_a_path_in_an_address_or_a_journal_leads_nowhere(site, dng) -> None:
    write_session(site.desk.folder / "P1+neutral", dng(3000))
    visitor = site.visitor()
    assert (
        visitor.get("/session/P1+neutral/full/cam0/1/small").headers["Content-Type"] == "image/jpeg"
    )
    for path in (
        "/session/..", "/session/..%2Fday", "/session/%2Fetc", "/session/.console/part",
        "/session/P1+neutral/x+/cam0/1/small", "/session/P1+neutral/full/cam0/2/small",
        "/session/P1+neutral/..%2F..%2Fsecret.dng/cam0/1/small", "/report/..%2F..%2Fday/0",
        "/static/..%2f..%2frig.json", "/static/../../rig.json",
    ):  # fmt: skip
        answer = visitor.get(path)
        assert answer.status in (404, 405), path
        assert not answer.body.startswith(b"\xff\xd8")


def test_a_person_is_added_only_with_a_pseudonym_and_consent(site, plan) -> None:
    visitor, before = site.visitor(), plan.read_bytes()
    wrong = [
        ({"subject": EVIL, "consent": "C-1"}, "letters, digits"),
        ({"subject": "../P9", "consent": "C-1"}, "never a name, an address or a path"),
        ({"subject": "P9", "consent": ""}, "Nobody is planned without consent"),
        ({"subject": "P1", "consent": "C-1"}, "each subject once"),
        ({"subject": "P9", "consent": "C-1", "expressions": "smirk"}, "an expression of the plan"),
    ]
    for fields, part in wrong:
        answer = visitor.post("/plan/add", stamp=site.desk.stamp(), **fields)
        assert part in answer.text, answer.text
        assert "<" not in answer.text
    assert plan.read_bytes() == before
    answer = visitor.post("/plan/add", stamp=site.desk.stamp(), subject="P9", consent="C-9")
    assert answer.headers["HX-Redirect"] == "/plan"
    assert read_plan(plan).subjects[-1].subject == "P9"


def test_a_plan_that_was_changed_meanwhile_is_looked_at_first(site, plan) -> None:
    visitor, stamp = site.visitor(), site.desk.stamp()
    assert visitor.post("/plan/up", take="P2/smile", stamp=stamp).headers["HX-Redirect"] == "/plan"
    changed = plan.read_bytes()
    answer = visitor.post("/plan/up", take="P2/smile", stamp=stamp)
    assert "changed meanwhile" in answer.text
    assert plan.read_bytes() == changed
    names = [take.name for take in read_plan(plan).all_takes()]
    assert names == ["P1/neutral", "P1/smile", "P2/smile", "P2/neutral"]


def test_of_two_changes_at_once_one_is_refused(site, plan) -> None:
    visitor, stamp = site.visitor(), site.desk.stamp()
    add = [
        lambda n=n: visitor.post("/plan/add", stamp=stamp, subject=f"P{n}", consent="C-1").text
        for n in (8, 9)
    ]
    answers = together(*add)
    assert sorted("changed meanwhile" in each for each in answers) == [False, True]
    assert len(read_plan(plan).subjects) == 3


def test_a_plan_that_is_wrong_is_told_on_its_page(site, plan) -> None:
    plan.write_text(plan.read_text().replace("C-2026-0041", "nobody"))
    page = site.visitor().get("/plan")
    assert page.status == 200
    assert "subjects[0].consent" in page.text


def test_a_day_can_begin_without_a_plan(tmp_path) -> None:
    with served(tmp_path / "new" / "plan.toml") as site:
        visitor = site.visitor()
        assert "0 of 0 sessions done" in visitor.get("/plan").text
        added = visitor.post("/plan/add", stamp=site.desk.stamp(), subject="P1", consent="C-1")
        assert added.headers["HX-Redirect"] == "/plan"
        assert "0 of 7 sessions done" in visitor.get("/plan").text
        assert "Start it again with them: lightstage console --help." in visitor.post("/start").text


def test_a_broken_photograph_reports_it_and_the_others_are_shown(site, dng) -> None:
    root = write_session(site.desk.folder / "P1+neutral", dng(3000))
    visitor, photo = site.visitor(), "/session/P1+neutral/full/cam0/1"
    path = root / "frames" / "full" / "cam0.dng"
    for broken in (dng(3000)[:900], b"II*\0" + bytes(200), b"", bytes(5000)):
        path.write_bytes(broken)
        answer = visitor.get(f"{photo}/small")
        assert answer.headers["Content-Type"].startswith("image/svg+xml")
        assert answer.headers["Cache-Control"] == "no-store"
        assert "cannot be shown" in visitor.get(f"{photo}/look").text
    path.unlink()
    assert "cannot be shown" in visitor.get(f"{photo}/look").text
    path.write_bytes(dng(3000))
    assert visitor.get(f"{photo}/small").body.startswith(b"\xff\xd8")
    assert "Nothing is clipped" in visitor.get(f"{photo}/look").text


def test_clipped_pixels_are_painted_and_counted(site, dng) -> None:
    write_session(site.desk.folder / "P1+neutral", dng(12000))
    look = site.visitor().get("/session/P1+neutral/full/cam0/1/look").text
    assert "Nothing is clipped" in look
    root = write_session(site.desk.folder / "P2+neutral", dng(20000))
    assert (root / "journal.jsonl").exists()
    look = site.visitor().get("/session/P2+neutral/full/cam0/1/look").text
    assert "red 100 %, green 100 %, blue 100 %" in look


def test_a_page_that_comes_back_gets_the_lines_that_it_lacks(site) -> None:
    write_session(site.desk.folder / "P1+neutral")
    visitor, path = site.visitor(), "/session/P1+neutral/events"

    def at_end(lines: dict) -> bool:
        return lines.get("event") == "end"

    lines = visitor.events(f"{path}?after=0", at_end)
    assert [number for number, _ in lines] == ["1", "2", "3", "4", "5", "6"]
    assert [each["sound"] for _, each in lines] == ["", "hold", "", "", "", "done"]
    lines = visitor.events(f"{path}?after=0", at_end, **{"Last-Event-ID": "4"})
    assert [number for number, _ in lines] == ["5", "6"]


def test_a_report_may_show_pictures_and_run_nothing(plan, tmp_path) -> None:
    made = tmp_path / "out" / "P1"
    made.mkdir(parents=True)
    write_json(made / "report.json", {"session": "s1"})
    (made / "report.html").write_text("<script>alert(1)</script>report")
    with served(plan, processed=tmp_path / "out") as site:
        write_session(site.desk.folder / "P1+neutral")
        visitor = site.visitor()
        assert "report P1" in visitor.get("/sessions").text
        answer = visitor.get("/report/P1+neutral/0")
        assert answer.text.endswith("report")
        policy = answer.headers["Content-Security-Policy"]
        assert "script-src" not in policy
        assert "default-src 'none'" in policy
        assert "sandbox" in policy
        assert visitor.get("/report/P1+neutral/1").status == 404
        assert visitor.get("/report/nobody/0").status == 404


def test_two_hundred_patterns_are_not_all_shown_at_a_time(site) -> None:
    names = [f"olat-{n:03}" for n in range(168)]
    write_session(site.desk.folder / "P1+neutral", sequence=names)
    page = site.visitor().get("/session/P1+neutral").text
    assert len(re.findall(r"<tr>|<tr ", page)) < 20
    assert "more patterns are not shown" in page


def test_a_plan_whose_folder_moved_wants_a_new_console(site, plan) -> None:
    plan.write_text(plan.read_text().replace('"sessions"', '"elsewhere"'))
    page = site.visitor().get("/plan").text
    assert "Its folder was changed: end the console, and start it again." in page


def test_sessions_that_nobody_looks_at_hold_no_file(site) -> None:
    visitor = site.visitor()
    for number in range(12):
        write_session(site.desk.folder / f"P{number}+neutral")
    visitor.get("/session/P0+neutral")
    before = len(list(Path("/proc/self/fd").iterdir()))
    for number in range(12):
        assert visitor.get(f"/session/P{number}+neutral").status == 200
    assert len(list(Path("/proc/self/fd").iterdir())) <= before + 6


def test_each_session_keeps_the_reason_why_its_check_failed(site) -> None:
    for name in ("P1+neutral", "P1+smile"):
        root = write_session(site.desk.folder / name)
        reason = f"{root}/frames: a photograph of {name} is gone"
        write_json(
            root / "checked.json",
            {
                "schema": "lightstage.checked/1",
                "passed": False,
                "said": reason,
                "session_sha256": "",
            },
        )
    page = site.visitor().get("/sessions").text
    for name in ("P1+neutral", "P1+smile"):
        assert f"frames: a photograph of {name} is gone</span>" in page


def test_a_check_of_another_session_leaves_the_reason_of_the_first(site) -> None:
    visitor = site.visitor()
    for name in ("P1+neutral", "P1+smile"):
        write_session(site.desk.folder / name)
        visitor.post(f"/session/{name}/check")
        checked = site.desk.folder / name / "checked.json"
        wait_until(checked.exists, "the check's note")
        wait_until(lambda: not site.desk.runner.state("check").running, "the check's end")
    page = visitor.get("/sessions").text
    assert page.count("X failed: ") == 2
    assert page.count('class="why"') == 2
    assert '<pre class="problem">' not in page  # nothing is said twice


def test_faults_that_were_accepted_are_reported_wherever_a_session_is_done(site) -> None:
    end = {"event": "end", "frames": 2, "capture": {"accepted": 1, "accepted_findings": 3}}
    for name, more in (("P1+neutral", end), ("P1+smile", None)):
        root = write_session(site.desk.folder / name)
        journal = root / "journal.jsonl"
        if more is not None:
            lines = journal.read_text().splitlines()
            lines[-1] = json.dumps({"id": len(lines), **more})
            journal.write_text("\n".join(lines) + "\n")
    visitor = site.visitor()
    plan = visitor.get("/plan").text
    assert "✓ done, with 3 findings accepted: " in plan
    assert plan.count("✓ done: ") == 1
    assert "2 of 4 sessions done, 1 of them with findings accepted." in plan
    assert "1 pattern accepted with 3 findings" in visitor.get("/sessions").text


def test_takes_of_one_expression_are_distinguished(site) -> None:
    write_session(site.desk.folder / "P1+neutral")
    write_session(site.desk.folder / "P1+neutral+2", created_utc="2031-05-06T11:30:00+00:00")
    write_session(site.desk.folder / "old", created_utc="2031-05-05T11:30:00+00:00")
    visitor = site.visitor()
    visitor.post("/plan/again", take="P1/neutral", stamp=site.desk.stamp())
    page = re.sub(r"\s+", " ", visitor.get("/sessions").text)
    rows = re.findall(
        r"(2031-05-0. ..:..)</a></td><td>P1</td><td>neutral</td><td>([^<]+)</td>", page
    )
    assert rows == [
        ("2031-05-06 11:30", "2"), ("2031-05-06 10:00", "1"), ("2031-05-05 11:30", "old"),
    ]  # fmt: skip
    plan = visitor.get("/plan").text
    assert ">take 1 (10:00)</a>, " in plan
    assert ">take 2 (11:30)</a>" in plan
    assert "P1, neutral, take 2" in visitor.get("/session/P1+neutral+2").text


def test_a_person_is_removed_only_without_a_session(site, plan) -> None:
    write_session(site.desk.folder / "P1+neutral")
    visitor = site.visitor()
    visitor.post("/plan/up", take="P2/smile", stamp=site.desk.stamp())
    page = visitor.get("/plan").text
    assert page.count('action="/plan/remove"') == 1
    before = plan.read_bytes()
    for subject, part in (("P1", "a person without a session"), ("P9", "a subject of the plan")):
        text = visitor.post("/plan/remove", subject=subject, stamp=site.desk.stamp()).text
        assert part in text, text
    assert plan.read_bytes() == before
    removed = visitor.post("/plan/remove", subject="P2", stamp=site.desk.stamp())
    assert removed.headers["HX-Redirect"] == "/plan"
    left = read_plan(plan)
    assert [each.subject for each in left.subjects] == ["P1"]
    assert {name.partition("/")[0] for name in left.order} <= {"P1"}


def test_a_damaged_session_of_another_expression_keeps_its_person_too(site, plan) -> None:
    root = site.desk.folder / "P1+asleep"
    root.mkdir(parents=True)
    (root / "journal.jsonl").write_text("{")
    text = site.visitor().post("/plan/remove", subject="P1", stamp=site.desk.stamp()).text
    assert "1 session (P1+asleep)" in text


def test_a_stage_whose_rig_is_gone_is_reported_in_words(tmp_path) -> None:
    runner = Runner(tmp_path, tmp_path)
    runner.start("devices", "devices", "", ["devices", "--rig", "none.json", "--leds",
                                            "pty:///dev/none", "--json"])  # fmt: skip
    state = wait_until(
        lambda: None if (now := runner.state("devices")) and now.running else now, "its end"
    )
    values = device_values(state, runner.facts(state.job), state.ended_s + 125)
    assert values["problem"] == "none.json: found no such file, expected a JSON file"
    assert values["look"] is None
    assert values["when"].endswith(" UTC, 2 min ago")


def test_a_check_of_the_devices_is_shown_however_much_it_found(site) -> None:
    finding = {
        "severity": "refuse", "code": "unlike", "where": "camera cam7, focus", "found": "AF" * 200,
        "expected": "Manual", "hint": "Set it.", "camera": "cam7",
    }  # fmt: skip
    look = {"lights": None, "acknowledged": False, "cameras": [], "ready": False}
    runner = site.desk.runner
    runner.start("devices", "devices", "", ["--version"])
    wait_until(lambda: not runner.state("devices").running, "its end")
    log = site.desk.folder / ".console" / "devices.log"
    log.write_text("a warning\n" + json.dumps({**look, "findings": 100 * [finding]}) + "\n")
    page = site.visitor().get("/devices/part").text
    assert "X Not ready" in page
    assert page.count("<b>Set it.</b>") == 100
    assert "could not be checked" not in page


def test_a_moment_is_shown_with_how_long_ago_it_was() -> None:
    assert when_words(0.0, 20.0) == "00:00 UTC, just now"
    assert when_words(0.0, -5.0) == "00:00 UTC, just now"  # a clock that was set back
    assert when_words(3600.0, 3600.0 + 720) == "01:00 UTC, 12 min ago"
    assert when_words(0.0, 7300.0) == "00:00 UTC, 2 h ago"


def test_a_check_from_the_page_names_the_pages_keys_and_no_command(site) -> None:
    root = write_session(site.desk.folder / "P1+neutral")
    journal = root / "journal.jsonl"
    journal.write_text("".join(journal.read_text().splitlines(keepends=True)[:3]))
    visitor = site.visitor()
    visitor.post("/session/P1+neutral/check")
    wait_until((root / "checked.json").exists, "the check's note")
    wait_until(lambda: not site.desk.runner.state("check").running, "the check's end")
    page = html.unescape(visitor.get("/sessions").text)
    assert "X failed" in page
    assert "session.json: found only a journal" in page
    assert "Press g on the session's page to resume it." in page
    assert "lightstage capture" not in page
    assert "lightstage watch" not in page


def test_the_last_session_of_a_plan_reports_that_all_is_done(site) -> None:
    visitor = site.visitor()
    for subject in ("P1", "P2"):
        for expression in ("neutral", "smile"):
            page = visitor.get("/plan").text
            write_session(
                site.desk.folder / f"{subject}+{expression}", subject=subject, expression=expression
            )
            assert "4 of 4" not in page
            shown = visitor.get(f"/session/{subject}+{expression}").text
            last = (subject, expression) == ("P2", "smile")
            assert ("Everything of the" in shown) == last
