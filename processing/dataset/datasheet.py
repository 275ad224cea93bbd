"""A release's DATASHEET.md: the questions of [Gebru2021], answered from what is known.

What only the lab knows is there as an open question until the lab answers it.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lightstage.formats.files import write_text
from processing.dataset import statements
from processing.dataset.about import About

DATASHEET = "DATASHEET.md"
OPEN = "**Not answered.** Ask the lab: {contact}."


def write_datasheet(folder: Path, about: About, facts: Mapping[str, Any], form: str) -> Path:
    """Write DATASHEET.md into the folder of a release.

    Args:
        folder: of the release.
        about: the lab's statements.
        facts: of dataset.json.
        form: `zarr` or `webdataset`.
    """
    lines = [f"# {about.name}", "", statements.description(facts), ""]
    lines += [
        "This datasheet has the form of *Datasheets for Datasets* (Gebru et al., 2021). What the "
        "software knows it has written; the lab has to give the rest."
    ]
    if about.unanswered:
        lines += ["", f"Not answered by the lab: {', '.join(about.unanswered)}."]
    for section, questions in _sections(about, facts, form).items():
        lines += ["", f"## {section}"]
        for question, answer in questions.items():
            text = answer.strip() or OPEN.format(contact=about.contact)
            lines += ["", f"**{question}**", "", text]
    return write_text(folder / DATASHEET, "\n".join(lines) + "\n")


def _sections(about: About, facts: Mapping[str, Any], form: str) -> dict[str, dict[str, str]]:
    """Questions and answers by section; an empty answer is an open question."""
    answers, counts = about.answers, facts["counts"]
    return {
        "Motivation": {
            "For what purpose was the set made?": answers.purpose,
            "Who made it?": ", ".join(about.creators),
            "Who paid for it?": answers.funding,
        },
        "Composition": {
            "What is one instance?": "A patch of skin with five maps. "
            + " ".join(f"`{name}`: {what}." for name, what in statements.MAPS.items()),
            "How many are there?": f"{counts['patches']}, of {counts['subjects']} people.",
            "Is it all that there is, or a sample?": statements.manipulation(facts),
            "Is anything missing?": statements.missing(),
            "Are there labels, or links between instances?": "There are none, on purpose.",
            "Are there recommended splits?": "None. People cannot be distinguished in the set, so "
            "that patches of one person can be on both sides of any split: a test on such a split "
            "gives too good a result.",
            "Are there errors or noise?": statements.errors(facts),
            "Does it need anything else, such as the web?": "No.",
            "Which people does it show?": "\n".join(
                f"- {each}" for each in statements.people(facts)
            ),
            "Whom do they represent, and who is missing?": answers.representation,
            "Can people be recognised?": str(facts["cannot_protect"]),
            "Is anything in it sensitive?": " ".join(statements.personal(facts)),
        },
        "Collection": {
            "How was it collected?": statements.collection(facts),
            "Who was asked to take part, how, and what were they paid?": answers.recruitment,
            "Over which time?": answers.timeframe,
            "Which board reviewed it?": answers.ethics_review,
            "What did people agree to, and how do they withdraw?": answers.consent,
            "What may it do to those who are shown, and who looked into that?": answers.impact,
        },
        "Preprocessing": {
            "What was done with the photographs?": statements.preprocessing(facts),
            "Is the raw data kept?": statements.raw_data(facts),
            "Is the software available?": "Yes: lightstage, Apache License 2.0.",
        },
        "Uses": {
            "What was it used for before?": answers.prior_uses,
            "What is it fit for?": " ".join(statements.uses()),
            "What must it not be used for?": answers.unsuitable_uses,
        },
        "Distribution": {
            "Under which licence?": about.license,
            "On which terms?": about.terms,
            "In which form?": f"For {statements.READ_BY[form]}. `checksums.json` has the SHA-256 "
            "of every file, `croissant.json` the description for machines.",
            "Where is it?": about.url,
            "Do others hold rights, or do laws on export apply?": answers.restrictions,
        },
        "Maintenance": {
            "Whom does one write to?": about.contact,
            "Who keeps it, corrects it, and takes people out?": answers.maintenance,
            "What becomes of old versions?": "Nobody can call back what was copied. A later "
            "release leaves out other patches, and people who withdrew.",
            "How is it cited?": about.cited_as,
        },
    }
