"""Who may read what shows a person's face: its owner, the lab's group if the lab wants it."""

from __future__ import annotations

import contextlib
import os
import stat
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Literal

Group = Literal["nothing", "read", "write"]
"""What the group of a folder may do with it and with what is in it."""

_MASKS: dict[Group, int] = {"nothing": 0o077, "read": 0o027, "write": 0o007}


class _Process:
    """What the umask of this process was before a command began; None outside commands."""

    users_umask: int | None = None


@contextlib.contextmanager
def private_command() -> Iterator[None]:
    """Make all that a command writes its owner's alone, until it decides otherwise.

    It decides so by `share`, which is called for outputs that show nobody, or by `limited_access`,
    which gives the lab's group what it may have.
    """
    _Process.users_umask = os.umask(_MASKS["nothing"])
    try:
        yield
    finally:
        os.umask(_Process.users_umask)
        _Process.users_umask = None


def share() -> None:
    """Let the user's own umask hold for what this command writes: it shows nobody's face."""
    if _Process.users_umask is not None:
        os.umask(_Process.users_umask)


@contextlib.contextmanager
def limited_access(group: Group = "nothing") -> Iterator[None]:
    """Make new files and folders of this process and its children private within the block.

    The user's own umask is set aside: folders are 0700 and files 0600, with the group's
    permissions beside that where `group` gives it any. Temporary files have these permissions from
    their first byte on, so that what is renamed has them too. The umask is one for all threads of
    the process: this belongs around a whole command.
    """
    before = os.umask(_MASKS[group])
    try:
        yield
    finally:
        os.umask(before)


def close_folder(path: Path) -> None:
    """Give a folder the permissions that a new one gets within `limited_access`.

    A folder that was there already, or whose permissions come from its parent's access list, can be
    open to others. A disk without permissions, and a folder of another user, stay as they are.
    """
    mask = os.umask(0)
    os.umask(mask)
    with contextlib.suppress(PermissionError, NotImplementedError):
        os.chmod(path, stat.S_IMODE(path.stat().st_mode) & ~0o777 | 0o777 & ~mask)


def group_of(folders: Iterable[Path]) -> Group:
    """What the group may do with every one of some folders; nothing where there are none.

    What is made of a session, and what is added to it, is as open as the session, and never open
    to users outside the group.
    """
    bits = 0o070
    found = False
    for folder in folders:
        with contextlib.suppress(OSError):
            bits &= folder.stat().st_mode
            found = True
    if not found or bits & 0o050 != 0o050:
        return "nothing"
    return "write" if bits & 0o020 else "read"
