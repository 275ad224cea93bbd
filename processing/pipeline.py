"""The stages in order, from photographs to the registered atlas, and which of them are stale."""

from __future__ import annotations

import contextlib
import ctypes
import dataclasses
import functools
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from lightstage.commands import ProgressCallback, quiet
from lightstage.errors import FormatError, one_error
from lightstage.formats.config import as_dict
from lightstage.formats.files import read_json, write_json
from lightstage.formats.lock import locked
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.session import Session, changed_frames, load_session
from lightstage.formats.template import Template, load_template
from processing.atlas.stage import atlas
from processing.coarse_maps import has_coarse, write_as_views
from processing.decode.completing import unmendable_frames, with_complements
from processing.decode.stage import decode, lit_patterns
from processing.errors import ProcessingError
from processing.pages import lacks_head, write_processed_report
from processing.pipeline_config import PipelineConfig, require_named
from processing.reconstruction.stage import reconstruct
from processing.records import (
    EVALUATION,
    REPORT_SCHEMA,
    RUN_LOCK,
    MadeFrom,
    Record,
    files_in,
    hash_template,
    measured,
    read_records,
    remove_leftovers,
    require_own,
    require_same_session,
    versions,
    write_records,
)
from processing.refinement.stage import refine
from processing.registration.stage import register, require_landmarks
from processing.separation.choice import give_normals, no_normals
from processing.separation.stage import separate
from processing.stage_inputs import STAGE_MODULES, StageInputs, stage_inputs, why_stale

STAGES = tuple(STAGE_MODULES)
WITH_TEMPLATE = ("register", "atlas")
WITH_NORMALS = ("separate", "refine", "atlas")
"""Stages that photographs from fewer than three directions of light cannot feed."""
READS_COARSE = ("reconstruct", "refine")
"""Stages that read the coarse maps of `separate` in OUT/work."""
VIEWS = "views/"
"""Maps that last: those of `refine`, or of `separate` where a run ends with it."""

Bar = Callable[[str], contextlib.AbstractContextManager[ProgressCallback]]
"""Given a stage's name, a context with a progress callback, such as `commands.progress_bar`."""


@dataclasses.dataclass(frozen=True)
class Job:
    """What the stages work on."""

    session: Session
    out: Path
    config: PipelineConfig
    template: Template | None
    template_hash: str
    normals: bool = True
    """Whether the photographs determine normals."""

    @property
    def stages(self) -> tuple[str, ...]:
        """The stages that such photographs go through, in order."""
        return STAGES if self.normals else tuple(s for s in STAGES if s not in WITH_NORMALS)

    @property
    def made_from(self) -> MadeFrom:
        """The session as the folder's records have it."""
        return MadeFrom(self.session.file.id, self.session.file.subject)


@contextlib.contextmanager
def no_bar(stage: str) -> Iterator[ProgressCallback]:
    """A bar that shows nothing."""
    del stage
    yield quiet


def run(
    session_path: Path,
    out: Path,
    template_path: Path,
    config: PipelineConfig,
    *,
    until: str = STAGES[-1],
    only: str | None = None,
    bar: Bar = no_bar,
) -> dict[str, Any]:
    """Process a session; stages whose inputs, configuration and code did not change are skipped.

    Every photograph is verified before anything is written.

    Args:
        session_path: a session folder.
        out: the processed folder, made or continued.
        template_path: a template folder.
        config: of all stages.
        until: the last stage.
        only: run this one stage, on what the earlier ones left in `out`.
        bar: draws progress.

    Returns:
        The content of OUT/report.json (report.html shows it), plus "ran": the stages that were not
        skipped.

    Raises:
        LightstageError: input that the user can mend; stages that finished before stay finished.
    """
    last = only or until
    job = read_job(session_path, out, template_path, config, last)
    # What these refuse is refused before the folder is made.
    require_named(config)
    _plan(job, last, only)
    with locked(out / RUN_LOCK, busy(out)):
        remove_leftovers(out)
        records, inputs, planned = _plan(job, last, only)
        for stage in planned:
            records = _run_stage(job, stage, inputs[stage], records, bar)
        lacked = _lacks_views(records, last)
        if lacked:
            records = _write_views(job, records, bar)
        described = _is_described(job)
        report = write_report_json(job, records)
        if planned or lacked or not described or lacks_head(out):
            write_processed_report(out, report)
    return {**report, "ran": planned}


