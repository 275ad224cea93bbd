"""One camera's photograph of one pattern: triggered, found on its card, brought home, kept.

A photograph that was exposed is never given up: a camera that fails afterwards is started again and
its card is read. What is there and cannot be identified for certain is kept as recovered, and the
camera takes the pattern again.
"""

from __future__ import annotations

import contextlib
import dataclasses
import time
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import Protocol

from lightstage.cameras.camera import CameraDevice, CardFile, Exposure, Summary
from lightstage.cameras.file_names import raw_first
from lightstage.capture.absent import AbsentCameras
from lightstage.capture.config import CaptureConfig
from lightstage.capture.freshness import Freshness
from lightstage.capture.late_cameras import ExposureTimes
from lightstage.capture.pattern_light import LateCameraError, PatternLight
from lightstage.errors import (
    CaptureError,
    CutPhotographError,
    DeviceError,
    FormatError,
    LightstageError,
)
from lightstage.findings import Finding
from lightstage.leds.controller import LightLostError
from lightstage.operator.words import ON_CARD
from lightstage.preflight import drift, photograph_findings, set_back
from lightstage.preflight.privacy import FIELDS
from lightstage.rig import Rig
from lightstage.session import SessionWriter, arrived, why_not_delete
from lightstage.steps import step


class OldPictureError(CaptureError):
    """A camera gave a picture that is not of its shot: of an earlier one, or of another session."""


class Checks(Protocol):
    """Checks photographs as they come (lightstage.checks.ShotChecks)."""

    def photograph(self, pattern: str, camera_id: str, path: Path) -> list[Finding]:
        """A photograph that is in the journal now; several threads may."""

    def shot(self, pattern: str) -> list[Finding]:
        """All photographs of a pattern are there: together, and beside the earlier patterns'."""

    def forget(self, pattern: str, camera_id: str) -> None:
        """A photograph no longer counts."""


@dataclasses.dataclass(frozen=True)
class Taken:
    """One photograph that is kept.

    Attributes:
        camera: whose.
        triggered_s: time.monotonic() of its trigger.
        exposed_s: when the camera reported that it was there.
        findings: of its check.
    """

    camera: str
    triggered_s: float
    exposed_s: float
    findings: tuple[Finding, ...]


