"""Photographs through a polariser before the lens, of lamps behind polarisers of their own.

What a polarised shot is on this stage. Every lamp has one fixed polariser: those of the horizontal
bank pass the field along the circle of latitude through the lamp, those of the vertical bank the
field along its meridian. These two fields are symmetric about the upright axis, so that every
camera near the equator finds them alike, and a lens needs one fixed polariser for both [Ghosh2011];
Ma's pattern cancels the mirror reflection better but for one viewpoint only, and needs a polariser
tuned lamp by lamp to it [Ma2007]. Lenses pass the upright field, along their picture's columns. So
`@parallel` is the shot by the vertical bank and `@cross` that by the horizontal one, each with half
the pattern's lamps (`lightstage.patterns`): the banks are interleaved, so that both light the face
from nearly the same directions, but not from the same ones, and no shot can use both banks without
mixing the two.

Why upright. A lamp at the side meets its facet at 30 to 60 degrees, near Brewster's angle, where
reflection all but removes the field in the plane of incidence and keeps the one across it. There a
circle of latitude runs in that plane and a meridian across it, and both leave slanting. With
upright lenses the lamps to be removed are those that reflect little anyway; with horizontal ones
those that reflect most, and cross keeps more than ten times as much.

A photograph without a polariser on the lens is `World.photograph`, whose lamps are unpolarised and
as strong. Half of light that has lost its polarisation reaches the sensor: twice the cross shot is
the diffuse light of that bank, and the parallel shot holds half the diffuse light and the specular.

How much specular light a cross shot keeps is `facet_shares`: a share 1 / extinction each of lamp
and lens, and what reflection itself turns, as r_s and r_p differ and the planes of lamp, facet and
lens do not agree. Benchmarks print it by angle.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from lightstage.rig import Camera, Rig
from sim.camera.shooting import LitSubject
from sim.errors import SimError
from sim.light.facets import SKIN_INDEX
from sim.light.lamps import Lamps
from sim.light.olat import Optics
from sim.light.polarised_factors import polarised_factors
from sim.light.scene import Surface
from sim.light.world import World
from sim.people.subject import Subject


@dataclasses.dataclass(frozen=True)
class PolariserConfig:
    """Polarisers of lamps and lenses.

    Attributes:
        lamp_extinction: how many times more of the wanted than of the other field leaves a lamp.
            1 is no polariser, infinity a perfect one; plastic sheet has about a thousand.
        lens_extinction: the same of what a lens's polariser passes; the wanted field passes whole.
        lens_deg: angle of the field that a lens passes against its picture's rows,
            counter-clockwise as the camera sees it: 0 is horizontal, 90 upright.
    """

    lamp_extinction: float = 1000.0
    lens_extinction: float = 1000.0
    lens_deg: float = 90.0

    def __post_init__(self) -> None:
        """SimError when an extinction is below 1 or an angle not finite."""
        for name in ("lamp_extinction", "lens_extinction"):
            if not getattr(self, name) >= 1:
                raise SimError(
                    "polarisers", field=name, found=str(getattr(self, name)), expected="at least 1"
                )
        if not np.isfinite(self.lens_deg):
            raise SimError(
                "polarisers", field="lens_deg", found=str(self.lens_deg), expected="degrees"
            )


def is_polarised(pattern: str) -> bool:
    """Whether a pattern is photographed through the lens's polariser."""
    return "@" in pattern


def lamp_axes(rig: Rig) -> np.ndarray:
    """(m, 3) unit: the field that each lamp's polariser passes, by its bank.

    Straight above or below, where circles of latitude have no direction, it is that of +z's
    meridian: x and z.
    """
    toward = rig.positions_mm / np.linalg.norm(rig.positions_mm, axis=1, keepdims=True)
    latitude = np.stack([toward[:, 2], np.zeros(len(toward)), -toward[:, 0]], axis=1)
    flat = np.linalg.norm(latitude, axis=1, keepdims=True)
    latitude = np.where(flat > 1e-9, latitude / np.maximum(flat, 1e-9), [1.0, 0.0, 0.0])
    meridian = np.cross(toward, latitude)
    horizontal = np.array([light.bank == "horizontal" for light in rig.lights])
    return np.where(horizontal[:, None], latitude, meridian)


def lens_axis(camera: Camera, config: PolariserConfig) -> np.ndarray:
    """(3,) unit, world: the field that a lens's polariser passes."""
    right, down = camera.cam_from_world[0, :3], camera.cam_from_world[1, :3]
    turn = np.radians(config.lens_deg)
    return np.cos(turn) * right - np.sin(turn) * down


