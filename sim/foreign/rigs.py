"""Rigs that suit the patterns badly."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.spatial.transform import Rotation

from lightstage.rig import Rig

HALF_ARC_DEG = 15.0
"""Between an arc of the default rig and the plane beside it."""
LOW_DEG = 8.0


def on_planes(rig: Rig, turn_deg: float = HALF_ARC_DEG, within_deg: float = LOW_DEG) -> Rig:
    """A rig some of whose lamps are on the planes that split the gradients.

    Half of such a light's level is nobody's by rights: to which side a pattern counts it is chance.

    Args:
        rig: of upright arcs; its cameras stay.
        turn_deg: about the upright axis, which brings arcs into x = 0 and z = 0.
        within_deg: lights so little above y = 0 are moved onto it; those below stay.
    """
    turned = Rotation.from_euler("y", turn_deg, degrees=True).apply(rig.positions_mm)
    radius = np.linalg.norm(turned, axis=1, keepdims=True)
    toward = turned / radius
    toward[np.abs(toward) < 1e-6] = 0.0
    low = (toward[:, 1] > 0) & (toward[:, 1] < np.sin(np.radians(within_deg)))
    toward[low, 1] = 0.0
    placed = toward * radius / np.linalg.norm(toward, axis=1, keepdims=True)
    lights = tuple(
        dataclasses.replace(light, position_mm=tuple(place))
        for light, place in zip(rig.lights, placed.tolist(), strict=True)
    )
    return dataclasses.replace(rig, lights=lights)