def read_job(
    session_path: Path,
    out: Path,
    template_path: Path,
    config: PipelineConfig,
    last: str = STAGES[-1],
    *,
    verified: bool = True,
) -> Job:
    """What the stages up to `last` work on; what would stop one of them later is refused now.

    Args:
        session_path: a session folder.
        out: the processed folder.
        template_path: a template folder.
        config: of all stages.
        last: the last stage that is wanted.
        verified: hold every photograph against its hash, which reads them all.

    Raises:
        LightstageError: input that the user can mend.
    """
    if last not in STAGES:
        raise ProcessingError("--until", found=repr(last), expected=", ".join(STAGES))
    session = with_complements(load_session(session_path))
    problems = unmendable_frames(session) or (changed_frames(session) if verified else [])
    if problems:
        raise one_error(problems)
    require_own(out)
    patterns = lit_patterns(session)
    if not patterns:
        raise ProcessingError(
            session.root / "session.json",
            field="sequence",
            found=f"no pattern with light among {', '.join(session.file.sequence) or 'none'}",
            expected="photographs of a lit face",
            hint="Is the capture finished? `lightstage check SESSION` shows what is there.",
        )
    normals = last == STAGES[0] or give_normals(session, patterns)
    if last in WITH_NORMALS and not normals:
        raise no_normals(patterns)
    if not (template_path / "template.json").is_file():
        # A stage that reads no template would not notice that another one was meant.
        raise FormatError(
            template_path, found="no template.json in it", expected="a template's folder"
        )
    template, template_hash = None, ""
    if STAGES.index(last) >= STAGES.index(WITH_TEMPLATE[0]):
        template_hash = hash_template(template_path)
        template = _template(template_path, template_hash)
        # Registration needs them an hour later at full size: reported now.
        require_landmarks(session, config.register)
    return Job(session, out, config, template, template_hash, normals)


@functools.lru_cache(maxsize=1)
def _template(path: Path, content: str) -> Template:
    """A template that was read once; `content`, the hash of its files, shows whether it changed."""
    del content
    return load_template(path)


def left_to_do(job: Job, last: str = STAGES[-1]) -> list[str]:
    """The stages up to `last` that are not up to date, in order.

    Raises:
        LightstageError: a folder made from another session, or records that cannot be read.
    """
    return _plan(job, last, None)[2]


def run_next(job: Job, last: str = STAGES[-1], bar: Bar = no_bar) -> tuple[str | None, list[str]]:
    """Run the first stage that is not up to date; after the last one what `run` ends with.

    Called until nothing is left it leaves what `run` does, whoever calls it each time.

    Args:
        job: of `read_job`.
        last: the last stage that is wanted.
        bar: draws progress.

    Returns:
        The stage that ran, None where none was left, and the stages that are left now.

    Raises:
        LightstageError: as `run`; ProcessingError also where another run holds the folder.
    """
    require_named(job.config)
    with locked(job.out / RUN_LOCK, busy(job.out)):
        remove_leftovers(job.out)
        records, inputs, planned = _plan(job, last, None)
        ran = planned[0] if planned else None
        if ran is not None:
            records = _run_stage(job, ran, inputs[ran], records, bar)
            planned = _plan(job, last, None)[2]
        if not planned:
            if _lacks_views(records, last):
                records = _write_views(job, records, bar)
            write_processed_report(job.out, write_report_json(job, records))
    return ran, planned


def is_reported(job: Job, last: str) -> bool:
    """Whether what a run ends with was written after its last stage, of the session as it is.

    A kill may come between, and a consent's id may be corrected in the session later.
    """
    stages, report = job.out / "stages.json", job.out / "report.html"
    try:
        reported = report.stat().st_mtime_ns >= stages.stat().st_mtime_ns
    except FileNotFoundError:
        return False
    return reported and _is_described(job) and not _lacks_views(read_records(job.out), last)


