"""The operator at a terminal: the picture, the keys, the questions."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, get_args

from rich.console import Console
from rich.live import Live

from lightstage.findings import Finding
from lightstage.interrupts import on_signals
from lightstage.operator.attendance import (
    Decision,
    OperatorConfig,
    Request,
    Requests,
    Wish,
    by_rule,
    possible_answers,
)
from lightstage.operator.cells import sayable
from lightstage.operator.keys import has_keys, heard, key_by_key
from lightstage.operator.screen import Ask, Screen
from lightstage.operator.view import View
from lightstage.operator.window import Scroll
from lightstage.operator.words import HEARD, KEYS, Notice, heard_words, notice_of, text_of

PICTURES_PER_S = 5
LINES_WAITING = 1000
"""Lines that wait for a reader of a pipe who has stopped; older ones are left out then."""
LAST_LINES_S = 1.0


class TerminalOperator:
    """Somebody at a terminal, or nobody and a log: `with TerminalOperator(...) as operator`.

    On a terminal it draws the picture anew; into a file or a pipe it writes plain lines. Without
    keys nobody can be asked, and the rule of `config` decides.

    Args:
        console: where to draw.
        session: the session's folder, for what the operator may type.
        config: the rule without keys.
        keys: file descriptor of a terminal whose keys count; None for none.
        elsewhere: whether somebody without a terminal here answers, by `request`.
    """

    def __init__(
        self,
        console: Console,
        session: str | Path = "SESSION",
        config: OperatorConfig | None = None,
        keys: int | None = None,
        elsewhere: bool = False,
    ) -> None:
        self.view = View(str(session))
        self._config = config or OperatorConfig()
        self._keys = keys
        self._asked = keys is not None or elsewhere
        self._requests = Requests()
        self._question: list[Notice] = []
        self._heard = ""
        self._stopped_s: float | None = None
        self._scroll = Scroll()
        self._show = Shown(console, self.view, self._ask_now)
        self._open = contextlib.ExitStack()

    def __enter__(self) -> TerminalOperator:
        with contextlib.ExitStack() as stack:
            if self._keys is not None:  # before they are shown
                stack.enter_context(key_by_key(self._keys))
                stack.enter_context(heard(self._keys, self._press))
            stack.enter_context(self._show)
            stack.enter_context(on_signals(lambda: self.request("abort")))
            self._open = stack.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._open.close()

    def receive(self, line: dict[str, Any], old: bool = False) -> None:
        """A line that is in the journal now, or `old` from before a resume; never waits."""
        self._requests.receive(line)
        if text_of(line, "event") in ("lit", "note") and not self._requests.aborted:
            self._heard = ""
        self._scroll = Scroll()
        self._show.receive(line, old)

    def command(self) -> Wish | None:
        """What keys and clients of the event stream wish."""
        return self._requests.command()

    def decide(self, findings: Sequence[Finding], retakes_left: int) -> Decision:
        """Show what was found and wait for an answer; somebody at the terminal may always retake.

        Where nobody is there to be asked, the rule decides at once.
        """
        if not self._asked:
            return "abort" if self._requests.aborted else self._by_rule(findings, retakes_left)
        self._scroll = Scroll()
        self._question = [
            notice_of({"event": "finding", **dataclasses.asdict(finding)}) for finding in findings
        ]
        try:
            return self._requests.ask(possible_answers(finding.code for finding in findings))
        finally:
            self._question, self._scroll = [], Scroll()

    def request(self, do: str, pattern: str = "") -> str | None:
        """Asked from elsewhere; why not, or None where it is accepted."""
        # Seen at once, as the lights may take longer; but only where it is going to happen.
        if do == "abort" and self._stopped_s is None and do in self._requests.possible:
            self._heard, self._stopped_s = HEARD[do], time.monotonic()
            self._show.report(Notice("stop", HEARD[do]))
        of = "" if self._question else pattern or self._requests.shown
        why = self._requests.request(do, pattern)
        if why is None:
            self._heard = heard_words(do, of)
        return why

    def at_abort(self, act: Callable[[], None]) -> None:
        """Do this when somebody aborts, in the thread that heard it."""
        self._requests.at_abort(act)

    def _by_rule(self, findings: Sequence[Finding], retakes_left: int) -> Decision:
        return by_rule(findings, retakes_left, self._config)

    def _press(self, key: str) -> None:
        self._scroll.at += {"up": -1, "down": 1}.get(key, 0)
        for do in get_args(Request):
            if KEYS[do][0] == key:
                why = self.request(do)
                if why is not None and not self._requests.aborted:
                    self._heard = f"Not now: {why}."

    def _ask_now(self) -> Ask:
        if self.view.over:
            # No key does anything any more, and of what was heard the stop alone still matters.
            return Ask(heard="" if self._stopped_s is None else HEARD["abort"])
        keys = () if self._keys is None else self._requests.possible
        stopping_s = None if self._stopped_s is None else time.monotonic() - self._stopped_s
        return Ask(tuple(self._question), keys, self._heard, self._scroll, stopping_s)


class Shown:
    """A view on a console, as long as the block lasts.

    Args:
        console: a terminal gets the picture, all else plain lines.
        view: what to show.
        ask: what can be done now.
    """

    def __init__(self, console: Console, view: View, ask: Callable[[], Ask]) -> None:
        self._console = console
        self._view = view
        self._ask = ask
        self._lines: deque[str] = deque(maxlen=LINES_WAITING)
        self._changed = threading.Condition()
        self._over = False
        self._drawing = contextlib.ExitStack()
        self._thread: threading.Thread | None = None

    def __enter__(self) -> Shown:
        if self._console.is_terminal and not self._console.is_dumb_terminal:
            self._drawing.enter_context(
                _drawn_anew(self._console, lambda: Screen(self._view, self._ask()))
            )
        else:
            self._thread = threading.Thread(target=self._print, name="lines", daemon=True)
            self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._drawing.close()
        with self._changed:
            self._over = True
            self._changed.notify()
        if self._thread is not None:
            self._thread.join(LAST_LINES_S)  # a reader who has stopped must not hold a capture

    def receive(self, line: dict[str, Any], old: bool = False) -> None:
        """Take up a line; it is drawn or, where it is not `old`, written soon."""
        words = self._view.receive(line)
        if old or self._thread is None or words.tone == "quiet":
            return
        text = f"{text_of(line, 'time_utc')[11:19]} {words}".strip()
        if text_of(line, "event") == "shot":
            text = f"{text} {self._view.progress()}"
        self._write(text)

    def report(self, words: Notice) -> None:
        """Write what is in no line of the journal; the picture shows it by itself."""
        if self._thread is not None:
            self._write(str(words))

    def _write(self, text: str) -> None:
        with self._changed:
            self._lines.append(text)
            self._changed.notify()

    def _print(self) -> None:
        while True:
            with self._changed:
                while not self._lines and not self._over:
                    self._changed.wait()
                if not self._lines:
                    return
                text = self._lines.popleft()
            try:
                self._console.file.write(sayable(text, self._console.encoding) + "\n")
                self._console.file.flush()
            except (OSError, ValueError):  # the reader has ended, or the file is closed
                return


@contextlib.contextmanager
def _drawn_anew(console: Console, picture: Callable[[], Screen]) -> Iterator[None]:
    """A picture that fills the terminal as long as the block lasts; its last state stays below.

    It is on the terminal's second screen, and each time all of it is drawn from the corner on:
    when the window is resized, a terminal moves and wraps the first screen's lines as it likes, and
    nobody can know where they are then. What others write to sys.stderr comes after the picture,
    since it would be drawn over.
    """
    redirected = io.StringIO()
    console.file = console.file  # the terminal, whatever sys.stderr is meanwhile
    live = Live(
        console=console,
        screen=True,
        get_renderable=picture,
        refresh_per_second=PICTURES_PER_S,
        redirect_stdout=False,
        redirect_stderr=False,
    )

    def leave() -> None:
        with contextlib.suppress(OSError):  # the terminal is closed
            live.stop()
            console.print(picture())
            console.file.write(redirected.getvalue())

    with contextlib.ExitStack() as stack:
        stack.callback(leave)
        stack.enter_context(contextlib.redirect_stderr(redirected))
        live.start(refresh=True)
        yield


@contextlib.contextmanager
def open_operator(
    session: str | Path,
    config: OperatorConfig | None = None,
    ask: bool = True,
    console: Console | None = None,
    keys: int = 0,
    elsewhere: bool = False,
) -> Iterator[TerminalOperator]:
    """The operator of this process: somebody who can be asked only where there are keys and eyes.

    Args:
        session: the session's folder.
        config: the rule where nobody is asked.
        ask: whether somebody may be asked.
        console: where to draw; standard error without it.
        keys: file descriptor whose keys count where it is a terminal of this process.
        elsewhere: whether somebody answers by the event stream where there is no terminal.
    """
    shown = console or Console(stderr=True, highlight=False)
    attended = ask and shown.is_terminal and has_keys(keys)
    own = keys if attended else None
    with TerminalOperator(shown, session, config, own, ask and elsewhere) as operator:
        yield operator
