"""Stage `decode`: a session's photographs to linear pictures on one scale, and foreground masks."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from lightstage.commands import ProgressCallback, quiet
from lightstage.errors import FormatError
from lightstage.formats.exr import read_exr
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.scale import raw_scale
from lightstage.formats.session import Frame, Session
from processing.colour import read_colour
from processing.completing import missing_patterns, said
from processing.errors import ProcessingError
from processing.frames import Frames, write_foreground, write_frames
from processing.masks import foreground
from processing.preparation import PrepareConfig, prepare_view, prepare_warnings
from processing.raw import read_raw


@dataclasses.dataclass(frozen=True)
class DecodeConfig:
    """What `decode` may be told."""

    clip_share: float = 0.99
    """Counts of at least this share of the white level are clipped."""
    foreground_share: float = 0.03
    """Foreground is brighter than this share of the picture's 99th percentile."""
    prepare: PrepareConfig = dataclasses.field(default_factory=PrepareConfig)
    """Motion, ambient light and flicker between the photographs."""


def decode(
    session: Session, out: Path, config: DecodeConfig, progress: ProgressCallback = quiet
) -> dict[str, Any]:
    """Decode every photograph of a session into OUT/work, and write the foreground masks.

    A frame without light (pattern `dark`) is ambient light: it is taken off all others.

    Returns:
        Facts: frames, cameras, clipped and foreground shares, warnings.

    Raises:
        FormatError: a photograph that cannot be read or has another size than its camera.
        ProcessingError: a camera in whose photographs nothing is lit.
    """
    cameras = session.camera_ids()
    matrices, warnings = _colours(session, cameras)
    recipes = missing_patterns(session)
    sums: dict[str, dict[str, Any]] = {}
    lit = tuple(p for p in session.file.sequence if session.levels(p).max() > 0)
    dark = [p for p in session.file.sequence if p not in lit]
    steps = len(cameras) * (len(lit) + len(dark))
    done = 0
    clipped: dict[str, float] = {}
    covered: dict[str, float] = {}
    folder = ProcessedFolder(out)
    for camera in cameras:
        shape = (session.rig.camera(camera).height_px, session.rig.camera(camera).width_px)
        images = np.zeros((len(lit), *shape, 3), np.float32)
        ambient = np.zeros((*shape, 3), np.float32)
        valid = np.ones(shape, bool)
        for pattern in (*dark, *(p for p in lit if p not in recipes[camera])):
            frame = session.frame(pattern, camera)
            rgb, good = read_frame(session, frame, matrices.get(camera), config.clip_share)
            if rgb.shape[:2] != shape:
                raise FormatError(
                    session.frame_path(frame),
                    found=f"{rgb.shape[1]} x {rgb.shape[0]} pixels",
                    expected=f"{shape[1]} x {shape[0]} as {camera} has in rig.json",
                )
            valid &= good
            if pattern in dark:
                ambient += rgb / len(dark)
            else:
                images[lit.index(pattern)] = rgb - ambient
            done += 1
            progress(done, steps)
        sums[camera] = prepare_view(
            out, camera, lit, images, valid, session, config.prepare, recipes[camera]
        )
        images[:, ~valid] = 0
        mask = foreground(images.max(axis=(0, 3)), config.foreground_share)
        if not mask.any():
            raise ProcessingError(
                f"camera {camera}",
                found="photographs in which nothing is lit",
                expected="a face",
                hint="Are the lights, the exposure and the lens cap as they should be?",
            )
        write_frames(out, camera, Frames.of(lit, images, valid))
        write_foreground(out, camera, mask)
        folder.write_mask(camera, mask)
        clipped[camera] = round(float((~valid & mask).sum() / mask.sum()), 5)
        covered[camera] = round(float(mask.mean()), 4)
    return {
        "cameras": len(cameras),
        "frames": steps,
        "patterns": list(lit),
        "ambient_from": dark,
        "clipped_share_of_foreground": clipped,
        "foreground_share_of_picture": covered,
        "sums": sums,
        "warnings": [*warnings, *said(recipes), *prepare_warnings(sums)],
    }


def read_frame(
    session: Session, frame: Frame, linear_from_raw: np.ndarray | None, clip_share: float
) -> tuple[np.ndarray, np.ndarray]:
    """One photograph as linear RGB.

    Args:
        session: whose photograph it is.
        frame: which.
        linear_from_raw: (3, 3) colour matrix of the camera for `raw` frames; None takes the
            camera's own neutral, on an unknown scale.
        clip_share: see DecodeConfig.

    Returns:
        (h, w, 3) float32 finite, and (h, w) bool valid.
    """
    path = session.frame_path(frame)
    if frame.encoding == "linear":
        rgb = read_exr(path)
        if rgb.ndim != 3:
            raise FormatError(path, found="one channel", expected="R G B")
        valid = np.isfinite(rgb).all(axis=2)
        return np.where(valid[..., None], rgb, np.float32(0)), valid
    picture = read_raw(path, clip_share)
    matrix = np.diag(picture.neutral_from_raw) if linear_from_raw is None else linear_from_raw
    return picture.rgb @ matrix.T.astype(np.float32), ~picture.clipped


def _colours(session: Session, cameras: list[str]) -> tuple[dict[str, np.ndarray], list[str]]:
    """Colour matrices of the cameras with RAW frames, and what to warn of."""
    raw = {frame.camera for frame in session.file.frames if frame.encoding == "raw"}
    if not raw:
        return {}, []
    if session.file.calibration.colour is None:
        said = "No colour calibration: white balance from AsShotNeutral, albedo scale unknown."
        return {}, [said]
    path = session.root / session.file.calibration.colour
    colours = read_colour(path, [camera for camera in cameras if camera in raw])
    scale = raw_scale(session)
    return {camera: colour.matrix * scale for camera, colour in colours.items()}, []
