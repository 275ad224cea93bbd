"""What a session must show: whole and unchanged photographs that its patterns explain."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lightstage.checks.origin import strangers, too_old
from lightstage.checks.photo_measures import Photo, measure_image, measure_photo
from lightstage.checks.shot import ShotChecks
from lightstage.checks.sums import find_sums
from lightstage.commands import ProgressCallback, quiet
from lightstage.errors import FormatError, LightstageError, one_error
from lightstage.findings import Finding
from lightstage.formats.exr import read_exr
from lightstage.formats.landmarks import LANDMARKS, read_clicked
from lightstage.formats.session import (
    Frame,
    Session,
    changed_frames,
    load_session,
    missing_frames,
)
from lightstage.formats.sums import UNCHECKED, Balance, axes_alike, has_gradient, sum_fault
from lightstage.photo_file import identify
from lightstage.resume_line import known_options
from lightstage.sequence import Shot
from lightstage.session import Accepted, accepted_findings, disagreements, read_journal
from lightstage.session.manifest import MANIFEST, check_manifest
from lightstage.session.opening import JOURNAL
from lightstage.ways import readers_ways

DARK_LEVEL = 1e-3
"""Mean, as a share of white, below which a photograph is noise and compared as this bright."""
MAX_CLIPPED = 0.02
"""Share of a photograph's pixels at the sensor's white level above which it is overexposed."""


@dataclasses.dataclass(frozen=True)
class CheckReport:
    """What was checked.

    Attributes:
        frames: photographs.
        sums: pattern sums compared, over all cameras.
        worst_sum: largest deviation found in them, as a share.
        clipped: largest share of clipped pixels in a photograph.
        findings: what else the photographs show, as a capture reports it after each shot: the
            operator may have seen and accepted it.
        facts: figures of all that was compared (`ShotChecks.facts`), for a later session's
            baseline.
        accepted: by pattern, how many faults the operator accepted.
        unproven: what the files of this session do not prove, in sentences.
    """

    frames: int
    sums: int
    worst_sum: float
    clipped: float
    findings: tuple[Finding, ...] = ()
    facts: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    accepted: Mapping[str, int] = dataclasses.field(default_factory=dict)
    unproven: tuple[str, ...] = ()


def check_session(root: Path, progress: ProgressCallback = quiet) -> CheckReport:
    """Check every photograph of a session: there, unchanged, its own, readable, lit as recorded.

    Args:
        root: of the session.
        progress: counts photographs.

    Raises:
        FormatError: every fault found, in one message.
    """
    session = _load(root)
    problems = missing_frames(session) + changed_frames(session) + _doubled(session)
    has_journal = (root / JOURNAL).is_file()
    if has_journal:
        problems += disagreements(root, session.file)
    if (root / LANDMARKS).exists():
        try:
            read_clicked(root / LANDMARKS, session.rig)
        except FormatError as error:
            problems.append(error)
    of_others, findings = strangers(session)
    problems += [*of_others, *too_old(session)]
    broken = {problem.where for problem in problems}
    whole = {f.path: f.sha256 for f in session.file.frames if str(root / f.path) not in broken}
    problems += [each for each in check_manifest(root, whole) if each.where not in broken]
    means: dict[tuple[str, str], float] = {}
    clipped: dict[tuple[str, str], float] = {}
    shots = [Shot(name, session.levels(name)) for name in session.file.sequence]
    checks = ShotChecks(session.rig, shots)
    done = 0
    for pattern in session.file.sequence:
        for frame in session.file.frames:
            path = session.frame_path(frame)
            if frame.pattern != pattern:
                continue
            if path.is_file() and str(path) not in broken:
                try:
                    photo = _measure(session, frame, path, checks.config.thumbnail_px)
                    key = frame.pattern, frame.camera
                    means[key], clipped[key] = photo.mean, photo.clipped_all
                    findings += checks.add(*key, photo)
                except FormatError as error:
                    problems.append(error)
            done += 1
            progress(done, len(session.file.frames))
        findings += checks.shot(pattern)
    problems += _overexposed(session, clipped)
    accepted: Accepted = {}
    with contextlib.suppress(LightstageError):  # a broken journal is reported above
        accepted = accepted_findings(read_journal(root / JOURNAL)) if has_journal else {}
    worst, sums, unlike = _compare_sums(session, means, accepted)
    problems += unlike
    if not sums and has_gradient({name: session.levels(name) for name in session.file.sequence}):
        findings.append(
            Finding("warn", "unchecked", str(root), UNCHECKED, "full, or the pairs of two axes")
        )
    if problems:
        raise one_error(problems)
    worst_clipped = max(clipped.values(), default=0.0)
    frames = len(session.file.frames)
    return CheckReport(
        frames,
        sums,
        worst,
        worst_clipped,
        tuple(findings),
        checks.facts(),
        {pattern: len(each) for pattern, each in accepted.items()},
        _unproven(has_journal, (root / MANIFEST).is_file()),
    )


def _unproven(journal: bool, manifest: bool) -> tuple[str, ...]:
    """What no comparison of a session's own files can show."""
    reasons = []
    if not journal:
        reasons.append(
            "There is no journal.jsonl: whether session.json was changed together with the "
            "photographs cannot be known."
        )
    if not manifest:
        reasons.append(
            "There is no manifest.json: whether the journal was changed, or files beside the "
            "photographs, cannot be known."
        )
    reasons.append(
        "Hashes without a signature prove neither who took the photographs nor when: files that "
        "were all changed together are not noticed."
    )
    return tuple(reasons)


