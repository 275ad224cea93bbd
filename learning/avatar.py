"""`avatar`: photographs, or captured maps, to a head that leaves the program, stage after stage.

A stage whose inputs, options and code are those of the last run is skipped.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import shutil
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from learning.checkpoint import code_version, shipped_points, shipped_weights
from learning.detail.command import ABOUT, detail_command
from learning.detail.command import OWN as OF_DETAIL
from learning.detail.config import RELIEF_MM, TIMES
from learning.errors import MapsError, NoReliefError
from learning.export.command import OWN as OF_EXPORT
from learning.export.command import README, export_command, formats_of
from learning.export.morphs import PHOTO
from learning.export.source import maps_folder
from learning.photo.avatar_page import write_avatar_page
from learning.photo.command import FIT, FitRequest, fit_command
from learning.photo.command import OWN as OF_FIT
from lightstage.commands import ProgressCallback
from lightstage.errors import ConfigError, DiskError
from lightstage.formats.exr import read_half_exr
from lightstage.formats.files import (
    others_below,
    others_in,
    read_json,
    require_replaceable,
    sha256_file,
    write_json,
)
from lightstage.formats.lock import locked
from lightstage.formats.processed import ProcessedFolder

SCHEMA = "lightstage.avatar/1"
STAGES = ("fit", "detail", "export")
KEYS = (*STAGES, "maps")
"""What the record has: of each stage, and of a captured head's maps."""
RECORD, PAGE = "avatar.json", "avatar.html"
"""What each stage was made of, by hash; and the page that shows what there is."""
LOCK = "avatar.lock"
"""Held while an avatar is made; the empty file stays."""
MARKS = {"fit": FIT, "detail": ABOUT, "export": README}
"""A file that a stage's folder holds."""
OWN = {"fit": OF_FIT, "detail": OF_DETAIL, "export": OF_EXPORT}
"""All that is in a stage's folder. What has other files too is neither removed nor replaced."""
NEUTRAL = "neutral"
EXPRESSIONS = (NEUTRAL, PHOTO)
"""With which a head may open."""
FLAT = "flat "
"""Stands before the hash of a fit in whose normals `detail` found no relief."""
Bar = Callable[[str], AbstractContextManager[ProgressCallback]]
"""Draws the progress of the stage that it is given."""


def avatar_command(
    request: FitRequest,
    until: str,
    formats: str,
    bar: Bar,
    maps: Path | None = None,
    expression: str = NEUTRAL,
) -> dict[str, Any]:
    """Make a head of photographs of one person: OUT/fit, OUT/detail, OUT/export, a page; the facts.

    A texture too small for pores has no OUT/detail; a note states it.

    Args:
        request: of the fit; its `out` is the avatar's folder.
        until: the last stage, of `STAGES`.
        formats: of `export`, with commas.
        bar: of each stage that runs.
        maps: of a captured head, such as a processed folder, in place of photographs: then there is
            no stage `fit`.
        expression: with which the exported head opens, of `EXPRESSIONS`.

    Raises:
        LightstageError: bad input; a stage that is there stays as it is.
    """
    began = time.monotonic()
    stages = STAGES if maps is None else STAGES[1:]
    if bool(request.photographs) == (maps is not None):
        raise ConfigError(
            "PHOTO, --maps",
            found="both" if request.photographs else "neither",
            expected="photographs, or the maps of a captured head",
        )
    if until not in stages:
        raise ConfigError("--until", found=repr(until), expected=" or ".join(stages))
    formats_of(formats)
    if expression not in EXPRESSIONS:
        raise ConfigError("--expression", found=repr(expression), expected=" or ".join(EXPRESSIONS))
    if maps is not None:
        _require_no_fit_options(request, expression)
    out = request.out
    others = others_in(out, [RECORD, PAGE, LOCK, *stages])
    if others:
        raise MapsError(
            out,
            field="--out",
            found=f"a folder that holds {others[0]}",
            expected="a new folder, or one that avatar made, of photographs or of maps as now",
            hint="Choose another --out.",
        )
    with _alone(out):
        facts = _made_of(request, stages, until, formats, bar, maps, expression)
    return {**facts, "seconds": time.monotonic() - began}


