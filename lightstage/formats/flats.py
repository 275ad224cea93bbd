"""flats.json (lightstage.flats/1): what each camera's pixels make of even light, and of none."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lightstage.errors import FormatError
from lightstage.formats.fields import array_of
from lightstage.formats.files import atomic_path, read_json, write_json
from lightstage.formats.npz import UNREADABLE_NPZ
from lightstage.formats.orientation import UNTURNED, Orientation
from lightstage.formats.paths import check_name, path_inside
from lightstage.rig import Camera

SCHEMA = "lightstage.flats/1"
LEAST_SHARE = 0.02
"""Of a lens's light at any place of its picture: less is no vignetting."""
UNUSABLE = (*UNREADABLE_NPZ, TypeError, OverflowError, AttributeError)
"""What an entry of another form, or a file of gains that is none, ends in."""


@dataclasses.dataclass(frozen=True)
class FlatField:
    """One camera's.

    Attributes:
        size_px: width and height of the mosaic as the sensor reads it, which a camera that is
            mounted upright turns; so are all places below.
        centre_px: (2,) x, y of the principal point; the top left pixel's middle is (0.5, 0.5).
        radius_px: half the picture's diagonal.
        radial: (3,) k: 1 + k1 r^2 + k2 r^4 + k3 r^6 is the share of the light that arrives at a
            distance of r radii from the principal point.
        per_pixel: (h, w) float32 further gain of each pixel of the mosaic; None: all 1.
        black_offset: (4,) of the mosaic's top left four places in row order: black above what the
            file states, as a share of white less the highest black; None where there are no darks.
        hot_pixels: (n, 2) int row, column.
    """

    size_px: tuple[int, int]
    centre_px: np.ndarray
    radius_px: float
    radial: np.ndarray
    per_pixel: np.ndarray | None = None
    black_offset: np.ndarray | None = None
    hot_pixels: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros((0, 2), int))

    @staticmethod
    def even(camera: Camera, orientation: Orientation = UNTURNED) -> FlatField:
        """A lens that loses nothing.

        Args:
            camera: of upright pictures.
            orientation: that brings what its sensor reads upright.
        """
        width, height = camera.width_px, camera.height_px
        centre = orientation.place_as_read(camera.cx_px, camera.cy_px, width, height)
        size = orientation.shape((width, height))
        return FlatField(size, np.array(centre), float(np.hypot(*size) / 2), np.zeros(3))

    def share(self, places_px: np.ndarray) -> np.ndarray:
        """(n,) share of the light that arrives at (n, 2) places x, y."""
        off = (np.asarray(places_px, float) - self.centre_px) / self.radius_px
        r2 = np.sum(off * off, axis=1)
        return np.asarray(1 + r2 * (self.radial[0] + r2 * (self.radial[1] + r2 * self.radial[2])))

    def smooth(self, shape: tuple[int, int], first: tuple[int, int]) -> np.ndarray:
        """(h, w) float32 gain against vignetting alone.

        Args:
            shape: height and width of a window of the mosaic.
            first: its top row and left column.
        """
        rows = (np.arange(shape[0]) + first[0] + 0.5 - self.centre_px[1]) / self.radius_px
        columns = (np.arange(shape[1]) + first[1] + 0.5 - self.centre_px[0]) / self.radius_px
        r2 = (rows**2).astype(np.float32)[:, None] + (columns**2).astype(np.float32)
        k1, k2, k3 = self.radial.astype(np.float32)
        return np.asarray(1 / (1 + r2 * (k1 + r2 * (k2 + r2 * k3))))

    def gain(self, shape: tuple[int, int], first: tuple[int, int] = (0, 0)) -> np.ndarray:
        """(h, w) float32 that counts above black are multiplied by, in a window as of `smooth`."""
        gain = self.smooth(shape, first)
        if self.per_pixel is not None:
            rows, columns = (
                slice(first[0], first[0] + shape[0]),
                slice(first[1], first[1] + shape[1]),
            )
            own = self.per_pixel[rows, columns]
            gain[: own.shape[0], : own.shape[1]] *= own
        return gain


