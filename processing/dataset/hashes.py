"""Files of a folder against the hashes that were written with them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from lightstage.commands import ProgressCallback, quiet
from lightstage.formats.files import sha256_file

MOST_SHOWN = 4
"""Differences that are named; of others only their number is."""


def differences(
    folder: Path,
    known: Mapping[str, str],
    listed: str,
    whole: str,
    progress: ProgressCallback = quiet,
) -> str:
    """In which files a folder is not as it was written, in words; empty where it is.

    Args:
        folder: with all that is below it.
        known: SHA-256 of each file, by its path in the folder.
        listed: file in the folder that holds these hashes.
        whole: of what the files are, for a file that has no hash.
        progress: called after each file that is hashed.
    """
    there = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
    there -= {listed}
    wrong = [f"{name} is missing" for name in sorted(known.keys() - there)]
    wrong += [f"{name} is not of {whole}" for name in sorted(there - known.keys())]
    both = sorted(known.keys() & there)
    for index, name in enumerate(both):
        if sha256_file(folder / name) != known[name]:
            wrong.append(f"{name} has changed")
        progress(index + 1, len(both))
    more = f"; and {len(wrong) - MOST_SHOWN} more" if len(wrong) > MOST_SHOWN else ""
    return "; ".join(wrong[:MOST_SHOWN]) + more
