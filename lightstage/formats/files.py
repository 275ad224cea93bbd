"""Files that are either whole or absent: written beside, fsynced, renamed."""

from __future__ import annotations

import contextlib
import fnmatch
import glob
import hashlib
import json
import math
import os
import re
import secrets
import shutil
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from lightstage.counting import counted
from lightstage.errors import DiskFullError, FormatError
from lightstage.failures import disk_full, is_disk_full
from lightstage.formats.lock import abandoned, being_filled, remove_abandoned
from lightstage.formats.values import read_value

NAME_BYTES = 4
"""Random bytes in the name of a file that is written beside, so that two writers never share one.
"""
REMOVALS, REMOVAL_PAUSE_S = 100, 0.02
SEEN_GONE = 5
"""A folder that is not there at so many looks in a row stays away: nobody writes into it now."""
OF_SYSTEMS = (".DS_Store", "Thumbs.db", "desktop.ini", ".directory")
"""What file managers leave in a folder that they show: nobody's, and nobody misses it."""


def fsync_path(path: Path) -> None:
    """Flush a file or a folder to the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


@contextlib.contextmanager
def atomic_path(path: Path, size: int | None = None) -> Iterator[Path]:
    """Yield a name beside `path` to write to; on success fsync it and rename it onto `path`.

    The temporary name keeps the suffix, since writers choose their format by it.
    If the block raises, the temporary file is removed and `path` is left as it was.

    Args:
        path: the file to write or to replace.
        size: its bytes, where they are known, so that an error of a full disk names what is
        missing.

    Raises:
        DiskFullError: the disk filled up, whatever the writer raised for it.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_name(f".{path.stem}.{secrets.token_hex(NAME_BYTES)}{path.suffix}")
    try:
        yield beside
        fsync_path(beside)
        os.replace(beside, path)
        fsync_path(path.parent)
    except Exception as error:
        if not is_disk_full(error):
            raise
        written = beside.stat().st_size if beside.is_file() else 0
        beside.unlink(missing_ok=True)
        raise disk_full(path, written, size) from error
    finally:
        beside.unlink(missing_ok=True)


def leftovers(folder: Path, name: str) -> list[Path]:
    """What writers that were killed left beside the files or folders of a name.

    Call this only as the folder's single writer: files that another writer has not finished look
    the same.

    Args:
        folder: where they were to be.
        name: theirs, or a glob of it, as it was given to `atomic_path` or `atomic_folder`.
    """
    own = Path(name)
    digits = "[0-9a-f]" * 2 * NAME_BYTES
    beside = f".{own.stem}.{digits}{own.suffix}"
    return sorted([*folder.glob(beside), *folder.glob(f"{beside}.old")])


def abandoned_beside(path: Path) -> list[Path]:
    """Half-filled folders that killed calls of `atomic_folder` left beside `path`, sorted.

    What somebody is filling is not among them.
    """
    beside = f".{glob.escape(path.name)}.{'[0-9a-f]' * 2 * NAME_BYTES}"
    halves = [half for half in path.parent.glob(beside) if abandoned(half)]
    # An old folder is moved away for the moment in which the new one takes its place.
    olds = [old for old in path.parent.glob(f"{beside}.old") if not _being_replaced(old)]
    return sorted([*halves, *olds])


def _being_replaced(old: Path) -> bool:
    half = old.with_suffix("")
    return half.exists() and not abandoned(half)


def _clear_of_killed(path: Path) -> None:
    """Remove what killed calls left beside `path`, and put back what they had moved away."""
    for left in abandoned_beside(path):
        with contextlib.suppress(OSError):  # of another user, or gone meanwhile
            if left.suffix == ".old" and not path.exists():
                os.replace(left, path)
            else:
                remove_abandoned(left)


def others_in(folder: Path, own: Iterable[str]) -> list[str]:
    """Names in an output folder that are of no file that its command makes, sorted.

    Args:
        folder: may be absent.
        own: what the command makes, as globs of names.
    """
    there = sorted(path.name for path in folder.iterdir()) if folder.is_dir() else []
    made = [*own, *OF_SYSTEMS]
    return [name for name in there if not any(fnmatch.fnmatch(name, each) for each in made)]


