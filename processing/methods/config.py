"""What the stage `separate` may be told."""

from __future__ import annotations

import dataclasses

from processing.lobe import SKIN_F0


@dataclasses.dataclass(frozen=True)
class SeparateConfig:
    """What `separate` may be told."""

    iterations: int = 5
    roughness: float = 0.25
    """Beckmann's m of skin, for the lobe."""
    specular_pool_mm: float = 4.0
    """Sigma over which pixels share one specular albedo."""
    specular_prior: float = SKIN_F0
    specular_prior_share: float = 3.0
    """Weight of the prior against the median pixel's evidence: without shadows that is poor."""
    albedo_prior_power: float = 0.005
    """Weight of the neighbours' albedo against a pixel's squared irradiance (2 in the open)."""
    grey_saturation: float = 0.05
    """Below this saturation colour tells nothing; from twice as much it is trusted."""
    dark_level: float = 0.004
    """A pixel whose brightest pattern stays below this tells nothing (1 = white under `full`)."""
