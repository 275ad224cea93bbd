"""What may stand in a session for a person: a pseudonym, never a name, an address or a path."""

from __future__ import annotations

import re
import unicodedata

from lightstage.errors import ConfigError


def check_pseudonym(text: str, field: str) -> str:
    """A subject, expression or consent record's id as a session may carry it.

    Raises:
        ConfigError: empty, too long, or characters other than letters, digits, space . _ -: a path,
            an e-mail address or a control character must not get into a session.
    """
    # Letters with their accents as one character, however a keyboard or a file name wrote them.
    composed = unicodedata.normalize("NFC", text)
    if not re.fullmatch(r"[\w][\w .-]{0,63}", composed):
        raise ConfigError(
            f"--{field}",
            found=repr(text),
            expected="1 to 64 letters, digits, spaces, dots, hyphens, underscores",
            hint="Use a pseudonym, never a name, an address or a path.",
        )
    return composed
