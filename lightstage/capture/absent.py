"""Cameras that failed and could not be started again: tried before the next light goes on."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait

from lightstage.cameras.camera import CameraDevice, CardFile
from lightstage.errors import DeviceError
from lightstage.operator.plain import THEN
from lightstage.session import SessionWriter

POLL_S = 0.03
"""How long the operator's wish to abort may wait."""


class AbsentCameras:
    """Starts cameras again, and remembers why each failed first until it answers.

    Its process has ended by then, and to ask that shows nothing of the camera. Several threads may
    call, each for a camera of its own.

    Args:
        writer: the session.
    """

    def __init__(self, writer: SessionWriter) -> None:
        self._writer = writer
        self._why: dict[str, DeviceError] = {}

    def restart(self, camera: CameraDevice, failure: DeviceError) -> tuple[CardFile, ...]:
        """Start a camera again; returns what is on its card.

        Args:
            camera: that failed.
            failure: its error.

        Raises:
            DeviceError: it does not start; with why it failed first.
        """
        why = self._why.setdefault(camera.id, failure)
        try:
            self._writer.note("note", camera=camera.id, said="restarting")
            camera.restart()
            self._writer.note("note", camera=camera.id, said="started again")
            card = camera.card()
        except DeviceError as error:
            raise DeviceError(f"{why}{THEN}{error}") from None
        del self._why[camera.id]
        return card

    def look_for(
        self, cameras: Sequence[CameraDevice], heed: Callable[[], None]
    ) -> dict[str, DeviceError]:
        """Start those again that could not be; why each does not answer still, by camera id.

        Args:
            cameras: of which some may be absent.
            heed: called again and again; what it raises ends the search.
        """
        absent = [camera for camera in cameras if camera.id in self._why]
        if not absent:
            return {}
        pool = ThreadPoolExecutor(len(absent))
        try:
            looks = {camera.id: pool.submit(self._still_gone, camera) for camera in absent}
            while wait(looks.values(), timeout=POLL_S).not_done:
                heed()
        finally:
            # Not waited for: closing the cameras ends what is under way.
            pool.shutdown(wait=False)
        found = {name: look.result() for name, look in looks.items()}
        return {name: error for name, error in found.items() if error is not None}

    def _still_gone(self, camera: CameraDevice) -> DeviceError | None:
        try:
            self.restart(camera, self._why[camera.id])
        except DeviceError as error:
            return error
        return None
