"""`avatar`: photographs to a head that leaves the program, stage after stage.

A stage whose inputs, options and code are those of the last run is skipped.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import time
from pathlib import Path
from typing import Any

from learning.checkpoint import code_version, shipped_weights
from learning.errors import MapsError
from learning.export.command import export_command, formats_of
from learning.photo.command import FIT, FitRequest, fit_command
from lightstage.commands import ProgressCallback, quiet
from lightstage.errors import ConfigError
from lightstage.formats.files import others_in, read_json, sha256_file, write_json

SCHEMA = "lightstage.avatar/1"
STAGES = ("fit", "export")
RECORD = "avatar.json"
"""What each stage was made of, by hash."""


def avatar_command(
    request: FitRequest, until: str, formats: str, progress: ProgressCallback
) -> dict[str, Any]:
    """Make a head of photographs of one person in OUT/fit and OUT/export; the facts.

    Args:
        request: of the fit; its `out` is the avatar's folder.
        until: the last stage, of `STAGES`.
        formats: of `export`, with commas.
        progress: of the fit, which takes nearly all of the time.

    Raises:
        LightstageError: bad input; a stage that is there stays as it is.
    """
    began = time.monotonic()
    if until not in STAGES:
        raise ConfigError("--until", found=repr(until), expected=" or ".join(STAGES))
    formats_of(formats)
    out = request.out
    others = others_in(out, [RECORD, *STAGES])
    if others:
        raise MapsError(
            out,
            field="--out",
            found=f"a folder that holds {others[0]}",
            expected="a new folder, or one that avatar made",
            hint="Choose another --out.",
        )
    made = _record(out)
    fit_key = _hash(_fit_inputs(request))
    skipped = []
    facts: dict[str, Any] = {}
    if made.get("fit") == fit_key and (out / "fit" / FIT).exists():
        skipped.append("fit")
        progress(1, 1)
        facts = read_json(out / "fit" / FIT)
    else:
        facts = fit_command(_in_folder(request, out / "fit"), progress)
        made = {"fit": fit_key}
        _keep(out, made)
    exported: dict[str, Any] = {}
    if until == "export":
        export_key = _hash([fit_key, formats])
        if made.get("export") == export_key and (out / "export").is_dir():
            skipped.append("export")
        else:
            exported = export_command(
                out / "fit",
                None,
                formats,
                out / "export",
                request.template,
                None,
                quiet,
                replace=True,
            )
            made["export"] = export_key
            _keep(out, made)
    return {
        "rows": facts["rows"],
        "columns": facts["columns"],
        "lamps": facts["lamps"],
        "skipped": skipped,
        "notes": [*facts["notes"], *exported.get("notes", [])],
        "seconds": time.monotonic() - began,
    }


def _in_folder(request: FitRequest, out: Path) -> FitRequest:
    return dataclasses.replace(request, out=out)


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
        [_content(path) for path in sorted(weights.glob("*.safetensors"))],
        [None if path is None else _content(path) for path in named],
        [request.face, request.film_mm, request.rows, request.refine],
    ]


def _content(path: Path) -> str | None:
    """A file's hash; None for what is no file: the fit refuses it, and a pipe is not waited for."""
    return sha256_file(path) if path.is_file() else None


def _hash(values: list[Any]) -> str:
    return hashlib.sha256(json.dumps(values).encode()).hexdigest()


def _record(out: Path) -> dict[str, str]:
    """What the stages that are there were made of; nothing where no record can be read."""
    if not (out / RECORD).exists():
        return {}
    stages = read_json(out / RECORD, SCHEMA).get("stages")
    return {k: v for k, v in stages.items() if k in STAGES} if isinstance(stages, dict) else {}


def _keep(out: Path, made: dict[str, str]) -> None:
    write_json(out / RECORD, {"schema": SCHEMA, "stages": made})
