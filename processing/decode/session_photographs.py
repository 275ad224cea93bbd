"""A session's photographs, RAW or linear: find the face in one, develop a window of it."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Protocol

import numpy as np

from lightstage.errors import FormatError
from lightstage.exif import MOST_STOPS
from lightstage.formats.exr import read_exr
from lightstage.formats.flats import FlatField, read_flats
from lightstage.formats.session import Frame, Session
from processing.colour import ColourCorrection, read_colour
from processing.frames.window import Window
from processing.raw.develop import Settings, develop, store
from processing.raw.raw_file import RawFile, open_raw, read_exposure
from processing.raw.region import cell_px, preview

PEAK_SHARE = 0.999
"""Share of a linear photograph's values that its half floats hold best."""


class Photograph(Protocol):
    """An opened photograph."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""

    def look(self) -> tuple[np.ndarray, int]:
        """The brightest colour in squares: (rows, columns) float32, and their side in pixels."""

    def peak(self) -> float:
        """What its linear values hardly exceed."""

    def develop(
        self,
        window: Window,
        scale: float,
        ambient: np.ndarray | None,
        out: np.ndarray,
        clipped: np.ndarray,
    ) -> None:
        """Write a window's linear values over `scale`, less `ambient`; see `raw.develop`.

        Args:
            window: of (h, w) pixels.
            scale: of the values that are written.
            ambient: (h, w, 3) float32, or None.
            out: (h, w, 3) float16, overwritten.
            clipped: (h, w) uint8 marks, overwritten.
        """

    def close(self) -> None:
        """Give its memory back."""


@dataclasses.dataclass
class RawPhotograph:
    """A camera's file.

    Attributes:
        raw: opened.
        settings: whose factor is the exposure's alone.
    """

    raw: RawFile
    settings: Settings

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns, upright."""
        return self.raw.shape

    def look(self) -> tuple[np.ndarray, int]:
        """See Photograph."""
        return preview(self.raw)

    def peak(self) -> float:
        """What a pixel at the white level becomes."""
        rows = np.abs(self.settings.correction.coefficients).sum(axis=1)
        return float(rows.max()) * self.settings.factor

    def develop(
        self,
        window: Window,
        scale: float,
        ambient: np.ndarray | None,
        out: np.ndarray,
        clipped: np.ndarray,
    ) -> None:
        """See Photograph."""
        scaled = dataclasses.replace(self.settings, factor=self.settings.factor / scale)
        develop(self.raw, window, scaled, ambient, out, clipped)

    def close(self) -> None:
        """See Photograph."""
        self.raw.close()


@dataclasses.dataclass
class LinearPhotograph:
    """Linear values in memory: (h, w, 3) float32, of an OpenEXR file."""

    rgb: np.ndarray

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.rgb.shape[0], self.rgb.shape[1]

    def look(self) -> tuple[np.ndarray, int]:
        """See Photograph."""
        side = cell_px(self.shape)
        rows, columns = self.shape[0] // side * side, self.shape[1] // side * side
        few = self.rgb[:rows:side, :columns:side].astype(np.float32)
        return np.nan_to_num(few, nan=0, posinf=0, neginf=0).max(axis=2), side

    def peak(self) -> float:
        """The `PEAK_SHARE` quantile of the values that are not zero.

        Not the largest: one mirrored lamp of 65504 would leave skin too few bits. What is so much
        brighter than this that no half float holds it counts as no number.
        """
        size = np.abs(self.rgb)
        some = size[np.isfinite(size) & (size > 0)]
        return float(np.quantile(some, PEAK_SHARE)) if some.size else 0.0

    def develop(
        self,
        window: Window,
        scale: float,
        ambient: np.ndarray | None,
        out: np.ndarray,
        clipped: np.ndarray,
    ) -> None:
        """See Photograph."""
        store(self.rgb[window.slices] / np.float32(scale), ambient, out, clipped)

    def close(self) -> None:
        """See Photograph."""
        self.rgb = np.zeros((0, 0, 3), np.float32)


@dataclasses.dataclass(frozen=True)
class Calibrated:
    """How one camera's RAW photographs become light; None for what is not known.

    Attributes:
        correction: on the session's scale; None takes each file's own neutral.
        field: flats and darks.
    """

    correction: ColourCorrection | None
    field: FlatField | None

    def identity(self) -> list[object]:
        """JSON-ready: what the photographs' values depend on."""
        field = self.field
        own = self.correction
        own_gain = None if field is None else field.per_pixel
        return [
            None if own is None else [own.coefficients.tolist(), own.exposure],
            None
            if field is None
            else [
                field.size_px,
                np.asarray(field.centre_px).tolist(),
                field.radius_px,
                np.asarray(field.radial).tolist(),
                None if field.black_offset is None else field.black_offset.tolist(),
                field.hot_pixels.tolist(),
                None if own_gain is None else hashlib.sha256(own_gain.tobytes()).hexdigest(),
            ],
        ]


