"""Scans of one person under two names: who is scored must not be trained on by the other name."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from learning.errors import TrainingError
from processing.dataset import Store

KNOWN = "A network knows whom it was trained on: its figures on them do not hold for others."
"""Why nobody may be in both halves."""
NAMED = 6
"""Names that a message gives, at most."""


def require_other_scans(store: Store, trained: Collection[str], held_out: Collection[str]) -> None:
    """Refuse people of whom a network would know what it is measured on.

    Args:
        store: the data.
        trained: pseudonyms of the people trained on.
        held_out: pseudonyms of those who are measured.

    Raises:
        TrainingError: scans of both that were made of the same files.
    """
    whose = {scan.sha256: scan.subject for scan in store.scans if scan.subject in trained}
    same = [
        f"{whose[scan.sha256]} and {scan.subject}"
        for scan in store.scans
        if scan.subject in held_out and scan.sha256 and scan.sha256 in whose
    ]
    if same:
        raise TrainingError(
            store.path,
            field="scans",
            found=f"the same files of {listed(same)}, of whom one is trained on and one held out",
            expected="each person in one half",
            hint=f"{KNOWN} Build the store with one name a person.",
        )


def listed(names: Sequence[str]) -> str:
    """Some names in a row, and how many more there are."""
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return ", ".join(names[:NAMED]) + more
