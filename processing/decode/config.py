"""Settings of the stage `decode`."""

from __future__ import annotations

import dataclasses

from processing.raw.clip import CLIP_SHARE


@dataclasses.dataclass(frozen=True)
class PrepareConfig:
    """Settings of the checks of a view's photographs."""

    forced: bool = False
    """Use photographs that do not add up as their patterns do."""
    cells_per_mm: float = 2.0
    """Resolution of the small pictures in which motion and light are measured, cells per mm."""
    still_px: float = 0.25
    """A photograph displaced by less (root mean square) is left as it is."""
    least_explained: float = 0.15
    """Share of what a pair leaves over that a displacement must take away to be believed."""
    least_flicker: float = 0.01
    """A photograph brighter or darker than the others by more is evened out."""
    least_ambient: float = 0.003
    """Ambient light above this share of full is taken off, where all pairs show it alike."""
    ambient_sigma_mm: float = 3.0
    """Sigma of the Gaussian that smooths ambient light, mm at the sphere's centre."""


@dataclasses.dataclass(frozen=True)
class DecodeConfig:
    """Settings of `decode`."""

    clip_share: float = CLIP_SHARE
    """Counts of at least this share of the white level are clipped."""
    foreground_share: float = 0.03
    """Foreground is brighter than this share of the picture's 99th percentile."""
    crop: bool = True
    """Develop only the window that holds the face, not the whole picture."""
    mesh: str = ""
    """PLY file of this head as it sat, such as an earlier run's base mesh: only what it covers,
    and `mesh_margin_mm` around it, is developed. None where empty."""
    mesh_margin_mm: float = 25.0
    """Width around that mesh that is developed too, mm."""
    prepare: PrepareConfig = dataclasses.field(default_factory=PrepareConfig)
    """Motion, ambient light and flicker between the photographs."""
