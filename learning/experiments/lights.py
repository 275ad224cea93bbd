"""The ten lights that the people held out are measured in, around one target [Lattas2021]."""

from __future__ import annotations

import dataclasses

import torch
from torch import Tensor

from learning.render.environments import Environment

TARGET, SIDE = "target", "side-right"
NAMES = (
    TARGET,
    "position-30",
    "position+30",
    "intensity-30",
    "intensity+30",
    "front",
    SIDE,
    "side-left",
    "above",
    "below",
)
"""In order. The published ten are the target, its lamps' places and its intensity 30 % less and
more, and directional light from in front and from the side; the paper does not list the others."""
SHARE = 0.3
DIRECTIONS = {
    "front": (0.0, 0.15, 1.0),
    SIDE: (1.0, 0.1, 0.2),
    "side-left": (-1.0, 0.1, 0.2),
    "above": (0.1, 1.0, 0.5),
    "below": (-0.1, -0.8, 0.7),
}
"""Toward the lamp, head frame."""
DISTANCE_MM = 1500.0
"""Distance at which directional lamps are placed for their shadows: far for a head."""
STRENGTH, AMBIENT = 0.9, 0.05
"""Strength of the directional lamp, and of the light from everywhere beside it."""


def lights_around(target: Environment) -> dict[str, Environment]:
    """The ten lights by name, each a batch of one."""
    places = target.position_mm
    found = {
        TARGET: target,
        "position-30": dataclasses.replace(target, position_mm=aside(places, -SHARE)),
        "position+30": dataclasses.replace(target, position_mm=aside(places, SHARE)),
        "intensity-30": dataclasses.replace(target, rgb=target.rgb * (1 - SHARE)),
        "intensity+30": dataclasses.replace(target, rgb=target.rgb * (1 + SHARE)),
    }
    for name, toward in DIRECTIONS.items():
        direction = torch.nn.functional.normalize(places.new_tensor(toward), dim=0)
        found[name] = Environment(
            (DISTANCE_MM * direction).view(1, 1, 3),
            torch.full((1, 1, 3), STRENGTH),
            torch.full((1, 3), AMBIENT),
            torch.zeros(1, 1, dtype=torch.bool),
            target.camera_mm,
        )
    return found


def aside(position_mm: Tensor, share: float) -> Tensor:
    """(..., 3) lamps moved to their right, level, by a share of their distance.

    A lamp straight above or below moves along +x.
    """
    distance = position_mm.norm(dim=-1, keepdim=True)
    level = torch.stack(
        [position_mm[..., 2], torch.zeros_like(position_mm[..., 0]), -position_mm[..., 0]], dim=-1
    )
    length = level.norm(dim=-1, keepdim=True)
    ahead = position_mm.new_tensor([1.0, 0.0, 0.0]).expand_as(level)
    right = torch.where(length > 1e-6 * distance, level / length.clamp_min(1e-12), ahead)
    return position_mm + share * distance * right
