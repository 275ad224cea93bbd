"""The page's addresses and what each answers."""

from __future__ import annotations

import asyncio
import contextlib
import html
import json
import time
import urllib.parse
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from pathlib import Path
from typing import Any

import jinja2
from anyio import to_thread
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import FileResponse, HTMLResponse, RedirectResponse, Response
from starlette.responses import StreamingResponse as Stream
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp

from lightstage.checks.sums import Sum
from lightstage.console import showing
from lightstage.console.access import CSRF_FIELD, CSRF_HEADER, Guard, Visitors, same_token
from lightstage.console.album import why_not
from lightstage.console.desk import CHECK, LOOK, STAGE, Desk
from lightstage.console.following import Followed, Photograph
from lightstage.console.showing import Person
from lightstage.day import PUBLISHED, Planned, PlannedSubject
from lightstage.errors import ConfigError, FormatError, LightstageError
from lightstage.operator.words import heard_words

DATA = Path(__file__).parents[1] / "data" / "console"
REPORT_POLICY = (
    "default-src 'none'; img-src data: 'self'; style-src 'unsafe-inline'; sandbox; "
    "frame-ancestors 'none'; base-uri 'none'"
)
"""Policy of a processing report: pictures and styles of its own, and nothing that runs."""
NO_PICTURE = (
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 120 80" width="120" height="80">'
    '<rect width="120" height="80" fill="#333"/><path d="M0 0L120 80M120 0L0 80" stroke="#999"/>'
    '<text x="60" y="45" fill="#fff" font-size="15" text-anchor="middle">no picture</text></svg>'
)

NO_SUM = ["Sum of light: this camera has no photographs yet of patterns that sum with this one."]


def guarded(desk: Desk, token: str, hosts: Sequence[str], clients: Sequence[str] = ()) -> ASGIApp:
    """The whole application behind its guard (arguments as `access.Guard`)."""
    visitors = Visitors(desk.config.visitors)
    return Guard(application(desk), token, hosts, visitors, clients)


def application(desk: Desk) -> Starlette:
    """The application of a desk, without a guard."""
    page = Pages(desk)
    session = "/session/{name}"
    photo = session + "/{pattern}/{camera}/{take:int}"
    return Starlette(
        routes=[
            Route("/", page.first),
            Route("/plan", page.plan),
            Route("/live", page.live),
            Route("/devices", page.devices),
            Route("/devices/part", page.devices_part),
            Route("/sessions", page.sessions),
            Route(session, page.session),
            Route(session + "/part", page.session_part),
            Route(session + "/events", page.events),
            Route(photo + "/small", page.small),
            Route(photo + "/large", page.large),
            Route(photo + "/look", page.look),
            Route(photo + "/focus", page.focus),
            Route(photo + "/sum", page.sum),
            Route(photo + "/sum.jpg", page.sum_jpg),
            Route("/report/{name}/{number:int}", page.report),
            Route("/plan/{act}", page.change_plan, methods=["POST"]),
            Route("/start", page.start, methods=["POST"]),
            Route(session + "/{act}", page.act, methods=["POST"]),
            Route("/devices/look", page.look_at_devices, methods=["POST"]),
            Mount("/static", _Static(directory=DATA)),
        ],
        exception_handlers={LightstageError: page.refused, 404: page.refused, 405: page.refused},
    )


class _Static(StaticFiles):
    """Our own files, which a browser may keep for an hour."""

    def file_response(self, *args: Any, **kwargs: Any) -> Response:
        answer = super().file_response(*args, **kwargs)
        answer.headers["Cache-Control"] = "private, max-age=3600"
        return answer


