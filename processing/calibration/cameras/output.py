"""Measured cameras as files: rig.json with its cameras replaced, and cameras.json beside it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lightstage.commands import ProgressCallback, quiet
from lightstage.formats.board import BoardConfig
from lightstage.formats.calibration_shots import NAME as SHOTS_NAME
from lightstage.formats.cameras import NAME, SCHEMA
from lightstage.formats.config import make_config, require_bounds
from lightstage.formats.files import atomic_folder, write_json
from lightstage.rig import MEASURED_WITH, UNCHECKED, UNMEASURED, rig_sha256, save_rig
from processing.bounds import BOUNDS
from processing.calibration.cameras.boards import see_boards
from processing.calibration.cameras.config import CamerasFile
from processing.calibration.cameras.measured import MeasuredCameras, measure_cameras
from processing.calibration.folder import Source
from processing.errors import ProcessingError
from processing.records import versions


def camera_settings(source: Source, values: Mapping[str, Any], where: str | Path) -> CamerasFile:
    """Settings as a file names them; the shots give what it does not name of the board.

    Args:
        source: the lab's shots.
        values: tables of a TOML file.
        where: the file's name, for errors.

    Raises:
        ConfigError: an unknown key, a value of another type or out of its bounds, in either.
    """
    target = source.facts.get("charuco", {}).get("target", {})
    shots = source.root / str(source.facts.get("charuco", {}).get("folder", ""))
    board = make_config(BoardConfig, target, f"{shots / SHOTS_NAME}, target")
    named = values.get("board", {})
    if isinstance(named, Mapping):
        values = {**values, "board": {**dataclasses.asdict(board), **named}}
    settings = make_config(CamerasFile, values, where)
    require_bounds(settings, where, BOUNDS)
    return settings


def make_cameras(
    source: Source, config: CamerasFile, out: Path, progress: ProgressCallback = quiet
) -> MeasuredCameras:
    """Measure cameras, and write OUT/rig.json and OUT/cameras.json together.

    Raises:
        FormatError: `out` is something else, or a photograph cannot be read.
        PoseError: see `measure_cameras`.
        ProcessingError: no shots of a board, or a camera to allow that the rig does not have.
    """
    poses = source.poses.get("charuco")
    if not poses:
        raise ProcessingError(
            source.root,
            found=f"shots of {', '.join(source.poses)}",
            expected="shots of a ChArUco board",
            hint="Take them: `lightstage calibrate charuco --out LAB`.",
        )
    rig = poses[0].session.rig
    known = [camera.id for camera in rig.cameras]
    unknown = [name for name in config.cameras.allow if name not in known]
    if unknown:
        raise ProcessingError(
            source.root,
            field="cameras.allow (--allow-camera)",
            found=", ".join(unknown),
            expected=f"cameras of this rig: {', '.join(known)}",
        )
    # A session's folder of calibrations has a file of this name, too.
    with atomic_folder(out, NAME, schema=SCHEMA, own=(NAME, "rig.json")) as folder:
        sights = see_boards(poses, config.board, progress)
        found = measure_cameras(sights, rig, config.board, config.cameras)
        more = {
            **rig.more,
            MEASURED_WITH: rig_sha256(rig),
            UNMEASURED: found.unmeasured,
            UNCHECKED: found.unchecked,
        }
        save_rig(dataclasses.replace(rig, cameras=found.cameras, more=more), folder / "rig.json")
        write_json(
            folder / NAME,
            {
                "schema": SCHEMA,
                "source": source.facts.get("charuco", {}),
                "config": dataclasses.asdict(config),
                "facts": found.facts,
                "warnings": [*source.warnings, *found.warnings],
                "versions": versions(),
            },
        )
    return found
