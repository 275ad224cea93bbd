"""Journal and disk against one camera's card after another."""

from __future__ import annotations

import dataclasses
import datetime
from collections.abc import Collection, Sequence
from pathlib import Path

from lightstage.cameras.camera import CameraDevice, CardFile
from lightstage.counting import counted
from lightstage.errors import DeviceError, FormatError, LightstageError
from lightstage.exif import read_exif
from lightstage.findings import Finding
from lightstage.formats.files import fsync_path
from lightstage.photo_file import identify_file
from lightstage.session.camera_clock import Verdict, judge_time
from lightstage.session.crash_remains import Leftovers
from lightstage.session.disk import disk_errors
from lightstage.session.durable_rename import Arrival, is_whole, settle, sha256_on_disk
from lightstage.session.photo_entry import Kept, Key, in_words
from lightstage.session.present import why_not_delete
from lightstage.session.state import Exposed
from lightstage.session.writer import SessionWriter
from lightstage.steps import step

DOWNLOADS = 2
"""How often a file that does not come whole is asked for."""
UNSURE = "size and header"
"""How a photograph was verified whose card no longer has it."""


CLOCK_S = 120.0
"""By how much a camera's clock may be off; a preflight allows less."""
ZONE_S = 900.0
"""Time zones are whole quarters of an hour."""


@dataclasses.dataclass(frozen=True)
class Reconciled:
    """What was brought together.

    Attributes:
        adopted: takes that were exposed before the crash and are kept now.
        restored: takes whose file was missing or damaged and came from the card again.
        rejected: takes that do not count and are taken again.
        recovered: files of uncertain light or label.
        findings: what the operator should know.
        wanted: cameras that must still take each pattern; () where only its ``shot`` is wanted.
    """

    adopted: tuple[Key, ...]
    restored: tuple[Key, ...]
    rejected: tuple[Key, ...]
    recovered: tuple[Path, ...]
    findings: tuple[Finding, ...]
    wanted: dict[str, tuple[str, ...]]