def _is_described(job: Job) -> bool:
    """Whether OUT/report.json has of the session what no stage reads."""
    try:
        value = read_json(job.out / "report.json")
    except FormatError:
        return False
    return isinstance(value, dict) and all(value.get(k) == v for k, v in _about(job).items())


class BusyError(ProcessingError):
    """Another process works on the folder."""


def busy(out: Path) -> BusyError:
    """The message about a folder that another process holds."""
    return BusyError(
        out,
        field="--out",
        found="a folder that another run is writing to",
        expected="one run at a time",
        hint="Wait until that one has ended, or choose another --out.",
    )


def _plan(
    job: Job, last: str, only: str | None
) -> tuple[dict[str, Record], dict[str, StageInputs], list[str]]:
    """The folder's records, what each stage depends on, and the stages to run."""
    require_same_session(job.out, job.made_from)
    records = read_records(job.out)
    kept = records if only else {}
    inputs = stage_inputs(job.session, job.config, job.template_hash, kept)
    if only:
        return records, inputs, _only(job, only, records, inputs)
    stale = [stage for stage, why in _reasons(job, records, inputs, last).items() if why]
    return records, inputs, stale


def why(job: Job, last: str = STAGES[-1]) -> dict[str, str | None]:
    """In words why each stage up to `last` must run; None where it is up to date.

    Raises:
        LightstageError: a folder made from another session, or records that cannot be read.
    """
    records, inputs, _ = _plan(job, last, None)
    return _reasons(job, records, inputs, last)


def _reasons(
    job: Job, records: dict[str, Record], inputs: dict[str, StageInputs], last: str
) -> dict[str, str | None]:
    """Why each stage up to `last` must run, None where its record still holds."""
    reasons: dict[str, str | None] = {}
    for stage in job.stages[: job.stages.index(last) + 1]:
        first = next((name for name, reason in reasons.items() if reason), None)
        reasons[stage] = why_stale(records.get(stage), inputs[stage], first, job.out)
    return reasons


def _only(
    job: Job, stage: str, records: dict[str, Record], inputs: dict[str, StageInputs]
) -> list[str]:
    """One stage; `separate` decodes first where that is stale, since it has no command."""
    before = job.stages[: job.stages.index(stage)]
    if stage == "separate":
        stale = why_stale(records.get("decode"), inputs["decode"], None, job.out)
        return ["separate"] if stale is None else ["decode", "separate"]
    missing = [name for name in before if name not in records]
    if "separate" in before and stage in READS_COARSE and "separate" not in missing:
        # An older version wrote coarse maps to views/ alone, where `refine` overwrote them.
        there = all(has_coarse(job.out, camera) for camera in job.session.camera_ids())
        missing += [] if there else ["separate"]
    if missing:
        raise ProcessingError(
            f"stage {stage}",
            found=f"no output of {', '.join(missing)}",
            expected="the stages before it done",
            hint=f"Run `lightstage-processing run SESSION --out OUT --until {before[-1]}` first.",
        )
    return [stage]


def _run_stage(
    job: Job, stage: str, inputs: StageInputs, records: dict[str, Record], bar: Bar
) -> dict[str, Record]:
    """Run one stage and record it; it and all after it count as not done while it runs."""
    kept = {name: records[name] for name in STAGES[: STAGES.index(stage)] if name in records}
    if stage == "refine" and "separate" in kept:
        # From its first file on, what `separate` left in views/ is no longer all there.
        own = [name for name in kept["separate"].outputs if not name.startswith(VIEWS)]
        kept["separate"] = dataclasses.replace(kept["separate"], outputs=own)
    # What `evaluate` found was of other maps than those that are made now.
    (job.out / EVALUATION).unlink(missing_ok=True)
    if stage == "separate":
        # Maps in views/ are of other coarse ones; `refine`, or the run's end, writes them anew.
        for path in (job.out / VIEWS).glob("*/*.exr"):
            path.unlink()
    if stage == "decode":
        _remove_other_cameras(job)
    # Before the stage's first file: a folder names its session however early the stage ends.
    write_records(job.out, job.made_from, kept)
    before = files_in(job.out)
    facts: dict[str, Any] = {}
    with bar(stage) as progress, measured(facts):
        facts |= _stage(job, stage, progress)
    give_back()
    after = files_in(job.out)
    outputs = sorted(name for name in after if after[name] != before.get(name))
    config = as_dict(getattr(job.config, stage))
    kept[stage] = Record(inputs.key, outputs, facts, inputs.parts, config)
    write_records(job.out, job.made_from, kept)
    return kept


