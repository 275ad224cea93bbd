"""Settings of `calibrate`."""

from __future__ import annotations

import dataclasses

from processing.calibration.colour.config import (
    ChartConfig,
    ColourFitConfig,
    FlatConfig,
    GreyAlbedoConfig,
)
from processing.calibration.lights.config import LightsConfig


@dataclasses.dataclass(frozen=True)
class CalibrateConfig:
    """Settings of `calibrate`; a table of its TOML file each."""

    chart: ChartConfig = dataclasses.field(default_factory=ChartConfig)
    """How the colour chart is read."""
    colour: ColourFitConfig = dataclasses.field(default_factory=ColourFitConfig)
    """How colour corrections are fitted."""
    flat: FlatConfig = dataclasses.field(default_factory=FlatConfig)
    """How flats and darks are read."""
    grey: GreyAlbedoConfig = dataclasses.field(default_factory=GreyAlbedoConfig)
    """The grey ball of known reflectance."""
    lights: LightsConfig = dataclasses.field(default_factory=LightsConfig)
    """How lamps are measured."""
