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
    colour: ColourFitConfig = dataclasses.field(default_factory=ColourFitConfig)
    flat: FlatConfig = dataclasses.field(default_factory=FlatConfig)
    grey: GreyConfig = dataclasses.field(default_factory=GreyConfig)
    lights: LightsConfig = dataclasses.field(default_factory=LightsConfig)
