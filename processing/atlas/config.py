"""Settings of the stage `atlas`."""

from __future__ import annotations

import dataclasses

from lightstage.errors import ConfigError

BLENDED = (
    "diffuse_albedo",
    "specular_albedo",
    "diffuse_normal",
    "specular_normal",
    "ambient_occlusion",
)
OPTIONAL = ("roughness",)
"""Blended where every view has it."""


@dataclasses.dataclass(frozen=True)
class WeightConfig:
    """How views are weighted."""

    feather_mm: float = 6.0
    """A view's weight rises from 0 at its silhouettes to full at this distance from them."""
    erode_px: float = 1.5
    """Width along silhouettes that is not read, because these pixels contain background, px."""
    jump_mm: float = 4.0
    """Neighbouring depths farther apart (and than eight pixels' width) are a silhouette."""
    bias_mm: float = 0.4
    """Distance behind the z-buffer at which a texel still counts as seen, mm."""
    bias_px: float = 1.5
    """Added to `bias_mm`: depth change of the surface over this many pixels."""
    least_cos: float = 0.15
    """Views from flatter than this show nothing usable."""
    doubt_deg: float = 25.0
    """A view's maps lose weight where its normal differs from the mesh's by more than this."""
    disbelief_deg: float = 50.0
    """They have no weight where it differs by more than this: it was solved on a wrong surface."""

    def __post_init__(self) -> None:
        """Refuse angles between which no weight can fall."""
        if self.doubt_deg >= self.disbelief_deg:
            raise ConfigError(
                "atlas.blend.weights",
                field="disbelief_deg",
                found=f"{self.disbelief_deg:g}, with doubt_deg = {self.doubt_deg:g}",
                expected="more than doubt_deg",
            )


@dataclasses.dataclass(frozen=True)
class BlendConfig:
    """How views are weighted and merged."""

    band_mm: float = 3.0
    """Gaussian sigma between the two bands: below it views are averaged widely, above narrowly."""
    detail_power: float = 4.0
    """Power on the weights of the fine band: the best view's detail is kept, not averaged away."""
    detail_least: float = 0.1
    """A view whose weight is below this share of the best's adds nothing to the fine band, where
    it would count a ten-thousandth: half floats do not resolve that."""
    weights: WeightConfig = dataclasses.field(default_factory=WeightConfig)
    """How each view is weighted."""


@dataclasses.dataclass(frozen=True)
class AtlasConfig:
    """The atlas's settings."""

    rows: int = 6144
    """Columns are two thirds of it."""
    gutter_px: int = 16
    """How far the islands' colours reach beyond their borders."""
    maps: tuple[str, ...] = BLENDED + OPTIONAL
    """Which of the views' maps are merged; the others are not read."""
    largest_gap_mm: float = 1.5
    """Where the registered mesh is farther than this from the scan, views are not believed."""
    mirror_mm: float = 3.0
    """Largest distance from a vertex's mirror image to the nearest vertex for the two to be a pair,
    mm."""
    skin_margin_mm: float = 2.0
    """What is nearer than this to an eye or to the opening of the mouth is no skin."""
    blend: BlendConfig = dataclasses.field(default_factory=BlendConfig)
    """How views are weighted and merged."""

    def __post_init__(self) -> None:
        """Refuse rows that no 3:2 atlas has, before any stage runs."""
        if self.rows < 6 or self.rows % 3:
            raise ConfigError(
                "atlas", field="rows", found=str(self.rows), expected="a multiple of 3, 6 at least"
            )
        unknown = sorted(set(self.maps) - {*BLENDED, *OPTIONAL})
        twice = sorted({f"{name} twice" for name in self.maps if self.maps.count(name) > 1})
        if unknown or twice or not self.maps:
            raise ConfigError(
                "atlas",
                field="maps",
                found=", ".join(unknown + twice) or "none",
                expected=f"some of {', '.join(BLENDED + OPTIONAL)}, each once",
            )
