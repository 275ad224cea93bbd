"""Stage `decode`: a session's photographs to linear pictures on one scale, and foreground masks."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from lightstage.commands import ProgressCallback, quiet
from lightstage.formats.mesh import read_ply
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.scale import raw_scale
from lightstage.formats.session import Session
from lightstage.formats.sums import UNCHECKED, has_gradient
from processing.decode.completing import Recipe, completed_in_words, missing_patterns
from processing.decode.config import DecodeConfig, PrepareConfig
from processing.decode.files import (
    CameraJob,
    Look,
    fill_draft,
    first_look,
)
from processing.decode.preparation import cell_px, prepare_view, prepare_warnings
from processing.decode.session_photographs import (
    exposure_factors,
    read_calibrations,
    read_exposures,
)
from processing.errors import ProcessingError
from processing.frames.drafts import NOT_A_NUMBER, Draft, new_frames
from processing.frames.read import write_foreground
from processing.frames.small import SmallPictures, small_pictures
from processing.frames.window import Window, whole
from processing.masks import view_foreground
from processing.raw.region import mesh_window
from processing.readings import px_per_mm


@dataclasses.dataclass(frozen=True)
class Decoded:
    """Facts of one camera: shares of the picture and of the foreground, photographs kept."""

    foreground_share: float
    clipped_share: float
    window_share: float
    kept: int
    sums: dict[str, Any]


def decode(
    session: Session, out: Path, config: DecodeConfig, progress: ProgressCallback = quiet
) -> dict[str, Any]:
    """Decode every photograph of a session into OUT/work, and write the foreground masks.

    Only the window that holds the face is developed, and photographs that were decoded before are
    kept as long as neither they nor anything that they depend on changed. A frame without light
    (pattern `dark`) is ambient light: it is taken off all others.

    Returns:
        Facts: frames, cameras, clipped and foreground shares, warnings.

    Raises:
        FormatError: a photograph that cannot be read, has another size than its camera, or an
            exposure that cannot be brought to the others'.
        ProcessingError: a camera in whose photographs nothing is lit, or most is no number.
        FormatError: a camera's photographs that do not add up as their patterns do.
    """
    cameras = session.camera_ids()
    raw = {frame.camera for frame in session.file.frames if frame.encoding == "raw"}
    calibrations = read_calibrations(session, raw_scale(session) if raw else 1.0)
    recipes = missing_patterns(session)
    lit = lit_patterns(session)
    dark = tuple(p for p in session.file.sequence if p not in lit)
    steps = len(cameras) * (len(lit) + len(dark))
    warnings = [] if all(c.correction for c in calibrations.values()) else [UNCALIBRATED]
    decoded: dict[str, Decoded] = {}
    for number, camera in enumerate(cameras):
        missing = recipes[camera]
        frames = {p: session.frame(p, camera) for p in (*lit, *dark) if p not in missing}
        calibrated = calibrations.get(camera)
        correction = None if calibrated is None else calibrated.correction
        wanted = None if correction is None else correction.exposure
        exposures = read_exposures(session, frames)
        factors = exposure_factors(session, frames, exposures, wanted)
        if exposures and not any(exposures.values()):
            warnings.append(f"{camera}: {NO_EXPOSURE}")
        if len(set(factors.values())) > 1:
            warnings.append(f"{camera}: {_exposures(factors)}")
        shares = config.clip_share, config.foreground_share
        job = CameraJob(session, camera, frames, lit, dark, calibrated, factors, *shares)
        done = _Steps(progress, number * (len(lit) + len(dark)), steps)
        decoded[camera] = _decode_camera(job, out, config, missing, done)
        if decoded[camera].clipped_share > WARN_CLIPPED:
            warnings.append(f"{camera}: {decoded[camera].clipped_share:.0%} {CLIPPED_FACE}")
        contradictions = decoded[camera].sums["contradictions"]
        warnings += [f"forced: {one}" for one in contradictions]
    sums = {camera: one.sums for camera, one in decoded.items()}
    levels = {name: session.levels(name) for name in session.file.sequence}
    if has_gradient(levels) and not any(one["sums_compared"] for one in sums.values()):
        warnings.append(UNCHECKED)
    return {
        "cameras": len(cameras),
        "frames": steps,
        "patterns": list(lit),
        "ambient_from": list(dark),
        "frames_kept_from_the_last_run": sum(one.kept for one in decoded.values()),
        "window_share_of_picture": {c: one.window_share for c, one in decoded.items()},
        "clipped_share_of_foreground": {c: one.clipped_share for c, one in decoded.items()},
        "foreground_share_of_picture": {c: one.foreground_share for c, one in decoded.items()},
        "sums": sums,
        "warnings": [*warnings, *completed_in_words(recipes), *prepare_warnings(sums)],
    }


def lit_patterns(session: Session) -> tuple[str, ...]:
    """Patterns of a session's sequence that give light, in its order."""
    return tuple(p for p in session.file.sequence if session.levels(p).max() > 0)


