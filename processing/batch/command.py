"""`lightstage-processing batch`: many sessions, on this machine or on a cluster."""

from __future__ import annotations

import secrets
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lightstage.commands import ConsentsOption, JsonFlag, finish, output_folder
from lightstage.counting import counted
from lightstage.errors import ConfigError, DiskFullError, FormatError, LightstageError, one_error
from lightstage.formats.access import group_of, limited_access
from lightstage.formats.consents import require_consents
from processing.atlas.config import AtlasConfig
from processing.errors import ProcessingError
from processing.options import TemplatePath

if TYPE_CHECKING:
    from lightstage.formats.session import Session
    from processing.batch.config import BatchConfig
    from processing.batch.drive import Batch, Item
    from processing.pipeline_config import PipelineConfig

MOST_WORKERS = 1024


def register(app: typer.Typer) -> None:
    """Add the command `batch` to an application."""
    app.command("batch")(batch_command)


def batch_command(
    sessions: list[Path] = typer.Argument(..., help="Session folders.", show_default=False),
    out: Path = output_folder("--out", help="Folder for a processed folder of each session."),
    template: Path = TemplatePath,
    config: Path | None = typer.Option(
        None, "--config", help="TOML file with one table for each stage, and [batch]."
    ),
    until: str = typer.Option("atlas", "--until", help="The last stage to run."),
    atlas_rows: int | None = typer.Option(
        None, "--atlas-rows", min=6, help=f"Atlas height in texels [{AtlasConfig.rows}]."
    ),
    workers: str = typer.Option(
        "auto",
        "--workers",
        help="Workers of this machine: a number, or auto for as many as its memory holds; a "
        "scheduler has its own.",
    ),
    consents: Path | None = ConsentsOption,
    scheduler: str | None = typer.Option(
        None, "--scheduler", help="Dask scheduler of a cluster, tcp://HOST:PORT."
    ),
    as_json: bool = JsonFlag,
) -> None:
    """Every session from photographs to the atlas; what is up to date is skipped."""
    from lightstage.formats.config import read_toml
    from processing.batch.config import take_batch
    from processing.pipeline import STAGES
    from processing.pipeline_config import config_of

    if until not in STAGES:
        raise ProcessingError("--until", found=repr(until), expected=", ".join(STAGES))
    count = wanted_workers(workers)
    if count is not None and scheduler is not None:
        raise ConfigError(
            "--workers",
            found="it beside --scheduler",
            expected="one of the two",
            hint="A scheduler's workers are started with `dask worker`.",
        )
    values = {} if config is None else read_toml(config)
    where = config or "configuration"
    settings = take_batch(values, where)
    stages = config_of(values, where, atlas_rows)
    opened = _read(sessions)
    given = {str(s.root): (s.file.model_extra or {}).get("consent") for s in opened}
    require_consents(consents, "research", given)
    with limited_access(group_of(sessions)):
        batch = _run(opened, out, template, stages, settings, until, count, scheduler)
    _end(batch, out, as_json)


def wanted_workers(workers: str) -> int | None:
    """The number of workers that the user wants; None for as many as memory holds."""
    if workers == "auto":
        return None
    if not (workers.isdecimal() and 1 <= int(workers[:6]) <= MOST_WORKERS):
        raise ConfigError(
            "--workers", found=repr(workers), expected=f"auto, or a number from 1 to {MOST_WORKERS}"
        )
    return int(workers)


def _read(paths: list[Path]) -> list[Session]:
    """All sessions, or every folder that is none, and every id that two folders have."""
    from lightstage.formats.session import load_session

    problems: list[LightstageError] = []
    sessions: list[Session] = []
    first: dict[str, Path] = {}
    for path in paths:
        try:
            session = load_session(path)
        except LightstageError as error:
            problems.append(error)
            continue
        other = first.setdefault(session.file.id, path)
        if other is not path:
            problems.append(
                FormatError(
                    path,
                    field="id",
                    found=f"session {session.file.id}, which {other} is already",
                    expected="each session once",
                    hint="Leave one of the two out.",
                )
            )
        sessions.append(session)
    if problems:
        raise one_error(problems)
    return sessions


