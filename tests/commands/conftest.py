"""Every command of the four programs, found from their parsers, and a way to run one in here."""

from __future__ import annotations

import dataclasses
import importlib
import signal
import sys
from pathlib import Path
from typing import Any

import pytest
import typer

from lightstage.commands import run_app

LONGEST_S = 30.0
"""A command that takes longer hangs: it is interrupted, so that its test fails and tells which."""
PROGRAMS = ("lightstage", "processing", "learning", "sim")


@dataclasses.dataclass(frozen=True)
class Command:
    """One command of a program.

    Attributes:
        program: package that holds it.
        words: its name, with its group's before it.
        parser: Typer's.
    """

    program: str
    words: tuple[str, ...]
    parser: Any

    def __str__(self) -> str:
        return " ".join((self.program, *self.words))

    @property
    def outputs(self) -> dict[str, Any]:
        """Options that name what is written, by name."""
        named = {option: p for p in self.parser.params for option in p.opts}
        return {name: named[name] for name in ("--out", "--picture") if name in named}

    def words_with(self, option: str, value: Path) -> list[str]:
        """A command line with this output and something for all else that is required."""
        words = [*self.words, option, str(value)]
        for param in self.parser.params:
            if not param.required or option in param.opts:
                continue
            words += [param.opts[0]] if param.opts[0].startswith("-") else []
            words.append("nothing")
        return words


def found_commands() -> list[Command]:
    """All commands, from the parsers."""
    found = []
    for program in PROGRAMS:
        app = importlib.import_module(f"{program}.__main__").app
        _add(found, program, (), typer.main.get_command(app))
    return found


def _add(found: list[Command], program: str, words: tuple[str, ...], parser: Any) -> None:
    for name in parser.list_commands(None):
        below = parser.get_command(None, name)
        if hasattr(below, "commands"):
            _add(found, program, (*words, name), below)
        else:
            found.append(Command(program, (*words, name), below))


COMMANDS = found_commands()


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Give tests `each_command`, or `each_output`: a command and one of its outputs."""
    if "each_command" in metafunc.fixturenames:
        metafunc.parametrize("each_command", COMMANDS, ids=str)
    if "each_output" in metafunc.fixturenames:
        pairs = [(command, option) for command in COMMANDS for option in command.outputs]
        names = [f"{command} {option}" for command, option in pairs]
        metafunc.parametrize("each_output", pairs, ids=names)


@dataclasses.dataclass(frozen=True)
class Ended:
    """How a command ended."""

    code: int
    out: str
    err: str


@pytest.fixture
def run_command(monkeypatch, capsys):
    """A function that runs a program in this process: `run_command("sim", "render", ...)`."""
    signals: tuple[int, ...] = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = [signal.getsignal(number) for number in signals]

    def too_long(*_: object) -> None:
        raise KeyboardInterrupt

    before.append(signal.signal(signal.SIGALRM, too_long))
    signals += (signal.SIGALRM,)

    def run(program: str, *words: Any) -> Ended:
        monkeypatch.setattr(sys, "argv", [f"lightstage-{program}", *map(str, words)])
        capsys.readouterr()
        signal.setitimer(signal.ITIMER_REAL, LONGEST_S)
        try:
            with pytest.raises(SystemExit) as ended:
                run_app(importlib.import_module(f"{program}.__main__").app)
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0)
        said = capsys.readouterr()
        code = ended.value.code
        return Ended(code if isinstance(code, int) else 0, said.out, said.err)

    yield run
    for number, handler in zip(signals, before, strict=True):
        signal.signal(number, handler)