class Reconciler(Leftovers):
    """Disk and journal against the cards."""

    def __init__(self, writer: SessionWriter, delete: bool) -> None:
        super().__init__(writer)
        self.delete = delete
        self.adopted: list[Key] = []
        self.restored: list[Key] = []

    def look_at(
        self, cameras: Sequence[CameraDevice], damaged: Sequence[Kept]
    ) -> list[LightstageError]:
        """One camera after another; returns what failed, when the others are done.

        Args:
            cameras: opened.
            damaged: photographs whose file is to be brought again.
        """
        problems: list[LightstageError] = []
        for camera in cameras:
            try:
                self._camera(camera, [each for each in damaged if each.camera == camera.id])
            except DeviceError as error:
                problems.append(error)
        return problems

    def result(self) -> Reconciled:
        """All that was done."""
        return Reconciled(
            tuple(self.adopted),
            tuple(self.restored),
            tuple(self.rejected),
            tuple(self.recovered),
            tuple(self.findings),
            self.state.wanted(),
        )

    # -- one camera

    def _camera(self, camera: CameraDevice, damaged: Sequence[Kept]) -> None:
        self._require_same(camera)
        now = set(camera.card())
        changed = self.state.on_card(camera.id) - now
        for each in damaged:
            self._restore(camera, each, now)
        for exposed in self.state.unsettled(camera.id):
            if exposed.file in now and not changed:
                self._from_card(camera, exposed)
            else:
                self._without_card(camera, exposed, now)
        unknown = sorted(now - self.state.known(camera.id), key=lambda file: file.name)
        self._give_up_outstanding(camera, () if changed else unknown)
        if changed:
            self._note_changed(camera, changed, unknown)
            files = sorted([file.name, file.size] for file in now)
            self.writer.note("note", about="card", camera=camera.id, cards={camera.id: files})
        else:
            self._finish_deleting(camera, now)

    def _require_same(self, camera: CameraDevice) -> None:
        before, now = self.state.serials.get(camera.id), camera.summary().serial
        if before is not None and now is not None and before != now:
            raise DeviceError(
                f"camera {camera.id}",
                field="serial",
                found=f"{now}, another camera than the session began with",
                expected=before,
                hint="Connect that one again: photographs may be on its card.",
            )

    def _from_card(self, camera: CameraDevice, exposed: Exposed) -> None:
        """Keep an exposure that is on the card: its bytes decide about what is on the disk."""
        incoming, sha256, size = self._download(camera, exposed)
        named = self.named(exposed)
        if named is not None:
            with disk_errors(named):
                if sha256_on_disk(named) == sha256:
                    # Downloaded before the crash and on the card still: it is certainly this one.
                    incoming.unlink()
                    incoming = named
        twin = self.writer.twin(sha256)
        why = "" if incoming == named else _other_time(incoming, exposed)
        if twin is not None:
            why = f"the bytes of {twin}"
        elif size != exposed.file.size:
            why = f"{counted(size, 'byte')} came of {exposed.file.size}"
        if why:
            self.set_aside(incoming, exposed, why)
            self.reject(exposed.key, why)
            return
        if incoming == named:
            with disk_errors(named):
                fsync_path(named.parent)
                encoding = identify_file(named).encoding
            self.writer.frame(*exposed.key, named, exposed.file, sha256, encoding, adopted=True)
            self.adopted.append(exposed.key)
            return
        if named is not None:
            self.set_aside(named, exposed, "not what is on the card", of_card=False)
        try:
            self.writer.keep(*exposed.key, incoming, exposed.file, sha256, adopted=True)
        except FormatError as error:
            self.set_aside(incoming, exposed, str(error))
            self.reject(exposed.key, str(error))
        else:
            self.adopted.append(exposed.key)

    def _download(self, camera: CameraDevice, exposed: Exposed) -> tuple[Path, str, int]:
        for _ in range(DOWNLOADS):
            incoming = self.writer.incoming(*exposed.key)
            got = camera.download(exposed.file.name, incoming, exposed.pattern)
            with disk_errors(incoming):
                size = incoming.stat().st_size
            if size == exposed.file.size == got.size:
                break
        return incoming, got.sha256, size

    def _without_card(
        self, camera: CameraDevice, exposed: Exposed, now: Collection[CardFile]
    ) -> None:
        """Settle an exposure whose card was changed since: what the disk has is all there is."""
        named, partial = self.named(exposed), self.partial(exposed)
        whole = [p for p in (named, partial) if p is not None and is_whole(p, exposed.file.size)]
        if whole:
            with disk_errors(whole[0]):
                sha256 = sha256_on_disk(whole[0])
            if self.writer.twin(sha256) is None:
                self._adopt_unsure(exposed, whole[0], sha256)
                return
        for path in (named, partial):
            if path is not None:
                why = "left of a photograph that its card no longer has"
                self.set_aside(path, exposed, why, of_card=False)
        why = "it was not on this computer yet when the card was emptied or exchanged"
        if exposed.file in now:
            # A file of its name and size; whether it is this photograph nobody can know.
            self._recover(camera, exposed.file, exposed.pattern, "the card was changed")
        self.reject(exposed.key, why)

    def _adopt_unsure(self, exposed: Exposed, path: Path, sha256: str) -> None:
        if path == self.partial(exposed):
            self.writer.keep(
                *exposed.key, path, exposed.file, sha256, adopted=True, verified=UNSURE
            )
        else:
            with disk_errors(path):
                fsync_path(path.parent)
                encoding = identify_file(path).encoding
            self.writer.frame(
                *exposed.key, path, exposed.file, sha256, encoding, adopted=True, verified=UNSURE
            )
        self.adopted.append(exposed.key)
        self.add(
            Finding(
                "warn",
                "verified-by-size",
                in_words(exposed.key),
                found="a card that no longer has it, and a whole file on this computer",
                expected="both, to compare their bytes",
                hint="It is kept; inspect it.",
                pattern=exposed.pattern,
                camera=exposed.camera,
            )
        )

    def _give_up_outstanding(self, camera: CameraDevice, unknown: Sequence[CardFile]) -> None:
        outstanding = self.state.outstanding(camera.id)
        pattern = None if outstanding is None else outstanding[0]
        why = "found on the card; whether its light lasted is not known"
        maybe_ours = [self._recover(camera, file, pattern, why) for file in unknown]
        if others := maybe_ours.count(False):
            what = counted(others, "photograph")
            note = f"{what} of other sessions on its card, left alone"
            self.writer.note("note", camera=camera.id, said=note)
        if outstanding is not None:
            why = "its light is not certain" if unknown else "the camera took no photograph of it"
            self.reject((outstanding[0], camera.id, outstanding[1]), why)

    def _recover(self, camera: CameraDevice, file: CardFile, pattern: str | None, why: str) -> bool:
        """Keep a file of the card apart; whether it may be of this session."""
        kept = self.writer.recover(camera, file, pattern, why)
        if kept is not None:
            self.recovered.append(kept)
        return kept is not None

    def _note_changed(
        self, camera: CameraDevice, changed: Collection[CardFile], unknown: Sequence[CardFile]
    ) -> None:
        left = f" It still holds {counted(len(unknown), 'file')} of others." if unknown else ""
        self.add(
            Finding(
                "warn",
                "card-changed",
                f"camera {camera.id}",
                found=f"{counted(len(changed), 'file')} missing from its card, such as "
                f"{min(file.name for file in changed)}",
                expected="the card as this session left it",
                hint="Was it emptied or exchanged? What was not yet on this computer is taken "
                f"again.{left}",
                camera=camera.id,
            )
        )

    def _finish_deleting(self, camera: CameraDevice, now: Collection[CardFile]) -> None:
        """Delete what is kept and was to be deleted, if it is the same to the byte."""
        here = {each.file: each for each in self.state.frames() if each.camera == camera.id}
        begun = self.state.deleting(camera.id)
        for file, pattern in begun.items():
            if file not in now:
                self.writer.deleted(pattern, camera.id, file)
        for file, kept in here.items():
            if file not in now or not (self.delete or file in begun):
                continue
            pattern = kept.pattern
            incoming = self.writer.incoming(*kept.key)
            got = camera.download(file.name, incoming, pattern)
            with disk_errors(incoming):
                incoming.unlink()
            if got.sha256 != kept.sha256:
                continue  # another picture under its name: nobody else has that one
            why = why_not_delete(self.root, self.state, kept.key)
            if why:
                note = f"{file.name} stays on the card: {why}"
                self.writer.note("note", camera=camera.id, said=note)
                continue
            if file not in begun:
                self.writer.deleting(pattern, camera.id, file)
            step("deleting", pattern, camera.id)
            camera.delete(file.name)
            self.writer.deleted(pattern, camera.id, file)
            step("deleted", pattern, camera.id)

    def _restore(self, camera: CameraDevice, kept: Kept, now: Collection[CardFile]) -> None:
        """Bring a photograph that was kept from the card again, if it is the same to the byte."""
        key, file, path = kept.key, kept.file, self.root / kept.path
        if path.exists():
            self.set_aside_file(path, camera.id, kept.pattern, "changed on the disk")
        if file in now:
            incoming = self.writer.incoming(*key)
            got = camera.download(file.name, incoming, kept.pattern)
            if got.sha256 == kept.sha256:
                settle(
                    Arrival(
                        incoming, path.stem, file.size, got.sha256, in_words(key), key[0], camera.id
                    )
                )
                note = f"{kept.path} came from its card again"
                place = {"path": kept.path, "camera": camera.id}
                self.writer.note("note", about="restored", **place, said=note)
                self.restored.append(key)
                return
            with disk_errors(incoming):
                incoming.unlink()
        self.reject(key, "its file is missing or damaged, and the card does not have it")
        self.add(
            Finding(
                "warn",
                "photograph-lost",
                str(path),
                found="a file that is missing or damaged, and that the card does not have either",
                expected="the photograph that was kept",
                hint="It is retaken. Inspect the disk.",
                pattern=kept.pattern,
                camera=camera.id,
            )
        )


def _other_time(path: Path, exposed: Exposed) -> str:
    """Why a file is no photograph of this exposure by the time in it; empty where it may be.

    A card formatted and used again has the same names, and raw files are often of one size.
    """
    with disk_errors(path):
        taken = read_exif(path).taken
    if taken is None or not exposed.time_utc:
        return ""
    told_utc = datetime.datetime.fromisoformat(exposed.time_utc)
    if exposed.clock_offset_s is not None:
        ago_s = exposed.clock_offset_s - exposed.lasted_s
        begun = told_utc + datetime.timedelta(seconds=ago_s)
        differs = judge_time(taken, begun, exposed.lasted_s) is Verdict.DIFFERS
        return f"taken at another time, {taken}" if differs else ""
    if taken.tzinfo is not None:
        off_s = (taken - told_utc).total_seconds()
    else:
        off_s = (taken - told_utc.replace(tzinfo=None)).total_seconds()
        off_s -= round(off_s / ZONE_S) * ZONE_S if abs(off_s) < 15 * 3600 else 0.0
    return f"taken at another time, {taken}" if abs(off_s) > CLOCK_S else ""
