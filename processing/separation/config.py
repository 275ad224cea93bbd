"""Settings of the stage `separate`."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Literal

from lightstage.errors import ConfigError
from processing.lighting.lobe import SKIN_F0

Relief = Literal["mirror", "detail", "diffuse"]
"""What specular normals are: from mirror directions, their relief on the diffuse normals, or the
diffuse normals themselves."""


@dataclasses.dataclass(frozen=True)
class KampourisConfig:
    """The published formulas by colour."""

    combine: Literal["maximum", "median", "mean", "weighted"] = "median"
    """How the specular parts found along x, y and z become one; `weighted` by how little noise and
    model error each pair passes on, with the pair swapped where the brighter photograph is the more
    saturated one."""
    field: Literal["uniform", "lights"] = "uniform"
    """What normals and albedo take the light for: even, as printed, or the stage's own lights."""
    least_saturation: float = 0.02
    """A darker photograph less saturated than this has no specular part taken off."""
    most_specular: float = 0.2
    """Largest specular part that is taken off a photograph (1 = white under `full`)."""
    pool_mm: float = 0.0
    """Sigma over which neighbours' specular parts are averaged; 0 leaves each pixel its own."""


@dataclasses.dataclass(frozen=True)
class RatiosConfig:
    """Plain ratios of complements, nothing separated."""

    field: Literal["uniform", "lights"] = "uniform"
    """The light that normals and albedo are computed for, as of `KampourisConfig`."""
    specular: float = SKIN_F0
    """Taken off `full` and written as specular albedo everywhere."""


@dataclasses.dataclass(frozen=True)
class MuxConfig:
    """Two shots hold six numbers a pixel for six unknowns, so that gloss leans on its prior."""

    specular_pool_mm: float = 6.0
    """Sigma over which pixels share one specular albedo."""
    specular_prior_share: float = 0.3
    """Weight of the prior against the median pixel's evidence."""


@dataclasses.dataclass(frozen=True)
class MirrorConfig:
    """Specular normals from mirror directions."""

    spread_deg: float = 1.0
    """How far specular normals stand from diffuse ones, before anything is read."""
    rounds: int = 6
    """Steps of Gauss-Newton."""


@dataclasses.dataclass(frozen=True)
class LobeFitConfig:
    """Gloss and specular normals from readings whose diffuse normals are known."""

    roughness: tuple[float, ...] = (0.18, 0.22, 0.26, 0.30, 0.34)
    """Beckmann's m that are tried, ascending, at least three."""
    roughness_pool_mm: float = 6.0
    """Sigma over which pixels share one lobe width."""
    specular_pool_mm: float = 1.0
    """Sigma over which pixels share one specular albedo."""
    specular_prior: float = SKIN_F0
    """Specular albedo that pixels without evidence have."""
    specular_prior_share: float = 0.02
    """Weight of the prior against the median pixel's evidence."""
    albedo_prior_power: float = 0.005
    """Weight of the neighbours' albedo against a pixel's squared irradiance (2 in the open)."""
    model_error: float = 0.02
    """What the diffuse part is wrong by, as a share of it."""
    detail_mm: float = 2.0
    """Relief finer than this sigma is detail."""
    mirror: MirrorConfig = dataclasses.field(default_factory=MirrorConfig)
    """How specular normals are found from mirror directions."""

    def __post_init__(self) -> None:
        """Refuse lobes between which no best one can be interpolated."""
        widths = self.roughness
        if len(widths) < 3 or any(a >= b for a, b in itertools.pairwise(widths)):
            raise ConfigError(
                "separate",
                field="roughness",
                found=str(list(widths)),
                expected="three values of Beckmann's m or more, each above the one before",
            )


@dataclasses.dataclass(frozen=True)
class SeparateConfig:
    """Settings of `separate`."""

    method: Literal["auto", "colour", "kampouris", "ratios", "polarised", "linear", "mux"] = "auto"
    """`auto`: by what the session's patterns are."""
    forced: bool = False
    """Continue where more than half of the face is ill-posed."""
    normals: Literal["auto", "chroma", "red", "blue", "mean"] = "auto"
    """The part of RGB that diffuse normals are taken from; `auto`: the method's own."""
    iterations: int = 5
    """Linear solves of a normal, each with the lamps above the horizon of the one before."""
    roughness: float = 0.25
    """Beckmann's m of skin, for the lobe."""
    tile_mm: float = 0.6
    """Where eight pixels are no longer than this, `colour` finds lobe, confidence and the lights
    above the horizon for tiles of 8 x 8 pixels; 0 finds them for every pixel."""
    specular_pool_mm: float = 4.0
    """Sigma over which pixels share one specular albedo."""
    specular_prior: float = SKIN_F0
    """Specular albedo that pixels without evidence have."""
    specular_prior_share: float = 10.0
    """Weight of the prior against the median pixel's evidence: without shadows that is poor."""
    albedo_prior_power: float = 0.005
    """Weight of the neighbours' albedo against a pixel's squared irradiance (2 in the open)."""
    grey_saturation: float = 0.05
    """Below this saturation colour has no weight; from twice as much it has full weight."""
    dark_level: float = 0.004
    """A pixel whose brightest pattern stays below this is not used (1 = white under `full`)."""
    specular_normals: Literal["auto", Relief] = "auto"
    """What specular normals are; `auto`: the best of each method."""
    noise: float = 0.001
    """Standard deviation of a reading I over sqrt(.25 + I), as a camera at base sensitivity has."""
    half_trust_deg: float = 5.0
    """Standard deviation of a normal that halves its confidence."""
    kampouris: KampourisConfig = dataclasses.field(default_factory=KampourisConfig)
    """Settings of the method `kampouris`."""
    ratios: RatiosConfig = dataclasses.field(default_factory=RatiosConfig)
    """Settings of the method `ratios`."""
    polarised: LobeFitConfig = dataclasses.field(default_factory=LobeFitConfig)
    """Settings of the method `polarised`."""
    linear: LobeFitConfig = dataclasses.field(
        default_factory=lambda: LobeFitConfig(specular_pool_mm=4.0, specular_prior_share=3.0)
    )
    """Settings of the method `linear`."""
    mux: MuxConfig = dataclasses.field(default_factory=MuxConfig)
    """Settings of the method `mux`."""


def relief_of(own: Relief, config: SeparateConfig) -> Relief:
    """What a method's specular normals are, where its own are `own`."""
    return own if config.specular_normals == "auto" else config.specular_normals