def filters(rig: Rig, camera: Camera, config: PolariserConfig) -> Optics:
    """What the polarisers of a rig's lamps and of one lens do to each lamp's light."""
    axes, places = lamp_axes(rig), rig.positions_mm
    analyser = lens_axis(camera, config)

    def optics(
        position: np.ndarray, normal: np.ndarray, view: np.ndarray, lit: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        return polarised_factors(
            position,
            normal,
            view,
            places[lit],
            axes[lit],
            analyser,
            SKIN_INDEX,
            config.lamp_extinction,
            config.lens_extinction,
        )

    return optics


class PolarisedWorld:
    """A `World` whose cameras look through polarisers at polarised lamps.

    Attributes:
        world: the same without polarisers.
        config: of the polarisers.
        rig: lights and cameras.
        lamps: the world's.
    """

    def __init__(self, world: World, config: PolariserConfig | None = None) -> None:
        self.world = world
        self.config = config or PolariserConfig()
        self.rig: Rig = world.rig
        self.lamps: Lamps = world.lamps

    @property
    def surfaces(self) -> dict[str, Surface]:
        """What each camera's pixels see."""
        return self.world.surfaces

    @property
    def subject(self) -> Subject:
        """Who sits in the stage."""
        return self.world.subject

    def with_subject(self, subject: Subject) -> PolarisedWorld:
        """The same stage with another subject, or the same one elsewhere."""
        return PolarisedWorld(self.world.with_subject(subject), self.config)

    def photograph(self, camera_id: str, levels: np.ndarray) -> np.ndarray:
        """Pictures (s, h, w, 3) float32 under levels (s, m), through the lens's polariser."""
        levels = np.asarray(levels)
        weights = (levels if levels.ndim == 3 else levels[:, :, None]) * self.lamps.weights
        optics = filters(self.rig, self.rig.camera(camera_id), self.config)
        return self.world.pictures(camera_id, weights, self.lamps, optics)

    def skin_peak(self, quantile: float = 0.999, levels: np.ndarray | None = None) -> np.ndarray:
        """(3,) what the brightest skin reads under `full` without polarisers: at most half."""
        return self.world.skin_peak(quantile, levels)


def behind_polarisers(lit: LitSubject) -> PolarisedWorld:
    """Who photographs polarised patterns; SimError unless it is the fast path."""
    if not isinstance(lit, World):
        raise SimError(
            "polarised pattern",
            found=type(lit).__name__,
            expected="the simulator's own light",
            hint="The path-traced reference knows no polarisers here; take --light fast.",
        )
    return PolarisedWorld(lit)


def seen_through(lit: LitSubject, patterns: Sequence[str]) -> LitSubject:
    """Who photographs a session during which nobody touches the lenses.

    Raises:
        SimError: only some of the patterns are polarised, or the light is not the fast path's.
    """
    through = [is_polarised(name) for name in patterns]
    if not any(through):
        return lit
    if not all(through):
        raise SimError(
            "sequence",
            found=f"{patterns[through.index(False)]} beside {patterns[through.index(True)]}",
            expected="polarised patterns only, or none",
            hint="Nobody turns nine polarisers during a capture; --direct takes such a sequence.",
        )
    return behind_polarisers(lit)


def facet_shares(
    rig: Rig, camera: Camera, config: PolariserConfig | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Share of specular light that passes the lens's polariser, lamp by lamp.

    Args:
        rig: the lamps.
        camera: the view.
        config: of the polarisers.

    Returns:
        (m,) angle of incidence in degrees at a facet at the origin that mirrors a lamp into the
        camera, and (m,) what passes, relative to what an unpolarised lamp sends into a lens without
        polariser: 1/2 where nothing is polarised, near 1 in parallel, leakage in cross; up to 2
        near Brewster's angle, where half of unpolarised light is not reflected at all.
    """
    config = config or PolariserConfig()
    view = camera.centre_mm / np.linalg.norm(camera.centre_mm)
    toward = rig.positions_mm / np.linalg.norm(rig.positions_mm, axis=1, keepdims=True)
    incidence = np.degrees(np.arccos(np.clip(toward @ view, -1, 1))) / 2
    origin = np.zeros((1, 3))
    _, specular = filters(rig, camera, config)(
        origin, view[None], view[None], np.arange(len(toward))
    )
    return incidence, specular[0]
