"""Colour: camera RGB to the session's linear RGB, and sRGB's curve for looking at pictures."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from lightstage.formats.colour import SCHEMA, colour_numbers
from lightstage.formats.files import read_json


@dataclasses.dataclass(frozen=True)
class ColourCorrection:
    """One camera's way from raw counts to linear rgb, 1.0 = what a perfect white reads.

    Attributes:
        matrix: (3, 3) linear_from_raw: rgb_linear = M @ (raw - black) / (white - black).
        root_polynomial: (3, 6) from `root_terms` to linear rgb, in place of the matrix; None where
            the matrix is used. Both are homogeneous: twice the light gives twice the value.
        exposure: of the photographs that it was made from, seconds * ISO / f-number^2; None where
            they were exposed as the session is.
    """

    matrix: np.ndarray
    root_polynomial: np.ndarray | None = None
    exposure: float | None = None

    @property
    def coefficients(self) -> np.ndarray:
        """(3, 6) float64 from `root_terms` to linear rgb, whichever of the two is used."""
        if self.root_polynomial is not None:
            return self.root_polynomial
        return np.concatenate([self.matrix, np.zeros((3, 3))], axis=1)

    def scaled(self, factor: float) -> ColourCorrection:
        """The same with results `factor` times as large."""
        bent = self.root_polynomial
        return dataclasses.replace(
            self,
            matrix=self.matrix * factor,
            root_polynomial=None if bent is None else bent * factor,
        )

    def apply(self, raw: np.ndarray) -> np.ndarray:
        """Linear rgb of raw readings.

        Args:
            raw: (..., 3) counts above black as a share of white; float32 or float64. Negative
                values (noise) are kept in the linear terms and are 0 under a root.

        Returns:
            The same shape and type; NaN where a channel is NaN.
        """
        if self.root_polynomial is None:
            return np.asarray(raw @ self.matrix.T.astype(raw.dtype))
        return np.asarray(root_terms(raw) @ self.root_polynomial.T.astype(raw.dtype))


def root_terms(raw: np.ndarray) -> np.ndarray:
    """r, g, b, sqrt(rg), sqrt(gb), sqrt(rb): the root-polynomial terms of degree 2.

    Source: [Finlayson2015].

    Args:
        raw: (..., 3) float.

    Returns:
        (..., 6), the same type. A negative channel, which is noise, counts as 0 under a root;
        colour-science, whose terms are the same else, gives roots of negative products a sign.
    """
    root = np.sqrt(np.maximum(raw, 0))
    r, g, b = root[..., 0], root[..., 1], root[..., 2]
    return np.concatenate([raw, np.stack([r * g, g * b, r * b], axis=-1)], axis=-1)


def read_colour(path: Path, camera_ids: list[str]) -> dict[str, ColourCorrection]:
    """Read a session's colour calibration.

    Args:
        path: JSON ``{"cameras": {ID: {"linear_from_raw": 3 x 3}}}``; each camera may have a
            ``root_polynomial`` (3 x 6) that is used in place of the matrix, and an ``exposure``.
        camera_ids: cameras that must be in it.

    Returns:
        Camera id to its correction.

    Raises:
        FormatError: every camera that is missing or whose numbers are unusable, in one message.
    """
    numbers = colour_numbers(read_json(path, SCHEMA), camera_ids, path)
    return {camera: ColourCorrection(*own) for camera, own in numbers.items()}


def srgb_from_linear(rgb_linear: np.ndarray) -> np.ndarray:
    """Display values (...) of (...) linear ones: IEC 61966-2-1, clipped to 0..1.

    Source: [IEC61966].
    """
    value = np.clip(rgb_linear, 0.0, 1.0)
    curve = 1.055 * np.power(np.maximum(value, 0.0031308), 1 / 2.4) - 0.055
    return np.where(value <= 0.0031308, 12.92 * value, curve)
