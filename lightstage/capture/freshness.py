"""Whether a picture that a camera gives is of this shot, by its camera's clock and card."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path

from lightstage.cameras.camera import CameraDevice, CardFile, Exposure, Summary
from lightstage.exif import read_exif
from lightstage.session import SessionWriter
from lightstage.session.camera_clock import CameraClock, Verdict, judge_time
from lightstage.session.disk import disk_errors
from lightstage.session.state import CLOCK_SET


class Freshness:
    """Knows each camera's clock and what was on its card at the beginning.

    Args:
        writer: the session.
        summaries: each camera's, just read, its clock among it.
        cards: what is on each card, by camera id.
        believed: whether clocks are compared.
    """

    def __init__(
        self,
        writer: SessionWriter,
        summaries: Mapping[str, Summary],
        cards: Mapping[str, Collection[CardFile]],
        believed: bool,
    ) -> None:
        self._writer = writer
        self._there = {camera_id: frozenset(files) for camera_id, files in cards.items()}
        self._clocks = {
            camera_id: CameraClock.read_now(each.clock_offset_s if believed else None)
            for camera_id, each in summaries.items()
        }

    def clock_facts(self, camera: CameraDevice) -> dict[str, float]:
        """The journal's facts of a camera's clock at an exposure; empty where it is unknown."""
        clock = self._clocks[camera.id]
        return {} if clock is None else {"clock_offset_s": clock.offset_now_s()}

    def doubt(self, camera: CameraDevice, exposure: Exposure, path: Path) -> str:
        """Why a picture that was downloaded is not of its shot, in words; empty where it may be.

        Args:
            camera: asked for its clock again where the time in the file is another one.
            exposure: the shot.
            path: the picture.

        Raises:
            DeviceError: the camera does not answer.
        """
        with disk_errors(path):
            taken = read_exif(path).taken
        clock, verdict = self._clocks[camera.id], Verdict.UNKNOWN
        if clock is not None:
            begun = clock.at(exposure.triggered_s)
            verdict = judge_time(taken, begun, exposure.exposed_s - exposure.triggered_s)
            if verdict is Verdict.DIFFERS and not self._was_set(camera, clock, exposure):
                shown = begun.isoformat(" ", "seconds")
                return f"the time {taken} in the file, the camera's clock showed {shown}"
        # A clock that was set proves nothing: before or after this shot, nobody knows.
        if verdict is not Verdict.FITS and exposure.files[0] in self._there[camera.id]:
            return f"the file {exposure.files[0].name}, which was on its card before this capture"
        return ""

    def _was_set(self, camera: CameraDevice, clock: CameraClock, exposure: Exposure) -> bool:
        """Whether a camera's clock was set since it was read; it is known anew then."""
        offset_s = camera.summary().clock_offset_s
        if offset_s is not None and not clock.was_set_since(offset_s):
            return False
        self._clocks[camera.id] = CameraClock.read_now(offset_s)
        reason = "its clock was set during the capture, or can no longer be read"
        file = [exposure.files[0].name, exposure.files[0].size]
        self._writer.note("note", about=CLOCK_SET, camera=camera.id, file=file, said=reason)
        return True
