"""RESULTS.md: tables of all benchmarks by subject, each with the command that made it."""

from __future__ import annotations

import dataclasses
import re

SUBJECTS = {
    "Capture": (
        *("acquisition", "capture_", "check_", "console", "fault", "gphoto2", "kill_matrix"),
        "leds",
    ),
    "Calibration": ("colour_calibration", "geometry_motion", "geometry_poses", "lights"),
    "Maps from photographs": ("foreign", "reflectance_"),
    "Mesh": ("geometry_",),
    "Template and registration": ("anthropometry", "landmarks", "registration_", "template_"),
    "Atlas": ("atlas_",),
    "Whole sessions": ("batch", "session_"),
    "Dataset": ("dataset", "reidentify"),
    "Renderer": ("render_",),
    "Networks": ("networks", "paper_", "training", "upscale"),
    "One photograph": ("avatar", "domain_light", "likeness", "photo"),
    "Simulated stage": ("sim_",),
}
"""Subject to how its benchmarks' names begin; the first that fits holds a benchmark's tables."""
HEAD = (
    "# Results\n\n"
    "The newest table of each benchmark; older ones are in the history of this file. A table names "
    "the command that made it,\nits date, commit and machine. `make bench-stale` lists those whose "
    "code has changed since.\n"
)
_MADE = re.compile(r"`python -m benchmarks\.(\w+)(.*?)`, (\S+), commit (\S+), (.*)")


@dataclasses.dataclass(frozen=True)
class Table:
    """One table of RESULTS.md.

    Attributes:
        title: of its section.
        script: name of the benchmark in `benchmarks`.
        options: of its command line, with a space before, or empty.
        date: ISO.
        commit: abbreviated hash of what ran.
        machine: cores, memory and processor.
        body: note and table, in Markdown.
    """

    title: str
    script: str
    options: str
    date: str
    commit: str
    machine: str
    body: str

    @property
    def subject(self) -> str:
        """The heading it is under."""
        return subject_of(self.script)

    def text(self) -> str:
        """Its section."""
        made = f"`python -m benchmarks.{self.script}{self.options}`, {self.date}, commit "
        return f"### {self.title}\n\n{made}{self.commit}, {self.machine}\n\n{self.body.strip()}\n"


def subject_of(script: str) -> str:
    """The subject of a benchmark by its name.

    Raises:
        ValueError: none of `SUBJECTS` names it.
    """
    for subject, names in SUBJECTS.items():
        if script.startswith(names):
            return subject
    raise ValueError(f"benchmarks/{script}.py: SUBJECTS of results_file.py names no subject for it")


def read_tables(text: str) -> list[Table]:
    """The tables of RESULTS.md.

    Raises:
        ValueError: a section does not state how it was made.
    """
    tables = []
    for part in re.split(r"^### ", text, flags=re.MULTILINE)[1:]:
        title, _, rest = part.partition("\n")
        # What follows the table is the heading of the next subject.
        rest = re.split(r"^## ", rest, flags=re.MULTILINE)[0]
        made = _MADE.match(rest.strip())
        if made is None:
            raise ValueError(f"RESULTS.md, {title!r}: no line that says how it was made")
        body = rest.strip()[made.end() :].strip()
        script, options, date, commit, machine = made.groups()
        tables.append(Table(title, script, options, date, commit, machine, body))
    return tables


def results_text(tables: list[Table]) -> str:
    """RESULTS.md: subjects in the order of `SUBJECTS`, their tables by script and title."""
    contents, sections = "", ""
    for subject in SUBJECTS:
        some = [table for table in tables if table.subject == subject]
        if not some:
            continue
        contents += f"- [{subject}](#{anchor(subject)})\n"
        sections += f"\n## {subject}\n"
        for table in sorted(some, key=lambda table: (table.script, table.title)):
            contents += f"  - [{table.title}](#{anchor(table.title)})\n"
            sections += "\n" + table.text()
    return f"{HEAD}\n{contents}{sections}"


def anchor(title: str) -> str:
    """The link to a heading, as Markdown readers make it."""
    return re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-")


def with_table(tables: list[Table], table: Table) -> list[Table]:
    """The tables with one more, in place of that of its title."""
    return [*(other for other in tables if other.title != table.title), table]