def write_flats(fields: dict[str, FlatField], path: Path, more: dict[str, Any]) -> Path:
    """Write flats.json, and FLATS-CAMERA.npz beside it for cameras with a gain of each pixel.

    Args:
        fields: by camera id.
        path: of the JSON file.
        more: further fields of the file (where it comes from, figures).
    """
    cameras = {}
    for camera, field in fields.items():
        name = None
        if field.per_pixel is not None:
            name = f"{path.stem}-{camera}.npz"
            with atomic_path(path.with_name(name)) as beside:
                np.savez_compressed(beside, gain=field.per_pixel.astype(np.float16))
        offset = field.black_offset
        cameras[camera] = {
            "width_px": field.size_px[0],
            "height_px": field.size_px[1],
            "centre_px": field.centre_px.tolist(),
            "radius_px": field.radius_px,
            "radial": field.radial.tolist(),
            "per_pixel": name,
            "black_offset": None if offset is None else offset.tolist(),
            "hot_pixels": field.hot_pixels.tolist(),
        }
    return write_json(path, {"schema": SCHEMA, "cameras": cameras, **more})


def read_flats(path: Path, cameras: list[str]) -> dict[str, FlatField]:
    """Read flats.json: the fields of some cameras, by id; arguments and errors as `each_flat`."""
    return dict(each_flat(read_json(path, SCHEMA), cameras, path))


def each_flat(
    value: Mapping[str, Any], cameras: Sequence[str], path: Path
) -> Iterator[tuple[str, FlatField]]:
    """The cameras' fields one after another, since gains of single pixels fill the memory.

    Args:
        value: of the file.
        cameras: ids that are wanted; one that is not in the file is left out.
        path: of the file, beside which the gains are.

    Raises:
        FormatError: at the end, every camera whose entry is unusable, in one message.
    """
    entries = value.get("cameras")
    bad = []
    for camera in cameras:
        if not isinstance(entries, dict) or camera not in entries:
            continue
        try:
            field = _field(entries[camera], path)
        except UNUSABLE:
            bad.append(camera)
            continue
        yield camera, field
    if bad or not isinstance(entries, dict):
        raise FormatError(
            path,
            field="cameras",
            found=f"no usable flat of {', '.join(bad)}" if bad else "none",
            expected="width_px, height_px, centre_px, radius_px, radial, per_pixel, black_offset "
            "and hot_pixels of each camera",
            hint="Make it again: lightstage-processing calibrate.",
        )


def _field(entry: dict[str, Any], path: Path) -> FlatField:
    """One camera's entry; ValueError and the like where it is unusable."""
    sides = array_of([entry["width_px"], entry["height_px"]], 2)
    centre, radial = array_of(entry["centre_px"], 2), array_of(entry["radial"], 3)
    radius = float(array_of(entry["radius_px"]))
    given = entry.get("black_offset")
    offset = None if given is None else array_of(given, 4)
    pixels = array_of(entry.get("hot_pixels", []), -1, 2)
    size, hot = (int(sides[0]), int(sides[1])), pixels.astype(int)
    whole = bool((sides % 1 == 0).all() and (pixels % 1 == 0).all())
    if not whole or radius <= 0 or min(size) < 2:
        raise ValueError("numbers")
    if ((hot < 0) | (hot >= size[::-1])).any():
        raise ValueError("hot pixels")
    own = None
    if entry.get("per_pixel") is not None:
        name = check_name(entry["per_pixel"], path, "per_pixel")  # beside this file
        with np.load(path_inside(path.parent, name, path, "per_pixel"), allow_pickle=False) as file:
            own = file["gain"].astype(np.float32)
        # Of odd sizes, `calibrate` leaves the last row and column out.
        even = tuple(side // 2 * 2 for side in size[::-1])
        if own.shape not in (size[::-1], even) or not (np.isfinite(own) & (own > 0)).all():
            raise ValueError("gain")
    field = FlatField(size, centre, radius, radial, own, offset, hot)
    corners = np.array([[x, y] for x in (0, size[0]) for y in (0, size[1])], float)
    # Along the way from the centre to each corner: a polynomial may be low between.
    along = centre + np.linspace(0, 1, 33)[:, None, None] * (corners - centre)
    with np.errstate(over="ignore", invalid="ignore"):
        lit = field.share(along.reshape(-1, 2)) > LEAST_SHARE  # false for NaN
    if not lit.all():
        raise ValueError("no light in the picture")
    return field