def _remove_other_cameras(job: Job) -> None:
    """Remove what there is of cameras that the session no longer has: stages read all views."""
    frames, own = job.out / "work" / "frames", set(job.session.camera_ids())
    there = {*ProcessedFolder(job.out).view_ids(), *(path.name for path in frames.glob("*"))}
    for camera in there - own:
        shutil.rmtree(job.out / VIEWS / camera, ignore_errors=True)
        for path in (job.out / "work").glob("*/*"):
            if path.is_dir() and path.name == camera:
                shutil.rmtree(path)
            elif path.stem == camera:
                path.unlink()


def _stage(job: Job, stage: str, progress: ProgressCallback) -> dict[str, Any]:
    session, out, config = job.session, job.out, job.config
    if stage == "decode":
        return decode(session, out, config.decode, progress)
    if stage == "separate":
        return separate(session, out, config.separate, progress)
    if stage == "reconstruct":
        return reconstruct(session, out, config.reconstruct, progress, job.normals)
    if stage == "refine":
        return refine(session, out, config.refine, progress)
    assert job.template is not None
    if stage == "register":
        return register(session, out, job.template, config.register, progress)
    return atlas(session, out, job.template, config.atlas, progress)


def _lacks_views(records: dict[str, Record], last: str) -> bool:
    """Whether a run that ends with `separate` has yet to write its maps to views/, where they last.

    Where a later stage is wanted they are not written there: it reads them in OUT/work.
    """
    if last != "separate" or "separate" not in records or "refine" in records:
        return False
    return not any(name.startswith(VIEWS) for name in records["separate"].outputs)


def _write_views(job: Job, records: dict[str, Record], bar: Bar) -> dict[str, Record]:
    """Write the coarse maps to views/, and record them as outputs of `separate`."""
    with bar("views") as progress:
        written = write_as_views(job.out, job.session.camera_ids(), progress)
    record = records["separate"]
    record = dataclasses.replace(record, outputs=sorted({*record.outputs, *written}))
    records = {**records, "separate": record}
    write_records(job.out, job.made_from, records)
    return records


def _about(job: Job) -> dict[str, Any]:
    """What the report has of the session itself."""
    file = job.session.file
    consent = (file.model_extra or {}).get("consent")
    return {
        "session": file.id,
        "subject": file.subject,
        "expression": file.expression,
        "consent": consent,
    }


def write_report_json(job: Job, records: dict[str, Record]) -> dict[str, Any]:
    """Write OUT/report.json from the finished stages; returns its content.

    The settings are those that each stage ran with, which may be others than this run's.
    """
    stages = {name: dict(records[name].facts) for name in STAGES if name in records}
    warnings = [
        f"{name}: {warning}"
        for name, facts in stages.items()
        for warning in facts.pop("warnings", [])
    ]
    report = {
        "schema": REPORT_SCHEMA,
        **_about(job),
        "stages": stages,
        "warnings": warnings,
        "versions": versions(),
        "config": {name: record.config for name, record in records.items()},
    }
    write_json(job.out / "report.json", report)
    return report


def give_back() -> None:
    """Hand back what was freed: glibc keeps it for the thread that had it, gigabytes after a stage.

    Elsewhere than on glibc nothing is done.
    """
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)
