"""A session's life on disk: an append-only journal, photographs kept once, session.json at last.

The journal (journal.jsonl) is the record; session.json is made from it when all shots are there.
"""

from __future__ import annotations

import threading
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from lightstage.cameras.camera import CameraDevice, CardFile
from lightstage.errors import CaptureError, FormatError
from lightstage.formats.access import close_folder
from lightstage.formats.paths import path_inside
from lightstage.formats.session import save_session, session_id
from lightstage.rig import Rig, load_rig
from lightstage.session.colour import carried_paths
from lightstage.session.disk import disk_errors, make_folder
from lightstage.session.durable_rename import Arrival, settle, sha256_on_disk
from lightstage.session.events import Line
from lightstage.session.finished import session_from_journal
from lightstage.session.journal import Journal, utc_now
from lightstage.session.journal_writer import Record, as_json
from lightstage.session.neighbours import Neighbours
from lightstage.session.opening import JOURNAL, RIG, require_new, rig_hash, save_beside
from lightstage.session.photo_entry import Key, in_words, stem_of
from lightstage.session.plan import SessionPlan
from lightstage.session.recovered_files import FOLDER, put_aside, take_aside
from lightstage.session.state import NOT_OURS, SessionState
from lightstage.steps import step


class SessionWriter(Record):
    """Writes one session folder; made by `new` or `resumed`. Several threads may.

    While one is open, no other process can write the same session.

    Attributes:
        root: the folder.
        beside: photographs of other sessions, none of which may enter this one; nobody is known
            until `look_beside`.
    """

    def __init__(self, root: Path, journal: Journal, state: SessionState) -> None:
        super().__init__(journal, state)
        self.root = root
        self._claimed: dict[str, Key] = {}  # bytes on their way to a name, by their hash
        self._claiming = threading.Lock()
        self.beside = Neighbours()

    @staticmethod
    def new(
        root: Path,
        rig: Rig,
        plan: SessionPlan,
        cards: Mapping[str, Collection[CardFile]] | None = None,
        serials: Mapping[str, str | None] | None = None,
        facts: Mapping[str, Any] | None = None,
        colour: Mapping[str, Any] | None = None,
        beside: Mapping[str, bytes] | None = None,
    ) -> SessionWriter:
        """Make a session; a folder that holds something is never touched.

        Args:
            root: the folder to make.
            rig: saved with the session.
            plan: what it is going to hold.
            cards: what is on each camera's card now, by camera id.
            serials: what each camera reports as its serial number, by camera id.
            facts: what else the journal shall begin with (devices, configuration).
            colour: a colour calibration (as read by read_colour) to keep in the session.
            beside: other files of the calibration, by name (read_calibration).

        Raises:
            ConfigError: a name that may not be in a session.
            CaptureError: the folder exists and is not empty, or the disk refuses.
        """
        plan = plan.checked(rig)
        require_new(root)
        created = utc_now()
        with disk_errors(root):
            root.mkdir(parents=True, exist_ok=True)
            close_folder(root)
        journal, begin = Journal.new(
            root / JOURNAL,
            lambda: save_beside(root, rig, colour, beside or {}),
            session=session_id(plan.subject, plan.expression, created),
            created_utc=created,
            **plan.facts(),
            cameras=[camera.id for camera in rig.cameras],
            rig_sha256=rig_hash(rig),
            cards={c: as_json(files) for c, files in (cards or {}).items()},
            serials=dict(serials or {}),
            calibration=carried_paths(colour, beside or {}),
            **(facts or {}),
        )
        return SessionWriter(root, journal, SessionState([begin]))

    @staticmethod
    def resumed(root: Path, rig: Rig | None = None, *, finished: bool = False) -> SessionWriter:
        """Open an unfinished session to resume it; the line `resume` must be written first.

        Args:
            root: its folder.
            rig: must be the session's own, if given.
            finished: whether it may be finished, because something of it shall be taken again.

        Raises:
            FormatError: no session, a damaged journal, or a changed rig.json.
            CaptureError: another process writes to it, it is finished, or `rig` is another one.
        """
        journal, lines = Journal.resumed(root / JOURNAL)
        try:
            for folder in (root / "frames", root / FOLDER, *(root / "frames").glob("*/")):
                inside = folder.relative_to(root).as_posix()
                path_inside(root, inside, root, "folder")  # files are moved and removed in it
            state = SessionState(lines)
            own = rig_hash(load_rig(root / RIG))
            if own != state.begin["rig_sha256"]:
                raise FormatError(
                    root / RIG,
                    found="another rig than the one that the session began with",
                    expected="the same",
                    hint="Restore it; the photographs' light is not known without it.",
                )
            if rig is not None and rig_hash(rig) != own:
                raise CaptureError(
                    root,
                    field="rig",
                    found="a session of another rig",
                    expected="the rig given",
                    hint="Resume with the session's own rig.json.",
                )
            if state.ended and not finished:
                raise CaptureError(
                    root,
                    found="a session that is finished",
                    expected="one with something left to do",
                    hint="To take single photographs again: lightstage retake. To take all of it "
                    "again, give a new folder.",
                )
        except BaseException:
            journal.close()
            raise
        return SessionWriter(root, journal, state)

    def next_take(self, pattern: str, camera: str) -> int:
        """Number of a camera's next take of a pattern, whose name is free on the disk."""
        folder = self.root / "frames" / pattern
        there = {path.stem for path in folder.iterdir()} if folder.is_dir() else set()
        take = self.state.next_take(pattern, camera)
        while self.stem(camera, take) in there:
            take += 1
        return take

    @staticmethod
    def stem(camera: str, take: int) -> str:
        """Name of a take's file, without suffix."""
        return stem_of(camera, take)

    def partial(self, pattern: str, camera: str, take: int) -> Path:
        """The file of a photograph while it is being downloaded."""
        return self.root / "frames" / pattern / f".{camera}.take{take}.partial"

    def incoming(self, pattern: str, camera: str, take: int) -> Path:
        """Where a photograph is to be downloaded to; its folder is there, it is not.

        What a download before this one left there is removed: it was not whole or not right, and
        the photograph is on the camera's card.
        """
        path = self.partial(pattern, camera, take)
        with disk_errors(path.parent):
            make_folder(path.parent, self.root)
            path.unlink(missing_ok=True)
        return path

    def keep(
        self,
        pattern: str,
        camera: str,
        take: int,
        incoming: Path,
        file: CardFile,
        sha256: str,
        **facts: Any,
    ) -> Path:
        """Verify a downloaded photograph, give it its name, journal it: a ``frame``.

        Args:
            pattern: what was lit.
            camera: who took it.
            take: as in `trigger`; 1 where photographs are imported.
            incoming: where it was downloaded to (`incoming`).
            file: as the camera lists it.
            sha256: of the bytes where they left the camera's driver.
            facts: for the journal.

        Returns:
            Where it is.

        Raises:
            FormatError: no photograph, or a truncated one.
            CaptureError: the disk holds other bytes, the name is taken, or the disk refuses.
        """
        where = in_words((pattern, camera, take))
        stem = self.stem(camera, take)
        path, kind = settle(Arrival(incoming, stem, file.size, sha256, where, pattern, camera))
        self.frame(pattern, camera, take, path, file, sha256, kind.encoding, **facts)
        return path

    def claim(self, sha256: str, key: Key) -> str | None:
        """Whose bytes these are already, in words; None: nobody's, and from now on this take's."""
        with self._claiming:
            first = self.state.whose(sha256) or self._claimed.setdefault(sha256, key)
        return self.twin(sha256) if first == key else in_words(first)

    def twin(self, sha256: str) -> str | None:
        """Which photograph of this session or of one beside it has these bytes, in words."""
        first = self.state.whose(sha256)
        if first is not None:
            return in_words(first)
        for each in self.state.recovered().values():
            if each.sha256 == sha256:
                return each.path
        return self.beside.whose(sha256)

    def look_beside(self) -> None:
        """Learn the photographs of all sessions in the folders beside this one."""
        self.beside = Neighbours(self.root)

    def frame(
        self,
        pattern: str,
        camera: str,
        take: int,
        path: Path,
        file: CardFile,
        sha256: str,
        encoding: str,
        **facts: Any,
    ) -> Line:
        """Journal a photograph that has its name and was verified (`keep` does both)."""
        exposure = self.state.exposure((pattern, camera, take))
        if exposure is not None and exposure.acknowledged is not None:
            facts = {"acknowledged": exposure.acknowledged, **facts}
        line = self.journal.write(
            "frame",
            pattern=pattern,
            camera=camera,
            take=take,
            path=path.relative_to(self.root).as_posix(),
            sha256=sha256,
            encoding=encoding,
            size=file.size,
            file=file.name,
            **facts,
        )
        with self._claiming:
            self._claimed.pop(sha256, None)  # the state knows it now
        step("journaled", pattern, camera)
        return line

    def recover(
        self, camera: CameraDevice, file: CardFile, pattern: str | None, why: str
    ) -> Path | None:
        """Bring a file whose light or label is not certain from a card, under ``recovered/``.

        Args:
            camera: on whose card it is.
            file: there.
            pattern: what it may be of, None where nothing is known.
            why: for people.

        Returns:
            Where it is. Called again for the same file, it finds the one that is there. None
            for a photograph of a session beside this one: it stays on the card alone.

        Raises:
            DeviceError: it did not come from the card.
            CaptureError: the disk holds other bytes, or refuses.
        """
        kept = take_aside(
            self.root, camera, file, pattern, lambda each: self.beside.whose(each) is not None
        )
        if kept is None:
            whose = [file.name, file.size]
            self.journal.write("note", about=NOT_OURS, camera=camera.id, file=whose)
            return None
        self.recovered(camera.id, kept.path, pattern, why, file)
        return kept.path

    def aside(self, path: Path, camera: str, file: CardFile | None, pattern: str, why: str) -> Path:
        """Move a file of the session under ``recovered/``, and journal that.

        Args:
            path: of the file.
            camera: whose it is.
            file: that it was downloaded from, None where it is not certain to be that.
            pattern: what it may be of.
            why: for people.

        Returns:
            Where it is.
        """
        name = f"{pattern}-{path.name.lstrip('.')}" if file is None else file.name
        kept = put_aside(self.root, camera, path, name)
        self.recovered(camera, kept.path, pattern, why, file)
        return kept.path

    def recovered(
        self, camera: str, path: Path, pattern: str | None, why: str, file: CardFile | None = None
    ) -> None:
        """Journal a file that is under ``recovered/`` (`recover` and `aside` do both)."""
        relative = path.relative_to(self.root).as_posix()
        told_before = self.state.recovered().get(relative)
        if told_before is not None and (file is None or told_before.file is not None):
            return
        with disk_errors(path):
            facts: dict[str, Any] = {"sha256": sha256_on_disk(path), "size": path.stat().st_size}
        self.journal.write(
            "recovered",
            camera=camera,
            file=None if file is None else [file.name, file.size],
            path=relative,
            pattern=pattern,
            why=why,
            **facts,
        )

    def finish(self) -> Path:
        """Write session.json from the journal on the disk; returns its path.

        Raises:
            FormatError: a shot of the sequence is not finished.
        """
        with disk_errors(self.root / "session.json"):
            path = save_session(self.root, session_from_journal(self.root / JOURNAL))
        step("session-written")
        return path

    def end(self, **facts: Any) -> None:
        """Journal that all is done; nothing may be written after it."""
        frames = len(self.state.cameras) * len(self.state.patterns)
        self.journal.write("end", last=True, frames=frames, **facts)
        step("ended")

    def abort(self, **facts: Any) -> None:
        """Journal that the capture ends here; nothing may be written after it."""
        self.journal.write("aborted", last=True, **facts)

    def close(self) -> None:
        """Close the journal; the folder stays as it is."""
        self.journal.close()
