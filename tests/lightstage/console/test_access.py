"""Nobody sees the page or presses its keys but who has the printed address, from our own pages."""

from __future__ import annotations

import asyncio
import re
import secrets
import urllib.parse

import pytest
from starlette.responses import PlainTextResponse

from lightstage.console.access import Guard, Visitors
from lightstage.console.server import local_address
from lightstage.errors import ConfigError
from tests.lightstage.console.conftest import Visitor

PAGES = ("/plan", "/live", "/devices", "/sessions")


def test_without_the_token_there_is_nothing_to_see(site) -> None:
    stranger = Visitor(site.port)
    for path in (*PAGES, "/", "/static/console.js", "/devices/part", "/session/P1/events"):
        answer = stranger.get(path)
        assert answer.status == 401
        assert "lightstage console" in answer.text
        assert "P1" not in answer.text


def test_a_guessed_token_opens_nothing(site) -> None:
    for guess in ("", "x", site.token[:-1], site.token + "x", secrets.token_urlsafe(32), "ü"):
        answer = Visitor(site.port).get(f"/plan?token={urllib.parse.quote(guess)}")
        assert answer.status == 401
        assert "Set-Cookie" not in answer.headers


def test_the_token_opens_a_session_and_leaves_the_address(site) -> None:
    answer = Visitor(site.port).get(f"/plan?token={site.token}&x=1")
    assert answer.status == 303
    assert answer.headers["Location"] == "/plan?x=1"
    cookie = answer.headers["Set-Cookie"].lower()
    assert "httponly" in cookie
    assert "samesite=strict" in cookie
    visitor = site.visitor()
    for path in PAGES:
        page = visitor.get(path)
        assert page.status == 200
        assert site.token not in page.text
        assert site.token not in str(page.headers)


def test_the_way_in_leads_to_no_other_computer(site) -> None:
    for path in ("//evil.example/", "///evil.example", "/%2F%2Fevil.example/"):
        answer = Visitor(site.port).get(f"{path}?token={site.token}")
        assert re.match(r"/[^/]", answer.headers["Location"]), answer.headers["Location"]


def test_a_token_in_a_referer_or_a_cookie_opens_nothing(site) -> None:
    stranger = Visitor(site.port)
    assert stranger.get("/plan", Referer=site.url).status == 401
    assert stranger.get("/plan", Cookie=f"lightstage-{site.port}={site.token}").status == 401
    assert stranger.get("/plan", Authorization=f"Bearer {site.token}").status == 401


def test_a_page_from_yesterday_shows_what_to_do(site) -> None:
    late = Visitor(site.port)
    late.cookie = f"lightstage-{site.port}={secrets.token_urlsafe(32)}"
    answer = late.ask("POST", "/start", {"Origin": late.origin}, "csrf=old")
    assert answer.status == 401
    assert "started again" in answer.text


def test_a_name_that_leads_here_is_not_ours(site) -> None:
    visitor = site.visitor()
    for host in (
        "evil.example",
        f"evil.example:{site.port}",
        "127.0.0.1",
        f"127.0.0.1:{site.port}.x",
    ):
        assert visitor.get("/plan", Host=host).status == 403
        assert visitor.get(f"/?token={site.token}", Host=host).status == 403
    assert visitor.get("/plan", Host=f"localhost:{site.port}").status == 200


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "", "http://127.0.0.1:1"])
def test_a_post_from_another_page_changes_nothing(site, plan, origin: str) -> None:
    visitor, before = site.visitor(), plan.read_bytes()
    body = f"csrf={visitor.csrf()}&take=P2/neutral&stamp={site.desk.stamp()}"
    headers = {"Origin": origin} if origin else {}
    assert visitor.ask("POST", "/plan/up", headers, body).status == 403
    for named in (visitor.origin, "null"):
        crossing = {"Origin": named, "Sec-Fetch-Site": "cross-site"}
        assert visitor.ask("POST", "/plan/up", crossing, body).status == 403
    assert plan.read_bytes() == before


def test_a_post_without_its_sessions_second_token_changes_nothing(site, plan) -> None:
    visitor, other, before = site.visitor(), site.visitor(), plan.read_bytes()
    for token in ("", "guess", other.csrf(), site.token):
        body = f"csrf={token}&take=P2/neutral&stamp={site.desk.stamp()}"
        answer = visitor.ask("POST", "/plan/up", {"Origin": visitor.origin}, body)
        assert answer.status == 422
        assert "Reload the page" in answer.text
    assert plan.read_bytes() == before
    body = f"csrf={visitor.csrf()}&take=P2/neutral&stamp={site.desk.stamp()}"
    assert visitor.ask("POST", "/plan/up", {"Origin": visitor.origin}, body).status == 303
    assert plan.read_bytes() != before


def test_a_form_works_without_scripts_too(site, plan) -> None:
    visitor = site.visitor()
    body = f"csrf={visitor.csrf()}&take=P2/neutral&stamp={site.desk.stamp()}"
    own = {"Origin": "null", "Sec-Fetch-Site": "same-origin"}
    answer = visitor.ask("POST", "/plan/up", own, body)
    assert (answer.status, answer.headers["Location"]) == (303, "/plan")


def test_what_changes_something_is_no_get(site, plan) -> None:
    visitor, before = site.visitor(), plan.read_bytes()
    for path in ("/plan/up?take=P2/neutral", "/start", "/session/P1/do?do=abort", "/devices/look"):
        assert visitor.get(path).status in (404, 405)
    assert visitor.ask("PUT", "/plan", {"Origin": visitor.origin}).status == 405
    assert plan.read_bytes() == before


def test_every_answer_keeps_the_address_to_itself_and_runs_our_code_alone(site) -> None:
    visitor = site.visitor()
    answers = [visitor.get(path) for path in (*PAGES, "/nothing", "/static/console.js")]
    answers += [Visitor(site.port).get("/plan"), visitor.get("/plan", Host="evil.example")]
    for answer in answers:
        assert answer.headers["Referrer-Policy"] == "no-referrer"
        assert "script-src 'self'" in answer.headers["Content-Security-Policy"]
        assert "unsafe" not in answer.headers["Content-Security-Policy"]
        assert "frame-ancestors 'none'" in answer.headers["Content-Security-Policy"]
    for path in PAGES:
        text = visitor.get(path).text
        assert not re.search(r"<script(?![^>]*src=)|\son\w+=|style=|<style", text)
        assert not re.search(r"(src|href|action)=.(https?:)?//", text)


@pytest.mark.parametrize(
    ("client", "status"), [("127.0.0.1", 401), ("10.0.0.7", 401), ("10.0.0.8", 403)]
)
def test_another_computer_is_refused_unless_it_was_named(client: str, status: int) -> None:
    guard = Guard(PlainTextResponse("in"), "token", ["10.0.0.1:80"], Visitors(4), ["10.0.0.7"])
    scope = {
        "type": "http", "method": "GET", "path": "/plan", "query_string": b"",
        "headers": [(b"host", b"10.0.0.1:80")], "client": (client, 5000),
    }  # fmt: skip
    sent = []

    async def send(message) -> None:
        sent.append(message)

    asyncio.run(guard(scope, None, send))
    assert sent[0]["status"] == status


@pytest.mark.parametrize(
    "host", ["0.0.0.0", "127.0.0.1", "224.0.0.1", "tablet.local", "", "10.0.0.0/8"]
)
def test_allow_from_takes_the_address_of_one_other_computer_alone(host: str) -> None:
    with pytest.raises(ConfigError, match="one other computer"):
        local_address(host)