@contextlib.contextmanager
def _alone(out: Path) -> Iterator[None]:
    """Keep other calls out of the folder within the block; one that makes nothing leaves nothing.

    On a disk that cannot lock files nothing keeps others out.

    Raises:
        MapsError: another call writes there.
    """
    was_there = out.exists()
    busy = MapsError(
        out,
        field="--out",
        found="another avatar that is made there now",
        expected="a folder of this one's own",
        hint="Wait until it ends, or choose another --out.",
    )
    with contextlib.ExitStack() as held:
        with contextlib.suppress(DiskError):
            held.enter_context(locked(out / LOCK, busy))
        try:
            yield
        finally:
            if not others_in(out, [LOCK]):
                (out / LOCK).unlink(missing_ok=True)
                if not was_there:
                    out.rmdir()


def _made_of(
    request: FitRequest,
    stages: Sequence[str],
    until: str,
    formats: str,
    bar: Bar,
    maps: Path | None,
    expression: str,
) -> dict[str, Any]:
    """Make what is not up to date, see `avatar_command`; the facts."""
    out = request.out
    made, of_export = _record(out)
    source = out / "fit" if maps is None else maps
    fit_key = _hash(_fit_inputs(request) if maps is None else _maps_inputs(maps, request.template))
    keys = {
        "fit": fit_key,
        "detail": _hash([fit_key, RELIEF_MM, TIMES]),
        "export": _hash([fit_key, formats, expression]),
    }
    if maps is not None and made.get("maps") != fit_key:
        made = {"maps": fit_key}  # what is there was made of another head
    skipped = []
    wanted = stages[: stages.index(until) + 1]
    for stage in _anew(wanted, made, keys, out):
        # Before any work, not after minutes of it.
        require_replaceable(out / stage, MARKS[stage], own=OWN[stage])
    for stage in wanted:
        if _is_made(stage, made, keys[stage], out):
            skipped.append(stage)
            continue
        key = keys[stage]
        if made.pop(stage, None) is not None:
            # A kill before the new record would leave the stage under the key of an earlier one.
            _write_record(out, made, of_export)
        with bar(f"avatar {stage}") as progress:
            if stage == "fit":
                fit_command(dataclasses.replace(request, out=out / "fit"), progress)
                made, of_export = {}, []  # what is there was made of another fit
            elif stage == "detail":
                key = key if _detailed(source, out, progress) else FLAT + key
            else:
                of_export = _exported(source, request, formats, expression, progress)
        made[stage] = key
        # What was made of another head does not stay beside this one, and the page shows it.
        for other in _beside(made):
            _remove(out / other)
        (out / PAGE).unlink(missing_ok=True)
        _write_record(out, made, of_export)
    parts = [stage for stage in stages if not made.get(stage, FLAT).startswith(FLAT)]
    if not _is_newer(out / PAGE, out / RECORD):
        with bar("avatar page") as progress:
            write_avatar_page(out / PAGE, parts, maps, next(iter(request.photographs), None))
            progress(1, 1)
    facts = read_json(out / "fit" / FIT) if maps is None else _facts_of(maps)
    notes: list[str] = []
    if made.get("detail", "").startswith(FLAT):
        notes.append(
            f"no detail: the normals of {facts['rows']} rows have no pores and folds, those of "
            "768 rows and more may",
        )
    if "export" in parts:
        notes += of_export
    notes += [
        f"{out / other} is not of this head; it stays, as it holds what avatar did not make"
        for other in _beside(parts)
        if (out / other).exists()
    ]
    return {
        "rows": facts["rows"],
        "columns": facts["columns"],
        "lamps": facts["lamps"],
        "parts": parts,
        "skipped": skipped,
        "notes": [*facts["notes"], *notes],
    }


def _require_no_fit_options(request: FitRequest, expression: str) -> None:
    """Refuse options of a fit where there is none."""
    of_fit = {
        "--landmarks": request.landmarks is not None,
        "--face": request.face != 1,
        "--focal-35mm": request.film_mm is not None,
        "--checkpoint": request.checkpoint is not None,
        "--rows": request.rows is not None,
        "--refine": request.refine is not None,
        "--config": request.config is not None,
        "--expression": expression != NEUTRAL,
    }
    given = [name for name, is_given in of_fit.items() if is_given]
    if given:
        raise ConfigError(
            ", ".join(given),
            found="given with --maps",
            expected="photographs, as a captured head has no fit",
            hint="Leave out what is of the fit.",
        )


def _is_made(stage: str, made: dict[str, str], key: str, out: Path) -> bool:
    """Whether a stage is up to date, and its folder there."""
    if stage == "detail" and made.get(stage) == FLAT + key:
        return True
    return made.get(stage) == key and (out / stage / MARKS[stage]).exists()


