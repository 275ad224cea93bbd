"""Going on after a crash: journal, disk and cards are brought together; nothing is guessed.

A photograph counts under a label only where the journal has its ``exposed`` line: the light lasted
through it, and the file's name on the card is known. At most one trigger of a camera is outstanding
at any time, so every other new file on a card is of an uncertain light: it is kept under
``recovered/``, and the camera takes the pattern again.

Every step may be killed, and what is left then is brought together by the next resume in the same
way.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

from lightstage.cameras.camera import CameraDevice, CardFile
from lightstage.errors import CaptureError, one_error
from lightstage.findings import Finding
from lightstage.session.reconciling import Reconciled, Reconciler
from lightstage.session.writer import SessionWriter


def arrived(before: Collection[CardFile], now: Collection[CardFile]) -> tuple[CardFile, ...]:
    """Files that came to a card, in the order in which the camera lists them."""
    known = set(before)
    return tuple(file for file in now if file not in known)


def reconcile(
    writer: SessionWriter, cameras: Sequence[CameraDevice], *, delete: bool = False
) -> Reconciled:
    """Bring journal, disk and cards together, after a crash or after a camera failed.

    Args:
        writer: of the session, resumed and its `resume` written.
        cameras: opened; all of the session's, or those that failed in it. The disk is looked
            through only where all are given.
        delete: delete on the cards what is kept. A deletion that was begun is ended anyway.

    Raises:
        DeviceError: a camera is another one than before, or cannot be read. What concerns the
            others is done by then, and nothing of this one is given up: resume again.
        CaptureError: this computer's disk refuses.
    """
    found = Reconciler(writer, delete)
    ids = {camera.id for camera in cameras}
    whole = ids >= set(writer.state.cameras)
    problems = found.look_at(cameras, found.damaged() if whole else [])
    if problems:
        raise one_error(problems)
    if whole:
        found.tidy()
    return found.result()


def bring_home(
    writer: SessionWriter, cameras: Sequence[CameraDevice], *, delete: bool = False
) -> Reconciled:
    """Before a session ends: search for every photograph, on the disk and on the cards.

    The bytes of each are read back from the disk. One that is missing or damaged comes from its
    card again, or its take is rejected and the pattern is wanted again (`Reconciled.wanted`).
    What is on the cards and is not on this computer yet is kept, such as a photograph that was
    taken again because its first take did not come.

    Args:
        writer: of the session.
        cameras: opened; one that does not answer now is a finding, where none of its photographs
            is missing.
        delete: as in `reconcile`.

    Raises:
        CaptureError: this computer's disk refuses, or a photograph is missing on it and its camera
            does not answer.
    """
    found = Reconciler(writer, delete)
    lost = found.damaged()
    problems = found.look_at(cameras, lost)
    settled = {*found.restored, *found.rejected}
    left = [each for each in lost if each.key not in settled]
    if left:
        raise CaptureError(
            writer.root / left[0].path,
            found=f"a file that is missing or damaged ({len(left)} in all)",
            expected="the photograph that was kept",
            hint="; ".join(map(str, problems)),
        )
    for problem in problems:
        found.add(
            Finding(
                "warn",
                "card-unread",
                problem.where,
                found=problem.found or str(problem),
                expected="its card, to search for photographs that were left there",
                hint="All that counts is kept. Inspect the card before you empty it.",
            )
        )
    return found.result()
