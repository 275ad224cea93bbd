"""Kinds of calibration shots: what to put before the cameras, under which light, how often."""

from __future__ import annotations

import dataclasses

from lightstage.calibrations.config import CalibrationConfig, require_kind
from lightstage.patterns import Drive
from lightstage.patterns.names import BINARY
from lightstage.rig import Rig

GEOMETRY = ("serial", "model", "aperture", "focus")
EXPOSURE = ("serial", "model", "iso", "shutter", "aperture")


@dataclasses.dataclass(frozen=True)
class Kind:
    """One kind.

    Attributes:
        name: as commands and files call it.
        put: what the operator puts before the cameras, in plain words; `{camera}` is the one that
            a pose faces, `{where}` before or behind, in turn, as that camera sees it.
        patterns: lit for each pose, names of lightstage.patterns.
        drive: how lights are weighted; `on-off` where each lamp's own strength is searched for.
        faces: each pose is made for one camera, in turn; else for all at once.
        settings: fields of a camera's Summary that must be the same for the shots to hold.
        lit: whether they show the LEDs' light, and so end with another LED firmware.
        gives: what is measured from them, and is no longer known when they have expired.
    """

    name: str
    put: str
    patterns: tuple[str, ...]
    drive: Drive
    faces: bool
    settings: tuple[str, ...]
    lit: bool
    gives: str

    def poses(self, rig: Rig, config: CalibrationConfig) -> int:
        """How many poses."""
        if self.name == "charuco":
            return config.board_poses_per_camera * len(rig.cameras)
        if self.faces:
            return len(rig.cameras)
        return {
            "mirror": config.mirror_poses,
            "grey": config.grey_poses,
            "dark": config.dark_poses,
        }[self.name]

    def faced(self, rig: Rig, index: int) -> str | None:
        """The camera for which pose `index` (from 0) is made; None: for all."""
        return rig.cameras[index % len(rig.cameras)].id if self.faces else None

    def instruction(self, rig: Rig, index: int) -> str:
        """What the operator is asked to do for pose `index` (from 0)."""
        where = "before" if (index // len(rig.cameras)) % 2 == 0 else "behind"
        other = {
            "tilt": " tilted another way than before," if index else "",
            "spot": ", on another spot than before" if index else "",
        }
        return self.put.format(camera=self.faced(rig, index), where=where, **other)

    def shown(self, rig: Rig, every_light: bool) -> tuple[str, ...]:
        """Patterns of a pose.

        Args:
            rig: the lights.
            every_light: of a mirror ball, one light after the other in place of gradients.
        """
        if every_light and self.name == "mirror":
            return ("full", *(f"olat-{light.id:03d}" for light in rig.lights))
        return self.patterns


KINDS: dict[str, Kind] = {
    kind.name: kind
    for kind in (
        Kind(
            "charuco",
            # Nearer and farther: else a longer lens farther off would fit nearly as well.
            "Hold the ChArUco board a hand's width {where} the middle of the stage, facing "
            "{camera},{tilt} and keep it still.",
            ("full",),
            "solid-angle",
            True,
            GEOMETRY,
            False,
            "the cameras' places and lenses",
        ),
        Kind(
            "mirror",
            "Set the mirror ball in the middle of the stage{spot}.",
            # The ratio of a linear gradient to full gives a lamp's place along its axis.
            ("full", *(f"lin-{name}" for name in BINARY)),
            "on-off",
            False,
            GEOMETRY,
            True,
            "the lamps' places",
        ),
        Kind(
            "grey",
            "Set the grey ball in the middle of the stage.",
            ("full", *BINARY),
            "on-off",
            False,
            ("serial", "model", "aperture"),
            True,
            "how strong the lights are",
        ),
        Kind(
            "chart",
            "Hold the colour chart in the middle of the stage, facing {camera}.",
            ("full",),
            "solid-angle",
            True,
            EXPOSURE,
            True,
            "the cameras' colours",
        ),
        Kind(
            "dark",
            "Put the lens caps on, or make the room quite dark.",
            ("dark",),
            "solid-angle",
            False,
            ("serial", "model", "iso", "shutter"),
            False,
            "the sensors' black and hot pixels",
        ),
        Kind(
            "flat",
            "Hold a matt white or grey card close before {camera}, so that it fills the picture.",
            ("full",),
            "solid-angle",
            True,
            GEOMETRY,
            True,
            "the lenses' loss of light toward the corners",
        ),
    )
}
"""All kinds by name, in the order of KIND_NAMES."""


def kind_of(name: str) -> Kind:
    """The kind of this name; ConfigError where there is none."""
    return KINDS[require_kind(name, "kind")]
