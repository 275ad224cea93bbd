"""All shots of a session, in order; only the failed camera or pattern is taken again."""

from __future__ import annotations

import collections
import dataclasses
import time
from collections.abc import Collection, Mapping, Sequence

from lightstage.cameras.camera import CameraDevice
from lightstage.capture.camera_shot import Checks, Photographer
from lightstage.capture.config import CaptureConfig
from lightstage.capture.shot import ShotTaken, missed, stopped, take_shot
from lightstage.capture.suspects import Suspects
from lightstage.capture.wishes import Wishes
from lightstage.errors import CaptureError, LightstageError, one_error
from lightstage.findings import Finding
from lightstage.operator import Decision, Operator
from lightstage.operator.attendance import NOT_TAKEN
from lightstage.operator.plain import cause
from lightstage.preflight import SkewReport, skew_findings
from lightstage.safety import SafeLights
from lightstage.sequence import Shot
from lightstage.session import SessionWriter, accepted_findings, read_journal
from lightstage.steps import step

PAUSE_POLL_S = 0.05


@dataclasses.dataclass(frozen=True)
class CaptureReport:
    """What a capture did.

    Attributes:
        frames: photographs of the session that count.
        taken: photographs that were kept now, also those that no longer count.
        shots: patterns taken, retakes among them.
        retakes: photographs that were taken again.
        warnings: findings that the operator should know.
        accepted: patterns of the session whose faults the operator accepted.
        accepted_findings: how many faults these are.
        seconds: from the first light to the last journal line.
        lit_s: of these, waiting until the light may change, and for the lights' acknowledgement.
        exposed_s: of these, from the first trigger to the last picture of each shot.
        paused_s: of these, waiting for the operator: in a pause, or for an answer.
        overhead_s: what is left: download, writing, hashing, checks, journal.
        max_skew_s: largest time between the first and the last trigger of one shot.
        skew: of each camera against the others, over all shots.
    """

    frames: int = 0
    taken: int = 0
    shots: int = 0
    retakes: int = 0
    warnings: int = 0
    accepted: int = 0
    accepted_findings: int = 0
    seconds: float = 0.0
    lit_s: float = 0.0
    exposed_s: float = 0.0
    paused_s: float = 0.0
    overhead_s: float = 0.0
    max_skew_s: float = 0.0
    skew: dict[str, dict[str, float]] = dataclasses.field(default_factory=dict)


