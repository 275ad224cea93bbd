"""Cameras for a session to which a story happens: what they will see is developed beforehand.

A request that is lost is asked again after seconds, not after the minutes that nine renderings may
take: so every pattern's photographs are ready when the capture begins.
"""

from __future__ import annotations

import dataclasses
import hashlib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from lightstage.formats.files import write_bytes
from lightstage.rig import Rig
from sim.devices.body_folder import NEXT
from sim.devices.faults import FaultLog, Story
from sim.devices.simulated_camera import SimulatedCameras

TIMEOUT_S = 3.0
ATTEMPTS = 5


class Lens(Protocol):
    """Takes what cameras see: a folder for each camera, or a shelf."""

    def put(self, camera_id: str, data: bytes) -> None:
        """What this camera sees from now on, or would see."""


@dataclasses.dataclass(frozen=True)
class Shelf:
    """Photographs of one state of the lamps.

    Attributes:
        folder: holds one file for each camera.
    """

    folder: Path

    def put(self, camera_id: str, data: bytes) -> None:
        """Keep a camera's photograph."""
        write_bytes(self.folder / f"{camera_id}.dng", data)


class StoryCameras(SimulatedCameras):
    """Simulated cameras that know beforehand how most states of the lamps are photographed.

    Args:
        root: folder for all of them, new.
        rig: whose cameras they are.
        story: what goes wrong.
        log: where that is noted.
        settings: under which their photographs are made.
    """

    def __init__(
        self,
        root: Path,
        rig: Rig,
        story: Story,
        log: FaultLog,
        settings: Mapping[str, Mapping[str, Any]],
    ) -> None:
        super().__init__(root, rig, story, log, settings)
        self._shelves = root / "shelves"

    def shelf(self, levels: np.ndarray) -> Shelf:
        """Where photographs under (n,) levels are kept."""
        state = np.round(np.asarray(levels) * 65535).astype("<u2").tobytes()
        return Shelf(self._shelves / hashlib.sha256(state).hexdigest()[:16])

    def recall(self, levels: np.ndarray) -> bool:
        """Put what is kept for these (n,) levels before the lenses; False where nothing is."""
        shelf = self.shelf(levels).folder
        if not shelf.is_dir():
            return False
        for camera_id in self.camera_ids:
            seen = self.folder(camera_id) / NEXT
            beside = seen.with_name(f".{NEXT}.new")
            os.link(shelf / f"{camera_id}.dng", beside)
            os.replace(beside, seen)
            beside.unlink(missing_ok=True)  # a link onto itself is left where it is
        return True