def _doubled(session: Session) -> list[LightstageError]:
    """RAW photographs with the same bytes: a sensor's noise never repeats, so one is stale."""
    problems: list[LightstageError] = []
    seen: dict[str, Frame] = {}
    for frame in session.file.frames:
        first = seen.setdefault(frame.sha256, frame)
        if first is not frame and frame.encoding == "raw":
            problems.append(
                FormatError(
                    session.frame_path(frame),
                    field="sha256",
                    found=f"the bytes of {first.path}",
                    expected="a photograph of its own",
                    hint="The camera gave an old picture; retake that shot.",
                )
            )
    return problems


def _load(root: Path) -> Session:
    unfinished = (root / "journal.jsonl").is_file() and not (root / "session.json").is_file()
    if unfinished:
        ways, options = readers_ways(), known_options(read_journal(root / "journal.jsonl"))
        how = [ways.follow(root), ways.resume(root, options)]
        raise FormatError(
            root / "session.json",
            found="only a journal",
            expected="a finished session",
            hint="\n  ".join(["Its capture runs or was interrupted.", *filter(None, how)]),
        )
    return load_session(root)


def _measure(session: Session, frame: Frame, path: Path, thumbnail_px: int) -> Photo:
    """A photograph's measures; FormatError when it is unreadable or of another size."""
    camera = session.rig.camera(frame.camera)
    kind = identify(path.read_bytes(), path)
    if kind.encoding != frame.encoding:
        raise FormatError(
            path, field="encoding", found=kind.encoding, expected=f"{frame.encoding} (session.json)"
        )
    if frame.encoding == "linear":
        photo = measure_image(read_exr(path, finite=True), path, thumbnail_px)
    else:
        photo = measure_photo(path, thumbnail_px)
    if photo.size_px != (camera.width_px, camera.height_px):
        raise FormatError(
            path,
            field="size",
            found=f"{photo.size_px[0]} x {photo.size_px[1]} pixels",
            expected=f"{camera.width_px} x {camera.height_px} (rig.json, {camera.id})",
        )
    return photo


def _overexposed(session: Session, clipped: dict[tuple[str, str], float]) -> list[LightstageError]:
    return [
        FormatError(
            session.frame_path(session.frame(pattern, camera)),
            field="exposure",
            found=f"{100 * share:.1f} % of the pixels clipped",
            expected=f"at most {100 * MAX_CLIPPED:g} %",
            hint="Shorten the exposure or lower ISO for all cameras, and capture again.",
        )
        for (pattern, camera), share in clipped.items()
        if share > MAX_CLIPPED
    ]


def _compare_sums(
    session: Session, means: dict[tuple[str, str], float], accepted: Accepted
) -> tuple[float, int, list[LightstageError]]:
    """Compare photographs whose driven levels add up to the same: light is linear."""
    levels = {pattern: session.levels(pattern) for pattern in session.file.sequence}
    sums = [Balance((s.first, s.second), (s.whole,)) for s in find_sums(levels)]
    sums += axes_alike(levels)
    problems: list[LightstageError] = []
    worst, count = 0.0, 0
    for one, camera in itertools.product(sums, session.camera_ids()):
        if not all((pattern, camera) in means for pattern in one.patterns):
            continue
        # Light that is there without a lamp is in every photograph, and in no lamp's sum.
        darks = [means[key] for key in means if key[1] == camera and not levels[key[0]].any()]
        room = sum(darks) / len(darks) if darks else 0.0
        left, right = (
            sum(means[pattern, camera] - room for pattern in side) for side in (one.left, one.right)
        )
        # What is darker is noise, and compared as if it were this bright.
        short = max(DARK_LEVEL - abs(right), 0.0)
        worst, count = max(worst, abs(left - right) / (abs(right) + short)), count + 1
        faulty = [
            name
            for name in one.patterns
            if any(each.get("camera") in (None, camera) for each in accepted.get(name, ()))
        ]
        hint = ""
        if faulty:
            hint = f"Its photograph of {' and '.join(faulty)} was accepted with faults: retake it."
        fault = sum_fault(session.root, camera, one, left + short, right + short, hint)
        if fault is not None:
            problems.append(fault)
    return worst, count, problems
