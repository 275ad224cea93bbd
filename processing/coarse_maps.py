"""Coarse maps between the stages: half floats of the face's pixels in OUT/work.

`separate` writes them there, `reconstruct` and `refine` read them there, and no later stage changes
them. OUT/views has what lasts: the maps of `refine`, or these where a session ends at `separate`.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from lightstage.commands import ProgressCallback, quiet
from lightstage.errors import FormatError
from lightstage.formats.exr import require_finite
from lightstage.formats.files import atomic_folder, fsync_path, read_json
from lightstage.formats.half import half_from_float, has_infinity, is_finite
from lightstage.formats.processed import MAPS, ProcessedFolder
from processing.frames.read import read_foreground
from processing.parallel import over_views, workers
from processing.view_maps import MAP_NAMES, PixelMaps

SCHEMA = "processing.coarse/1"
FACTS = "coarse.json"
BYTES_WRITTEN_PX = 18
"""Of the whole picture, that one map takes while it is written to OUT/views."""
SCALE_WHITE = "scale linear photographs so that a white under `full` reads 1, or calibrate colours"
"""What to try where readings are in another unit than white."""
RUN_SEPARATE = "Run the stage `separate`: lightstage-processing separate SESSION --out OUT."


@dataclasses.dataclass(frozen=True)
class CoarseMaps:
    """One view's maps of `separate`, read one by one and mapped.

    Attributes:
        folder: that holds them.
        mask: (h, w) bool, the view's foreground with n true pixels.
        pixels: n.
    """

    folder: Path
    mask: np.ndarray
    pixels: int

    def values(self, name: str) -> np.ndarray:
        """Map `name` at the mask's pixels in row order: (n,) or (n, 3) float16, finite.

        Raises:
            FormatError: missing or damaged.
        """
        path, channels = self.folder / f"{name}.npy", MAPS[name].channels
        try:
            half = np.load(path, mmap_mode="r", allow_pickle=False)
        except (OSError, ValueError, EOFError) as error:
            raise FormatError(
                path, found=str(error), expected="a coarse map", hint=RUN_SEPARATE
            ) from None
        shape = (self.pixels,) if channels == 1 else (self.pixels, channels)
        if half.shape != shape or half.dtype != np.float16:
            raise FormatError(
                path,
                found=f"{half.dtype} {half.shape}",
                expected=f"float16 {shape}",
                hint=RUN_SEPARATE,
            )
        _require_finite(half, path)
        return half

    def picture(self, name: str) -> np.ndarray:
        """Map `name` as a picture: (h, w) or (h, w, 3) float16, 0 outside the mask."""
        values = self.values(name)
        image = np.zeros((*self.mask.shape, *values.shape[1:]), np.float16)
        image[self.mask] = values
        return image


def coarse_path(out: Path, camera_id: str) -> Path:
    """The folder of a camera's coarse maps in a processed folder."""
    return out / "work" / "coarse" / camera_id


def has_coarse(out: Path, camera_id: str) -> bool:
    """Whether `separate` has written a camera's coarse maps."""
    return (coarse_path(out, camera_id) / FACTS).is_file()


def write_coarse(out: Path, camera_id: str, maps: PixelMaps) -> Path:
    """Write the maps of a camera's foreground; they replace older ones when all are on the disk.

    Returns:
        Their folder.

    Raises:
        FormatError: values that half floats cannot hold, or that are not finite.
    """
    folder = coarse_path(out, camera_id)
    halves = {
        name: _narrowed(getattr(maps, field), folder / f"{name}.npy")
        for field, name in MAP_NAMES.items()
    }
    value = {"schema": SCHEMA, "pixels": len(maps.confidence)}
    with atomic_folder(folder, FACTS) as beside:
        for name, half in halves.items():
            _write_array(beside / f"{name}.npy", half)
        (beside / FACTS).write_text(json.dumps(value, indent=1) + "\n")
        for path in beside.iterdir():
            fsync_path(path)
    return folder


def read_coarse(out: Path, camera_id: str) -> CoarseMaps:
    """A camera's coarse maps.

    Raises:
        FormatError: missing, or of another foreground than the camera's.
    """
    folder = coarse_path(out, camera_id)
    if not has_coarse(out, camera_id):
        raise FormatError(
            folder,
            found="no such file",
            expected=f"the coarse maps of {camera_id}",
            hint=RUN_SEPARATE,
        )
    mask = read_foreground(out, camera_id)
    pixels, stored = int(np.count_nonzero(mask)), read_json(folder / FACTS, SCHEMA).get("pixels")
    if stored != pixels:
        raise FormatError(
            folder / FACTS,
            field="pixels",
            found=repr(stored),
            expected=f"{pixels}, as many as the foreground of {camera_id} has",
            hint=RUN_SEPARATE,
        )
    return CoarseMaps(folder, mask, pixels)


def write_as_view(folder: ProcessedFolder, camera_id: str) -> CoarseMaps:
    """Write a camera's coarse maps and their mask to OUT/views, where maps that last are.

    Returns:
        The maps.
    """
    coarse = read_coarse(folder.root, camera_id)
    for name in MAP_NAMES.values():
        folder.write_view(camera_id, name, coarse.picture(name))
    folder.write_mask(camera_id, coarse.mask)
    return coarse


def write_as_views(
    out: Path, cameras: Sequence[str], progress: ProgressCallback = quiet
) -> list[str]:
    """Write all cameras' coarse maps to OUT/views.

    Returns:
        The files, relative to `out`.
    """
    folder = ProcessedFolder(out)
    largest = max((read_foreground(out, camera).size for camera in cameras), default=0)
    at_once = workers(BYTES_WRITTEN_PX * largest)
    written: list[Path] = []
    views = over_views(lambda camera: write_as_view(folder, camera), cameras, at_once)
    for done, (camera, _) in enumerate(views, 1):
        written += [folder.view_path(camera, name) for name in MAP_NAMES.values()]
        written.append(folder.mask_path(camera))
        progress(done, len(cameras))
    return [str(path.relative_to(out)) for path in written]


def _narrowed(values: np.ndarray, path: Path) -> np.ndarray:
    half, _ = half_from_float(values)
    if has_infinity(half):
        raise FormatError(
            path,
            found="values above 65504",
            expected="values that half can hold",
            hint=f"{SCALE_WHITE.capitalize()}.",
        )
    _require_finite(half, path)
    return half


def _require_finite(half: np.ndarray, path: Path) -> None:
    if not is_finite(half):
        require_finite(half, path)


def _write_array(path: Path, array: np.ndarray) -> None:
    """Write a C-contiguous array; numpy's own writer does not say that a disk is full."""
    with path.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, np.lib.format.header_data_from_array_1_0(array))
        file.write(array.reshape(-1).view(np.uint8).data)
