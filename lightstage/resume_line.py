"""Lines to paste into a shell: what resumes a session, and what follows it."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from lightstage.printable import printable

RESUME_WITH = "resume_with"
"""Name in the journal of the options that a resumed capture needs beside ``--out``."""
LONGEST = 4000


def resume_line(session: str | Path, options: Sequence[str] = ()) -> str:
    """What to type to resume a session.

    Args:
        session: its folder.
        options: as the capture was given them; none where they are not known.
    """
    line = shell_line("lightstage", "capture", "--resume", "--out", str(session), *options)
    return line if options else f"{line} (with --leds and --cameras as before)"


def retake_line(
    session: str | Path,
    patterns: Sequence[str],
    cameras: Sequence[str] = (),
    options: Sequence[str] = (),
) -> str:
    """What to type to take photographs of a session again.

    Args:
        session: its folder.
        patterns: names, at least one.
        cameras: ids; all where there are none.
        options: as the capture was given them; none where they are not known.
    """
    line = shell_line("lightstage", "retake", str(session), ",".join(patterns), *cameras, *options)
    return line if options else f"{line} (with --leds and --cameras as before)"


def calibrate_line(kind: str, rig: Path, lab: Path, options: Sequence[str]) -> str:
    """What to type to resume unfinished calibration shots.

    Args:
        kind: of the shots, such as ``charuco``.
        rig: path of rig.json.
        lab: the lab's folder.
        options: as the command was given them.
    """
    return shell_line(
        "lightstage", "calibrate", kind, "--resume", "--rig", str(rig), "--out", str(lab), *options
    )


def watch_line(session: str | Path) -> str:
    """What to type to follow a session."""
    return shell_line("lightstage", "watch", str(session))


def options_of(line: Mapping[str, Any]) -> list[str]:
    """The options that a line of a journal has for `resume_line`; none where it has none."""
    options = line.get(RESUME_WITH)
    if not isinstance(options, list):
        return []
    return [option for option in options if isinstance(option, str)]


def known_options(lines: Iterable[Mapping[str, Any]]) -> list[str]:
    """The latest options that any line of a journal has."""
    known = [options for line in lines if (options := options_of(line))]
    return known[-1] if known else []


def shell_line(*words: str) -> str:
    """Words as one printable line to paste into a shell, quoted where they need it."""
    return printable(shlex.join(words), LONGEST, squeeze=False)