def _run(
    sessions: list[Session],
    out: Path,
    template: Path,
    stages: PipelineConfig,
    settings: BatchConfig,
    until: str,
    count: int | None,
    scheduler: str | None,
) -> Batch:
    from processing.batch import cluster, needs, page, progress, work
    from processing.batch.drive import Batch, Item

    if not (template / "template.json").is_file():
        raise FormatError(template, found="no template.json in it", expected="a template's folder")
    sizes = [needs.megapixels(session) for session in sessions]
    if count is None and scheduler is None:
        needed = needs.peak_bytes(max(sizes), stages.atlas.rows, until)
        free = needs.free_bytes()
        count = needs.worker_count(needed, len(sessions), settings.memory_share, free)
    # Workers may have another working folder.
    out, template = out.resolve(), template.resolve()
    folders = [str(session.root.resolve()) for session in sessions]
    own = work.about(str(template), str(out), folders)
    out.mkdir(parents=True, exist_ok=True)
    with cluster.open_workers(scheduler, count or 1, settings) as workers:
        peers = cluster.require_fit(workers, template, out, folders, own, settings.away_s)
        batch_id = f"batch-{secrets.token_hex(4)}"
        items = [
            Item(
                work.Order(
                    batch_id,
                    folder,
                    str(out / session.file.id),
                    str(template),
                    stages,
                    until,
                    peers,
                    own["code"],
                    own["template"],
                ),
                session.file.id,
                session.file.subject,
                session.file.expression,
                size_mp,
            )
            for session, folder, size_mp in zip(sessions, folders, sizes, strict=True)
        ]
        with progress.shown() as show:
            written = time.monotonic()

            def show_batch(batch: Batch) -> None:
                nonlocal written
                show(batch.left())
                if time.monotonic() - written >= settings.page_every_s:
                    written = time.monotonic()
                    page.write_page(out, batch.items, settings.stands_out)

            batch = Batch(items, workers, settings, show_batch)
            try:
                batch.run()
            finally:
                page.write_page(out, items, settings.stands_out)
            show(batch.left())
    return batch


def _end(batch: Batch, out: Path, as_json: bool) -> None:
    """Report the result; failures come last, and then the command exits 2."""
    items = batch.items
    done = [item for item in items if item.state == "done"]
    failed = [item for item in items if item.state == "failed"]
    ran = sum(len(item.ran) for item in items)
    facts: dict[str, Any] = {
        "out": str(out),
        "sessions": len(items),
        "done": len(done),
        "stages_run": ran,
        "failed": {item.order.session: item.reason for item in failed},
        "not_begun": [item.order.session for item in items if item.state == "waiting"],
    }
    text = f"{out / 'batch.html'}: {len(done)} of {counted(len(items), 'session')} done, "
    text += f"{counted(ran, 'stage')} run"
    if len(done) == len(items):
        finish(text, facts, as_json)
        return
    for item in failed:
        if item.trace:
            print(item.trace, file=sys.stderr)
    print(text, file=sys.stderr)
    if as_json:
        finish(text, facts, True)
    if batch.full is not None:
        raise DiskFullError(
            f"{batch.full} No new stage was begun. Make room, and call this again to resume."
        )
    lines = [_failure(item) for item in failed]
    if batch.gone is not None:
        lines.append(f"{batch.gone}; what is done stays done")
    waiting = len(items) - len(done) - len(failed)
    raise ProcessingError(
        out,
        found=f"{counted(len(items) - len(done), 'session')} not done"
        + (f", {waiting} of them not worked on" if waiting else "")
        + "".join(f"\n  {line}" for line in lines),
        expected="all done",
        hint="Mend what is named, or leave these sessions out, and call this again to resume.",
    )


def _failure(item: Item) -> str:
    return f"{item.order.session} ({item.subject}, {item.expression}): {item.reason}"
