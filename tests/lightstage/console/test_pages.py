"""What the pages show of files that somebody changed, broke or wrote HTML into."""

from __future__ import annotations

import json
import re
from pathlib import Path

from lightstage.day import read_plan
from lightstage.formats.files import write_bytes, write_json
from tests.lightstage.console.conftest import served, together

EVIL = '<script>alert(1)</script>"><img src=x onerror=alert(2)>'


def write_session(root: Path, dng: bytes | None = None, **begin: object) -> Path:
    """A finished session of two photographs, as its journal tells it."""
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
         "path": "../../secret.dng"},
        {"event": "finding", "severity": "warn", "code": "x", "where": EVIL, "found": EVIL,
         "expected": EVIL, "hint": EVIL},
        {"event": "end", "frames": 2},
    ]  # fmt: skip
    root.mkdir(parents=True)
    text = "".join(json.dumps({"id": n, **line}) + "\n" for n, line in enumerate(lines, 1))
    (root / "journal.jsonl").write_text(text)
    if dng is not None:
        write_bytes(root / "frames" / "full" / "cam0.dng", dng)
        write_bytes(root.parents[1] / "secret.dng", dng)
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
    said = visitor.get(f"/session/{'%3Cscript%3E'}/part", **{"HX-Request": "true"})
    assert "<script>" not in said.text


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
    said = together(*add)
    assert sorted("changed meanwhile" in each for each in said) == [False, True]
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
        assert "start it again with" in visitor.post("/start").text.lower()


def test_a_broken_photograph_says_so_and_the_others_are_shown(site, dng) -> None:
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
    write_session(site.desk.folder / "P1+neutral", dng(16383 - 8))
    look = site.visitor().get("/session/P1+neutral/full/cam0/1/look").text
    assert "Nothing is clipped" in look
    root = write_session(site.desk.folder / "P2+neutral", dng(20000))
    assert (root / "journal.jsonl").exists()
    look = site.visitor().get("/session/P2+neutral/full/cam0/1/look").text
    assert "red 100 %, green 100 %, blue 100 %" in look


def test_a_page_that_comes_back_gets_the_lines_that_it_lacks(site) -> None:
    write_session(site.desk.folder / "P1+neutral")
    visitor, path = site.visitor(), "/session/P1+neutral/events"

    def at_end(told: dict) -> bool:
        return told.get("event") == "end"

    told = visitor.events(f"{path}?after=0", at_end)
    assert [number for number, _ in told] == ["1", "2", "3", "4", "5", "6"]
    assert [each["sound"] for _, each in told] == ["", "hold", "", "", "", "done"]
    told = visitor.events(f"{path}?after=0", at_end, **{"Last-Event-ID": "4"})
    assert [number for number, _ in told] == ["5", "6"]


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
    assert "start it again" in site.visitor().get("/plan").text


def test_sessions_that_nobody_looks_at_hold_no_file(site) -> None:
    visitor = site.visitor()
    for number in range(12):
        write_session(site.desk.folder / f"P{number}+neutral")
    visitor.get("/session/P0+neutral")
    before = len(list(Path("/proc/self/fd").iterdir()))
    for number in range(12):
        assert visitor.get(f"/session/P{number}+neutral").status == 200
    assert len(list(Path("/proc/self/fd").iterdir())) <= before + 6
