"""A program whose commands are imported when they are called, not when their names are listed.

`lightstage --help` lists all commands; the code behind them takes ten times as long to import.
"""

from __future__ import annotations

import importlib
from typing import Any, ClassVar

import typer

from lightstage.commands.app import SummarisedGroup


def lazy_group(table: dict[str, tuple[str, str]]) -> type[SummarisedGroup]:
    """A group class for `make_app`.

    Args:
        table: a command's name to the module whose `register(app)` adds it, and the first
            sentence of its help.
    """

    class Group(SummarisedGroup):
        lazy: ClassVar = table

        def list_commands(self, ctx: Any) -> list[str]:
            return [*self.lazy, *super().list_commands(ctx)]

        def get_command(self, ctx: Any, cmd_name: str) -> Any:
            if cmd_name in self.lazy and cmd_name not in self.commands:
                app = typer.Typer(rich_markup_mode=None)
                app.callback()(_nothing)  # or an application of one command would be that command
                importlib.import_module(self.lazy[cmd_name][0]).register(app)
                self.commands[cmd_name] = typer.main.get_group(app).commands[cmd_name]
            return super().get_command(ctx, cmd_name)

        def summaries(self, ctx: Any) -> list[tuple[str, str]]:  # noqa: ARG002  as it is called
            return [(name, summary) for name, (_, summary) in self.lazy.items()]

    return Group


def _nothing() -> None:
    """The part before every command's name."""
