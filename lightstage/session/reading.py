"""A journal, read: whole, or cut by a crash where a crash can cut it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from lightstage.errors import FormatError
from lightstage.formats.files import check_schema
from lightstage.formats.values import LINE, LINES_BYTES, parse_json, read_regular
from lightstage.session.events import Line, check_lines

SCHEMA = "lightstage.journal/2"
FIRST_SCHEMA = "lightstage.journal/1"


def last_run(lines: Sequence[Line]) -> Sequence[Line]:
    """Lines from which on a session was last resumed; all where it never was."""
    resumed = [place for place, line in enumerate(lines) if line["event"] == "resume"]
    return lines[max(resumed, default=0) :]


def read_journal(path: Path) -> list[Line]:
    """Lines of a journal, in order, as version 2 has them.

    A line that was cut by a crash is passed over where it is the last one or is followed by a
    ``resume``. A line of version 1 gets its place as ``id``, its photographs are take 1, and the
    session's id, there ``id``, is called ``session``.

    Raises:
        FormatError: no journal, of another schema, damaged elsewhere, with ids out of order, or
            with a line whose fields are not those of its event (`events`).
    """
    data = read_regular(path, LINES_BYTES, "the journal of a capture")
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
        raise no_journal(path, data)
    check_schema(path, lines[0], SCHEMA)
    if lines[0]["schema"] == FIRST_SCHEMA:
        lines = _upgraded(lines)
    for before, after in zip([{"id": 0}, *lines], lines, strict=False):
        if type(after.get("id")) is not int or after["id"] <= before["id"]:
            raise FormatError(
                path,
                field=f"after id {before['id']}",
                found=f"id {after.get('id')!r}",
                expected="a larger one",
            )
    check_lines(lines, path)
    return lines


def no_journal(path: Path, data: bytes) -> FormatError:
    """The error of a file that does not begin as a journal does; `data` is its first bytes."""
    text = data.split(b"\n", 1)[0][:40].decode(errors="replace").strip()
    return FormatError(
        path,
        field="line 1",
        found=repr(text) if text else "nothing",
        expected="the event begin of a capture's journal",
        hint="Restore the journal from a copy, or move another program's file out of the session's "
        "folder.",
    )


def _parse(text: bytes) -> Line | None:
    """A line's object; None where it is none."""
    try:
        value = parse_json(text, "journal", LINE)
    except FormatError:
        return None
    return value if isinstance(value, dict) and isinstance(value.get("event"), str) else None


def _upgraded(lines: list[Line]) -> list[Line]:
    """Lines of version 1 in the words of version 2."""
    upgraded = []
    for number, line in enumerate(lines, 1):
        new = {**line, "id": number}
        if line["event"] == "begin":
            new["session"] = line.get("id")
        if line["event"] == "frame":
            new["take"] = 1
        upgraded.append(new)
    return upgraded