WARN_CLIPPED = 0.1
"""Share of the foreground that may be clipped without a warning."""
MOST_LOST = 0.5
"""Share of pixels without a number above which these, not darkness, hide the face."""
CLIPPED_FACE = (
    "of the face is clipped or no number in some photograph, and gets no maps of its own; expose "
    "less, by what `full` shows, which clips first"
)
NO_EXPOSURE = "no photograph has its exposure in its file, so all are taken to have the same"
UNCALIBRATED = "No colour calibration: white balance from AsShotNeutral, albedo scale unknown."


class _Steps:
    """Reports progress photograph by photograph."""

    def __init__(self, progress: ProgressCallback, done: int, total: int) -> None:
        self.progress, self.first, self.done, self.total = progress, done, done, total

    def __call__(self) -> None:
        self.done += 1
        self.progress(min(self.done, self.total), self.total)


def _decode_camera(
    job: CameraJob,
    out: Path,
    config: DecodeConfig,
    missing: Mapping[str, Recipe],
    step: _Steps,
) -> Decoded:
    """Decode one camera; again with the whole picture where the window was too small."""
    limit = _limit(job, config)
    look = first_look(job, out, limit, crop=config.crop)
    found = _decode_window(job, look, limit, out, config, missing, step)
    if found is None:
        step.done = step.first
        look = dataclasses.replace(look, window=limit, opened={})
        found = _decode_window(job, look, limit, out, config, missing, step)
        assert found is not None  # no more than this is wanted
    return found


def _limit(job: CameraJob, config: DecodeConfig) -> Window:
    """The part of the picture that is wanted at all: that of the mesh where there is one."""
    if not config.mesh:
        return whole(job.shape)
    vertices = read_ply(Path(config.mesh)).vertices
    limit = mesh_window(vertices, job.session.rig.camera(job.camera), config.mesh_margin_mm)
    if limit.empty:
        raise ProcessingError(
            f"camera {job.camera}",
            field="decode.mesh",
            found=f"nothing of {config.mesh} in its picture",
            expected="a mesh in mm where the head sat",
        )
    return limit


class _WindowTooSmallError(Exception):
    """The mask continues beyond the window: what was written is dropped."""