class Photographer:
    """Takes photographs with all cameras of a session and remembers what is theirs.

    Args:
        rig: the cameras wanted.
        writer: the session.
        checks: checks each photograph.
        config: how often a file is requested, and whether it is deleted on the camera.
        summaries: each camera's, by its id; it must stay so.
        cards: what was on each card before, by camera id.

    Attributes:
        exposure_times: how long exposures of this session last.
        absent: cameras that could not be started again.
    """

    def __init__(
        self,
        rig: Rig,
        writer: SessionWriter,
        checks: Checks,
        config: CaptureConfig,
        summaries: Mapping[str, Summary],
        cards: Mapping[str, Collection[CardFile]],
    ) -> None:
        self._rig = rig
        self._writer = writer
        self._checks = checks
        self._config = config
        self._summaries = summaries
        self._known = {camera_id: set(files) for camera_id, files in cards.items()}
        self.exposure_times = ExposureTimes(each.shutter for each in summaries.values())
        self.absent = AbsentCameras(writer)
        believed = config.preflight.believe_camera_clocks
        self._freshness = Freshness(writer, summaries, cards, believed)
        # Cameras of which a trigger gave no picture: it may come to the card at any later time.
        self._doubtful: set[str] = set()

    def take(
        self,
        pattern: str,
        take: int,
        camera: CameraDevice,
        at_s: float,
        light: PatternLight,
    ) -> Taken:
        """Take and keep one photograph.

        Args:
            pattern: what is lit.
            take: 1, or more where it is taken again.
            camera: whose.
            at_s: time.monotonic() at which all trigger.
            light: that it is taken under.

        Raises:
            LightLostError: the light may have changed; the picture is kept as recovered.
            LateCameraError: the light was put out before the camera had exposed, and it answers
                again; a picture that it took is kept as recovered.
            DeviceError, FormatError, CutPhotographError: the camera took no photograph, or it did
                not come whole.
            OldPictureError: it is not of this shot; it is kept as recovered.
            CaptureError: this computer's disk failed.
        """
        try:
            self._clear_doubts(camera)
            exposure = self._trigger(pattern, camera, at_s)
        finally:
            lost = light.over(camera.id)
        if isinstance(exposure, DeviceError):
            try:
                exposure = self._search(pattern, camera, at_s, exposure)
            except DeviceError as error:
                if error is exposure and isinstance(lost, LateCameraError):
                    raise lost from None  # it answers again, without a picture of this light
                raise
        else:
            self.exposure_times.note(camera.id, exposure.exposed_s - at_s)
        if lost is not None:
            self._bring_home(camera, exposure.files, pattern, f"light not certain: {lost}")
            raise lost if isinstance(lost, LateCameraError) else LightLostError(str(lost))
        file = exposure.files[0]
        self._writer.exposed(
            pattern,
            take,
            camera.id,
            file,
            exposure.files[1:],
            triggered_after_s=round(exposure.triggered_s - at_s, 6),
            exposure_s=round(exposure.exposed_s - exposure.triggered_s, 6),
            **self._freshness.clock_facts(camera),
        )
        step("exposed", pattern, camera.id)
        path = self._fetch(pattern, take, camera, exposure)
        findings = self._look(pattern, camera, path)
        step("checked", pattern, camera.id)
        if self._config.delete_from_cameras:
            findings += self._delete(pattern, take, camera, file)
        return Taken(camera.id, exposure.triggered_s, exposure.exposed_s, tuple(findings))

    def look_again(self, pattern: str, camera_id: str, path: Path) -> list[Finding]:
        """What a photograph of before a crash shows, for later ones to be compared with it."""
        wanted = self._rig.camera(camera_id)
        return _late(
            pattern,
            [
                *map(_mendable, photograph_findings(path, wanted, self._summaries[camera_id])),
                *self._checks.photograph(pattern, camera_id, path),
            ],
        )

    def set_back(self, camera: CameraDevice) -> None:
        """Give a camera the settings that it began with, where they drifted."""
        try:
            done, failed = set_back(camera, self._summaries[camera.id])
        except LightstageError as error:
            done, failed = [], [str(error)]
        for finding in done:
            name = finding.where.rpartition(", ")[2]
            self._writer.note("note", camera=camera.id, said=f"{name} set back")
        for reason in failed:
            self._writer.note("note", camera=camera.id, said=f"not set back: {reason}")

    def _trigger(self, pattern: str, camera: CameraDevice, at_s: float) -> Exposure | DeviceError:
        """Trigger; the exposure, or why there is none."""
        try:
            exposure = camera.trigger(at_s, pattern)
        except DeviceError as error:
            return error
        self._known[camera.id] |= set(exposure.files)
        if not exposure.files:
            return DeviceError(f"camera {camera.id}", found="no picture after its trigger")
        return exposure

    def _clear_doubts(self, camera: CameraDevice) -> None:
        """Bring home what came to the card of a camera whose earlier trigger gave no picture."""
        if camera.id not in self._doubtful:
            return
        # A camera that cannot list its card now fails at the trigger, and is handled there.
        with contextlib.suppress(DeviceError):
            late = arrived(self._known[camera.id], camera.card())
            self._known[camera.id] |= set(late)
            self._bring_home(camera, late, None, "it came late, after its trigger had failed")

    def _search(
        self, pattern: str, camera: CameraDevice, at_s: float, failure: DeviceError
    ) -> Exposure:
        """The picture that a camera took before it failed, from its card; `failure` if none."""
        new = self._arrived(camera, failure)
        if not new:
            self._doubtful.add(camera.id)
            raise failure
        names = ", ".join(file.name for file in new)
        self._writer.note(
            "note",
            about=ON_CARD,
            camera=camera.id,
            pattern=pattern,
            said=f"{names} is on its card, though: {failure}",
        )
        several = len({Path(file.name).stem for file in new}) > 1
        if several or camera.id in self._doubtful:
            # Which one is this light's, or whether it is an earlier one's, nobody can know.
            self._bring_home(camera, new, pattern, f"not certain to be of this light: {failure}")
            raise failure
        files = tuple(sorted(new, key=lambda file: raw_first(file.name)))
        return Exposure(files, at_s, time.monotonic())

    def _arrived(self, camera: CameraDevice, failure: DeviceError) -> tuple[CardFile, ...]:
        """What is new on the card of a camera that failed, which is started again where it must."""
        try:
            now = camera.card()
        except DeviceError:
            try:
                now = self.absent.restart(camera, failure)
            except DeviceError:
                # What it has taken is seen when it answers, and of which light it is nobody knows.
                self._doubtful.add(camera.id)
                raise
        new = arrived(self._known[camera.id], now)
        self._known[camera.id] |= set(new)
        return new

    def _fetch(self, pattern: str, take: int, camera: CameraDevice, exposure: Exposure) -> Path:
        """Bring a file from the card to its place; asked for again where it does not come whole."""
        left = self._config.downloads
        while True:
            left -= 1
            try:
                return self._fetch_once(pattern, take, camera, exposure)
            except (DeviceError, FormatError, CutPhotographError) as error:
                self._writer.failed(pattern, take, camera.id, str(error))
                if left == 0:
                    raise
                if isinstance(error, DeviceError):
                    with contextlib.suppress(DeviceError):
                        camera.restart()

    def _fetch_once(
        self, pattern: str, take: int, camera: CameraDevice, exposure: Exposure
    ) -> Path:
        file = exposure.files[0]
        incoming = self._writer.incoming(pattern, camera.id, take)
        got = camera.download(file.name, incoming, pattern)
        twin = self._writer.claim(got.sha256, (pattern, camera.id, take))
        why = f"the bytes of {twin}" if twin else self._freshness.doubt(camera, exposure, incoming)
        if why:
            aside = self._writer.aside(incoming, camera.id, file, pattern, why)
            self._writer.rejected(pattern, camera.id, why, take)
            raise OldPictureError(
                f"{pattern} by {camera.id}, take {take}",
                found=why,
                expected="a picture of this shot",
                hint="The camera gave an old picture, which is kept as "
                f"{aside.relative_to(self._writer.root).as_posix()}. Switch the camera off and on.",
            )
        return self._writer.keep(
            pattern, camera.id, take, incoming, file, got.sha256, download_s=round(got.seconds, 6)
        )

    def _look(self, pattern: str, camera: CameraDevice, path: Path) -> list[Finding]:
        """Check the photograph and its header, and whether the camera is set as before."""
        findings = self.look_again(pattern, camera.id, path)
        # A camera that dies now is noticed at its next trigger; this photograph is safe.
        with contextlib.suppress(DeviceError):
            summary = self._summaries[camera.id]
            findings += _late(pattern, map(_mendable, drift(summary, camera.summary(), camera.id)))
        for finding in findings:
            self._writer.finding(finding)
        return findings

    def _bring_home(
        self, camera: CameraDevice, files: Collection[CardFile], pattern: str | None, why: str
    ) -> None:
        """Keep pictures whose light or label is not certain; they stay on the card otherwise."""
        for file in files:
            try:
                self._writer.recover(camera, file, pattern, why)
            except LightstageError as error:
                self._writer.note("note", camera=camera.id, said=f"{file.name}: {error}")

    def _delete(
        self, pattern: str, take: int, camera: CameraDevice, file: CardFile
    ) -> list[Finding]:
        """Delete a photograph on the camera; what is beside it, such as a JPEG, stays.

        It stays too where photographs are missing on the disk; that is a finding.
        """
        why = why_not_delete(self._writer.root, self._writer.state, (pattern, camera.id, take))
        if why:
            stays = Finding(
                "warn",
                "not-deleted",
                f"camera {camera.id}, {file.name}",
                found=why,
                expected="all photographs on the disk, before one is deleted on a camera",
                hint="Something removes files from the session's folder: stop it. What is missing "
                "is brought from the card or taken again at the end.",
                pattern=pattern,
                camera=camera.id,
            )
            self._writer.finding(stays)
            return [stays]
        self._writer.deleting(pattern, camera.id, file)
        step("deleting", pattern, camera.id)
        try:
            camera.delete(file.name)
        except DeviceError as error:
            self._writer.note("note", camera=camera.id, said=f"{file.name} not deleted: {error}")
            return []
        self._writer.deleted(pattern, camera.id, file)
        step("deleted", pattern, camera.id)
        return []


def _mendable(finding: Finding) -> Finding:
    """A setting that changed in the middle: what `Photographer.set_back` will do is the hint."""
    name = finding.where.rpartition(", ")[2]
    if finding.code != "drift" or name in ("serial", "model", "firmware"):
        return finding
    does = "The field is cleared" if name in FIELDS else "The setting is set back"
    hint = f"{does} on the camera in any case: r then takes this photograph again, a keeps it."
    return dataclasses.replace(finding, hint=hint)


def _late(pattern: str, findings: Iterable[Finding]) -> list[Finding]:
    """Findings now that lights are on: what would have been refused before is taken again."""
    return [
        dataclasses.replace(
            each,
            pattern=pattern,
            severity="retake" if each.severity == "refuse" else each.severity,
        )
        for each in findings
    ]
