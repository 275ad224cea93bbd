"""What the names of a card's files tell: photographs, previews, files of one shot."""

from __future__ import annotations

PREVIEWS = (".jpg", ".jpeg", ".heic", ".heif", ".hif")
NO_PHOTOGRAPHS = (
    *(".avi", ".mov", ".mp4", ".mts", ".wav", ".mp3", ".thm", ".lrv", ".xml", ".ctg", ".dat"),
    *(".txt", ".log", ".bin", ".dsc", ".idx", ".mrk", ".ind", ".inp", ".bdm", ".cpi", ".mpl"),
)
"""Other files that cameras put on their cards; whatever is not named here is a photograph."""


def suffix(name: str) -> str:
    """A file's suffix in small letters, with its dot."""
    stem, dot, end = name.rpartition(".")
    return f".{end.lower()}" if dot and stem else ""


def is_photograph(name: str) -> bool:
    """Whether a card's file is a photograph; also where its kind is unknown."""
    return suffix(name) not in NO_PHOTOGRAPHS


def raw_first(name: str) -> tuple[bool, str]:
    """Key that sorts the files of one shot: what is no preview first."""
    return suffix(name) in PREVIEWS, name


def stem(name: str) -> str:
    """A file's name without folder and suffix: the same for RAW and JPEG of one shot."""
    return name.rpartition("/")[2].rpartition(".")[0]