def _decode_window(
    job: CameraJob,
    look: Look,
    limit: Window,
    out: Path,
    config: DecodeConfig,
    missing: Mapping[str, Recipe],
    step: Callable[[], None],
) -> Decoded | None:
    """Decode what `look` found; None where the mask continues beyond its window."""
    scale = px_per_mm(job.session.rig.camera(job.camera))
    cell = cell_px(look.window.shape, scale, config.prepare)
    pictures = SmallPictures.empty(look.window.shape, job.lit, cell)
    place = look.window, job.shape, config.foreground_share
    try:
        with (
            ThreadPoolExecutor(2) as beside,
            new_frames(out, job.camera, job.lit, look.scale, look.window, job.shape) as draft,
        ):
            kept = fill_draft(job, out, look, draft, pictures, step)
            # While the photographs are checked they go to the disk, and the mask is found.
            settled = beside.submit(draft.settle)
            early = beside.submit(view_foreground, pictures.bright, pictures.side, *place)
            sums = _prepare(job, out, draft, pictures, config.prepare, missing)
            mask = early.result()
            settled.result()
            if draft.facts["changed_later"]:
                pictures = small_pictures(draft.half, job.lit, cell)
                mask = view_foreground(pictures.bright, pictures.side, *place)
            if _reaches_beyond(mask, look.window, limit):
                raise _WindowTooSmallError
            if not mask.any():
                raise _no_face(job.camera, np.asarray(draft.clipped))
            area = int(np.count_nonzero(mask))
            clipped = np.count_nonzero(mask & (np.asarray(draft.clipped) != 0)) / area
    except _WindowTooSmallError:
        return None
    whole_mask = look.window.placed(mask, job.shape)
    with ThreadPoolExecutor(1) as beside:
        written = beside.submit(write_foreground, out, job.camera, whole_mask)
        ProcessedFolder(out).write_mask(job.camera, whole_mask)
        written.result()
    pixels = job.shape[0] * job.shape[1]
    return Decoded(
        foreground_share=round(area / pixels, 4),
        clipped_share=round(clipped, 5),
        window_share=round(look.window.height * look.window.width / pixels, 4),
        kept=kept,
        sums=sums,
    )


def _no_face(camera: str, clipped: np.ndarray) -> ProcessingError:
    """The error of photographs without a foreground; `clipped` are the marks of `Frames`."""
    lost = float(np.mean(clipped & NOT_A_NUMBER != 0))
    if lost > MOST_LOST:
        return ProcessingError(
            f"camera {camera}",
            found=f"no number (NaN or infinity) in {lost:.0%} of the pixels, in some photograph",
            expected="a face",
            hint="Write the linear photographs again; `lightstage check SESSION` names them.",
        )
    return ProcessingError(
        f"camera {camera}",
        found="photographs in which nothing is lit",
        expected="a face",
        hint="Are the lights, the exposure and the lens cap as they should be?",
    )


def _prepare(
    job: CameraJob,
    out: Path,
    draft: Draft,
    pictures: SmallPictures,
    config: PrepareConfig,
    missing: Mapping[str, Recipe],
) -> dict[str, Any]:
    """Check and mend the photographs against each other; note which did not stay as decoded."""
    usable = np.asarray(draft.clipped) == 0
    sums = prepare_view(
        out, job.camera, job.lit, draft.half, usable, job.session, config, missing, pictures
    )
    draft.facts["changed_later"] = sums.pop("changed")
    if draft.facts["changed_later"]:
        draft.clipped[~usable & (draft.clipped == 0)] = NOT_A_NUMBER
    return sums


def _exposures(factors: Mapping[str, float]) -> str:
    """What was done about unlike exposures, in words."""
    usual = float(np.median(list(factors.values())))
    odd = {n: f / usual for n, f in factors.items() if abs(f / usual - 1) > 1e-4}
    factors_in_words = ", ".join(f"{name} times {factor:.4g}" for name, factor in odd.items())
    return f"unlike exposures in the files, brought to one: {factors_in_words}"


def _reaches_beyond(mask: np.ndarray, window: Window, limit: Window) -> bool:
    """Whether a window's mask reaches an edge beyond which there is more of `limit`."""
    below = limit.top + limit.height - window.top - window.height
    right = limit.left + limit.width - window.left - window.width
    return bool(
        (window.top > limit.top and mask[0].any())
        or (window.left > limit.left and mask[:, 0].any())
        or (below > 0 and mask[-1].any())
        or (right > 0 and mask[:, -1].any())
    )
