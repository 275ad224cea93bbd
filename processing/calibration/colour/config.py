"""Settings of the tables `[chart]`, `[colour]`, `[flat]` and `[grey]` of `calibrate`."""

from __future__ import annotations

import dataclasses
from typing import Literal

from processing.raw.clip import CLIP_SHARE


@dataclasses.dataclass(frozen=True)
class ChartConfig:
    """The chart."""

    reference: str = "classic"
    """``classic``, ``2014``, or a JSON file of a chart that was measured (chart_reference)."""
    pitch_mm: float | None = None
    """Between the middles of neighbouring patches; where absent the chart is taken to be held in
    the stage's middle, which gives its size."""
    max_tilt_deg: float = 40.0
    """Charts that are turned farther from a camera are not read by it."""
    clip_share: float = CLIP_SHARE
    """Counts of at least this share of the white level are clipped."""


@dataclasses.dataclass(frozen=True)
class ColourFitConfig:
    """How a chart's patches are turned into a correction."""

    use: Literal["auto", "matrix", "root_polynomial"] = "auto"
    """`auto`: what reads patches better that it was not fitted to."""
    neutral_weight: float = 2.0
    """Factor on the weight of the six neutral patches, which give white and scale."""
    skin_weight: float = 3.0
    """Factor on the weight of the two patches of skin."""
    dark_floor: float = 0.1
    """Residuals count as shares of a patch's mean reflectance plus this."""
    gain_of_root_polynomial: float = 0.1
    """The root polynomial is used where its held-out Delta E is smaller than the matrix's by at
    least this share, over all patches and over the two of skin."""
    max_clipped_share: float = 0.001
    """Patches with more pixels at the white level are left out."""
    outlier_delta_e: float = 12.0
    """A patch that is held out and wrong by more, and by four times the median, is left out."""
    min_patches: int = 16
    """Fewer usable patches of the chart's 24 are refused."""


@dataclasses.dataclass(frozen=True)
class FlatConfig:
    """How flats and darks are read."""

    per_pixel: bool = False
    """Keep each pixel's own gain beside the smooth vignetting (dust, unlike pixels)."""
    grid_px: int = 24
    """The vignetting is fitted to means of squares of so many pixels."""
    max_clipped_share: float = 0.001
    """A flat with more pixels at the white level is refused."""
    min_level: float = 0.02
    """A flat whose mean is less than this share of white is refused."""
    max_residual: float = 0.03
    """Warned of where the squares depart more than this from the fit, RMS as a share."""
    max_black_offset: float = 0.0003
    """Darks farther from the file's black level are warned of, and corrected; share of white."""
    max_dark_level: float = 0.01
    """A dark brighter than this in the mean is refused: the lens cap was off."""
    hot_level: float = 0.004
    """A pixel above the black level by more than this share of white in every dark is hot."""
    hot_sigmas: float = 8.0
    """A hot pixel is also above it by more than this many standard deviations of the noise."""
    max_hot_share: float = 0.001
    """More hot pixels are refused: there was light."""


@dataclasses.dataclass(frozen=True)
class GreyAlbedoConfig:
    """The grey ball."""

    radius_mm: float = 38.1
    """Radius of the ball, mm, about: its outlines measure it."""
    reflectance: float = 0.18
    """Reflectance of the ball, as its maker states or a spectrometer measured it."""
    sets_the_scale: bool = False
    """Whether colours are scaled to it; else to the chart's neutral patches, and it is a check."""
    facing: float = 0.5
    """Places are read whose normal and way to the camera have at least this cosine."""
    lit_share: float = 0.3
    """Places are read whose light is at least this share of that of the ball's brightest place."""
