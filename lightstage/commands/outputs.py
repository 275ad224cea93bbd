"""Options that name what a command writes: each is tried before any work begins.

A command that has computed for an hour must not end with "no permission". An option made here is
checked while the command line is read: the disk must take a small file there.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import stat
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import typer

from lightstage.counting import counted
from lightstage.errors import ConfigError, DiskError
from lightstage.failures import disk_full, explain, is_disk_full, nearest_existing
from lightstage.formats.access import share

_BLOCK = bytes(4096)
_NAME_BYTES = 255 - 24
"""Bytes of one name in a path, at most: temporary names add up to 24 bytes to a file's."""


def output_file(
    *names: str,
    help: str,  # noqa: A002  Typer's word
    suffixes: Sequence[str] = (),
    default: Any = ...,
    shared: bool = False,
) -> Any:
    """A Typer option for a file to write.

    Args:
        names: of the option, such as `--out`.
        help: what `--help` prints.
        suffixes: what its name may end in, lower case; any where empty.
        default: where the option is absent; required without it.
        shared: it shows nobody's face and is made to be passed on, so that the user's own umask
            holds for it; what a command writes is its owner's alone else.
    """
    return _option(names, help, default, shared, lambda name, path: try_file(name, path, suffixes))


def output_folder(
    *names: str,
    help: str,  # noqa: A002  Typer's word
    default: Any = ...,
    shared: bool = False,
) -> Any:
    """A Typer option for a folder to write into, made where absent; arguments as `output_file`."""
    return _option(names, help, default, shared, try_folder)


def try_file(option: str, path: Path, suffixes: Sequence[str] = ()) -> None:
    """Make sure that a file can be written at `path`; nothing is left there.

    Args:
        option: that named it, for messages.
        path: file to write; an existing file would be replaced.
        suffixes: what its name may end in; any where empty.

    Raises:
        ConfigError: another suffix.
        DiskError: a folder, no permission, a full or read-only disk ...
    """
    if suffixes and path.suffix.lower() not in suffixes:
        found = f"suffix {path.suffix!r}" if path.suffix else "no suffix"
        raise ConfigError(path, field=option, found=found, expected=" or ".join(suffixes))
    with _named(option, path):
        if stat.S_ISDIR(_mode(path)):
            raise DiskError(path, found="a folder", expected="a file to write")
        _try(path.parent)


def try_folder(option: str, path: Path) -> None:
    """Make sure that files can be written into a folder `path`; nothing is left there.

    Raises:
        DiskError: a file, no permission, a full or read-only disk ...
    """
    with _named(option, path):
        if os.path.lexists(path) and not stat.S_ISDIR(_mode(path)):
            found = "a link that leads nowhere" if path.is_symlink() else "a file"
            raise DiskError(path, found=found, expected="a folder to write into")
        _try(path)


def _option(
    names: tuple[str, ...],
    help_text: str,
    default: Any,
    shared: bool,
    check: Callable[[str, Path], None],
) -> Any:
    def tried(param: typer.CallbackParam, value: Path | None) -> Path | None:
        if value is not None and param.name is not None:
            check(f"--{param.name.replace('_', '-')}", value)
            if shared:
                share()
        return value

    return typer.Option(default, *names, help=help_text, callback=tried, show_default=False)


def _mode(path: Path) -> int:
    """The kind of file that `path` leads to; 0 where there is none."""
    try:
        return path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        return 0


def _try(folder: Path) -> None:
    """Write a small file into `folder`, or the nearest folder above that exists, and remove it."""
    trial = nearest_existing(folder) / f".trial.{secrets.token_hex(4)}"
    try:
        with trial.open("xb") as file:
            file.write(_BLOCK)
            file.flush()
            os.fsync(file.fileno())
    finally:
        with contextlib.suppress(OSError):
            trial.unlink()


@contextlib.contextmanager
def _named(option: str, path: Path) -> Iterator[None]:
    """Report what goes wrong inside as an error of this option and path."""
    try:
        for name in path.parts:
            if len(os.fsencode(name)) > _NAME_BYTES:
                raise DiskError(
                    path,
                    found=f"a name of {counted(len(os.fsencode(name)), 'byte')}",
                    expected=f"at most {_NAME_BYTES} bytes a name",
                )
        yield
    except FileNotFoundError:
        expected = "a place that can be written"
        raise DiskError(path, field=option, found="no place for files", expected=expected) from None
    except (OSError, DiskError) as error:
        explained = disk_full(path) if is_disk_full(error) else explain(error)
        assert explained is not None  # `explain` knows every OSError
        raise type(explained)(
            path,
            field=option,
            found=explained.found,
            expected=explained.expected,
            hint="Name another place to write to.",
        ) from None
