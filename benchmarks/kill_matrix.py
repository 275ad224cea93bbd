"""kill -9 at every step of a capture, to everybody who can die: what is lost, doubled, mislabelled?

Each cell is some captures of three patterns by three cameras, as a user runs them: stopped at the
step (at the first, the middle and the last shot where that differs), killed, resumed. Then
once more for those who are killed again while they resume.

``python -m benchmarks.kill_matrix``: about a quarter of an hour on two cores, a line a session.
"""

from __future__ import annotations

import collections
import os
import random
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from benchmarks.record import record
from lightstage.steps import STEPS
from sim.devices.kill_trial import KillTrial, Outcome
from sim.devices.kills import DELETING, LINES, SEQUENCE, Kill, Who, matrix
from sim.errors import SimError

WHOS: tuple[Who, ...] = ("capture", "camera", "all")
FIRST = Kill("triggered", "capture", "x+", "cam1")
"""After this one a resume has everything to do: a file to recover, others to keep, one to take."""


def again() -> list[tuple[Kill, Kill]]:
    """Killed at FIRST, then at every step of the capture that resumes."""
    second = [Kill(step, who) for step in STEPS for who in ("capture", "all")]
    second += [Kill("line-half-written", "capture", event=e) for e in (*LINES[1:], *MORE)]
    return [(FIRST, kill) for kill in second]


MORE = ("resume", "recovered", "rejected")


def trial(kills: Sequence[Kill]) -> Outcome:
    """One session through these kills; its result is printed at once."""
    with tempfile.TemporaryDirectory() as name:
        delete = any(kill.step in DELETING for kill in kills)
        try:
            outcome = KillTrial(Path(name), delete).run(kills)
        except SimError as error:
            outcome = Outcome((str(error),), 0, 0, 0, 0.0)
    result = "; ".join(outcome.faults) or "whole"
    print(f"{' then '.join(map(str, kills))}: {result}", file=sys.stderr, flush=True)
    return outcome


def run() -> None:
    """All of it; the table goes to RESULTS.md."""
    once = [(kill,) for kill in matrix(SEQUENCE, WHOS)]
    twice = again()
    sessions: list[Sequence[Kill]] = [*once, *twice]
    # In a mixed order: who looks in early sees something of every step.
    order = random.Random(0).sample(range(len(sessions)), len(sessions))
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        mixed = dict(zip(order, pool.map(trial, [sessions[i] for i in order]), strict=True))
    outcomes = [mixed[index] for index in range(len(sessions))]
    cells: dict[tuple[str, str], list[Outcome]] = collections.defaultdict(list)
    for (kill,), outcome in zip(once, outcomes, strict=False):
        cells[kill.step, kill.who].append(outcome)
    for (_, kill), outcome in zip(twice, outcomes[len(once) :], strict=True):
        cells[kill.step, "again"].append(outcome)
    rows: list[list[object]] = []
    for step in STEPS:
        row: list[object] = [step]
        for column in (*WHOS, "again"):
            here = cells[step, column]
            good = sum(1 for outcome in here if not outcome.faults)
            row.append(f"{good} of {len(here)}" if here else "-")
        rows.append(row)
    good = sum(1 for outcome in outcomes if not outcome.faults)
    killed = sum(outcome.killed for outcome in outcomes)
    slowest = max(outcome.dark_after_s for outcome in outcomes)
    record(
        "Kill matrix",
        ["killed at", "the capture", "a camera's process", "everybody", "again, going on"],
        rows,
        f"Captures that ended whole after SIGKILL, of all: {good} of {len(outcomes)}, with "
        f"{killed} kills; nothing lost, doubled or mislabelled (pixels say what they are), every "
        f"file of every card once on the disk; the lights dark {slowest:.2f} s after a kill at "
        "the latest (where everybody dies, by the device's own watchdog of 2 s)",
    )


if __name__ == "__main__":
    run()