def others_below(folder: Path, own: Iterable[str]) -> list[str]:
    """Files in an output folder, also in folders below it, that its command does not make, sorted.

    Links count, wherever they lead; empty folders do not.

    Args:
        folder: may be absent.
        own: paths in it of what the command makes, as globs in which no star matches a slash.
    """
    patterns = [each.split("/") for each in own]
    found = []
    for path in folder.rglob("*") if folder.is_dir() else []:
        names = path.relative_to(folder).parts
        is_file = not path.is_dir() or path.is_symlink()
        if (
            is_file
            and path.name not in OF_SYSTEMS
            and not any(
                len(names) == len(pattern) and all(map(fnmatch.fnmatch, names, pattern))
                for pattern in patterns
            )
        ):
            found.append("/".join(names))
    return sorted(found)


def require_replaceable(
    path: Path,
    marker: str,
    kind: str | None = None,
    schema: str | None = None,
    own: Iterable[str] | None = None,
) -> None:
    """Refuse an output folder that a command of this kind did not make.

    Args:
        path: the folder to make or to replace.
        marker: a file that a folder of this kind holds.
        kind: the `kind` that the marker, a JSON object, must have; None where its name is enough.
        schema: the `schema` that it must have, of any version; None where other files of its name
            have the same or none.
        own: all that the command makes, see `others_below`; None where anything beside the marker
            may be lost.

    Raises:
        FormatError: `path` is a file, a folder that holds something and is of another kind or has
            files of others, or the working folder or one above it.
    """
    working = _working_folder()
    if working is not None and path.resolve() in (working, *working.parents):
        # It is replaced as a whole, and whoever is in it would be left in a folder that is gone.
        raise FormatError(
            path,
            found="the working folder, or one above it",
            expected="another one, as a folder of results is replaced as a whole",
            hint="Name a folder in this one, or call the command from elsewhere.",
        )
    if not path.exists() or (path.is_dir() and not any(path.iterdir())):
        return
    found = ""
    if not (path / marker).is_file():
        found = f"something else that holds no {marker}"
    elif kind is not None or schema is not None:
        try:
            value = read_json(path / marker)
        except FormatError:
            value = None
        value = value if isinstance(value, dict) else {}
        if kind is not None and value.get("kind") != kind:
            found = f"a folder whose {marker} is of kind {value.get('kind')!r}, not {kind!r}"
        elif schema is not None and _stem(value.get("schema")) != _stem(schema):
            found = f"a folder whose {marker} is {value.get('schema')!r}, not {schema!r}"
    if found:
        raise FormatError(
            path,
            found=found,
            expected="a new folder, or one made by the same command",
            hint="Choose another output folder.",
        )
    others = [] if own is None else others_below(path, own)
    if others:
        more = f" and {counted(len(others) - 1, 'more file')}" if len(others) > 1 else ""
        raise FormatError(
            path,
            found=f"{others[0]}{more}, which the command did not make",
            expected="its own files alone, as the folder is replaced as a whole",
            hint="Move what is yours elsewhere, or choose another output folder.",
        )


def _stem(schema: object) -> str:
    """A schema without its version."""
    return str(schema).rpartition("/")[0]


def _working_folder() -> Path | None:
    """Where this process was called; None where that folder is gone."""
    try:
        return Path.cwd().resolve()
    except FileNotFoundError:
        return None


def require_new(
    path: Path,
    overwrite: bool,
    marker: str,
    kind: str | None = None,
    own: Iterable[str] | None = None,
) -> None:
    """Refuse an output folder that holds something, unless it may be replaced.

    Args:
        path: the folder to make.
        overwrite: whether the user asked to replace what is there.
        marker: see `require_replaceable`.
        kind: see `require_replaceable`.
        own: see `require_replaceable`.

    Raises:
        FormatError: a folder that holds something, or one of another kind or with files of others.
    """
    require_replaceable(path, marker, kind, own=own)
    if not overwrite and path.is_dir() and any(path.iterdir()):
        raise FormatError(
            path,
            found="a folder that holds something",
            expected="a new one",
            hint="Name another, or pass --overwrite.",
        )