class Run:
    """Takes the photographs that a session still lacks.

    Args:
        shots: in order, checked by safety.check_shots.
        wanted: cameras that must still take each pattern; none where all its photographs are there
            but the shot was not finished. A pattern that is not in it is done.
        cameras: opened.
        lights: the stage's, which end dark.
        photographer: keeps the photographs.
        writer: the session.
        checks: knows the photographs so far.
        operator: decides.
        config: deadlines.
        before: what photographs of patterns that are not finished showed before a crash.

    Attributes:
        suspected: after a contradiction that ended the capture, patterns that were taken before
            and may be the wrong ones, and their cameras (none: all).
    """

    def __init__(
        self,
        shots: Sequence[Shot],
        wanted: Mapping[str, Collection[str]],
        cameras: Sequence[CameraDevice],
        lights: SafeLights,
        photographer: Photographer,
        writer: SessionWriter,
        checks: Checks,
        operator: Operator,
        config: CaptureConfig,
        before: Mapping[str, list[Finding]] | None = None,
    ) -> None:
        self.suspected: tuple[list[str], list[str]] = ([], [])
        self._before = dict(before or {})
        self._shots = {shot.pattern: shot for shot in shots}
        self._all = {camera.id for camera in cameras}
        self._queue = collections.deque(
            (shot.pattern, frozenset(wanted[shot.pattern]))
            for shot in shots
            if shot.pattern in wanted
        )
        self._left = dict.fromkeys(self._shots, config.operator.retakes)
        self._suspects = Suspects(self._all, config.operator.retakes)
        self._cameras = cameras
        self._lights = lights
        self._photographer = photographer
        self._writer = writer
        self._checks = checks
        self._operator = operator
        self._wishes = Wishes(operator)
        self._config = config
        self._total = CaptureReport()
        self._skew = SkewReport()

    def take_all(self) -> CaptureReport:
        """Take every shot that is wanted.

        Raises:
            StoppedError: by the operator.
            CaptureError: nothing is left to try.
            CaptureError, DeviceError: this computer's disk, or the lights, failed.
        """
        started_s = time.monotonic()
        while self._queue:
            last, ids = self._queue.popleft()
            self._take(self._shots[last], [c for c in self._cameras if c.id in ids])
            self._heed(last)
        self._count(seconds=time.monotonic() - started_s)
        total = self._total
        spent_s = total.lit_s + total.exposed_s + total.paused_s
        state = self._writer.state
        accepted = accepted_findings(read_journal(self._writer.journal.path))
        return dataclasses.replace(
            total,
            accepted=len(accepted),
            accepted_findings=sum(map(len, accepted.values())),
            frames=sum(len(self._all) - len(state.missing(pattern)) for pattern in self._shots),
            overhead_s=total.seconds - spent_s,
            skew=self._skew.facts(),
        )

    def take_lost(self, wanted: Mapping[str, Collection[str]]) -> CaptureReport:
        """Take again what was kept and is no longer on the disk; the report is of all so far.

        Args:
            wanted: as for the constructor; the takes that were lost are rejected already.

        Raises:
            LightstageError: as take_all.
        """
        for pattern in self._shots:
            if pattern in wanted:
                for camera in wanted[pattern]:
                    self._checks.forget(pattern, camera)
                self._queue.append((pattern, frozenset(wanted[pattern])))
                self._count(retakes=len(wanted[pattern]))
        return self.take_all()

    def _count(self, **more: float) -> None:
        """Add to the figures of the report."""
        self._total = dataclasses.replace(
            self._total, **{name: getattr(self._total, name) + by for name, by in more.items()}
        )

    def _take(self, shot: Shot, cameras: Sequence[CameraDevice]) -> None:
        """Take a pattern once.

        Photographs with faults are queued for a retake if the operator decides so. Photographs
        that only came late are retaken without a question while retakes are left.
        """
        pattern = shot.pattern
        result = self._try(shot, cameras) if cameras else ShotTaken((), (), 0.0)
        kept = {each.camera for each in result.taken}
        before = self._before.pop(pattern, [])
        findings = [*before, *result.findings, *self._look(shot, result)]
        self._count(warnings=sum(each.severity == "warn" for each in findings))
        bad = [each for each in findings if each.severity in ("retake", "refuse")]
        self._require_own_rig(bad)
        again = self._suspects.retakes_for(pattern, bad)
        missing = {camera.id for camera in cameras} - kept
        if missing:
            again[pattern] = again.get(pattern, set()) | missing
        # Where only others are taken again, this pattern is checked again together with them.
        waits = any((each.pattern or pattern) == pattern for each in bad)
        if again:
            left = min(self._suspects.left(pattern, bad), *(self._left[each] for each in again))
            late = all(each.camera in result.late for each in bad)
            decision = "retake" if late and left > 0 else self._decide(pattern, bad, left)
            if decision == "retake":
                if waits and pattern not in again:
                    self._queue_first(pattern, ())
                self._suspects.count(pattern, bad)
                self._queue_again(again, bad)
            elif decision == "accept" and not missing:
                self._writer.accept(pattern, bad)
                self._set_back(bad)
                again, waits = {}, False
            elif self._wishes.aborted():
                raise stopped()
            else:
                self.suspected = _suspected(bad)
                raise one_error([_unfinished(each) for each in bad])
        if pattern not in again and not waits:
            self._writer.shot(
                pattern,
                acknowledged=self._lights.acknowledged,
                trigger_skew_s=round(result.skew_s, 6),
                exposed_s=round(result.exposed_s, 6),
            )
            step("shot-done", pattern)

    def _require_own_rig(self, bad: Sequence[Finding]) -> None:
        """Pictures of another size by all cameras are not the cameras' fault: nobody is asked."""
        sizes = [each for each in bad if each.code == "size"]
        if len(self._all) < 2 or {each.camera for each in sizes} != self._all:
            return
        raise CaptureError(
            self._writer.root / "rig.json",
            found="; ".join(dict.fromkeys(each.found for each in sizes)) + " by all cameras",
            expected="; ".join(dict.fromkeys(each.expected for each in sizes)),
            hint="Is this the rig.json of this stage? If not, begin a new session with the stage's "
            "own (--rig). If all cameras have another picture size, set them back and resume.",
        )

    def _decide(self, pattern: str, bad: Sequence[Finding], left: int) -> Decision:
        """Ask, in the dark: somebody may think about the answer for long."""
        self._lights.dark()
        findings = [dataclasses.asdict(each) for each in bad]
        self._writer.note("asked", pattern=pattern, findings=findings)
        asked_s = time.monotonic()
        decision = self._operator.decide(bad, left)
        self._count(paused_s=time.monotonic() - asked_s)
        self._writer.note("answered", pattern=pattern, do=decision)
        return decision

    def _try(self, shot: Shot, cameras: Sequence[CameraDevice]) -> ShotTaken:
        takes = {c.id: self._writer.next_take(shot.pattern, c.id) for c in cameras}
        gone = self._photographer.absent.look_for(cameras, self._heed_abort)
        there = [camera for camera in cameras if camera.id not in gone]
        result = ShotTaken((), (), 0.0)
        if there:
            result = take_shot(
                shot,
                takes,
                there,
                self._lights,
                self._photographer,
                self._writer,
                self._wishes,
                self._config,
            )
        absent = missed(shot.pattern, cameras, gone, self._writer)
        result = dataclasses.replace(result, findings=(*result.findings, *absent))
        if result.light_lost:
            self._writer.note("note", said="the lights were lost; they are greeted again, dark")
            self._lights.recover()
        self._count(
            taken=len(result.taken), shots=1, lit_s=result.lit_s, exposed_s=result.exposed_s
        )
        self._total = dataclasses.replace(
            self._total, max_skew_s=max(self._total.max_skew_s, result.skew_s)
        )
        self._skew.add({each.camera: each.triggered_s for each in result.taken})
        return result

    def _look(self, shot: Shot, result: ShotTaken) -> list[Finding]:
        """What the shot's photographs show together, and beside those of earlier patterns."""
        triggers = {each.camera: each.triggered_s for each in result.taken}
        limit_s = self._config.preflight.max_trigger_skew_s
        findings = skew_findings(shot.pattern, triggers, limit_s)
        if not self._writer.state.missing(shot.pattern):
            findings += self._checks.shot(shot.pattern)
        for finding in findings:
            self._writer.finding(finding)
        return findings

    def _queue_again(self, again: Mapping[str, set[str]], bad: Sequence[Finding]) -> None:
        for pattern, ids in again.items():
            for camera in self._cameras:
                if camera.id not in ids:
                    continue
                own = [each for each in bad if each.camera in (None, camera.id)]
                own = [each for each in own if pattern in (each.pattern, *each.suspects)] or own
                self._reject(pattern, camera.id, "; ".join(str(each) for each in own))
                if any(each.code == "drift" for each in own):
                    self._photographer.set_back(camera)
            self._left[pattern] -= 1
            self._queue_first(pattern, ids)

    def _set_back(self, bad: Sequence[Finding]) -> None:
        """Give cameras that drifted the settings that they began with."""
        drifted = {each.camera for each in bad if each.code == "drift"}
        for camera in self._cameras:
            if camera.id in drifted:
                self._photographer.set_back(camera)

    def _reject(self, pattern: str, camera: str, why: str) -> None:
        """A photograph that is there no longer counts; its file stays."""
        if self._writer.state.accepted(pattern, camera) is not None:
            self._writer.rejected(pattern, camera, why)
        self._checks.forget(pattern, camera)

    def _queue_first(self, pattern: str, ids: Collection[str]) -> None:
        """Take a pattern again before anything else, with the cameras it was queued for too."""
        queued = [(name, also) for name, also in self._queue if name == pattern]
        for entry in queued:
            self._queue.remove(entry)
        self._count(retakes=len(ids))
        self._queue.appendleft((pattern, frozenset(ids).union(*(also for _, also in queued))))

    def _heed_abort(self) -> None:
        if self._wishes.aborted():
            raise stopped()

    def _heed(self, last: str) -> None:
        """Act on what the operator wished since the last shot, whose pattern is given."""
        while (wish := self._wishes.take()) is not None:
            if wish.do == "abort":
                raise stopped()
            if wish.do == "pause":
                self._pause(last)
            if wish.do == "retake":
                self._take_again(wish.pattern or last)

    def _take_again(self, pattern: str) -> None:
        """All cameras take a pattern again before anything else."""
        for camera in self._all:
            self._reject(pattern, camera, "the operator wants it again")
        self._queue_first(pattern, self._all)

    def _pause(self, last: str) -> None:
        begun_s = time.monotonic()
        self._lights.dark()
        self._writer.note("note", said="paused, the lights are dark")
        while (wish := self._wishes.take()) is None or wish.do != "resume":
            if wish is None:
                time.sleep(PAUSE_POLL_S)
            elif wish.do == "abort":
                raise stopped()
            elif wish.do == "retake":
                self._take_again(wish.pattern or last)
        self._count(paused_s=time.monotonic() - begun_s)


def _suspected(findings: Sequence[Finding]) -> tuple[list[str], list[str]]:
    """Patterns that may be the wrong ones of a contradiction, and whose cameras (none: all)."""
    named = [finding for finding in findings if finding.suspects]
    patterns = list(dict.fromkeys(name for finding in named for name in finding.suspects))
    cameras = [finding.camera for finding in named]
    return patterns, [] if None in cameras else sorted({c for c in cameras if c is not None})


def _unfinished(finding: Finding) -> LightstageError:
    hint = finding.hint
    if finding.code == NOT_TAKEN:
        reason = cause(finding.found, finding.camera or "")
        return CaptureError(f"{finding.where}: no photograph: {reason}")
    if finding.suspects:
        names = ", ".join(finding.suspects)
        hint = f"{hint} The wrong photograph may also be that of {names}."
    return CaptureError(
        finding.where,
        found=finding.found,
        expected=finding.expected,
        hint=hint,
    )