class Pages:
    """Answers of every address.

    Args:
        desk: what they are made of.
    """

    def __init__(self, desk: Desk) -> None:
        self._desk = desk
        self._templates = jinja2.Environment(
            loader=jinja2.FileSystemLoader(DATA / "pages"),
            autoescape=True,
            undefined=jinja2.StrictUndefined,
            trim_blocks=True,
            lstrip_blocks=True,
        )

    async def first(self, _: Request) -> Response:
        """The plan, where a day begins."""
        return RedirectResponse("/plan", 303)

    async def plan(self, request: Request) -> Response:
        """The plan of the day."""
        desk = self._desk

        def values() -> dict[str, Any]:
            problem, stamp = "", desk.stamp()
            takes: list[Planned] = []
            try:
                takes = desk.takes()
            except LightstageError as error:
                problem = str(error)
            following = next((each for each in takes if each.open), None)
            people: dict[str, Person] = {}
            for each in takes:
                known = people.get(each.take.subject, Person(each.take.subject, each.take.consent))
                people[each.take.subject] = known.having(each)
            return {
                "people": list(people.values()),
                "takes": takes,
                "problem": problem,
                "stamp": stamp,
                "facts": showing.plan_facts(takes),
                "following": following,
                "running": desk.running(),
                "path": desk.path,
                "expressions": PUBLISHED,
                "stage": desk.stage is not None,
            }

        return self._page(request, "plan.html", "Plan", await _away(values))

    async def live(self, request: Request) -> Response:
        """The session that runs, or the last one; before it has a journal, that it is starting."""
        name, state = await _away(self._desk.current)
        if name and await _away((self._desk.folder / name / "journal.jsonl").exists):
            return RedirectResponse(f"/session/{_quoted(name)}", 303)
        problem = state.output if state is not None and state.failed else ""
        values = {"name": name, "job": state, "problem": problem}
        return self._page(request, "starting.html", "Live", values)

    async def session(self, request: Request) -> Response:
        """The desk of one session."""
        values = await _away(self._session_values, request.path_params["name"])
        return self._page(request, "session.html", values["name"], values)

    async def session_part(self, request: Request) -> Response:
        """The part of that page which changes."""
        values = await _away(self._session_values, request.path_params["name"])
        return self._part(request, "session_part.html", values)

    def _session_values(self, name: str) -> dict[str, Any]:
        followed = self._desk.followed(name)
        state = self._desk.runner.state(STAGE)
        own = state if state is not None and state.job.session == name else None
        values = showing.desk_values(followed, own, self._desk.config.most_rows)
        following, all_done = None, False
        # The next one is not offered before this one's process has ended.
        if followed.view.over and not values["starting"]:
            with contextlib.suppress(LightstageError):  # the plan's own page shows what is wrong
                takes = self._desk.takes()
                following = next((each for each in takes if each.open), None)
                all_done = bool(takes) and all(each.stand == "done" for each in takes)
        checking = self._desk.runner.state(CHECK)
        return {
            **values,
            "following": following,
            "all_done": all_done,
            "stage": self._desk.stage is not None,
            "checking": checking if checking and checking.job.session == name else None,
        }

    async def events(self, request: Request) -> Response:
        """The journal's lines as server-sent events, after ``Last-Event-ID`` where it is given."""
        name = request.path_params["name"]
        followed = await _away(self._desk.followed, name)
        given = request.headers.get("last-event-id") or request.query_params.get("after", "")
        after = int(given) if given.isdecimal() and len(given) < 16 else followed.view.last_id
        # A page that was loaded from another journal of this name may hold larger ids.
        after = min(after, followed.view.last_id)
        stream = self._stream(followed, after, request.is_disconnected)
        return Stream(stream, media_type="text/event-stream", headers={"X-Accel-Buffering": "no"})

    async def _stream(
        self, followed: Followed, after: int, gone: Callable[[], Awaitable[bool]]
    ) -> AsyncIterator[bytes]:
        config = self._desk.config
        yield b"retry: 1000\n\n"
        quiet_s, phase = 0.0, ""
        while not self._desk.closing.is_set() and not await gone():
            try:
                await _away(followed.update)
            except (OSError, LightstageError):
                return  # the folder is gone; the page asks again and gets an error
            news = followed.after(after)
            for event in news:
                after = event.id
                yield f"id: {event.id}\ndata: {json.dumps(event.data)}\n\n".encode()
            now = f"{followed.view.phase} {followed.live}"
            if not news and now != phase and phase:  # such as when its process is gone
                yield b"data: {}\n\n"
            phase = now
            quiet_s = 0.0 if news else quiet_s + config.look_s
            if quiet_s >= config.alive_s:
                quiet_s = 0.0
                yield b": alive\n\n"
            await asyncio.sleep(config.look_s)

    async def small(self, request: Request) -> Response:
        """A small picture of a photograph."""
        photograph = (await self._photograph(request))[0]
        try:
            data = await self._desk.album.thumbnail(photograph)
        except FormatError:
            return Response(NO_PICTURE, media_type="image/svg+xml")
        # Its address names its take, so it never changes.
        return Response(
            data, media_type="image/jpeg", headers={"Cache-Control": "private, max-age=86400"}
        )

    async def large(self, request: Request) -> Response:
        """A large picture of a photograph, with clipped pixels painted."""
        photograph = (await self._photograph(request))[0]
        try:
            data, _ = await self._desk.album.large(photograph)
        except FormatError:
            return Response(NO_PICTURE, media_type="image/svg+xml")
        return Response(data, media_type="image/jpeg")

    async def look(self, request: Request) -> Response:
        """A photograph's large picture with its histogram and figures."""
        photograph = (await self._photograph(request))[0]
        names = request.path_params
        values: dict[str, Any] = {**names, "problem": "", "sentences": [], "curves": []}
        try:
            _, facts = await self._desk.album.large(photograph)
            values |= showing.look_values(facts)
        except FormatError as error:
            values["problem"] = why_not(error)
        followed = await _away(self._desk.followed, names["name"])
        values["retake"] = not followed.live and self._desk.stage is not None
        return self._part(request, "look.html", values)

    async def focus(self, request: Request) -> Response:
        """How sharp a photograph is: its own request, so that the picture does not wait for it."""
        photograph, others = await self._photograph(request)
        # Compare with the camera's first photograph; the first itself with the second.
        pattern, other = next((each for each in others if each[1] != photograph), ("", None))
        try:
            measured = await self._desk.album.focus(photograph, other)
            words = showing.focus_words(measured, pattern)
        except FormatError as error:
            words = [f"Focus: not known. {why_not(error)}"]
        return self._part(request, "focus.html", {"words": words})

    async def sum(self, request: Request) -> Response:
        """How the light of a photograph sums with others of its camera."""
        found = await self._sum(request)
        values: dict[str, Any] = {**request.path_params, "pictured": False, "words": NO_SUM}
        if found is not None:
            try:
                _, facts = await self._desk.album.sums(found[1])
                followed = await _away(self._desk.followed, request.path_params["name"])
                words = showing.sum_words(facts, found[0], followed.max_misfit)
                values |= {"pictured": True, "words": words}
            except FormatError as error:
                values["words"] = [f"Sum of light: not known. {why_not(error)}"]
        return self._part(request, "sum.html", values)

    async def sum_jpg(self, request: Request) -> Response:
        """The picture of that sum."""
        found = await self._sum(request)
        try:
            if found is not None:
                data, _ = await self._desk.album.sums(found[1])
                return Response(data, media_type="image/jpeg")
        except FormatError:
            pass
        return Response(NO_PICTURE, media_type="image/svg+xml")

    async def _sum(self, request: Request) -> tuple[Sum, tuple[Photograph, ...]] | None:
        await self._photograph(request)
        names = request.path_params
        followed = await _away(self._desk.followed, names["name"])
        return await _away(followed.sum_of, names["pattern"], names["camera"])

    async def _photograph(
        self, request: Request
    ) -> tuple[Photograph, list[tuple[str, Photograph]]]:
        """The photograph that an address names, and all of its camera's with their patterns."""
        names = request.path_params
        followed = await _away(self._desk.followed, names["name"])
        found = followed.photograph(names["pattern"], names["camera"])
        if found is None or found.take != names["take"]:
            raise FormatError(
                f"{names['pattern']} by {names['camera']}"[:200],
                found=f"no take {names['take']}",
                expected="a photograph of this session",
            )
        return found, followed.photographs_of(names["camera"])

    async def devices(self, request: Request) -> Response:
        """Cameras and lights."""
        return self._page(request, "devices.html", "Devices", await _away(self._device_values))

    async def devices_part(self, request: Request) -> Response:
        """The part of that page which changes."""
        return self._part(request, "devices_part.html", await _away(self._device_values))

    def _device_values(self) -> dict[str, Any]:
        running = self._desk.running()
        state = self._desk.runner.state(LOOK)
        facts = "" if state is None or state.running else self._desk.runner.facts(state.job)
        values = showing.device_values(state, facts, time.time())
        values |= {"running": running, "stage": self._desk.stage, "captured": None, "budget": None}
        if running and (self._desk.folder / running / "journal.jsonl").exists():
            followed = self._desk.followed(running)
            values["captured"], values["budget"] = followed.view, followed.budget()
        return values

    async def sessions(self, request: Request) -> Response:
        """The sessions of the folder."""

        def values() -> dict[str, Any]:
            seen = list(reversed(self._desk.sessions()))
            checking = self._desk.runner.state(CHECK)
            # Where a check recorded why it failed, that is shown with its session.
            noted = {each.root.name for each in seen if each.why}
            failed = checking is not None and checking.failed and checking.job.session not in noted
            return {
                "sessions": seen,
                "folder": self._desk.folder,
                "checking": checking,
                "problem": checking.output if failed and checking else "",
            }

        return self._page(request, "sessions.html", "Sessions", await _away(values))

    async def report(self, request: Request) -> Response:
        """A processing report, as its file has it; nothing in it may run."""
        names = request.path_params
        seen = await _away(self._desk.sessions)
        found = next((each for each in seen if each.root.name == names["name"]), None)
        made = () if found is None else found.processed
        path = made[names["number"]] / "report.html" if names["number"] < len(made) else None
        if path is None or not path.is_file():
            raise FormatError("report", found="none", expected="a processed session's report.html")
        return FileResponse(
            path, media_type="text/html", headers={"Content-Security-Policy": REPORT_POLICY}
        )

    async def change_plan(self, request: Request) -> Response:
        """Add or remove a person, move a take, or plan another session of it."""
        form = await self._form(request)
        act, name, stamp = request.path_params["act"], form.get("take", ""), form.get("stamp", "")
        desk = self._desk
        if act == "add":
            expressions = tuple(form.get("expressions", "").replace(",", " ").split())
            own = None if expressions in ((), PUBLISHED) else expressions
            subject = PlannedSubject(form.get("subject", ""), form.get("consent", ""), own)
            await _away(desk.change, stamp, lambda plan: plan.with_subject(subject))
        elif act in ("up", "down"):
            by = -1 if act == "up" else 1
            await _away(desk.change, stamp, lambda plan: plan.moved(name, by))
        elif act == "again":
            found = await _away(lambda: {each.take.name: each for each in desk.takes()}.get(name))
            wanted = 1 if found is None else len(found.sessions) + 1
            await _away(desk.change, stamp, lambda plan: plan.wanting(name, wanted))
        elif act == "enough":
            found = await _away(lambda: {each.take.name: each for each in desk.takes()}.get(name))
            had = 1 if found is None else max(1, len(found.sessions))
            await _away(desk.change, stamp, lambda plan: plan.wanting(name, had))
        elif act == "remove":
            await _away(desk.remove, stamp, form.get("subject", ""))
        else:
            expected = "add, up, down, again, enough or remove"
            raise ConfigError("plan", found=ascii(act[:40]), expected=expected)
        return self._to(request, "/plan")

    async def start(self, request: Request) -> Response:
        """Start the next take, or one by its name."""
        form = await self._form(request)
        await _away(self._desk.start, form.get("take") or None)
        return self._to(request, "/live")

    async def act(self, request: Request) -> Response:
        """Send a request to a running capture, resume a session, retake or check."""
        form = await self._form(request)
        name, act = request.path_params["name"], request.path_params["act"]
        if act == "do":
            do, pattern = form.get("do", ""), form.get("pattern", "")
            why = await _away(self._desk.ask, name, do, pattern)
            of = "" if form.get("answer") else pattern
            text = heard_words(do, of) if why is None else f"Not now: {why}."
            return self._message(request, text, f"/session/{_quoted(name)}")
        if act == "resume":
            await _away(self._desk.resume, name)
            return self._to(request, "/live")
        if act == "retake":
            pattern, camera = form.get("pattern", ""), form.get("camera", "")
            await _away(self._desk.retake, name, pattern, camera)
            return self._to(request, "/live")
        if act == "check":
            await _away(self._desk.check, name)
            return self._to(request, "/sessions")
        raise ConfigError("session", found=ascii(act[:40]), expected="do, resume, retake or check")

    async def look_at_devices(self, request: Request) -> Response:
        """Start a check of the devices."""
        await self._form(request)
        await _away(self._desk.look_at_devices)
        return self._to(request, "/devices")

    async def refused(self, request: Request, error: Exception) -> Response:
        """An error in words: a page of its own, or one line where htmx sent the request."""
        if isinstance(error, LightstageError):
            text, status = str(error), 422
            if request.method in ("GET", "HEAD"):
                status = 404
        else:
            text, status = "There is no such page.", getattr(error, "status_code", 404)
        if "hx-request" in request.headers:
            return self._message(request, text, "")
        values = {"text": text}
        return self._page(request, "message.html", "Not possible", values, status)

    async def _form(self, request: Request) -> dict[str, str]:
        """The fields of a POST; ConfigError where its second token is not that of its session."""
        data = b""
        async for piece in request.stream():
            data += piece
            if len(data) > self._desk.config.form_bytes:
                raise ConfigError("form", found="too much", expected="a form of this page")
        fields = urllib.parse.parse_qs(data.decode("utf-8", "replace"), keep_blank_values=True)
        form = {name: values[0] for name, values in fields.items()}
        given = request.headers.get(CSRF_HEADER) or form.get(CSRF_FIELD, "")
        if not same_token(given, request.scope["visitor"]):
            raise ConfigError(
                "form",
                found="no token of this page",
                expected="that of a page of this session",
                hint="Reload the page, and try again.",
            )
        return form

    def _page(
        self, request: Request, template: str, title: str, values: dict[str, Any], status: int = 200
    ) -> Response:
        base = {"title": title, "at": request.url.path, "csrf": request.scope["visitor"].csrf}
        return HTMLResponse(self._templates.get_template(template).render(base | values), status)

    def _part(self, request: Request, template: str, values: dict[str, Any]) -> Response:
        base = {"csrf": request.scope["visitor"].csrf}
        return HTMLResponse(self._templates.get_template(template).render(base | values))

    def _to(self, request: Request, path: str) -> Response:
        """Send the browser to a page, in the way of a form or of htmx."""
        if "hx-request" in request.headers:
            return Response(headers={"HX-Redirect": path})
        return RedirectResponse(path, 303)

    def _message(self, request: Request, text: str, back: str) -> Response:
        """One line for the operator."""
        if "hx-request" in request.headers or not back:
            # A button may be drawn anew before its answer comes: htmx then finds no other place.
            away = request.headers.get("hx-target") != "message"
            moved = {"HX-Retarget": "#message", "HX-Reswap": "innerHTML"} if away else {}
            return HTMLResponse(html.escape(text), headers=moved)
        return RedirectResponse(back, 303)


async def _away(call: Callable[..., Any], *arguments: Any) -> Any:
    """Run what reads the disk in a thread, so that no other page waits for it."""
    return await to_thread.run_sync(lambda: call(*arguments))


def _quoted(name: str) -> str:
    return urllib.parse.quote(name, safe="")
