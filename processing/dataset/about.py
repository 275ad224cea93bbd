"""The lab's statements on a release, in a TOML file: licence, terms, who made it, answers.

name = "Skin patches of our lab"
license = "https://creativecommons.org/licenses/by-nc/4.0/"
terms = "For research on skin. Nobody may try to find out who is shown."
creators = ["Our Lab, Our University"]
contact = "dataset@example.org"
url = "https://example.org/skin-patches"
version = "1.0.0"

[answers]
purpose = "To train networks that find how skin reflects light."
"""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

from lightstage.errors import ConfigError, LightstageError, one_error
from lightstage.formats.config import make_config, read_toml

LONGEST = 10_000
"""Characters of a text."""
SHORT = ("name", "license", "contact", "url", "version")
"""Fields of one line."""
LONGEST_LINE = 500


@dataclasses.dataclass(frozen=True)
class Answers:
    """What the software cannot know of a data set; the datasheet lists what is empty as open.

    Attributes:
        purpose: for what it was made.
        funding: who paid for it.
        recruitment: who was invited to take part, how, and what they were paid.
        timeframe: over which time people were captured.
        ethics_review: which board reviewed the work, and its decision.
        consent: what people agreed to after which explanation, and how they withdraw.
        impact: what the set may do to those who are shown, and who studied that.
        prior_uses: what it was used for.
        unsuitable_uses: what it must not be used for.
        representation: whom the people represent, and who is missing.
        restrictions: other people's rights, and laws on its export.
        maintenance: who keeps it, corrects it, and takes people out; what becomes of old versions.
    """

    purpose: str = ""
    funding: str = ""
    recruitment: str = ""
    timeframe: str = ""
    ethics_review: str = ""
    consent: str = ""
    impact: str = ""
    prior_uses: str = ""
    unsuitable_uses: str = ""
    representation: str = ""
    restrictions: str = ""
    maintenance: str = ""


@dataclasses.dataclass(frozen=True)
class About:
    """The lab's statements on a release. All but `version`, `citation` and `answers` are required.

    Attributes:
        name: of the data set.
        license: its address, or its SPDX name.
        terms: what may be done with the set, and what not, in words.
        creators: organisations that made it.
        contact: where somebody who is shown, or who uses it, writes to.
        url: its page.
        version: MAJOR.MINOR.PATCH; a release with other patches is another MAJOR.
        citation: how it is cited, best in BibTeX.
        answers: to the datasheet's questions.
    """

    name: str = ""
    license: str = ""
    terms: str = ""
    creators: tuple[str, ...] = ()
    contact: str = ""
    url: str = ""
    version: str = "1.0.0"
    citation: str = ""
    answers: Answers = dataclasses.field(default_factory=Answers)

    def __post_init__(self) -> None:
        """Refuse what lacks a field that must be given, or has one that is none."""
        missing = [name for name in NEEDED if not _answered(getattr(self, name))]
        if missing:
            raise ConfigError(
                "the lab's statements on the release",
                found=f"no {', no '.join(missing)}",
                expected=f"{', '.join(NEEDED)}",
                hint="Only the lab can decide these. docs/dataset.md has an example.",
            )
        texts = {name: getattr(self, name) for name in (*SHORT, "terms", "citation")}
        texts |= {f"creators[{i}]": each for i, each in enumerate(self.creators)}
        answers = dataclasses.asdict(self.answers)
        texts |= {f"answers.{name}": text for name, text in answers.items()}
        problems: list[LightstageError] = []
        for name, text in texts.items():
            line = name in SHORT or name.startswith("creators")
            wanted = _problem(text, LONGEST_LINE if line else LONGEST, line)
            if name == "url" and not wanted and not re.fullmatch(r"https?://[^\s/]\S*", text):
                wanted = "an address that begins with https://"
            if name == "version" and not re.fullmatch(r"\d{1,9}\.\d{1,9}\.\d{1,9}", text):
                wanted = "three numbers, such as 1.0.0"
            if wanted:
                problems.append(
                    ConfigError("release", field=name, found=ascii(text)[:80], expected=wanted)
                )
        if problems:
            raise one_error(problems)

    @property
    def cited_as(self) -> str:
        """How the set is cited: as the lab has it, or by who made it, its name and version."""
        plain = f"{', '.join(self.creators)}: {self.name}, version {self.version}. {self.url}"
        return self.citation.strip() or plain

    @property
    def unanswered(self) -> list[str]:
        """Names of the answers that are missing."""
        return [
            name for name, text in dataclasses.asdict(self.answers).items() if not _answered(text)
        ]


NEEDED = ("name", "license", "terms", "creators", "contact", "url")


def read_about(path: Path | None) -> About:
    """Read the lab's statements on a release.

    Raises:
        ConfigError: no file, no TOML, an unknown key, a field that is missing or none.
    """
    if path is None:
        raise ConfigError(
            "--about",
            found="none",
            expected=f"a TOML file with {', '.join(NEEDED)}",
            hint="Only the lab can decide under which licence and terms its people are shown. "
            "docs/dataset.md has an example.",
        )
    return make_config(About, read_toml(path), path)


def _answered(value: str | tuple[str, ...]) -> bool:
    return any(map(str.strip, value)) if isinstance(value, tuple) else bool(value.strip())


def _problem(text: str, longest: int, one_line: bool) -> str:
    """Why a text may not be in a release; empty where it can."""
    if len(text) > longest:
        return f"at most {longest} characters"
    if not all(c.isprintable() or (c in "\n\t" and not one_line) for c in text):
        return "printable characters on one line" if one_line else "printable characters"
    return ""
