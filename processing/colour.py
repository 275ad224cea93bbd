"""Colour: camera RGB to the session's linear RGB, and sRGB's curve for looking at pictures."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lightstage.errors import FormatError
from lightstage.formats.files import read_json

SCHEMA = "lightstage.colour/1"


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
    value = read_json(path, SCHEMA)
    cameras = value.get("cameras")
    out: dict[str, ColourCorrection] = {}
    bad = []
    for camera in camera_ids:
        try:
            out[camera] = _correction(cameras[camera])
        except (KeyError, TypeError, ValueError):
            bad.append(camera)
    if bad:
        raise FormatError(
            path,
            field="cameras",
            found=f"no usable linear_from_raw for {', '.join(bad)}",
            expected="an invertible 3 x 3 matrix for each camera; root_polynomial, where there is "
            "one, 3 x 6 finite numbers; exposure above 0",
            hint="Photograph the colour chart with these cameras again.",
        )
    return out


def _correction(entry: Mapping[str, Any]) -> ColourCorrection:
    """One camera's correction; ValueError, TypeError or KeyError where it is unusable."""
    matrix = np.array(entry["linear_from_raw"], float).reshape(3, 3)
    bent, exposure = entry.get("root_polynomial"), entry.get("exposure")
    terms = None if bent is None else np.array(bent, float).reshape(3, 6)
    light = None if exposure is None else float(exposure)
    finite = np.isfinite(matrix).all() and (terms is None or np.isfinite(terms).all())
    usable = finite and abs(np.linalg.det(matrix)) >= 1e-12
    if not usable or (light is not None and not 0 < light < np.inf):
        raise ValueError("unusable numbers")
    return ColourCorrection(matrix, terms, light)


def srgb_from_linear(rgb_linear: np.ndarray) -> np.ndarray:
    """Display values (...) of (...) linear ones: IEC 61966-2-1, clipped to 0..1.

    Source: [IEC61966].
    """
    value = np.clip(rgb_linear, 0.0, 1.0)
    curve = 1.055 * np.power(np.maximum(value, 0.0031308), 1 / 2.4) - 0.055
    return np.where(value <= 0.0031308, 12.92 * value, curve)
