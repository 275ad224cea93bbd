"""A whole session with connected devices: begun or resumed, taken, written, reported."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lightstage import __version__
from lightstage.cameras.camera import Summary
from lightstage.capture.camera_shot import Checks, Photographer
from lightstage.capture.config import CaptureConfig
from lightstage.capture.run import CaptureReport, Run
from lightstage.capture.shot import stopped
from lightstage.capture.stage import Stage
from lightstage.checks import ShotChecks
from lightstage.counting import counted
from lightstage.errors import CaptureError, FormatError, LightstageError
from lightstage.findings import Finding
from lightstage.formats.config import as_dict, make_config
from lightstage.interrupts import signals_put_off
from lightstage.operator import Operator, serve_events
from lightstage.operator.plain import plain
from lightstage.patterns import on_plane
from lightstage.patterns.names import BINARY
from lightstage.preflight import Plan, clear_privacy, drift, preflight, require, set_back
from lightstage.resume_line import RESUME_WITH
from lightstage.rig import Rig, load_rig
from lightstage.safety import photosensitivity_findings
from lightstage.sequence import Shot
from lightstage.session import (
    SessionPlan,
    SessionWriter,
    bring_home,
    last_run,
    read_journal,
    reconcile,
    require_on_disk,
)
from lightstage.session.manifest import write_manifest
from lightstage.steps import step
from lightstage.ways import readers_ways

SPARE = 1.5
"""Photographs that cards and disk must have room for, against those that are planned."""


@dataclasses.dataclass(frozen=True)
class Order:
    """What is to be captured.

    Attributes:
        root: the session's folder; new, or of an unfinished session that is resumed.
        shots: in order; of a session that is resumed, its own (`unfinished`).
        resume: whether to resume what is in `root`.
        retake: pattern and camera of photographs of a session that is resumed, finished or
            not, that are taken again.
        subject: pseudonym.
        expression: such as ``neutral``.
        consent: id of the record of the subject's consent.
        colour: a colour calibration to keep in the session.
        beside: other files of that calibration, by name.
        facts: what else the journal and the manifest shall state, such as calibration shots.
        findings: of earlier checks, reported with those of the preflight.
        alone: whether somebody may resume this session alone; not with a pose of shots.
        resume_with: options beside ``--out`` with which the command resumes the session.
    """

    root: Path
    shots: Sequence[Shot]
    resume: bool = False
    retake: Sequence[tuple[str, str]] = ()
    subject: str = "subject-1"
    expression: str = "neutral"
    consent: str | None = None
    colour: dict[str, Any] | None = None
    beside: Mapping[str, bytes] = dataclasses.field(default_factory=dict)
    facts: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    findings: Sequence[Finding] = ()
    alone: bool = True
    resume_with: Sequence[str] = ()


def capture_session(
    stage: Stage,
    order: Order,
    config: CaptureConfig,
    operator: Operator,
    checks: Checks | None = None,
) -> CaptureReport:
    """Take what a session wants, with an opened stage, and finish it.

    Args:
        stage: opened.
        order: what is to be taken.
        config: of the capture.
        operator: decides, and sees every line of the journal.
        checks: checks each photograph; by default those of a face.

    Raises:
        DeviceError: something forbids the capture; no light went on. Or the lights failed.
        CaptureError: it could not be finished; what was taken is kept and can be resumed.
        StoppedError: by the operator, who may resume it too.
    """
    if config.preflight.clear:
        stage.summaries.update(clear_privacy(stage.cameras))
    reset = _set_back(stage, order.root) if order.resume else []
    count = len(order.shots)
    lit = [level for shot in order.shots for level in shot.levels if level > 0]
    plan = Plan(
        round(count * SPARE) + 1,
        patterns=tuple(shot.pattern for shot in order.shots),
        lowest_level=min(lit, default=1.0),
    )
    looked = preflight(
        stage.rig, stage.summaries, stage.file, stage.lights, order.root, plan, config.preflight
    )
    findings = [
        *stage.moved,
        *reset,
        *looked,
        *_split_lights(stage.rig, order.shots),
        # Last, so that they are in view where there is room for one alone: they are of the person.
        *photosensitivity_findings(order.shots, config.safety),
        *order.findings,
    ]
    require(findings)
    with _writer(stage, order, config, findings) as writer, contextlib.ExitStack() as followed:
        lines = read_journal(writer.journal.path)
        now = last_run(lines)
        retaken = sum(len(each["takes"]) for each in now if each["event"] == "retake")
        for place, line in enumerate(lines):
            operator.receive(line, old=place < len(lines) - len(now))
        writer.listeners.append(operator.receive)
        followed.enter_context(serve_events(writer, operator.request))
        run: Run | None = None
        operator.at_abort(stage.lights.dark)
        try:
            wanted = writer.state.wanted()
            if order.resume:
                delete = config.delete_from_cameras
                found = reconcile(writer, stage.cameras, delete=delete)
                wanted, findings = found.wanted, [*findings, *found.findings]
            run = _run(stage, order, config, operator, writer, wanted, checks)
            report = _take_until_whole(run, stage, config, writer, findings)
            report = dataclasses.replace(report, retakes=report.retakes + retaken)
            writer.finish()
            write_manifest(order.root, {**order.facts, "capture": dataclasses.asdict(report)})
            step("manifest-written")
            require_on_disk(order.root, writer.state)
            writer.end(capture=dataclasses.asdict(report))
        except BaseException as error:
            with signals_put_off():
                raise _last_words(error, stage, order, writer, run) from None
    return report


def _last_words(
    error: BaseException,
    stage: Stage,
    order: Order,
    writer: SessionWriter,
    run: Run | None,
) -> BaseException:
    """Dark, and the journal's last line; the error with the command that resumes the session.

    A defect is returned as it is, for its traceback.
    """
    # Dark first; a failure of it is reported where the lights are released.
    with contextlib.suppress(LightstageError):
        stage.lights.dark()
    if isinstance(error, KeyboardInterrupt):  # Ctrl-C, SIGTERM, a terminal that closed
        error = stopped()
    reason = str(error) or type(error).__name__
    with contextlib.suppress(LightstageError):
        writer.abort(said=reason, **{RESUME_WITH: [*order.resume_with]})
    if not isinstance(error, LightstageError):
        return error
    if not order.alone:
        return type(error)(plain(reason))
    ways = readers_ways()
    message = f"{plain(reason)}\n  {ways.resume(order.root, order.resume_with)}"
    patterns, ids = ([], []) if run is None else run.suspected
    if patterns:
        older = ways.retake(order.root, patterns, ids, order.resume_with)
        message += f"\n  If that finds the same again, an earlier photograph is wrong. {older}"
    return type(error)(message)


def _split_lights(rig: Rig, shots: Sequence[Shot]) -> list[Finding]:
    """Lights on the splitting plane of a binary gradient that is about to be lit."""
    axes = {shot.pattern[0] for shot in shots if shot.pattern.partition("@")[0] in BINARY}
    return [
        Finding(
            "note",
            "on-plane",
            f"patterns {axis}+ and {axis}-",
            f"{counted(len(ids), 'lamp')} on the splitting plane (ids "
            f"{', '.join(map(str, ids[:8]))}{', ..' if len(ids) > 8 else ''})",
            "none, or half in each",
            "They are lit half in both.",
        )
        for axis, ids in on_plane(rig).items()
        if axis in axes
    ]


def unfinished(root: Path) -> tuple[Rig, Order]:
    """An unfinished session's rig, and the order to resume it.

    Raises:
        FormatError: no session, or a damaged one.
    """
    path = root / "journal.jsonl"
    begin = read_journal(path)[0]
    levels = begin.get("levels") or {}
    unknown = [name for name in begin["sequence"] if name not in levels]
    if unknown:
        raise FormatError(
            path,
            field="levels",
            found=f"none of {', '.join(unknown)}",
            expected="those it began with",
        )
    shots = [Shot(name, np.array(levels[name])) for name in begin["sequence"]]
    return load_rig(root / "rig.json"), Order(
        root,
        shots,
        resume=True,
        subject=begin["subject"],
        expression=begin["expression"],
        consent=begin.get("consent"),
        facts=begin.get("facts") or {},
    )


def config_of(root: Path) -> CaptureConfig:
    """The configuration with which an unfinished session began.

    Raises:
        FormatError, ConfigError: no session, or one of another version.
    """
    path = root / "journal.jsonl"
    return make_config(CaptureConfig, read_journal(path)[0].get("config") or {}, path)


@contextlib.contextmanager
def _writer(
    stage: Stage, order: Order, config: CaptureConfig, findings: Sequence[Finding]
) -> Iterator[SessionWriter]:
    """The session on the disk, begun or resumed; what was found before is in its journal."""
    writer = _opened(stage, order, config)
    try:
        for finding in findings:
            writer.finding(finding)
        yield writer
    finally:
        writer.close()


def _opened(stage: Stage, order: Order, config: CaptureConfig) -> SessionWriter:
    """A new session's writer, or an unfinished one's after its line `resume`."""
    cards = {camera.id: camera.card() for camera in stage.cameras}
    serials = {camera_id: summary.serial for camera_id, summary in stage.summaries.items()}
    facts = {
        "version": __version__,
        "led_device": {
            **dataclasses.asdict(stage.lights.hello),
            "acknowledged": stage.lights.acknowledged,
            "pulse_hz": stage.lights.pulse_hz,
        },
        "told": {name: dataclasses.asdict(each) for name, each in stage.summaries.items()},
        "not_verifiable": {name: each.not_readable() for name, each in stage.summaries.items()},
        "on_plane": on_plane(stage.rig),
        "config": as_dict(config),
        "facts": dict(order.facts),
        RESUME_WITH: [*order.resume_with],
    }
    if not order.resume:
        levels = {shot.pattern: shot.levels.tolist() for shot in order.shots}
        plan = SessionPlan(tuple(levels), order.subject, order.expression, levels, order.consent)
        calibration = order.colour, order.beside
        writer = SessionWriter.new(order.root, stage.rig, plan, cards, serials, facts, *calibration)
        writer.look_beside()
        return writer
    # Of a finished session something is missing or taken again, else no device was opened.
    writer = SessionWriter.resumed(order.root, stage.rig, finished=True)
    try:
        require(_changed(writer, stage))
        writer.look_beside()
        writer.resume(cards, serials, **facts)
        if order.retake:
            writer.retake(order.retake, "somebody wants them again")
    except BaseException:
        writer.close()
        raise
    return writer


def _set_back(stage: Stage, root: Path) -> list[Finding]:
    """Give all cameras the settings with which an unfinished session began.

    What cannot be set is reported by `_changed`, which refuses to continue.
    """
    began = read_journal(root / "journal.jsonl")[0]["told"]
    findings: list[Finding] = []
    for camera in stage.cameras:
        if camera.id in began:
            done, _ = set_back(camera, Summary(**began[camera.id]))
            if done:
                stage.summaries[camera.id] = camera.summary()
            findings += done
    return findings


def _changed(writer: SessionWriter, stage: Stage) -> list[Finding]:
    """Where cameras are no longer set as when the session began."""
    began = {name: Summary(**summary) for name, summary in writer.state.begin["told"].items()}
    return [
        finding
        for camera_id, summary in stage.summaries.items()
        for finding in drift(began[camera_id], summary, camera_id)
    ]


def _run(
    stage: Stage,
    order: Order,
    config: CaptureConfig,
    operator: Operator,
    writer: SessionWriter,
    wanted: Mapping[str, Sequence[str]],
    checks: Checks | None,
) -> Run:
    checks = checks or ShotChecks(stage.rig, order.shots, config.checks)
    cards = {camera.id: camera.card() for camera in stage.cameras}
    photographer = Photographer(stage.rig, writer, checks, config, stage.summaries, cards)
    before: dict[str, list[Finding]] = {}
    for kept in writer.state.frames():
        if writer.state.accepted(kept.pattern, kept.camera) != kept:
            continue  # an older take that came home late
        found = photographer.look_again(kept.pattern, kept.camera, order.root / kept.path)
        if kept.pattern in wanted:  # of a finished one it was decided
            before.setdefault(kept.pattern, []).extend(found)
    return Run(
        order.shots,
        wanted,
        stage.cameras,
        stage.lights,
        photographer,
        writer,
        checks,
        operator,
        config,
        before,
    )


def _take_until_whole(
    run: Run,
    stage: Stage,
    config: CaptureConfig,
    writer: SessionWriter,
    before: Sequence[Finding],
) -> CaptureReport:
    """Take all; then search for it on the disk, and retake what is lost.

    Raises:
        CaptureError: photographs are lost again and again.
    """
    report, findings = run.take_all(), list(before)
    for left in range(config.operator.retakes, -1, -1):
        stage.lights.dark()
        home = bring_home(writer, stage.cameras, delete=config.delete_from_cameras)
        findings += home.findings
        if not home.wanted:
            break
        if not left:
            raise CaptureError(
                writer.root,
                found=f"photographs of {', '.join(home.wanted)} that vanished from the disk",
                expected="every photograph that was kept",
                hint="Something removes files from this folder. Stop it, then continue.",
            )
        report = run.take_lost(home.wanted)
    warned = sum(finding.severity == "warn" for finding in findings)
    return dataclasses.replace(report, warnings=report.warnings + warned)
