"""What crashes leave on the disk, and photographs that the disk lost."""

from __future__ import annotations

import re
from pathlib import Path

from lightstage.findings import Finding
from lightstage.formats.files import fsync_path
from lightstage.session.disk import disk_errors
from lightstage.session.photo_entry import Kept, Key
from lightstage.session.present import damaged
from lightstage.session.recovered_files import FOLDER, asides
from lightstage.session.state import Exposed
from lightstage.session.writer import SessionWriter

_PARTIAL = re.compile(r"\.(?P<camera>.+)\.take(?P<take>\d+)\.partial")


class Leftovers:
    """A session's folder after a crash.

    Args:
        writer: of the session, resumed.

    Attributes:
        recovered: files set aside so far.
        rejected: takes given up so far.
        findings: what the operator should know; each is in the journal too.
    """

    def __init__(self, writer: SessionWriter) -> None:
        self.writer = writer
        self.state = writer.state
        self.root = writer.root
        self.recovered: list[Path] = []
        self.rejected: list[Key] = []
        self.findings: list[Finding] = []

    def damaged(self) -> list[Kept]:
        """Photographs whose file is missing or no longer has its bytes.

        Raises:
            FormatError: one that leads out of the session over a link.
        """
        return damaged(self.root, self.state.frames())

    def tidy(self) -> None:
        """Remove or set aside what crashes left; every file ends under a line of the journal."""
        for path in sorted((self.root / "frames").glob("*/.*.partial")):
            parts = _PARTIAL.fullmatch(path.name)
            if parts is not None and parts["camera"] in self.state.cameras:
                self._tidy_partial(path, (path.parent.name, parts["camera"], int(parts["take"])))
        known = {kept.path for kept in self.state.all_frames()}
        for path in sorted((self.root / "frames").glob("*/[!.]*")):
            if path.relative_to(self.root).as_posix() not in known:
                self.add(
                    Finding(
                        "warn",
                        "stray-file",
                        str(path),
                        found="a file that the journal does not know",
                        expected="photographs of this session alone",
                        hint="It is left alone and does not count.",
                    )
                )
        with disk_errors(self.root / FOLDER):
            for path in (self.root / FOLDER).glob("*/.*.partial"):
                path.unlink()
        for camera, path in asides(self.root):
            if path.relative_to(self.root).as_posix() not in self.state.recovered():
                self._journal_aside(path, camera)
        session = self.root / "session.json"
        if self.state.wanted() and session.exists():
            # It was made from the journal when all was there; that is no longer so.
            with disk_errors(session):
                session.unlink()
                fsync_path(self.root)

    def _tidy_partial(self, path: Path, key: Key) -> None:
        """What a download left that is settled otherwise."""
        with disk_errors(path):
            if path.stat().st_size and not self.state.is_kept(key):
                self.set_aside_file(path, key[1], key[0], "left of a download")
            else:
                path.unlink()

    def _journal_aside(self, path: Path, camera: str) -> None:
        with disk_errors(path):
            if not path.stat().st_size:
                path.unlink()  # a name that was taken and never filled
                return
        self.writer.recovered(camera, path, None, "left by a crash")
        self.recovered.append(path)

    def named(self, exposed: Exposed) -> Path | None:
        """The file that has an exposure's name; one that is empty is a name taken in vain."""
        stem = self.writer.stem(exposed.camera, exposed.take)
        folder = self.root / "frames" / exposed.pattern
        for path in sorted(folder.glob(f"{stem}.*")):
            if path.stem == stem:
                with disk_errors(path):
                    if path.stat().st_size:
                        return path
                    path.unlink()
        return None

    def partial(self, exposed: Exposed) -> Path | None:
        """What was downloaded of an exposure and has no name yet."""
        path = self.writer.partial(*exposed.key)
        return path if path.exists() and path.stat().st_size else None

    def set_aside(self, path: Path, exposed: Exposed, why: str, *, of_card: bool = True) -> None:
        """Move a file of an exposure under ``recovered/``; `of_card`: its bytes are the card's."""
        if of_card:
            kept = self.writer.aside(path, exposed.camera, exposed.file, exposed.pattern, why)
            self.recovered.append(kept)
        else:
            self.set_aside_file(path, exposed.camera, exposed.pattern, why)

    def set_aside_file(self, path: Path, camera: str, pattern: str, why: str) -> None:
        """Move a file of uncertain origin under ``recovered/``."""
        self.recovered.append(self.writer.aside(path, camera, None, pattern, why))

    def reject(self, key: Key, why: str) -> None:
        """Give a take up: it will be taken again."""
        pattern, camera, take = key
        self.writer.rejected(pattern, camera, why, take)
        self.rejected.append(key)

    def add(self, finding: Finding) -> None:
        """Report to the operator, and to the journal."""
        self.writer.finding(finding)
        self.findings.append(finding)
