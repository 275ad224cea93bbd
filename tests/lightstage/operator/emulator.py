"""A small terminal emulator: what stands on the screen after bytes were written and it was resized.

As VTE, kitty and others do it: on the main screen, lines that wrapped are wrapped anew for another
width, and lines come back from the scrollback where the window grows; the alternate screen has no
scrollback, and is cut or padded.
"""

from __future__ import annotations

import codecs
import dataclasses
import re

CODE = re.compile(r"\x1b\[(\??)([0-9;]*)([A-Za-z])")
PART_OF_CODE = re.compile(r"\x1b(?:\[[?0-9;]*)?\Z")


@dataclasses.dataclass
class _Row:
    cells: list[str] = dataclasses.field(default_factory=list)
    goes_on: bool = False
    """Whether the row below it is the rest of the same line."""

    def put(self, column: int, character: str) -> None:
        self.cells += " " * (column + 1 - len(self.cells))
        self.cells[column] = character

    def text(self) -> str:
        return "".join(self.cells).rstrip()


@dataclasses.dataclass
class _Page:
    """Rows, the visible ones last; the cursor's row counts from the first of all."""

    columns: int
    rows: int
    scrollback: bool
    lines: list[_Row] = dataclasses.field(default_factory=lambda: [_Row()])
    row: int = 0
    column: int = 0

    @property
    def top(self) -> int:
        return max(0, len(self.lines) - self.rows)

    def visible(self) -> list[str]:
        shown = [row.text() for row in self.lines[self.top :]]
        return shown + [""] * (self.rows - len(shown))

    def write(self, character: str) -> None:
        if self.column >= self.columns:
            self.lines[self.row].goes_on = True
            self.line_feed()
            self.column = 0
        self.lines[self.row].put(self.column, character)
        self.column += 1

    def line_feed(self) -> None:
        self.row += 1
        if self.row == len(self.lines):
            self.lines.append(_Row())
            if not self.scrollback and len(self.lines) > self.rows:
                del self.lines[0]
                self.row -= 1

    def move(self, row: int, column: int) -> None:
        """To a visible row, counted from the top of the screen."""
        self.row = self.top + max(0, min(row, self.rows - 1))
        self.lines += [_Row() for _ in range(self.row + 1 - len(self.lines))]
        self.column = max(0, min(column, self.columns - 1))

    def erase_row(self, how: str) -> None:
        cells = self.lines[self.row].cells
        if how in ("", "0"):
            del cells[self.column :]
        elif how == "2":
            cells.clear()
        else:
            raise AssertionError(f"not known: erase in line {how!r}")

    def erase_screen(self, how: str) -> None:
        if how == "2":
            self.lines[self.top :] = [_Row() for _ in self.lines[self.top :]]
        elif how in ("", "0"):
            self.erase_row(how)
            self.lines[self.row + 1 :] = [_Row() for _ in self.lines[self.row + 1 :]]
        else:
            raise AssertionError(f"not known: erase in display {how!r}")

    def resize(self, columns: int, rows: int) -> None:
        if self.scrollback:
            self._wrap_anew(columns)
        else:
            for row in self.lines:
                del row.cells[columns:]
            row = self.row - self.top
            below = max(0, len(self.lines) - rows)
            above = max(0, row - rows + 1)  # the cursor stays in view
            self.lines = self.lines[above : len(self.lines) - (below - above)]
            self.row = min(row - above, len(self.lines) - 1)
        self.columns, self.rows = columns, rows
        self.column = min(self.column, columns - 1)

    def _wrap_anew(self, columns: int) -> None:
        while len(self.lines) > self.row + 1 and not self.lines[-1].text():
            self.lines.pop()
        whole: list[list[str]] = []
        cursor, goes_on = (0, 0), False
        for number, row in enumerate(self.lines):
            if not goes_on:
                whole.append([])
            if number == self.row:
                cursor = (len(whole) - 1, len(whole[-1]) + self.column)
            whole[-1] += row.cells
            goes_on = row.goes_on
        self.lines = []
        for number, cells in enumerate(whole):
            if number == cursor[0]:
                self.row = len(self.lines) + min(cursor[1], max(0, len(cells) - 1)) // columns
                self.column = cursor[1] % columns
            pieces = [cells[at : at + columns] for at in range(0, len(cells), columns)] or [[]]
            self.lines += [_Row(piece, True) for piece in pieces]
            self.lines[-1].goes_on = False


class Emulator:
    """Fed with what a program writes; control codes that it does not know fail the test."""

    def __init__(self, columns: int, rows: int) -> None:
        self._main = _Page(columns, rows, scrollback=True)
        self._page = self._main
        self._decode = codecs.getincrementaldecoder("utf-8")().decode
        self._pending = ""
        self.cursor_shown = True

    @property
    def alternate(self) -> bool:
        """Whether the alternate screen is shown."""
        return self._page is not self._main

    @property
    def screen(self) -> list[str]:
        """What is seen, row by row, without blanks at the ends."""
        return self._page.visible()

    @property
    def history(self) -> list[str]:
        """All of the main screen, with what was scrolled out of view."""
        return [row.text() for row in self._main.lines]

    def resize(self, columns: int, rows: int) -> None:
        """As somebody who drags the window's corner."""
        for page in {id(page): page for page in (self._main, self._page)}.values():
            page.resize(columns, rows)

    def feed(self, piece: bytes) -> None:
        """What the program wrote."""
        text = self._pending + self._decode(piece)
        part = PART_OF_CODE.search(text)
        self._pending = part[0] if part else ""
        text = text[: len(text) - len(self._pending)]
        at = 0
        for code in CODE.finditer(text):
            self._plain(text[at : code.start()])
            self._control(*code.groups())
            at = code.end()
        self._plain(text[at:])

    def _plain(self, text: str) -> None:
        for character in text:
            if character == "\r":
                self._page.column = 0
            elif character == "\n":
                self._page.line_feed()
            elif character.isprintable():
                self._page.write(character)
            else:
                raise AssertionError(f"not known: {character!r}")

    def _control(self, private: str, numbers: str, letter: str) -> None:
        page = self._page
        if private:
            assert (numbers, letter) in {(n, s) for n in ("25", "1049") for s in "hl"}
            self._mode(int(numbers), letter == "h")
        elif letter == "A":
            page.move(page.row - page.top - int(numbers or 1), page.column)
        elif letter == "H":
            row, _, column = numbers.partition(";")
            page.move(int(row or 1) - 1, int(column or 1) - 1)
        elif letter == "K":
            page.erase_row(numbers)
        elif letter == "J":
            page.erase_screen(numbers)
        elif letter != "m":
            raise AssertionError(f"not known: ESC [ {numbers}{letter}")

    def _mode(self, number: int, on: bool) -> None:
        if number == 25:
            self.cursor_shown = on
        elif on:
            self._page = _Page(self._main.columns, self._main.rows, scrollback=False)
        else:
            self._page = self._main
