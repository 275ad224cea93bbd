"""The command `sessions`: what a folder of sessions holds."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import typer

from lightstage.commands import JsonFlag, finish
from lightstage.commands.tables import print_table
from lightstage.counting import counted
from lightstage.day.sessions import Seen, in_words, sessions_of
from lightstage.errors import FormatError

TITLES = ("session", "subject", "expression", "began (UTC)", "state", "check", "processed")
SIGNS = {"whole": "+", "running": ">", "unfinished": "-", "damaged": "X"}
"""Before a session's state, so that no colour is needed to distinguish it."""


def register(app: typer.Typer) -> None:
    """Add the command to an application."""
    app.command("sessions")(sessions_command)


def sessions_command(
    folder: Path = typer.Argument(help="Folder of sessions, or one session."),
    processed: Path | None = typer.Option(
        None, help="Folder of processed folders: which sessions were processed, and where."
    ),
    as_json: bool = JsonFlag,
) -> None:
    """List the sessions of a folder: whose, of when, whole, checked and processed or not."""
    if processed is not None and not processed.is_dir():
        raise FormatError(
            processed,
            field="--processed",
            found="a file" if processed.exists() else "no such folder",
            expected="a folder of processed folders",
        )
    seen = sessions_of(folder, processed)
    if not seen:
        raise FormatError(
            folder,
            found="no session in it",
            expected="a folder that holds sessions' folders",
            hint="Name the folder above the one that a capture was given with --out.",
        )
    if not as_json:
        print_table(TITLES, map(_cells, seen))
    finish(
        f"{folder}: {counted(len(seen), 'session')}, {in_words(seen)}",
        {"folder": str(folder), "sessions": [_facts(each) for each in seen]},
        as_json,
    )


def _cells(each: Seen) -> list[str]:
    state = f"{SIGNS[each.state]} {each.state}"
    if each.kept < each.wanted:
        state += f", {each.kept} of {each.wanted}"
    if each.accepted:
        state += f", {counted(each.accepted, 'pattern')} accepted with faults"
    checked = f"{each.checked}: {each.why.splitlines()[0]}" if each.why else each.checked
    made = ", ".join(path.name for path in each.processed) or "no"
    return [
        each.root.name, each.subject, each.expression, each.date, state, checked, made
    ]  # fmt: skip


def _facts(seen: Seen) -> dict[str, Any]:
    facts = dataclasses.asdict(seen)
    return {**facts, "root": str(seen.root), "processed": [str(path) for path in seen.processed]}
