"""How a command runs and ends: exit codes, errors in words and as JSON, the line of facts."""

from __future__ import annotations

import json
import os
import select
import sys
from typing import Any, cast

import typer
from typer.core import TyperGroup
from typer.exceptions import TyperException

from lightstage.errors import LightstageError, StoppedError
from lightstage.failures import explain
from lightstage.formats.access import private_command
from lightstage.formats.files import without_nan
from lightstage.interrupts import ignore_signals, interrupted, raise_on_signals

JsonFlag = typer.Option(
    False, "--json", help="Print the facts, or the error, as JSON on the last line."
)

ConsentsOption = typer.Option(
    None,
    "--consents",
    envvar="LIGHTSTAGE_CONSENTS",
    help="The lab's registry of consents (TOML or JSON): what is not agreed to is refused.",
    show_envvar=False,
)

BAD_INPUT, DEFECT, INTERRUPTED = 2, 1, 130
"""Exit codes: what a user can mend; a defect of this software; stopped by Ctrl-C, another signal
or a key."""


class SummarisedGroup(TyperGroup):
    """A group of commands whose `--help` lists the whole first sentence of each.

    Typer cuts them to 45 characters, which leaves out what distinguishes a command.
    """

    def summaries(self, ctx: Any) -> list[tuple[str, str]]:
        """Names of the commands, in order, and the first sentence of each one's help."""
        return [
            (name, command.get_short_help_str(limit=sys.maxsize))
            for name in self.list_commands(ctx)
            if (command := self.get_command(ctx, name)) is not None
        ]

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the list; Typer calls this."""
        with formatter.section("Commands"):
            formatter.write_dl(self.summaries(ctx))


def make_app(help_text: str, group: type[SummarisedGroup] = SummarisedGroup) -> typer.Typer:
    """A Typer application with this project's settings and the option --version.

    Args:
        help_text: what `--help` prints of it.
        group: how it finds its commands (`lazy_group`).
    """
    app = typer.Typer(
        cls=group,
        help=help_text,
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        # As markup, `[safety]` in a help text would be taken for a style and vanish.
        rich_markup_mode=None,
    )
    app.callback()(_with_version)
    return app


def _print_version(wanted: bool) -> None:
    if wanted:
        from lightstage import __version__

        print(f"lightstage {__version__}")
        raise typer.Exit


def _with_version(
    version: bool = typer.Option(
        False,
        "--version",
        help="Print the version and exit.",
        callback=_print_version,
        is_eager=True,
    ),
) -> None:
    """The part before every command's name."""


def run_app(app: typer.Typer) -> None:
    """Run an application and exit: 0 done, 2 for what the user can mend, 130 interrupted.

    What the user can mend is one message on stderr; with --json it is also the last line of
    stdout, as {"error": {...}}. Set LIGHTSTAGE_TRACEBACK=1 to see where it was raised. Any other
    exception is a defect, and shows its traceback.

    What the command writes is its owner's alone, whatever the umask, unless its output is `shared`
    (lightstage.commands.outputs) or the lab's group may have it (lightstage.formats.access).
    """
    raise_on_signals()
    as_json = "--json" in sys.argv[1:]
    try:
        with private_command():
            status = typer.main.get_command(app).main(standalone_mode=False)
        sys.stdout.flush()
    except TyperException as error:
        cast(Any, error).show()  # Typer's base class, which is public, does not declare it
        _print_meaning(error)
        _print_json(as_json, type(error).__name__, {"message": error.format_message()})
        sys.exit(error.exit_code)
    except (KeyboardInterrupt, typer.Abort):
        _end_interrupted(as_json)
    except Exception as error:
        # An import or a library that was interrupted can raise an error of its own.
        if interrupted() and not isinstance(error, LightstageError):
            _end_interrupted(as_json)
        _end_with(error, as_json)
    if status == INTERRUPTED:
        _end_interrupted(as_json)
    sys.exit(status if isinstance(status, int) else 0)


def _print_meaning(error: TyperException) -> None:
    """What an option or argument is that is missing or wrong: its line of --help."""
    meant = getattr(getattr(error, "param", None), "help", None)
    if meant:
        print(f"It is: {meant}", file=sys.stderr)


def finish(text: str, facts: dict[str, Any], as_json: bool) -> None:
    """End a command: one line of facts with units, or the same as JSON, null for NaN."""
    print(json.dumps(without_nan(facts), allow_nan=False) if as_json else text)


def _end_with(error: Exception, as_json: bool) -> None:
    """Print an error that the user can mend and exit; raise a defect again."""
    if isinstance(error, BrokenPipeError) and _reader_is_gone():
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(DEFECT)
    explained = explain(error)
    if explained is None:
        raise error
    if os.environ.get("LIGHTSTAGE_TRACEBACK"):
        sys.excepthook(type(error), error, error.__traceback__)
    name, stopped = type(explained).__name__, isinstance(explained, StoppedError)
    if stopped:
        ignore_signals()
    print(explained if stopped else f"{name}: {explained}", file=sys.stderr)
    fields = {
        key: getattr(explained, key) for key in ("where", "field", "found", "expected", "hint")
    }
    _print_json(as_json, name, {"message": str(explained), **fields})
    sys.exit(INTERRUPTED if stopped else BAD_INPUT)


def _reader_is_gone() -> bool:
    """Whether whoever read our output has ended (`| head`): nobody is left to read."""
    poll = select.poll()
    poll.register(1, 0)
    return any(event & select.POLLERR for _, event in poll.poll(0))


def _end_interrupted(as_json: bool) -> None:
    ignore_signals()
    print("Interrupted.", file=sys.stderr)
    _print_json(as_json, "Interrupted", {"message": "Interrupted."})
    sys.exit(INTERRUPTED)


def _print_json(as_json: bool, kind: str, fields: dict[str, str]) -> None:
    if as_json:
        print(json.dumps({"error": {"type": kind, **fields}}))
