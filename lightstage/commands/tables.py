"""A table of a command: as wide as the terminal, and in a file or a pipe as wide as it needs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

PIPE_COLUMNS = 240


def print_table(titles: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print rows of texts under their titles on stdout; nothing in them is markup."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console(highlight=False)
    if not console.is_terminal:
        console = Console(highlight=False, width=PIPE_COLUMNS)
    table = Table(box=None, pad_edge=False)
    for title in titles:
        table.add_column(title, overflow="fold")
    for row in rows:
        table.add_row(*map(Text, row))
    console.print(table)