@contextlib.contextmanager
def atomic_folder(
    path: Path,
    marker: str,
    kind: str | None = None,
    schema: str | None = None,
    own: Iterable[str] | None = None,
) -> Iterator[Path]:
    """Yield a new folder beside `path` to fill; on success it takes the place of `path`.

    If the block raises, the new folder is removed and `path` is left as it was. What killed calls
    for the same `path` left is removed first.

    Args:
        path: the folder to make or to replace.
        marker: a file that a folder of this kind holds. A folder that exists, holds something and
            lacks it is somebody else's and is refused.
        kind: see `require_replaceable`.
        schema: see `require_replaceable`.
        own: see `require_replaceable`.

    Raises:
        FormatError: see `require_replaceable`.
        DiskFullError: the disk filled up, whatever the writer raised for it.
    """
    require_replaceable(path, marker, kind, schema, own)
    # Of a link what it leads to is replaced, and the link stays.
    path = path.resolve()
    path.parent.mkdir(parents=True, exist_ok=True)
    _clear_of_killed(path)

    def name() -> Path:
        return path.with_name(f".{path.name}.{secrets.token_hex(NAME_BYTES)}")

    with being_filled(name) as beside:
        old = beside.with_name(beside.name + ".old")
        try:
            yield beside
            fsync_path(beside)
            require_replaceable(path, marker, kind, schema, own)  # what came meanwhile is not lost
            if path.exists():
                os.replace(path, old)
            os.replace(beside, path)
            fsync_path(path.parent)
        except BaseException as error:
            full = is_disk_full(error)
            # The file that met the full disk is gone by now.
            met = error.written if isinstance(error, DiskFullError) else 0
            written = met + _bytes_below(beside) if full else 0
            _remove(beside)
            if full:
                raise disk_full(path, written) from error
            raise
        finally:
            if old.exists() and not path.exists():
                os.replace(old, path)
            shutil.rmtree(old, ignore_errors=True)


def _remove(folder: Path) -> None:
    """Remove a folder, also while a library's threads still write the last files into it."""
    gone = 0
    for _ in range(REMOVALS):
        if not folder.exists():
            gone += 1
            if gone == SEEN_GONE:
                return
        else:
            gone = 0
            shutil.rmtree(folder, ignore_errors=True)
        time.sleep(REMOVAL_PAUSE_S)


def _bytes_below(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def write_bytes(path: Path, data: bytes) -> Path:
    """Write bytes atomically; returns `path`."""
    with atomic_path(path, len(data)) as beside:
        beside.write_bytes(data)
    return path


def write_text(path: Path, text: str) -> Path:
    """Write UTF-8 text atomically; returns `path`."""
    return write_bytes(path, text.encode())


def write_json(path: Path, value: Any) -> Path:
    """Write JSON atomically (NaN refused); returns `path`."""
    return write_text(path, json.dumps(value, indent=1, allow_nan=False) + "\n")


def without_nan(value: Any) -> Any:
    """A value with null in place of each number that is not finite: JSON has none of these."""
    if isinstance(value, dict):
        return {key: without_nan(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [without_nan(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def read_json(path: Path, schema: str | None = None) -> Any:
    """Read a JSON file.

    Args:
        path: the file.
        schema: such as ``lightstage.rig/1``; a file of another name or a newer major version is
            refused.

    Raises:
        FormatError: missing, not JSON within the reader's limits (formats.values), or of another
            schema.
    """
    value = read_value(path)
    if schema is not None:
        check_schema(path, value, schema)
    return value


def check_schema(path: Path, value: Any, schema: str) -> None:
    """Refuse a JSON value that is not of `schema` or is of a newer major version."""
    found = value.get("schema") if isinstance(value, dict) else None
    name, _, major = schema.partition("/")
    found_name, _, found_major = str(found).partition("/")
    digits = found_major.split(".")[0]
    if found_name != name or not re.fullmatch("[0-9]{1,9}", digits):
        raise FormatError(
            path,
            field="schema",
            found=repr(found),
            expected=repr(schema),
            hint="docs/formats.md describes each file.",
        )
    if int(digits) > int(major):
        raise FormatError(
            path,
            field="schema",
            found=repr(found),
            expected=f"at most {schema!r}",
            hint="The file was written by a newer version; update this software.",
        )


def sha256_file(path: Path) -> str:
    """SHA-256 of a file's bytes as they are on disk, in hexadecimal."""
    with path.open("rb") as handle:
        return hashlib.file_digest(handle, "sha256").hexdigest()
