"""What happens in a capture, as lines of its journal.

Events: ``begin`` and ``resume`` (what is planned, who the devices are, what is on the cards),
``devices``, ``lit`` (levels acknowledged), ``trigger`` (before cameras are asked), ``exposed`` (a
file on a card, under light that lasted), ``frame`` (a photograph, hashed from the disk),
``failed``, ``finding``, ``accepted`` (findings that the operator lets pass), ``rejected`` (a take
that does not count), ``retake`` (takes that do not count because somebody wants them again),
``recovered`` (a file of uncertain light or label), ``deleting`` and ``deleted`` (on a card),
``shot`` (a pattern with all its photographs), ``calibration``, ``note``, ``aborted``, ``end``.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping, Sequence
from typing import Any

from lightstage.cameras.camera import CardFile
from lightstage.errors import CaptureError
from lightstage.findings import Finding
from lightstage.session.events import Line
from lightstage.session.journal import Journal, Listener
from lightstage.session.state import SessionState


class Record:
    """Writes a session's events; several threads may.

    Attributes:
        journal: the record.
        state: its content so far.
    """

    def __init__(self, journal: Journal, state: SessionState) -> None:
        self.journal = journal
        self.state = state
        journal.book = state.apply

    @property
    def listeners(self) -> list[Listener]:
        """Called with each line of the journal, in order, after it is on the disk."""
        return self.journal.listeners

    def resume(
        self,
        cards: Mapping[str, Collection[CardFile]],
        serials: Mapping[str, str | None],
        **facts: Any,
    ) -> Line:
        """Journal that a capture is resumed, with what is on the cards now."""
        return self.journal.write(
            "resume",
            after_torn_line=self.journal.torn,
            cards={camera: as_json(files) for camera, files in cards.items()},
            serials=dict(serials),
            **facts,
        )

    def lit(
        self, pattern: str, levels: Sequence[float], *, acknowledged: bool, **facts: Any
    ) -> Line:
        """Journal that a pattern is lit.

        Args:
            pattern: its name.
            levels: (n,) that are really driven.
            acknowledged: whether the lights reported it.
            facts: for the record.
        """
        return self.journal.write(
            "lit", pattern=pattern, acknowledged=acknowledged, levels=list(levels), **facts
        )

    def trigger(self, pattern: str, takes: Mapping[str, int], **facts: Any) -> Line:
        """Journal, before any of them is asked, which cameras will take a pattern, and which take.

        A camera's earlier trigger counts as closed by this.
        """
        return self.journal.write("trigger", pattern=pattern, takes=dict(takes), **facts)

    def exposed(
        self,
        pattern: str,
        take: int,
        camera: str,
        file: CardFile,
        beside: Sequence[CardFile] = (),
        **facts: Any,
    ) -> Line:
        """Journal which file on its card is a camera's photograph of a light that lasted.

        Args:
            pattern: what was lit, through the whole exposure.
            take: as in `trigger`.
            camera: who took it.
            file: the RAW.
            beside: other files of the same shot.
            facts: for the record.
        """
        return self.journal.write(
            "exposed",
            pattern=pattern,
            camera=camera,
            take=take,
            file=[file.name, file.size],
            beside=as_json(beside),
            **facts,
        )

    def failed(self, pattern: str, take: int, camera: str, said: str) -> Line:
        """Journal that something about a take failed; it may still be kept later."""
        return self.journal.write("failed", pattern=pattern, camera=camera, take=take, said=said)

    def finding(self, finding: Finding) -> Line:
        """Journal what a check of a device or a photograph found."""
        return self.journal.write("finding", **_facts(finding))

    def accept(self, pattern: str, findings: Sequence[Finding]) -> Line:
        """Journal that the operator takes a pattern's photographs as they are, with their faults.

        Args:
            pattern: whose shot is over by that.
            findings: all that spoke against it; they may be of earlier patterns too.
        """
        return self.journal.write("accepted", pattern=pattern, findings=list(map(_facts, findings)))

    def rejected(self, pattern: str, camera: str, why: str, take: int | None = None) -> Line:
        """Journal that a take does not count; its file stays.

        Args:
            pattern: whose.
            camera: whose.
            why: for people.
            take: which; None: the one that counts now.

        Raises:
            CaptureError: no take counts.
        """
        if take is None:
            kept = self.state.accepted(pattern, camera)
            if kept is None:
                raise CaptureError(
                    f"{pattern} by {camera}", found="no photograph", expected="one to reject"
                )
            take = kept.take
        return self.journal.write("rejected", pattern=pattern, camera=camera, take=take, why=why)

    def retake(self, photographs: Collection[tuple[str, str]], why: str) -> Line:
        """Journal, in one line, that photographs are to be taken again: their takes do not count.

        Args:
            photographs: pattern and camera of each; one without a photograph is wanted anyway.
            why: for people.
        """
        takes = [kept.key for kept in self.state.frames() if kept.key[:2] in set(photographs)]
        return self.journal.write("retake", takes=[list(key) for key in takes], why=why)

    def deleting(self, pattern: str, camera: str, file: CardFile) -> Line:
        """Journal, before it is asked to, that a camera will delete a file that is kept."""
        return self.journal.write(
            "deleting", pattern=pattern, camera=camera, file=[file.name, file.size]
        )

    def deleted(self, pattern: str, camera: str, file: CardFile) -> Line:
        """Journal that a file is no longer on the card."""
        return self.journal.write(
            "deleted", pattern=pattern, camera=camera, file=[file.name, file.size]
        )

    def shot(self, pattern: str, **facts: Any) -> Line:
        """Journal that all photographs of a pattern are kept and do.

        Raises:
            CaptureError: one is not.
        """
        missing = self.state.missing(pattern)
        if missing:
            raise CaptureError(
                f"pattern {pattern}",
                found=f"no photograph by {', '.join(missing)}",
                expected="one of each camera",
            )
        return self.journal.write("shot", pattern=pattern, **facts)

    def note(self, event: str, **facts: Any) -> Line:
        """Journal anything else."""
        return self.journal.write(event, **facts)


def _facts(finding: Finding) -> dict[str, Any]:
    """A finding as a journal has it."""
    fields = dataclasses.asdict(finding).items()
    return {name: value for name, value in fields if value is not None and value != ()}


def as_json(files: Collection[CardFile]) -> list[list[Any]]:
    """Files of a card as a journal has them: name and size."""
    return [[file.name, file.size] for file in files]
