"""Settings of `calibrate`."""

from __future__ import annotations

import dataclasses

from processing.calibration.colour.all_cameras import ChartConfig
from processing.calibration.colour.fit import ColourFitConfig
from processing.calibration.colour.flats import FlatConfig
from processing.calibration.colour.grey import GreyConfig
from processing.calibration.lights.fit import LightsConfig


@dataclasses.dataclass(frozen=True)
class CalibrateConfig:
    """Settings of `calibrate`; a table of its TOML file each."""

    chart: ChartConfig = dataclasses.field(default_factory=ChartConfig)
    """How the colour chart is read."""
    colour: ColourFitConfig = dataclasses.field(default_factory=ColourFitConfig)
    """How colour corrections are fitted."""
    flat: FlatConfig = dataclasses.field(default_factory=FlatConfig)
    """How flats and darks are read."""
    grey: GreyConfig = dataclasses.field(default_factory=GreyConfig)
    """The grey ball of known reflectance."""
    lights: LightsConfig = dataclasses.field(default_factory=LightsConfig)
    """How lamps are measured."""
