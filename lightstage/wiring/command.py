"""The command `lights identify`."""

from __future__ import annotations

import contextlib
import os
import sys
from pathlib import Path

import typer

from lightstage.capture.config import read_config
from lightstage.commands import JsonFlag, finish, make_app, output_file
from lightstage.counting import counted
from lightstage.errors import ConfigError
from lightstage.operator.keys import ESCAPES, key_by_key
from lightstage.rig import Rig, load_rig, save_rig
from lightstage.wiring.identify import identify
from lightstage.wiring.walk import STEPS, corrections

LEVEL = 0.5
"""Level of the lamp that shines: plain to see, and a lamp bears it as long as anybody looks."""
MOST_CHANNELS = 65535
DIGITS = "0123456789"


def register(app: typer.Typer) -> None:
    """Add the group `lights` to an application."""
    group = make_app("Light single lamps: which one is on which wire.")
    group.command("identify")(identify_command)
    app.add_typer(group, name="lights")


def identify_command(
    rig: Path = typer.Option(..., "--rig", help="rig.json: the places of the lamps."),
    leds: str = typer.Option(..., help="The LED device, as for `capture`."),
    out: Path = output_file(
        "--out",
        help="The corrected rig, .json; may be the rig itself.",
        suffixes=[".json"],
        shared=True,
    ),
    level: float = typer.Option(LEVEL, min=0.01, max=1.0, help="Of the lamp that shines."),
    channels: int | None = typer.Option(
        None,
        min=1,
        max=MOST_CHANNELS,
        help="Of a device that does not report how many it has, if more than the rig needs.",
    ),
    config: Path | None = typer.Option(
        None, "--config", help="TOML with other limits of light than the defaults, as `capture`'s."
    ),
    as_json: bool = JsonFlag,
) -> None:
    """Light one lamp after the other, and correct the rig's addresses by what is seen."""
    settings = read_config(config)
    the_rig = load_rig(rig)

    def save(changed: Rig) -> None:
        save_rig(changed, out)

    with contextlib.ExitStack() as stack:
        if sys.stdin.isatty():
            stack.enter_context(key_by_key(sys.stdin.fileno()))
            ask = Keys(sys.stdin.fileno()).ask
        else:
            ask = Lines().ask
        found = identify(the_rig, leds, ask, _print_line, save, settings.safety, level, channels)
    changes = corrections(the_rig, found)
    for change in changes:
        _print_line(change)
    finish(
        f"{out}: {counted(len(changes), 'address', 'addresses')} corrected"
        if changes
        else f"{rig}: no address corrected, nothing written",
        {"rig": str(out) if changes else None, "corrected": changes},
        as_json,
    )


class Keys:
    """The operator's keys at a terminal: one key is one step, and only a number ends with Enter.

    Args:
        handle: of a terminal that gives each key at once (`key_by_key`).
    """

    def __init__(self, handle: int) -> None:
        self._handle = handle

    def ask(self, question: str) -> str:
        """Print a question and return the line that a key or a number makes; EOFError at the end.

        Several keys at once, such as a paste, are one step at most.
        """
        print(question, end="", file=sys.stderr, flush=True)
        typed = ""
        while True:
            piece = os.read(self._handle, 1024)
            if not piece:
                raise EOFError
            if ESCAPES.fullmatch(piece):  # an arrow is no step; Escape takes back what was typed
                self._echo("\b \b" * len(typed))
                typed = ""
                continue
            for key in ESCAPES.sub(b"", piece).decode(errors="replace").lower():
                if key in "\r\n" or (not typed and key in (" ", *STEPS)):
                    self._echo(f"{key.strip()}\n")
                    return typed or key.strip()
                if key in "\x7f\b" and typed:
                    self._echo("\b \b")
                    typed = typed[:-1]
                elif key in DIGITS or (not typed and key in ("c", "s")):
                    self._echo(key)
                    typed += key

    def _echo(self, text: str) -> None:
        print(text, end="", file=sys.stderr, flush=True)


class Lines:
    """The operator's lines from a pipe, one for each step.

    Raises:
        ConfigError: none, before a light goes on.
    """

    def __init__(self) -> None:
        self._first: str | None = sys.stdin.readline()
        if not self._first:
            raise ConfigError(
                "standard input",
                found="no terminal and no line",
                expected="somebody who reports what is seen",
                hint="Start it in a terminal, or pipe one line for each step: a lamp's "
                "number, Enter for the next, c NUMBER, s NUMBER, q.",
            )

    def ask(self, question: str) -> str:
        """Print a question and return the line; EOFError at the end."""
        print(question, end="", file=sys.stderr, flush=True)
        line, self._first = self._first or sys.stdin.readline(), None
        if not line:
            raise EOFError
        return line


def _print_line(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
