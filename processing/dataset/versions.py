"""Whether another release has a release's name and version: its patches are others."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from lightstage.counting import counted
from lightstage.errors import LightstageError
from lightstage.formats.files import read_json
from lightstage.formats.values import read_lines
from processing.dataset.about import About
from processing.dataset.contents import RELEASES
from processing.dataset.croissant import CROISSANT
from processing.dataset.store import Store


def same_version(store: Store, out: Path, about: About) -> str:
    """What to warn of where another release has the same name and version; empty where none has.

    Those are compared that the store has recorded, wherever they are now, one that is replaced, and
    all beside it, which another store may have made. Call this before the release is made.

    Args:
        store: that it is made of.
        out: where it is going to be.
        about: the lab's statements on it.
    """
    wanted = about.name, about.version
    known = [place for place, named in _releases(store.path, out.resolve()) if named == wanted]
    others = list(dict.fromkeys(known))
    if not others:
        return ""
    more = f" and {counted(len(others) - 1, 'more release')}" if len(others) > 1 else ""
    major = int(about.version.partition(".")[0]) + 1
    return (
        f"version {about.version} of {about.name!r} is that of {others[0]}{more} too, which has "
        "other patches, since they are drawn anew for each release: where that one has left the "
        f'lab, state another `version` in --about, such as "{major}.0.0", and publish again'
    )


def _releases(store: Path, out: Path) -> Iterator[tuple[str, tuple[Any, Any]]]:
    """Places of releases, with the name and version of each, as croissant.json has them too."""
    recorded = read_lines(store / RELEASES) if (store / RELEASES).is_file() else []
    lines = [line for line in recorded if isinstance(line, dict)]
    # The newest first. Lines of earlier versions have no name: the release itself may be there.
    for line in reversed(lines):
        if "version" in line:
            yield str(line.get("out")), _named(line)
    for folder in (out, *(Path(str(line.get("out"))) for line in lines), *_beside(out)):
        with contextlib.suppress(LightstageError):
            value = read_json(folder / CROISSANT)
            if isinstance(value, dict):
                yield str(folder), _named(value)


def _beside(out: Path) -> list[Path]:
    return sorted(path.parent for path in out.parent.glob(f"*/{CROISSANT}"))


def _named(value: dict[str, Any]) -> tuple[Any, Any]:
    return value.get("name"), value.get("version")
