"""Whether the person who is photographed is in the lab's table of pseudonyms."""

from __future__ import annotations

import difflib
import unicodedata
from pathlib import Path

from lightstage.errors import ConfigError
from lightstage.formats.names import name_problem, pseudonym_problem
from lightstage.formats.values import read_text_lines
from lightstage.session.config import SessionConfig


def require_known(subject: str, config: SessionConfig) -> None:
    """Refuse a subject that the lab's table lacks; a lab without a table knows everybody.

    Args:
        subject: that `check_pseudonym` takes.
        config: names the table.

    Raises:
        ConfigError: no such subject in the table, or a table that cannot be read.
    """
    if config.pseudonyms is None:
        return
    path = Path(config.pseudonyms)
    known = read_pseudonyms(path)
    composed = unicodedata.normalize("NFC", subject)
    if composed in known:
        return
    near = difflib.get_close_matches(composed, known, n=1)
    meant = f" (the nearest known one is {near[0]})" if near else ""
    raise ConfigError(
        path,
        field="subject",
        found=f"no {composed!a}",
        expected="every subject in this table ([session] pseudonyms)",
        hint=f"Add the line {composed} to it, or check for a typing error{meant}.",
    )


def read_pseudonyms(path: Path) -> list[str]:
    """The pseudonyms of a table: one a line; what follows a ``#`` is a comment.

    Raises:
        ConfigError: no such file, none that can be read, or a line that is no pseudonym.
    """
    known = []
    for number, line in enumerate(read_text_lines(path, "a table of pseudonyms"), 1):
        text = unicodedata.normalize("NFC", line.partition("#")[0].strip())
        wanted = (pseudonym_problem(text) or name_problem(text)) if text else None
        if wanted is not None:
            raise ConfigError(
                path,
                field=f"line {number}",
                found=ascii(text[:80]),
                expected=wanted,
                hint="Write one pseudonym a line, such as P07, and comments after a #.",
            )
        known += [text] if text else []
    return known
