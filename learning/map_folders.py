"""Which folder of maps is meant, where one was named that holds several or another kind."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from learning.errors import MapsError
from lightstage.counting import counted

MARK = "diffuse_albedo.exr"
"""A folder that holds this one holds maps."""
DEEPEST = 3
NAMED = 6


def require_texture_maps(folder: Path, option: str = "--maps") -> None:
    """Refuse a folder that holds no maps of its own, or a camera's instead of the texture's.

    Args:
        folder: as given.
        option: by which it was given; empty of an argument.

    Raises:
        MapsError: no folder; several folders of maps below, listed with their kinds; none at all; a
            view's maps, which are pictures of one camera.
    """
    if not folder.is_dir():
        raise MapsError(
            folder,
            field=option,
            found="a file" if folder.exists() else "no such folder",
            expected="a folder of maps, such as OUT/atlas of a processed folder",
        )
    if (folder / MARK).is_file():
        if folder.resolve().parent.name == "views":
            raise MapsError(
                folder,
                field=option,
                found="one camera's maps, in the layout of its photograph",
                expected="maps in the texture's layout",
                hint=f"Give {folder.resolve().parent.parent / 'atlas'}, which the stage atlas "
                "makes of all views.",
            )
        return
    found = sorted(_below(folder, DEEPEST))
    if not found:
        raise MapsError(
            folder,
            field=option,
            found=f"no {MARK} in it nor below",
            expected="a folder of maps, such as OUT/atlas of a processed folder",
        )
    textures = [path for path in found if path.parent.name != "views"]
    named = [f"{path.relative_to(folder)} ({_meaning(path)})" for path in found[:NAMED]]
    more = [f"{len(found) - NAMED} more"] if len(found) > NAMED else []
    choice = f"Give {textures[0]}" if textures else "Run the stage atlas, which makes it"
    raise MapsError(
        folder,
        field=option,
        found=f"no maps of its own, but {counted(len(found), 'folder')} of maps below: "
        + ", ".join([*named, *more]),
        expected="one folder of maps in the texture's layout",
        hint=f"{choice}." if len(textures) < 2 else f"{choice}, or another of one person.",
    )


def _meaning(folder: Path) -> str:
    if folder.parent.name == "views":
        return "one camera's, in the layout of its photograph"
    if folder.name == "atlas":
        return "the texture of one person and expression"
    return "maps in a texture's layout"


def _below(folder: Path, depth: int) -> Iterator[Path]:
    """Folders with maps below one, down to a depth."""
    with os.scandir(folder) as entries:
        inner = [Path(e.path) for e in entries if e.is_dir() and not e.name.startswith(".")]
    for path in inner:
        if (path / MARK).is_file():
            yield path
        elif depth > 1:
            yield from _below(path, depth - 1)
