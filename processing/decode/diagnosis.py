"""Pictures of light and motion in a view's photographs, for the report."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from lightstage.errors import FormatError
from lightstage.formats.files import atomic_path
from lightstage.formats.npz import UNREADABLE_NPZ

ROWS = 200
"""Rows of the pictures that are kept."""
RESIDUAL_WHITE = 0.05
"""Share of full that a sum's residual shows as full red or blue."""
UNLIKE_WHITE = 0.6
"""Share of full that a picture of another pattern shows as brightest."""


@dataclasses.dataclass
class Diagnosis:
    """Small pictures of one view, any size; filled as its photographs are checked.

    Attributes:
        whole: (h, w, 3) under the most light.
        clipped: (h, w) 0..1, share of a cell that is clipped or no number.
        residuals: axis to (h, w): what a pair has more than full, share of full, as photographed.
        ambient: (h, w, 3) light that no lamp made, share of full; None where no pair shows it.
        unlike: pattern to (r, c): how far from what a ball would show under it, share of full.
    """

    whole: np.ndarray
    clipped: np.ndarray
    residuals: dict[str, np.ndarray] = dataclasses.field(default_factory=dict)
    ambient: np.ndarray | None = None
    unlike: dict[str, np.ndarray] = dataclasses.field(default_factory=dict)


def diagnosis_path(out: Path, camera_id: str) -> Path:
    """The file of a view's small pictures in a processed folder."""
    return out / "work" / "diagnosis" / f"{camera_id}.npz"


def write_diagnosis(out: Path, camera_id: str, pictures: Diagnosis) -> Path:
    """Write a view's pictures at most `ROWS` high, atomically; returns the file's path."""
    arrays = {"whole": pictures.whole, "clipped": pictures.clipped}
    arrays |= {f"residual {axis}": picture for axis, picture in pictures.residuals.items()}
    arrays |= {f"unlike {name}": picture for name, picture in pictures.unlike.items()}
    if pictures.ambient is not None:
        arrays["ambient"] = pictures.ambient
    small: dict[str, Any] = {name: _small(picture) for name, picture in arrays.items()}
    path = diagnosis_path(out, camera_id)
    with atomic_path(path) as beside:
        np.savez(beside, **small)
    return path


def read_diagnosis(out: Path, camera_id: str) -> Diagnosis:
    """Read a view's pictures.

    Raises:
        FormatError: missing or damaged.
    """
    path = diagnosis_path(out, camera_id)
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name].astype(np.float32) for name in file.files}
        return Diagnosis(
            arrays["whole"],
            arrays["clipped"],
            {n.partition(" ")[2]: a for n, a in arrays.items() if n.startswith("residual ")},
            arrays.get("ambient"),
            {n.partition(" ")[2]: a for n, a in arrays.items() if n.startswith("unlike ")},
        )
    except UNREADABLE_NPZ as error:
        raise FormatError(path, found=str(error), expected="pictures that decode writes") from None


def diagnosed_cameras(out: Path) -> list[str]:
    """Cameras whose pictures are there, sorted."""
    return sorted(path.stem for path in diagnosis_path(out, "x").parent.glob("*.npz"))


def _small(picture: np.ndarray) -> np.ndarray:
    if picture.shape[0] > ROWS:
        width = max(1, round(picture.shape[1] * ROWS / picture.shape[0]))
        picture = cv2.resize(
            np.asarray(picture, np.float32), (width, ROWS), interpolation=cv2.INTER_AREA
        )
    return np.clip(picture, -60_000, 60_000).astype(np.float16)
