"""What is held in memory of a photograph on this computer: little, for there are very many."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import PurePosixPath

from lightstage.cameras.camera import CardFile
from lightstage.session.events import Line

Key = tuple[str, str, int]
"""Pattern, camera, take."""
DIGEST_BYTES = 32


@dataclasses.dataclass(frozen=True, slots=True)
class Kept:
    """A photograph that has its name and its ``frame`` line.

    Attributes:
        pattern: what was lit.
        camera: whose photograph.
        take: 1, or more where it was taken again.
        file: on the camera's card.
        digest: SHA-256 of its bytes, `packed`.
        place: suffix of its path where that is the usual one, else the whole path.
    """

    pattern: str
    camera: str
    take: int
    file: CardFile
    digest: bytes
    place: str

    @staticmethod
    def of(line: Line, file: CardFile | None) -> Kept:
        """What to hold of a ``frame`` line.

        Args:
            line: as in the journal.
            file: the same as the ``exposed`` line had it, if any; not held twice.
        """
        key = key_of(line)
        if file is None or (file.name, file.size) != (line["file"], line["size"]):
            file = CardFile(line.get("file", ""), line.get("size", 0))  # not in version 1
        suffix = sys.intern(PurePosixPath(line["path"]).suffix)
        usual = bool(suffix) and line["path"] == usual_path(key, suffix)
        return Kept(*key, file, packed(line["sha256"]), suffix if usual else line["path"])

    @property
    def key(self) -> Key:
        """Pattern, camera, take."""
        return (self.pattern, self.camera, self.take)

    @property
    def sha256(self) -> str:
        """Of its bytes, in hexadecimal."""
        return self.digest.hex() if len(self.digest) == DIGEST_BYTES else self.digest.decode()

    @property
    def path(self) -> str:
        """In the session."""
        return usual_path(self.key, self.place) if self.place.startswith(".") else self.place


@dataclasses.dataclass(frozen=True, slots=True)
class Recovered:
    """A file of uncertain light or label.

    Attributes:
        path: in the session.
        sha256: of its bytes.
        file: on the card that it came from, None where that is not certain.
    """

    path: str
    sha256: str
    file: CardFile | None


def packed(sha256: str) -> bytes:
    """A hash in half the memory: (32,) bytes; its text where it is none."""
    try:
        digest = bytes.fromhex(sha256)
    except ValueError:
        digest = b""
    return digest if len(digest) == DIGEST_BYTES and digest.hex() == sha256 else sha256.encode()


def stem_of(camera: str, take: int) -> str:
    """Name of a take's file, without suffix."""
    return camera if take == 1 else f"{camera}.take{take}"


def usual_path(key: Key, suffix: str) -> str:
    """The file of a take's photograph in a session."""
    return f"frames/{key[0]}/{stem_of(*key[1:])}{suffix}"


def key_of(line: Line) -> Key:
    """Pattern, camera and take of a line."""
    return (sys.intern(line["pattern"]), sys.intern(line["camera"]), line["take"])


def in_words(key: Key) -> str:
    """A take in words."""
    pattern, camera, take = key
    return f"{pattern} by {camera}" if take == 1 else f"{pattern} by {camera}, take {take}"
