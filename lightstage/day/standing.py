"""What came of a plan: which of its sessions are whole, begun, wanted again, or still to come."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Literal

from lightstage.counting import counted
from lightstage.day.plan import DayPlan, Take
from lightstage.day.sessions import Seen, seen_session
from lightstage.errors import CaptureError

Stand = Literal["done", "again", "begun", "running", "damaged", "to come"]


@dataclasses.dataclass(frozen=True)
class Planned:
    """One take of a plan and its sessions on the disk.

    Attributes:
        take: what is wanted.
        stand: what came of it; ``again`` is one that is whole and wanted once more.
        sessions: its folders, the first take first.
        folder: of the session that comes next, or of the last one where it is done.
    """

    take: Take
    stand: Stand
    sessions: tuple[Seen, ...]
    folder: Path

    @property
    def open(self) -> bool:
        """Whether it is to be captured, or resumed."""
        return self.stand in ("to come", "again", "begun")

    @property
    def accepted(self) -> str:
        """What the operator accepted, such as ``with 2 findings accepted``; empty for nothing."""
        findings = sum(seen.findings for seen in self.sessions)
        return f"with {counted(findings, 'finding')} accepted" if findings else ""


def sessions_folder(plan: DayPlan, path: Path) -> Path:
    """Where a plan's sessions are.

    Args:
        plan: the day.
        path: of the plan's file.
    """
    return path.absolute().parent / plan.sessions


def planned(plan: DayPlan, path: Path) -> list[Planned]:
    """Every take of a plan, in the day's order (arguments as `sessions_folder`)."""
    folder = sessions_folder(plan, path)
    return [stand_of(take, folder) for take in plan.all_takes()]


def stand_of(take: Take, folder: Path) -> Planned:
    """What is on the disk of one take.

    Args:
        take: of a plan.
        folder: of the plan's sessions.
    """
    seen: list[Seen] = []
    for number in range(1, take.wanted + 1):
        root = folder / take.folder(number)
        found = seen_session(root)
        if found is None:
            return Planned(take, "again" if seen else "to come", tuple(seen), root)
        seen.append(found)
        if found.state != "whole":
            stand: Stand = "begun" if found.state == "unfinished" else found.state
            return Planned(take, stand, tuple(seen), root)
    return Planned(take, "done", tuple(seen), seen[-1].root)


def next_open(plan: DayPlan, path: Path, name: str | None = None) -> Planned:
    """The take that comes next, or one by its name.

    Args:
        plan: the day.
        path: of the plan's file.
        name: ``SUBJECT/EXPRESSION``; the first open one in the day's order where None.

    Raises:
        ConfigError: no such take.
        CaptureError: nothing is left to do, or what is named is done, runs, or is damaged.
    """
    if name is not None:
        found = stand_of(plan.take(name), sessions_folder(plan, path))
        if not found.open:
            raise CaptureError(
                found.folder,
                found=f"{name}, which is {found.stand}",
                expected="a take that is to come, wanted again, or begun",
                hint="To repeat one that is done, give it a number under [takes] in the plan: "
                f'"{name}" = {len(found.sessions) + 1}.',
            )
        return found
    takes = planned(plan, path)
    for each in takes:
        if each.open:
            return each
    if not takes:
        found_text, hint = "no subject", "Add a table [[subjects]] with subject and consent."
    else:
        stands = [each.stand for each in takes]
        counts = [f"{stands.count(s)} {s}" for s in dict.fromkeys(stands)]
        found_text = f"nothing to capture: {', '.join(counts)}"
        hint = "Add a subject, or want one again under [takes]."
    raise CaptureError(path, found=found_text, expected="a take that is to come", hint=hint)
