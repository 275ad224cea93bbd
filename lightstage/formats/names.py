"""Which texts may name a person, and which a consent record."""

from __future__ import annotations

import re
import unicodedata
from pathlib import Path

from lightstage.errors import FormatError

LONGEST = 64
RESERVED = frozenset(
    ["con", "prn", "aux", "nul", *(f"{port}{n}" for port in ("com", "lpt") for n in range(10))]
)
"""Device names that no file may have on Windows, whatever follows a dot."""
SCRIPTS = ("LATIN", "GREEK", "CYRILLIC")
"""Scripts whose letters look alike."""


def pseudonym_problem(text: str) -> str | None:
    """Why a text may not name a person in a session; None where it can.

    Refused are paths, addresses, control and invisible characters, letters that only resemble
    others (full width, mathematical, scripts mixed so that two subjects resemble each other), names
    that a file system changes (a dot or space at the end) or keeps for itself.

    Args:
        text: composed (NFC).
    """
    if not re.fullmatch(rf"\w[\w .-]{{0,{LONGEST - 1}}}", text):
        return "letters, digits, spaces, dots, hyphens and underscores, 1 to 64"
    if unicodedata.normalize("NFKC", text) != text:
        return "plain letters (no full-width or styled ones)"
    if text[-1] in ". " or ".." in text:
        return "no dot or space at the end, no two dots together"
    if text.split(".")[0].rstrip().casefold() in RESERVED:
        return "no name that a system keeps for itself"
    scripts = {s for s in SCRIPTS for c in text if unicodedata.name(c, "").startswith(s)}
    if len(scripts) > 1:
        return f"letters of one script, not of {' and '.join(sorted(scripts))} (they look alike)"
    return None


def name_problem(text: str) -> str | None:
    """Why a pseudonym of a person may be a name; None where it cannot be taken for one.

    Names have a first and a last part, or letters that a pseudonym does not need. Refused are
    blanks, and without any digit also a second part and letters other than a to z.

    Args:
        text: that `pseudonym_problem` takes.
    """
    plain = re.fullmatch(r"[A-Za-z]+", text)
    if " " in text or not (plain or re.search(r"[0-9]", text)):
        return "one word of letters a to z, or one with a digit, such as P07 or subject-12"
    return None


def require_pseudonym(text: object, where: str | Path, field: str) -> str:
    """A file's subject or expression, in one spelling.

    A name with a blank is taken here, as sessions of before such were refused may have one.

    Args:
        text: from the file.
        where: the file.
        field: of the file.

    Raises:
        FormatError: no text, or one that `pseudonym_problem` refuses.
    """
    composed = unicodedata.normalize("NFC", text) if isinstance(text, str) else ""
    wanted = pseudonym_problem(composed) if composed else "a pseudonym"
    if wanted is not None:
        shown = "none" if text is None else ascii(text)
        raise FormatError(
            where,
            field=field,
            found=shown if len(shown) <= 80 else f"{shown[:80]}..",
            expected=wanted,
            hint="The file was changed by hand or by another program: name a pseudonym such as "
            "P07 in it, never a name, an address or a path.",
        )
    return composed


def consent_problem(text: str) -> str | None:
    """Why a text is no id of a consent record; None where it is.

    An id is 2 to 64 ASCII letters, digits and ``. _ -``, begins with a letter or digit, ends with
    one, and holds at least one digit: a number in a list, never a name.
    """
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]{0,62}[A-Za-z0-9]", text):
        return "2 to 64 letters (a to z), digits, dots, hyphens and underscores"
    if ".." in text:
        return "no two dots together"
    if not re.search(r"[0-9]", text):
        return "an id with a digit, such as C-2026-0041, never a name"
    return None
