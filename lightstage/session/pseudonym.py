"""What may represent a person in a session: a pseudonym, never a name, an address or a path."""

from __future__ import annotations

import unicodedata

from lightstage.errors import ConfigError
from lightstage.formats.names import consent_problem, name_problem, pseudonym_problem


def check_pseudonym(text: str, field: str) -> str:
    """A subject or expression as a session may carry it, in one spelling (`formats.names`).

    Args:
        text: given.
        field: of the session; an ``expression`` is no person's name.

    Raises:
        ConfigError: empty, too long, or what could be a path, an e-mail address, a control
            character, a name that only resembles another, or a person's name.
    """
    # Letters with their accents as one character, however a keyboard or a file name wrote them.
    composed = unicodedata.normalize("NFC", text)
    wanted = pseudonym_problem(composed)
    if wanted is None and field != "expression":
        wanted = name_problem(composed)
    if wanted is not None:
        raise ConfigError(
            f"--{field}",
            found=ascii(text),  # what resembles something else shall not be printed
            expected=wanted,
            hint="Use a pseudonym such as P07 or subject-12, never a name, an address or a path.",
        )
    return composed


def check_consent(text: str) -> str:
    """The id of a consent record as a session may carry it (`formats.names.consent_problem`).

    Raises:
        ConfigError: no such id.
    """
    wanted = consent_problem(text)
    if wanted is not None:
        raise ConfigError(
            "--consent",
            found=ascii(text),
            expected=wanted,
            hint="Give the record's number; the record itself stays where it is.",
        )
    return text
