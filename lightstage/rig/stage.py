"""The stage: its lamps, on which wires they are, and its cameras, in order."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from lightstage.errors import RigError
from lightstage.rig.camera import Camera

MEASURED_WITH = "measured_with_rig_sha256"
"""In a rig.json whose cameras were measured from photographs: `rig_sha256` of the rig they were
taken with. It is the same stage."""
UNMEASURED = "unmeasured_cameras"
"""Field of such a rig.json: ids of cameras that keep the lens and pose they had before."""
UNCHECKED = "unchecked_cameras"
"""Field of such a rig.json: ids of cameras that saw too few boards for their place to be checked.
"""
CONTROLLER = "main"
"""What a lamp's controller is called where the rig does not name it."""


@dataclasses.dataclass(frozen=True)
class LightAddress:
    """To which wire a light is connected.

    Attributes:
        channel: place on the controller's line, counted from 0.
        controller: name of the device that drives it.
        more: fields that others added in rig.json; they are kept.
    """

    channel: int
    controller: str = CONTROLLER
    more: Mapping[str, Any] = dataclasses.field(default_factory=dict, compare=False)


@dataclasses.dataclass(frozen=True)
class Light:
    """One LED.

    Attributes:
        id: label, unique in the rig.
        name: such as ``arc00/light03``.
        position_mm: world position.
        bank: polarisation, ``horizontal`` or ``vertical``; None where the light is not polarised.
        rgb_gain: measured radiant intensity relative to nominal, per channel.
        colour: name of the emitter's colour, such as ``warm`` or ``red``, where several stand in
            one place; None where all are alike.
        address: wire that drives it; None where its place in the rig's list is its channel.
        more: fields that others added in rig.json; they are kept.
    """

    id: int
    name: str
    position_mm: tuple[float, float, float]
    bank: str | None = None
    rgb_gain: tuple[float, float, float] = (1.0, 1.0, 1.0)
    colour: str | None = None
    address: LightAddress | None = None
    more: Mapping[str, Any] = dataclasses.field(default_factory=dict, compare=False)


@dataclasses.dataclass(frozen=True)
class Rig:
    """The stage: lights and cameras in order."""

    lights: tuple[Light, ...]
    cameras: tuple[Camera, ...]
    more: Mapping[str, Any] = dataclasses.field(default_factory=dict, compare=False)
    """Fields that others added in rig.json; they are kept."""

    @functools.cached_property
    def positions_mm(self) -> np.ndarray:
        """(n, 3) light positions."""
        return np.array([light.position_mm for light in self.lights], float).reshape(-1, 3)

    @functools.cached_property
    def colours(self) -> dict[str | None, np.ndarray]:
        """Colour of emitters to (n,) bool which lights are of it, in the rig's order."""
        named = [light.colour for light in self.lights]
        return {
            colour: np.array([each == colour for each in named]) for colour in dict.fromkeys(named)
        }

    @functools.cached_property
    def rgb_gains(self) -> np.ndarray:
        """(n, 3) light gains."""
        return np.array([light.rgb_gain for light in self.lights], float).reshape(-1, 3)

    @functools.cached_property
    def addresses(self) -> tuple[LightAddress, ...]:
        """Each lamp's address: from the rig, else its place in the list."""
        return tuple(light.address or LightAddress(i) for i, light in enumerate(self.lights))

    @property
    def addressed(self) -> bool:
        """Whether the rig itself states how its lamps are wired."""
        return any(light.address is not None for light in self.lights)

    def camera(self, camera_id: str) -> Camera:
        """The camera of this id; RigError when there is none."""
        for camera in self.cameras:
            if camera.id == camera_id:
                return camera
        known = ", ".join(camera.id for camera in self.cameras)
        raise RigError("rig", field="cameras", found=f"no {camera_id}", expected=f"one of {known}")

    def readdressed(self, addresses: Sequence[LightAddress]) -> Rig:
        """The same rig with another controller and channel of each light.

        Args:
            addresses: of each light, in the rig's order.
        """
        lights = tuple(
            dataclasses.replace(
                light,
                address=LightAddress(new.channel, new.controller, own.more),
            )
            for light, own, new in zip(self.lights, self.addresses, addresses, strict=True)
        )
        return dataclasses.replace(self, lights=lights)

    def scaled(self, factor: float) -> Rig:
        """The same rig with `factor` times as many pixels a side in every camera."""
        more = {key: each for key, each in self.more.items() if key != MEASURED_WITH}
        cameras = tuple(camera.scaled(factor) for camera in self.cameras)
        return dataclasses.replace(self, cameras=cameras, more=more)
