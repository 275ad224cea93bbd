"""Who may see the page and press its keys: this computer's user, with the address that was printed.

Four things are checked before anything else. The other end must be this computer, or the one that
`--allow-from` names. ``Host`` must be an address that we serve, or a page of somebody else's name
could reach us by a name that leads here (DNS rebinding). A session cookie must be ours, which the
token in the printed address opens. What changes something is a POST with our ``Origin`` and with
the session's own second token, which no other page can know.
"""

from __future__ import annotations

import collections
import dataclasses
import hmac
import secrets
from collections.abc import Sequence
from urllib.parse import parse_qs, urlencode

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import cookie_parser
from starlette.responses import RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

TOKEN = "token"
CSRF_HEADER, CSRF_FIELD = "x-csrf-token", "csrf"
SAFE = ("GET", "HEAD")
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; "
    "form-action 'self'; frame-ancestors 'none'; base-uri 'none'"
)
HEADERS = {
    "Content-Security-Policy": POLICY,
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
"""On every answer; one that has a header of such a name keeps its own."""

OPEN_AGAIN = (
    "This page has no session with the console that runs now. Open the address that "
    "`lightstage console` printed when it started (the console was started again since, or this "
    "address is not complete)."
)


@dataclasses.dataclass
class Visitor:
    """One browser.

    Attributes:
        csrf: the second token, which its pages carry.
    """

    csrf: str


class Visitors:
    """Tokens of browsers, in memory alone: a console that starts again knows none.

    Args:
        most: remembered; the oldest go first.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._known: collections.OrderedDict[str, Visitor] = collections.OrderedDict()

    def new(self) -> str:
        """A cookie's value."""
        value = secrets.token_urlsafe(32)
        self._known[value] = Visitor(secrets.token_urlsafe(32))
        while len(self._known) > self._most:
            self._known.popitem(last=False)
        return value

    def of(self, cookie: str) -> Visitor | None:
        """The browser that has a cookie; None where no browser has it."""
        # A look-up of 256 random bits in a hash table: its run time does not help to guess them.
        return self._known.get(cookie)


class Guard:
    """Stands before the application (ASGI).

    Args:
        app: what is guarded; its scopes get ``visitor``.
        token: of the printed address.
        hosts: values of ``Host`` that are ours, such as ``127.0.0.1:8750``.
        visitors: browsers that came with the token.
        clients: addresses that may connect beside this computer's own.
    """

    def __init__(
        self,
        app: ASGIApp,
        token: str,
        hosts: Sequence[str],
        visitors: Visitors,
        clients: Sequence[str] = (),
    ) -> None:
        self._app = app
        self._token = token
        self._hosts = frozenset(hosts)
        self._visitors = visitors
        self._clients = frozenset(clients)
        port = next(iter(hosts)).rpartition(":")[2]
        self.cookie = f"lightstage-{port}"  # a browser sends its cookies to every port

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request that may not pass; let the application answer any other."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        answer = self._answer(scope)
        target = self._app if answer is None else answer

        async def sent(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        await target(scope, receive, sent)

    def _answer(self, scope: Scope) -> Response | None:
        """The refusal or redirection of a request; None where the application may answer it."""
        headers = Headers(scope=scope)
        client = (scope.get("client") or ("", 0))[0]
        if client not in ("127.0.0.1", "::1") and client not in self._clients:
            return _no("This computer may not see the page: see --allow-from.")
        host = headers.get("host", "")
        if host not in self._hosts:
            return _no("This address is not the console's: open the one that it printed.")
        query = parse_qs(scope.get("query_string", b"").decode("latin-1"), keep_blank_values=True)
        if TOKEN in query and scope["method"] in SAFE:
            return self._enter(scope, query)
        visitor = self._visitors.of(cookie_parser(headers.get("cookie", "")).get(self.cookie, ""))
        if visitor is None:
            return _no(OPEN_AGAIN, 401)
        if scope["method"] not in SAFE:
            if scope["method"] != "POST":
                return _no("Only GET and POST are answered here.", 405)
            if not _from_our_page(headers, f"http://{host}"):
                return _no("This was sent by another page than the console's own.")
        scope["visitor"] = visitor
        return None

    def _enter(self, scope: Scope, query: dict[str, list[str]]) -> Response:
        """A session for whoever has the token, at the same address without it."""
        given = query.pop(TOKEN)[0]
        if not hmac.compare_digest(given.encode(), self._token.encode()):
            return _no(OPEN_AGAIN, 401)
        rest = urlencode(query, doseq=True)
        # One slash: two would name another computer.
        path = "/" + scope["path"].lstrip("/")
        answer = RedirectResponse(path + (f"?{rest}" if rest else ""), 303)
        answer.set_cookie(
            self.cookie, self._visitors.new(), httponly=True, samesite="strict", path="/"
        )
        return answer


def _from_our_page(headers: Headers, origin: str) -> bool:
    """Whether a POST comes from a page of ours, by its headers.

    A form that is sent without scripts has the origin ``null``, since our pages send no referrer;
    then ``Sec-Fetch-Site``, which the browser alone can set, must state the same origin.
    """
    site = headers.get("sec-fetch-site")
    if headers.get("origin") == "null":
        return site == "same-origin"
    return headers.get("origin") == origin and site in (None, "same-origin")


def same_token(given: str, visitor: Visitor) -> bool:
    """Whether a POST's second token is its session's."""
    return hmac.compare_digest(given.encode(), visitor.csrf.encode())


def _no(text: str, status: int = 403) -> Response:
    return Response(text + "\n", status, media_type="text/plain")
