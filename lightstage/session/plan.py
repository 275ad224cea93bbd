"""What a session is going to hold."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping, Sequence
from typing import Any

from lightstage.errors import ConfigError, LightstageError, one_error
from lightstage.rig import Rig
from lightstage.session.pseudonym import check_consent, check_pseudonym

FILE_NAME = re.compile(r"\w[\w@+.-]{0,99}")
_TAKE = re.compile(r"\.take\d+$")


@dataclasses.dataclass(frozen=True)
class SessionPlan:
    """What a session is going to hold.

    Attributes:
        sequence: names of the patterns, in order; they become folders.
        subject: pseudonym.
        expression: such as ``neutral``.
        levels: of each pattern, (n,) in 0..1 in the rig's order; none where photographs are
            imported.
        consent: id of the record of the subject's consent, None where there is none.
    """

    sequence: tuple[str, ...]
    subject: str = "subject-1"
    expression: str = "neutral"
    levels: Mapping[str, Sequence[float]] = dataclasses.field(default_factory=dict)
    consent: str | None = None

    def checked(self, rig: Rig) -> SessionPlan:
        """The same with its pseudonyms in one spelling.

        Raises:
            ConfigError: what may not be in a session or name a file, all in one message.
        """
        problems: list[LightstageError] = []

        def pseudonym(text: str, field: str) -> str:
            try:
                return check_pseudonym(text, field)
            except ConfigError as error:
                problems.append(error)
                return text

        subject = pseudonym(self.subject, "subject")
        expression = pseudonym(self.expression, "expression")
        if self.consent is not None:
            try:
                check_consent(self.consent)
            except ConfigError as error:
                problems.append(error)
        cameras = [camera.id for camera in rig.cameras]
        for what, names in (("pattern", self.sequence), ("camera", cameras)):
            folded: dict[str, str] = {}
            for name in names:
                if not FILE_NAME.fullmatch(name) or _TAKE.search(name):
                    problems.append(
                        ConfigError(
                            f"{what} {name!r}",
                            found="a name that cannot name a file",
                            expected="letters, digits and _ @ + . -, not ending in .take1",
                        )
                    )
                # Some disks take Cam0 and cam0 for one file.
                if folded.setdefault(name.casefold(), name) != name or names.count(name) > 1:
                    problems.append(
                        ConfigError(
                            f"{what} {name!r}",
                            found=f"another one called {folded[name.casefold()]!r}",
                            expected="names that differ in more than capitals",
                        )
                    )
        if problems:
            raise one_error(problems)
        return dataclasses.replace(self, subject=subject, expression=expression)

    def facts(self) -> dict[str, Any]:
        """As a journal's first line has it."""
        return {
            "subject": self.subject,
            "expression": self.expression,
            "consent": self.consent,
            "sequence": list(self.sequence),
            "levels": {name: [float(x) for x in self.levels[name]] for name in self.levels},
        }
