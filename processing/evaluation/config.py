"""Settings of the evaluation against truth."""

from __future__ import annotations

import dataclasses
import enum


class AlbedoOf(enum.StrEnum):
    """What a diffuse albedo is a share of."""

    ENTERED = "entered"
    """Of the light that entered the skin: ours."""
    INCIDENT = "incident"
    """Of the light that fell on it: that of renderers whose diffuse layer has no interface."""


@dataclasses.dataclass(frozen=True)
class EvaluateConfig:
    """Settings of the evaluation.

    Attributes:
        complete_within_mm: a true surface point this near to the mesh counts as reconstructed.
        surface_points: at most so many of the pixels of true skin measure a mesh.
        albedo: what the truth's diffuse albedo is a share of, see `AlbedoOf`.
    """

    complete_within_mm: float = 0.5
    surface_points: int = 200_000
    albedo: AlbedoOf = AlbedoOf.ENTERED