def read_calibrations(session: Session, scale: float) -> dict[str, Calibrated]:
    """What a session knows of its cameras with RAW photographs.

    Args:
        session: with its calibration files.
        scale: of the session's light against the calibration's (`formats.scale.raw_scale`).

    Raises:
        FormatError: a calibration file that cannot be used, or that lacks a camera.
    """
    raw = {frame.camera for frame in session.file.frames if frame.encoding == "raw"}
    cameras = [camera for camera in session.camera_ids() if camera in raw]
    colour, flats = session.file.calibration.colour, flats_path(session)
    colours: Mapping[str, ColourCorrection] = {}
    if cameras and colour is not None:
        colours = read_colour(session.root / colour, cameras)
    fields = read_flats(flats, cameras) if cameras and flats is not None else {}
    return {
        camera: Calibrated(
            colours[camera].scaled(scale) if camera in colours else None, fields.get(camera)
        )
        for camera in cameras
    }


def flats_path(session: Session) -> Path | None:
    """The file of a session's flats; None where it carries none."""
    extra = session.file.calibration.model_extra or {}
    flats = extra.get("flats")
    return None if flats is None else session.root / str(flats)


def read_exposures(session: Session, frames: Mapping[str, Frame]) -> dict[str, float | None]:
    """The exposures of a camera's RAW photographs, by pattern; None where a file has none.

    Raises:
        FormatError: one that cannot be read.
    """
    return {
        name: read_exposure(session.frame_path(frame))
        for name, frame in frames.items()
        if frame.encoding == "raw"
    }


def exposure_factors(
    session: Session,
    frames: Mapping[str, Frame],
    exposures: Mapping[str, float | None],
    wanted: float | None,
) -> dict[str, float]:
    """Factors that bring a camera's RAW photographs to one exposure, from their files.

    Args:
        session: whose they are.
        frames: by pattern, in the session's order; linear ones need nothing.
        exposures: of `read_exposures`.
        wanted: exposure that the colours hold for; None for the first photograph's.

    Returns:
        Pattern to factor. All 1 where no file has its exposure.

    Raises:
        FormatError: some files have it and some do not, or exposures too far apart.
    """
    exposure_s = {name: exposures.get(name) for name in frames}
    raw = [name for name, frame in frames.items() if frame.encoding == "raw"]
    known = [name for name in raw if exposure_s[name] is not None]
    silent = [name for name in raw if exposure_s[name] is None]
    if known and silent:
        raise FormatError(
            session.frame_path(frames[silent[0]]),
            field="exposure",
            found="no exposure time, ISO or f-number in the file",
            expected=f"them, as {known[0]} has them: photographs of unknown exposure do not "
            "belong together",
            hint="Copy the files from the camera again, unchanged.",
        )
    reference = wanted
    factors = {}
    for name in frames:
        own = exposure_s[name]
        if own is None:
            factors[name] = 1.0
            continue
        reference = own if reference is None else reference
        factors[name] = reference / own
        if abs(np.log2(factors[name])) > MOST_STOPS:
            raise FormatError(
                session.frame_path(frames[name]),
                field="exposure",
                found=f"{abs(np.log2(factors[name])):.1f} stops from the others or from the "
                "calibration",
                expected=f"at most {MOST_STOPS:g}",
                hint="Were these photographs taken for this session?",
            )
    # Files give the same setting alike only to a float's accuracy.
    return {n: 1.0 if abs(f - 1) < 1e-5 else float(f) for n, f in factors.items()}


def open_photograph(
    session: Session, frame: Frame, calibrated: Calibrated | None, factor: float, clip_share: float
) -> Photograph:
    """Open a frame's file.

    Args:
        session: whose it is.
        frame: which.
        calibrated: of its camera, for RAW.
        factor: of its exposure.
        clip_share: see `raw.develop.Settings`.

    Raises:
        FormatError: it cannot be read.
    """
    path = session.frame_path(frame)
    if frame.encoding == "linear":
        rgb = read_exr(path)
        if rgb.ndim != 3:
            raise FormatError(path, found="one channel", expected="R G B")
        return LinearPhotograph(rgb)
    raw = open_raw(path)
    known = calibrated or Calibrated(None, None)
    field = known.field
    if field is not None and field.size_px != raw.size[::-1]:
        raise FormatError(
            path,
            field="size",
            found=f"{raw.size[1]} x {raw.size[0]} pixels",
            expected=f"{field.size_px[0]} x {field.size_px[1]}, as the flats of {frame.camera} "
            "that the session carries",
            hint="Flats hold for photographs of their own size alone. Take flats at this size, or "
            "import the session again without them.",
        )
    correction = known.correction or ColourCorrection(np.diag(raw.neutral))
    return RawPhotograph(raw, Settings(correction, factor, clip_share, field))