def _anew(
    wanted: Sequence[str], made: dict[str, str], keys: dict[str, str], out: Path
) -> list[str]:
    """The stages that a call makes: those that are not up to date, and all after a new fit."""
    found = [stage for stage in wanted if not _is_made(stage, made, keys[stage], out)]
    return list(wanted) if "fit" in found else found


def _beside(parts: Iterable[str]) -> list[str]:
    """The stages after a fit that are not among some."""
    return [stage for stage in STAGES[1:] if stage not in parts]


def _is_newer(page: Path, record: Path) -> bool:
    """Whether the page was written after the last stage: a kill may come between."""
    return page.exists() and page.stat().st_mtime_ns >= record.stat().st_mtime_ns


def _detailed(source: Path, out: Path, progress: ProgressCallback) -> bool:
    """Make OUT/detail; false, and one of another fit is gone, where there is no relief."""
    folder = out / "detail"
    try:
        detail_command(source, None, folder, RELIEF_MM, TIMES, progress)
    except NoReliefError:
        _remove(folder)
        return False
    return True


def _remove(folder: Path) -> None:
    """Remove a stage's folder if it has the stage's mark and nothing but the stage's files."""
    stage = folder.name
    if (folder / MARKS[stage]).is_file() and not others_below(folder, OWN[stage]):
        shutil.rmtree(folder)


def _exported(
    source: Path, request: FitRequest, formats: str, expression: str, progress: ProgressCallback
) -> list[str]:
    """Make OUT/export; returns notes for the user."""
    facts = export_command(
        source,
        None,
        formats,
        request.out / "export",
        request.template,
        None,
        progress,
        replace=True,
        opens_with=PHOTO if expression == PHOTO else None,
    )
    notes: list[str] = facts["notes"]
    return notes


def _fit_inputs(request: FitRequest) -> list[Any]:
    """All that a fit depends on: contents of files, options, code."""
    template = sorted(path for path in request.template.rglob("*") if path.is_file())
    checkpoint = request.checkpoint or shipped_weights()
    weights = checkpoint if checkpoint.is_dir() else checkpoint.parent
    named = [request.landmarks, request.config]
    return [
        code_version(),
        [[path.name, _content(path)] for path in request.photographs],
        [[path.name, _content(path)] for path in template],
        [
            _content(path)
            for folder in (weights, shipped_points())
            for path in sorted(folder.glob("*.safetensors"))
        ],
        [None if path is None else _content(path) for path in named],
        [request.face, request.film_mm, request.rows, request.refine],
    ]


def _maps_inputs(maps: Path, template: Path) -> list[Any]:
    """All that a captured head's export depends on."""
    folder = maps_folder(maps, "--maps")
    beside = ProcessedFolder(folder.parent)
    files = [*sorted(folder.glob("*.exr")), beside.registered_mesh, beside.head_pose]
    files.append(beside.neutral_mesh)
    files += sorted(path for path in template.rglob("*") if path.is_file())
    return [code_version(), [[path.name, _content(path)] for path in files]]


def _facts_of(maps: Path) -> dict[str, Any]:
    """The fields of `fit.json` for a captured head."""
    albedo = read_half_exr(maps_folder(maps) / "diffuse_albedo.exr")
    return {"rows": albedo.shape[0], "columns": albedo.shape[1], "lamps": None, "notes": []}


def _content(path: Path) -> str | None:
    """A file's hash; None for what is no file: the fit refuses it, and a pipe is not waited for."""
    return sha256_file(path) if path.is_file() else None


def _hash(values: list[Any]) -> str:
    return hashlib.sha256(json.dumps(values).encode()).hexdigest()


def _record(out: Path) -> tuple[dict[str, str], list[str]]:
    """What the stages that are there were made of, and notes of the export that is there.

    Nothing where no record can be read.
    """
    if not (out / RECORD).exists():
        return {}, []
    record = read_json(out / RECORD, SCHEMA)
    stages, notes = record.get("stages"), record.get("export_notes")
    return (
        {k: v for k, v in stages.items() if k in KEYS} if isinstance(stages, dict) else {},
        [note for note in notes if isinstance(note, str)] if isinstance(notes, list) else [],
    )


def _write_record(out: Path, made: dict[str, str], of_export: list[str]) -> None:
    """Write what `_record` reads."""
    write_json(out / RECORD, {"schema": SCHEMA, "stages": made, "export_notes": of_export})
