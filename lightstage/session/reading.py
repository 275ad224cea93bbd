"""A journal, read: whole, or cut by a crash where a crash can cut it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from lightstage.errors import FormatError
from lightstage.formats.files import check_schema

SCHEMA = "lightstage.journal/2"
FIRST_SCHEMA = "lightstage.journal/1"
Line = dict[str, Any]


def read_journal(path: Path) -> list[Line]:
    """Lines of a journal, in order, as version 2 has them.

    A line that was cut by a crash is passed over where it is the last one or is followed by a
    ``resume``. A line of version 1 gets its place as ``id``, its photographs are take 1, and the
    session's id, there ``id``, is called ``session``.

    Raises:
        FormatError: no journal, of another schema, damaged elsewhere, or with ids out of order.
    """
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise FormatError(path, found="no such file", expected="the journal of a capture") from None
    except OSError as error:
        raise FormatError(path, found=str(error), expected="a readable journal") from None
    lines: list[Line] = []
    torn: FormatError | None = None
    for number, text in enumerate(data.removesuffix(b"\n").split(b"\n"), 1):
        line = _parse(text)
        if line is not None and torn is not None and line["event"] != "resume":
            raise torn
        if line is not None:
            lines.append(line)
            torn = None
        elif torn is None:
            torn = FormatError(
                path,
                field=f"line {number}",
                found=f"{text[:40]!r}",
                expected="a JSON object with an event",
                hint="The journal was changed by hand or by the disk; restore it from a copy.",
            )
        # Several cut lines in a row are a resume that was killed, and its successor's.
    if not lines or lines[0]["event"] != "begin":
        raise FormatError(path, field="line 1", found="something else", expected="the event begin")
    check_schema(path, lines[0], SCHEMA)
    if lines[0]["schema"] == FIRST_SCHEMA:
        return _upgraded(lines)
    for before, after in zip([{"id": 0}, *lines], lines, strict=False):
        if not isinstance(after.get("id"), int) or after["id"] <= before["id"]:
            raise FormatError(
                path,
                field=f"after id {before['id']}",
                found=f"id {after.get('id')!r}",
                expected="a larger one",
            )
    return lines


def _parse(text: bytes) -> Line | None:
    """A line's object; None where it is none."""
    try:
        value = json.loads(text)
    except ValueError:
        return None
    return value if isinstance(value, dict) and isinstance(value.get("event"), str) else None


def _upgraded(lines: list[Line]) -> list[Line]:
    """Lines of version 1 in the words of version 2."""
    upgraded = []
    for number, line in enumerate(lines, 1):
        new = {**line, "id": number}
        if line["event"] == "begin":
            new["session"] = line["id"]
        if line["event"] == "frame":
            new["take"] = 1
        upgraded.append(new)
    return upgraded
