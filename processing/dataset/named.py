"""Where a pseudonym is named: in names of files, in texts, and in tables and letters of offices."""

from __future__ import annotations

import codecs
import contextlib
import json
import re
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path

TEXT_BYTES = 1 << 26
"""A longer text is not searched."""
HEAD_BYTES = 1 << 13
"""A file with a zero among its first bytes is no text; pictures and arrays have one there."""
UTF_16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
OFFICE = frozenset(f".{name}" for name in ("xlsx", "docx", "pptx", "ods", "odt", "odp"))
"""Suffixes of archives of XML texts: a lab's table of pseudonyms is often one."""
UNREADABLE = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError)
"""What a damaged or encrypted one ends in: nobody reads a name there either."""


def names_subject(path: Path, subject: str) -> bool:
    """Whether a file has a pseudonym as a word in its name or in its text.

    A file is a text by its bytes, whatever its suffix: UTF-8, or UTF-16 with its mark, as tables
    are saved in.

    Args:
        path: a file; of a folder or a link only the name counts.
        subject: the pseudonym.
    """
    word = _word(subject)
    return bool(word.search(path.name)) or any(word.search(text) for text in _texts(path))


def _texts(path: Path) -> Iterator[str]:
    if path.is_symlink() or not path.is_file():
        return
    if path.suffix.lower() in OFFICE:
        with contextlib.suppress(*UNREADABLE), zipfile.ZipFile(path) as archive:
            for part in archive.infolist():
                if part.file_size <= TEXT_BYTES and part.filename.endswith(".xml"):
                    yield archive.read(part).decode("utf-8", "replace")
        return
    with path.open("rb") as file:
        head = file.read(HEAD_BYTES)
        wide = head.startswith(UTF_16)
        if (wide or b"\0" not in head) and path.stat().st_size <= TEXT_BYTES:
            yield (head + file.read()).decode("utf-16" if wide else "utf-8", "replace")


def _word(subject: str) -> re.Pattern[str]:
    return re.compile(rf"(?<![\w-]){''.join(map(_letter, subject))}(?![\w-])")


def _letter(letter: str) -> str:
    """A pattern of a letter, also as JSON escapes it, ours too, where it is beyond ASCII."""
    if letter.isascii():
        return re.escape(letter)
    return f"(?:{re.escape(letter)}|(?i:{re.escape(json.dumps(letter)[1:-1])}))"
