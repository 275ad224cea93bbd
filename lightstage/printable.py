"""Text from outside, made safe to show: from devices, files, other programs.

A camera's name or a driver's error may hold escape sequences that move the cursor, marks that
turn the order of letters, half characters or sixty thousand letters. Whatever enters from a device
goes through `printable` once, where it enters; then the terminal, the journal, JSON and `watch` are
all safe.
"""

from __future__ import annotations

LONGEST = 300
"""Characters of a device's text that are kept."""
LONGEST_LINES = 4000
"""Characters of one part of an error."""


def printable(value: object, longest: int = LONGEST, squeeze: bool = True) -> str:
    r"""One line of printable characters, of bounded length.

    Control characters, marks of writing direction, half characters (surrogates) and separators
    other than a space are written as Python escapes, such as ``\x1b`` and ``\u202e``.

    Args:
        value: a text, or whatever has one.
        longest: characters at most; a longer text ends with ``…``.
        squeeze: each run of white space becomes one space, and none is at the ends; NUL bytes
            at the ends, with which cameras fill their fields, go too. Otherwise it is escaped.
    """
    text = str(value)
    if squeeze:
        # Cut first, generously: the rest of a very long text need not be read.
        text = " ".join(text[: 16 * longest].strip("\0 \t\r\n").split())
    text = "".join(map(_escaped, text[: longest + 1]))
    return text if len(text) <= longest else f"{text[: longest - 1]}…"


def printable_lines(value: object, longest: int = LONGEST_LINES) -> str:
    """The same for a text that may have several lines, such as five errors in one message.

    Args:
        value: a text, or whatever has one.
        longest: characters at most.
    """
    text = str(value)
    if text.isprintable() and len(text) <= longest:
        return text
    lines = text[: longest + 1].split("\n")
    text = "\n".join("".join(map(_escaped, line)) for line in lines)
    return text if len(text) <= longest else f"{text[: longest - 1]}…"


def _escaped(character: str) -> str:
    return character if character.isprintable() else ascii(character)[1:-1]
