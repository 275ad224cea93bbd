"""The command `watch`: a capture from another terminal, or one that is over."""

from __future__ import annotations

import contextlib
import io
import math
import threading
import time
from pathlib import Path
from typing import get_args

import typer
from rich.console import Console
from rich.text import Text

from lightstage.commands import JsonFlag, finish, output_file
from lightstage.counting import counted
from lightstage.errors import CaptureError, ConfigError, FormatError
from lightstage.formats.files import write_text
from lightstage.operator.attendance import Request
from lightstage.operator.client import LOOK_S, ask, follow
from lightstage.operator.journal_stream import JournalTail
from lightstage.operator.keys import has_keys, heard, key_by_key
from lightstage.operator.screen import Ask, Screen
from lightstage.operator.terminal import Shown
from lightstage.operator.view import View
from lightstage.printable import printable
from lightstage.ways import TYPED

KEYBOARD = 0


def register(app: typer.Typer) -> None:
    """Add the command to an application."""
    app.command("watch")(watch_command)


def watch_command(
    session: Path = typer.Argument(help="Session folder, of a capture that runs or is over."),
    do: str | None = typer.Option(
        None, help="Ask the running capture: retake, accept, abort, pause or resume."
    ),
    picture: Path | None = output_file(
        "--picture",
        help="Write what the terminal shows to this SVG instead of following.",
        suffixes=[".svg"],
        default=None,
    ),
    until: int | None = typer.Option(None, help="With --picture: as it was after this line's id."),
    columns: int = typer.Option(100, min=40, help="With --picture: width in characters."),
    wait: float = typer.Option(
        math.inf,
        help="Wait so many seconds for a session that is not there yet; without it, until Ctrl-C.",
        show_default=False,
    ),
    as_json: bool = JsonFlag,
) -> None:
    """Follow a capture from another terminal, or ask it to pause, retake or stop."""
    if not wait >= 0.0:
        raise ConfigError("--wait", found=str(wait), expected="seconds, 0 or more")
    if session.exists() and not session.is_dir():
        raise ConfigError(
            session, found="a file", expected="a session's folder", hint="Give the folder it is in."
        )
    if do is not None and do not in get_args(Request):
        raise ConfigError("--do", found=repr(do), expected=f"one of {', '.join(get_args(Request))}")
    if do is not None:
        why = ask(session, do)
        if why is not None:
            raise CaptureError(session, field=do, found=why, expected="a capture that can do so")
        finish(f"{session}: {do} is accepted", {"session": str(session), "accepted": do}, as_json)
        return
    if until is not None and picture is None:
        raise ConfigError("--until", found=str(until), expected="--picture beside it")
    view = View(str(session))
    if picture is not None:
        with JournalTail(session / "journal.jsonl") as tail:
            for line in tail.read():
                if until is None or line["id"] <= until:
                    view.receive(line)
        if until is not None and until > view.last_id:
            raise ConfigError("--until", found=str(until), expected=f"at most {view.last_id}")
        keys = ("retake", "pause", "abort") if view.phase == "running" else view.answers
        write_text(picture, drawn(Screen(view, Ask(view.question, keys)), columns))
    else:
        _wait_for(session / "journal.jsonl", wait)
        _watch(session, view)
    gone, ended = view.phase == "gone", view.phase in ("aborted", "complete", "before")
    stopped = gone or view.phase == "aborted"
    again = f"\n  {TYPED.resume(session, view.options)}" if stopped else ""
    finish(
        f"{session}: {view.kept} of {counted(view.wanted, 'photograph')} kept, "
        f"{len(view.done)} of {counted(len(view.patterns), 'pattern')} done, "
        f"{view.phase if ended else 'not over'} at line {view.last_id}"
        f"{', and no capture runs' if gone else ''}{again}",
        {
            "session": str(session),
            "phase": view.phase,
            "photographs": view.kept,
            "wanted": view.wanted,
            "patterns_done": len(view.done),
            "last_id": view.last_id,
            "gone": gone,
        },
        as_json,
    )


def drawn(screen: Screen, columns: int, rows: int = 30) -> str:
    """A screen as an SVG text.

    Args:
        screen: what to draw.
        columns: width in characters.
        rows: height; the screen leaves out what does not fit.
    """
    console = Console(
        file=io.StringIO(),
        record=True,
        width=columns,
        height=rows,
        force_terminal=True,
        color_system="truecolor",
        legacy_windows=False,
    )
    console.print(screen)
    return console.export_svg(title=f"lightstage capture --out {screen.view.session}")


def _wait_for(journal: Path, wait_s: float) -> None:
    """Wait until a capture has begun; FormatError when that takes too long, Ctrl-C ends."""
    if journal.exists() or not wait_s:
        return  # who opens it reports what is wrong with it
    console = Console(stderr=True, highlight=False)
    console.print(
        Text(f"No capture in {printable(journal.parent)} yet: waiting for it. Ctrl-C ends."),
        soft_wrap=True,
    )
    until_s = time.monotonic() + wait_s
    while not journal.exists():
        if time.monotonic() >= until_s:
            raise FormatError(
                journal,
                found=f"no such file within {wait_s:g} s",
                expected="the journal of a capture",
                hint="Is this the folder that the capture was given with --out?",
            )
        time.sleep(LOOK_S)


def _watch(session: Path, view: View) -> None:
    """Show lines as they come, until the capture is over or the watcher leaves."""
    console = Console(stderr=True, highlight=False)
    left = threading.Event()
    attended = console.is_terminal and has_keys(KEYBOARD)

    def press(key: str) -> None:
        if key == "q":
            left.set()

    keys = ("leave",) if attended else ()
    with contextlib.ExitStack() as stack:
        if attended:
            stack.enter_context(key_by_key(KEYBOARD))
            stack.enter_context(heard(KEYBOARD, press))
        shown = stack.enter_context(
            Shown(console, view, lambda: Ask(keys=() if view.over else keys))
        )
        try:
            for line in follow(session, left.is_set):
                shown.receive(line)
            if not left.is_set():  # it was followed to its end, or until its process ended
                view.gone()
        except KeyboardInterrupt:  # Ctrl-C leaves, as q does
            pass
