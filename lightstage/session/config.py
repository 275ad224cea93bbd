"""What a lab wants of every session of a person."""

from __future__ import annotations

import dataclasses

from lightstage.formats.access import Group


@dataclasses.dataclass(frozen=True)
class SessionConfig:
    """What a lab wants of every session of a person.

    Attributes:
        require_consent: refuse a session without the id of the record of the person's consent;
            otherwise such a session begins with a warning.
        pseudonyms: a table of the lab's pseudonyms, one a line: a subject that is not in it is
            refused. Without one, a subject that may be a person's name is.
        group: what the group of the session's folder may do with it: nothing, read, or write.
            Other users of the computer may do nothing.
    """

    require_consent: bool = False
    pseudonyms: str | None = None
    group: Group = "nothing"
