"""Nine cameras for libgphoto2's virtual camera: folders whose one file is what a shot gives."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Sequence
from pathlib import Path

from lightstage.counting import counted
from sim.camera.exposure import with_exposure
from sim.devices.faults import FaultLog, Story
from sim.errors import SimError

PORT = "usb:001,001"
"""Where libgphoto2's virtual USB shows its one camera; each folder has a process of its own."""
SEED = "SEED0001.JPG"
"""libgphoto2's virtual camera looks for a file of this kind; its bytes may be any."""
SHUTTER, APERTURE = "0.0100s", "f/2.8"
"""What libgphoto2's virtual camera reports of itself, whatever its file."""
UNDATED = "    :  :   %H:%M:%S"
"""EXIF's form where the date is not known; the time of day distinguishes one session's files from
another's, of the same person and seed too."""
UNVERIFIABLE = (
    *("serial", "iso", "aperture", "shutter", "mode", "white_balance", "image_format", "focus"),
    *("owner", "artist", "copyright", "place"),
)
FILE_FAULTS = ("fail", "hang", "stale", "truncated")
"""What files can do to libgphoto2's virtual camera; by itself it fills up at its 27th shot."""


class CameraFolders:
    """One VCAMERADIR for each camera.

    Args:
        root: folder for all of them, on one file system.
        camera_ids: which.
        story: what goes wrong; a camera's first file is there before any shot, and each one after
            it counts as one.
        log: where that is noted.

    Raises:
        SimError: a fault that files cannot make, or of a camera that is not there.
    """

    def __init__(
        self,
        root: Path,
        camera_ids: Sequence[str],
        story: Story | None = None,
        log: FaultLog | None = None,
    ) -> None:
        self._story = story or Story()
        self._log = log or FaultLog()
        self._story.check_cameras(camera_ids)
        for fault in self._story.faults:
            if fault.kind.device == "camera" and fault.name not in FILE_FAULTS:
                raise SimError(
                    f"fault {fault.name}",
                    found="libgphoto2's virtual cameras",
                    expected=f"one of {', '.join(FILE_FAULTS)}, or simulated cameras",
                )
        self._files: dict[str, int] = {}
        self.root = root
        self.camera_ids = tuple(camera_ids)
        self._sizes: dict[str, int] = {}
        for camera_id in camera_ids:
            self._seed(camera_id).parent.mkdir(parents=True)

    def folder(self, camera_id: str) -> Path:
        """A camera's VCAMERADIR."""
        return self.root / camera_id

    def put(self, camera_id: str, data: bytes) -> None:
        """Make `data` what the camera's next shot gives; never half of it is seen.

        libgphoto2's virtual camera keeps the size that it saw when it was opened: it would cut a
        larger file and fail on a smaller one.

        Raises:
            SimError: another size than the camera's first file.
        """
        size = self._sizes.setdefault(camera_id, len(data))
        if len(data) != size:
            raise SimError(
                f"camera {camera_id}",
                found=f"a file of {counted(len(data), 'byte')}",
                expected=f"{size}",
            )
        shot = self._files.get(camera_id, -1) + 1
        self._files[camera_id] = shot
        # Without a date, as of a camera that does not know it: the file is older than its shot.
        taken = time.strftime(UNDATED)
        data = with_exposure(data, shutter=SHUTTER, aperture=APERTURE, taken=taken, shot=shot)
        due = {each.name: each for each in self._story.due(camera_id, "shot", shot)}
        for each in due.values():
            self._log.write(camera_id, each, shot)
        seed = self._seed(camera_id)
        if "fail" in due:
            seed.unlink(missing_ok=True)
            return
        if "stale" in due:
            return
        if "truncated" in due:
            data = data[: round(size * due["truncated"].fault["share"])]
        # Beside the folder, not in it: the camera lists whatever is there.
        beside = self.root / f"{camera_id}.next"
        if "hang" in due:
            os.mkfifo(beside)  # libgphoto2 blocks in open(), as on a stuck USB transfer
        else:
            beside.write_bytes(data)
        os.replace(beside, seed)

    def cameras_file(self) -> str:
        """The cameras file (TOML) that binds the rig's cameras to these folders."""
        allowed = ", ".join(f'"{name}"' for name in UNVERIFIABLE)
        lines = [f"allow_unverifiable = [{allowed}]"]
        for camera_id in self.camera_ids:
            lines += [
                f"[cameras.{camera_id}]",
                f'port = "{PORT}"',
                # A JSON string is a TOML string too.
                f"virtual_folder = {json.dumps(str(self.folder(camera_id)), ensure_ascii=False)}",
            ]
        return "\n".join(lines) + "\n"

    def _seed(self, camera_id: str) -> Path:
        return self.root / camera_id / "DCIM" / "100TEST" / SEED
