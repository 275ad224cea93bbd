"""Sessions of 24 megapixel cameras' DNG files, for benchmarks of speed.

A rendered view of 1.5 megapixels is enlarged four times a side and photographed by the simulator's
sensor, with its mosaic and its noise at full size: what is slow or fast about a picture of 24
megapixels depends on its size, its mask and its noise, not on the finest relief.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from benchmarks.reflectance_people import folder, person, session
from lightstage.formats.exr import read_exr
from lightstage.formats.files import atomic_folder, sha256_file
from lightstage.formats.session import (
    Calibration,
    Driven,
    Frame,
    Session,
    SessionFile,
    load_session,
    save_session,
)
from lightstage.rig import default_rig, save_rig
from sim.camera.dng import Exif, dng_bytes
from sim.camera.sensor import SensorConfig, make_sensor

WHO = "tone3"
CAMERA = "cam0"
EXIF = Exif("Nikon DSC D750", "6012345", 16.0, 105.0)


def large_session() -> Path:
    """The session's folder, made where it is missing."""
    root = folder() / f"24mp-{WHO}"
    if not root.is_dir():
        with atomic_folder(root, "session") as beside:
            _make(beside / "session")
    return root / "session"


def _make(out: Path) -> None:
    small = load_session(session(person(WHO)))
    photograph_large(small, [CAMERA], out)


def photograph_large(small: Session, cameras: Sequence[str], out: Path) -> None:
    """Write a session of 24 megapixel DNG files from a rendered one.

    Args:
        small: linear frames without noise.
        cameras: those of the default rig that are taken.
        out: folder to make.
    """
    every = default_rig()
    rig = dataclasses.replace(every, cameras=tuple(every.camera(name) for name in cameras))
    out.mkdir()
    save_rig(rig, out / "rig.json")
    frames, colour = [], {}
    for number, camera in enumerate(rig.cameras):
        full = read_exr(small.frame_path(small.frame("full", camera.id)))
        peak = np.quantile(full.reshape(-1, 3), 0.9995, axis=0)
        sensor = make_sensor(SensorConfig(), peak, np.random.default_rng(1 + number))
        for index, pattern in enumerate(small.file.sequence):
            light = read_exr(small.frame_path(small.frame(pattern, camera.id)))
            size = (camera.width_px, camera.height_px)
            large = cv2.resize(light, size, interpolation=cv2.INTER_CUBIC)
            rng = np.random.default_rng([number, index])
            counts = sensor.expose(np.maximum(large, 0), rng)
            path = Path("frames") / pattern / f"{camera.id}.dng"
            (out / path).parent.mkdir(parents=True, exist_ok=True)
            (out / path).write_bytes(dng_bytes(counts, sensor, EXIF))
            digest = sha256_file(out / path)
            frames.append(
                Frame(
                    pattern=pattern, camera=camera.id, path=str(path), sha256=digest, encoding="raw"
                )
            )
        matrix = np.linalg.inv(sensor.raw_from_linear).tolist()
        colour[camera.id] = {"linear_from_raw": matrix, "exposure_s": sensor.exposure_s}
    (out / "colour.json").write_text(
        json.dumps({"schema": "lightstage.colour/1", "cameras": colour})
    )
    levels = {n: Driven(levels=small.levels(n).tolist()) for n in small.file.sequence}
    file = SessionFile(
        id="24mp",
        created_utc="2026-01-01T00:00:00Z",
        subject=small.file.subject,
        expression="neutral",
        sequence=small.file.sequence,
        frames=frames,
        patterns=levels,
        calibration=Calibration(colour="colour.json"),
    )
    save_session(out, file)


if __name__ == "__main__":
    print(large_session())
