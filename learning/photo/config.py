"""What the fit of a head to photographs is configured by."""

from __future__ import annotations

import dataclasses
import math

from lightstage.errors import ConfigError

BOUNDS: dict[str, tuple[float, float]] = {
    "rows": (192, 12288),
    "landmark_percent": (0.1, 50),
    "focal_spread": (1e-3, 2),
    "focal_told_spread": (1e-3, 1),
    "identity_modes": (0, 1000),
    "depth_ratio": (0.3, 3),
    "depth_deviation": (1e-3, 1),
    "free_modes": (0, 400),
    "asymmetry": (0, 1),
    "expression_spread": (1e-3, 2),
    "refine_seconds": (0, 3600),
    "rounds": (1, 5),
}
"""Least and most of each number."""
SIZES_MM = (1e-3, 500.0)


@dataclasses.dataclass(frozen=True)
class FitConfig:
    """The only defaults of `fit`.

    Attributes:
        rows: of the texture, a multiple of 3 (rows : columns = 3 : 2).
        landmark_percent: standard deviation of a landmark, of the distance between the eyes'
            outer corners.
        focal_spread: standard deviation of the focal length's logarithm where no file tells it.
        focal_told_spread: the same where EXIF tells it.
        identity_modes: of the template, at most.
        depth_ratio: of people's faces to the template's, from the ears to the front. Our template
            is deeper than people are: a scanned head (Lee Perry-Smith's) has .88 of its depth, the
            mean of ICT's model .73.
        depth_deviation: standard deviation of that ratio.
        free_modes: smooth changes of the shape beside the template's modes.
        free_mm: standard deviations of these changes on the face, one for each of their sizes.
        free_length_mm: distances over which they are alike, for each of these sizes.
        asymmetry: standard deviation of what the two sides of a face do not share, of `free_mm`.
        expression_spread: standard deviation of an expression's strength; 1 is its full one.
        refine_seconds: for the search of the light and the skin under it, at most.
        rounds: of light, skin and mask in turns.
    """

    rows: int = 1536
    landmark_percent: float = 12.0
    focal_spread: float = 0.35
    focal_told_spread: float = 0.03
    identity_modes: int = 100
    depth_ratio: float = 0.85
    depth_deviation: float = 0.12
    free_modes: int = 100
    free_mm: tuple[float, ...] = (3.0, 1.0)
    free_length_mm: tuple[float, ...] = (40.0, 18.0)
    asymmetry: float = 0.25
    expression_spread: float = 0.25
    refine_seconds: float = 20.0
    rounds: int = 2

    def __post_init__(self) -> None:
        """ConfigError where a number is out of its bounds."""
        for name, (least, most) in BOUNDS.items():
            _require(name, getattr(self, name), least, most)
        for name in ("free_mm", "free_length_mm"):
            for value in getattr(self, name):
                _require(name, value, *SIZES_MM)
        if len(self.free_mm) != len(self.free_length_mm):
            raise ConfigError(
                "free_length_mm",
                found=f"{len(self.free_length_mm)} distances",
                expected=f"{len(self.free_mm)}, as many as free_mm has",
            )
        if self.rows % 3:
            raise ConfigError("rows", found=str(self.rows), expected="a multiple of 3")


def _require(name: str, value: float, least: float, most: float) -> None:
    if not (math.isfinite(value) and least <= value <= most):
        raise ConfigError(name, found=f"{value:g}", expected=f"{least:g} to {most:g}")
