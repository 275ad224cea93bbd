"""How whoever reads a message resumes, follows or retakes: by a shell or by the console's page.

The console sets `READER` for the commands that it starts, because it shows their messages on its
page. Like the width of a terminal, this belongs to a process's output and not to its work.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from lightstage.resume_line import resume_line, retake_line, watch_line

READER = "LIGHTSTAGE_READER"
"""Environment variable: who reads what a command writes; a terminal's user where it is not set."""
CONSOLE = "console"
"""Its value where the operator's page shows it."""


class Ways(NamedTuple):
    """Sentences for one kind of reader; a line that ends in a command has no full stop.

    Attributes:
        resume: a session, with the options of its capture (none where they are not known).
        follow: a session; empty where its reader follows it already.
        retake: photographs of a session: these patterns by these cameras (all where there are
            none), with the options of its capture.
    """

    resume: Callable[[str | Path, Sequence[str]], str]
    follow: Callable[[str | Path], str]
    retake: Callable[[str | Path, Sequence[str], Sequence[str], Sequence[str]], str]


def _retake_typed(
    session: str | Path, patterns: Sequence[str], cameras: Sequence[str], options: Sequence[str]
) -> str:
    return f"To retake: {retake_line(session, patterns, cameras, options)}"


def _retake_clicked(
    _session: str | Path, patterns: Sequence[str], cameras: Sequence[str], _options: Sequence[str]
) -> str:
    photographs = f"{', '.join(patterns)} by {', '.join(cameras) or 'all cameras'}"
    return f"To retake {photographs}: on the session's page click each one, then its button."


TYPED = Ways(
    lambda session, options: f"To resume: {resume_line(session, options)}",
    lambda session: f"Anyone here can follow with: {watch_line(session)}",
    _retake_typed,
)
"""In a terminal."""
PRESSED = Ways(
    lambda _session, _options: "Press g on the session's page to resume it.",
    lambda _session: "",
    _retake_clicked,
)
"""On the console's page."""


def readers_ways() -> Ways:
    """Those of whoever reads this process's messages."""
    return PRESSED if os.environ.get(READER) == CONSOLE else TYPED
