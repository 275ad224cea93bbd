"""Settings of the stage `register`."""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass(frozen=True)
class PlateConfig:
    """The energy and its solver."""

    stretch_share: float = 0.02
    """Weight of first against second derivatives. First ones would hold the skin back where it
    slides, so they are only strong enough to keep unseen parts from running away."""
    iterations: int = 30
    """Conjugate gradients a round, at most."""
    settled_mm: float = 0.003
    """A step that moves no vertex farther ends a solve."""


@dataclasses.dataclass(frozen=True)
class GateConfig:
    """What is believed."""

    share: float = 0.7
    """Largest distance of a closest point that counts, as a share of the stiffness."""
    least_mm: float = 3.0
    """The largest distance is at least this, mm, however small the stiffness is."""
    far_share: float = 0.7
    """The largest distance is also at least this share of the way to the nearest landmark: pose and
    coarse stiffnesses bring what is far from all landmarks, the neck, only roughly to its place."""
    normal_deg: float = 60.0
    """A closest point does not count where its normal differs from the vertex's by more."""
    unmoved_mm: float = 0.02
    """A vertex that moved no farther since its closest point was found keeps it: its tangent plane
    is the same within a micrometre."""
    borders: bool = True
    """The mesh's open borders (neck, lids) follow the nearest borders of the scan."""
    border_share: float = 1.0
    """A border of the scan is followed within this share of the stiffness, and only where the
    mesh's nearest place to it is the mesh's border, give or take as much: a scan that ends well
    before the mesh does ends in the middle of it."""
    cavity_sky: float = 0.08
    """A vertex inside mouth, nose or ear follows only what sees less of the sky than this: what
    photographs show there is lips and lids closed over it."""


@dataclasses.dataclass(frozen=True)
class BothWaysConfig:
    """How closest points are sought and believed."""

    from_mm: float = 25.0
    """Stiffnesses of at most this match both ways."""
    radian_mm: tuple[float, float] = (3.0, 12.0)
    """A turn of the normal by a radian counts like so many mm: like the stiffness, within these."""
    least_mm: float = 4.0
    """A match counts within the stiffness, or within this where the stiffness is smaller, mm."""
    normal_deg: float = 75.0
    """A match does not count where the normals of its two places differ by more."""
    hold: float = 0.1
    """A match holds its vertex along the surface with this share of its pull onto it."""
    around_mm: float = 12.0
    """The scan's points within this of the mesh's part are matched; skin around is drawn alike."""


@dataclasses.dataclass(frozen=True)
class ModesConfig:
    """The model fit's settings."""

    iterations: int = 20
    """Rounds of closest points and of a step of pose and modes, at most."""
    landmark_sigma_mm: float = 3.0
    """Standard deviation of a landmark's error, mm."""
    landmark_robust_mm: float = 20.0
    """A landmark this far away pulls a quarter as strongly as by its distance."""
    surface_sigma_mm: float = 3.0
    """Standard deviation of the scan's distance from the model, along its normal, mm."""
    surface_samples: int = 150
    """The surface counts like so many independent points; its neighbours are not independent."""
    largest_identity: float = 2.5
    """Standard deviations. Expressions are kept within 0 and 1."""
    expression_sigma: float = 0.3
    """Standard deviation of an expression's coefficient; that of an identity's is 1."""
    scale_sigma: float = 0.05
    """Standard deviation of the natural logarithm of a head's size beside the template's."""
    gate_mm: float = 20.0
    """Largest distance of a closest point that counts in the first half of the rounds, mm; a third
    of it counts in the second half."""
    normal_gate_deg: float = 50.0
    """A closest point does not count where its normal differs from the model's by more."""


@dataclasses.dataclass(frozen=True)
class NonrigidConfig:
    """Non-rigid ICP's settings."""

    stiffness_mm: tuple[float, ...] = (150.0, 80.0, 40.0, 20.0, 10.0, 5.0, 2.5, 1.2, 0.5)
    """Annealed: details of the displacement shorter than about 2 pi times this are suppressed."""
    noise_times: float = 6.0
    """Stiffnesses below so many times the scan's noise would copy it and are left out."""
    iterations: int = 2
    """Closest-point rounds per stiffness, at most."""
    still_mm: float = 0.05
    """A round that moves no vertex farther ends its stiffness."""
    coarse_cell_mm: float = 5.0
    """Vertices within cells of this size are one at stiffnesses of `coarse_above_mm` or more; 0
    uses the whole template everywhere."""
    coarse_above_mm: float = 8.0
    """Smallest stiffness that is solved on the joined vertices, mm."""
    hold: float = 0.03
    """A match holds its vertex along the surface with this share of its pull onto it."""
    settled_below_mm: float = 41.0
    """Below this stiffness what has no match is held where it is with that share as well: coarse
    stiffnesses have put it there, and fine ones would let it creep."""
    landmark_pull: float = 50.0
    """A landmark pulls so many times as hard as the plate resists: a point on a thin plate that
    rests on springs is held by 8 l^2, so the pull follows the stiffness l down."""
    fine_pull: float = 2.0
    """The same for stiffnesses below `fine_mm`. Such a landmark pulls only along the surface where
    its vertex follows the scan, which gives the surface's place better."""
    fine_mm: float = 12.0
    """Size of a landmark's own error, mm: stiffnesses below it use `fine_pull`."""
    contradicted_mm: float = 4.0
    """A landmark is left out if all others predict it farther off than this, mm, and
    `contradicted_times` holds too."""
    contradicted_times: float = 6.0
    """A landmark is left out only if it is also this many times farther off than the median
    landmark, each beside the error that is expected of it."""
    off_surface_mm: float = 1.5
    """A landmark is also left out if it is farther from the scan than this, mm, and
    `off_surface_times` holds too."""
    off_surface_times: float = 5.0
    """A landmark off the scan is left out only if its distance is this many times the landmarks'
    median distance."""
    intricate_stiffness_mm: float = 1.2
    """Ears that were not found as wholes stop following below this."""
    yield_times: float = 1 / 16
    """Factor of the scan's pull from then on where the mesh folds: as if the plate were twice
    as stiff there, since its resistance grows with the fourth power of the stiffness."""
    unfold_rounds: int = 5
    """Largest number of further rounds that undo folds and crossings at the last stiffness."""
    mend_rounds: int = 20
    """Largest number of times that places which still fold or cross are smoothed and checked."""
    gate: GateConfig = dataclasses.field(default_factory=GateConfig)
    """Which closest points count."""
    both_ways: BothWaysConfig = dataclasses.field(default_factory=BothWaysConfig)
    """How intricate parts are matched both ways."""
    plate: PlateConfig = dataclasses.field(default_factory=PlateConfig)
    """The thin plate's energy and its solver."""

    def down_to(self, stiffness_mm: float) -> NonrigidConfig:
        """The same with the stiffnesses of at least this, or the first; no unfolding."""
        some = tuple(size for size in self.stiffness_mm if size >= stiffness_mm)
        return dataclasses.replace(
            self, stiffness_mm=some or self.stiffness_mm[:1], unfold_rounds=0, mend_rounds=0
        )


@dataclasses.dataclass(frozen=True)
class EarConfig:
    """How ears are found and believed."""

    sought: bool = True
    """Whether ears are searched for at all."""
    stands_off_mm: float = 4.0
    """Points farther from the skin without ears than this are an ear's, mm."""
    reach: float = 1.5
    """An ear is searched for within this many times its size around its centre."""
    least_points: int = 50
    """Least number of the scan's points off the skin that can be an ear."""
    radian_mm: float = 15.0
    """In the search for closest points a turn of the normal by a radian counts like so many mm."""
    rounds: int = 30
    """Rounds of closest points and of a similarity fitted to them."""
    points: int = 2000
    """Points of the scan's ear that are used; more add time and no information."""
    size: tuple[float, float] = (0.6, 1.5)
    """Smallest and largest size of a found ear, relative to the template's."""
    residual_share: float = 0.25
    """Largest median residual of a found ear, as a share of the size of the template's ear."""
    blend_mm: float = 35.0
    """Skin within this of an ear that is moved to its place makes room for it."""


@dataclasses.dataclass(frozen=True)
class RegisterConfig:
    """Registration's settings."""

    landmark_command: str = ""
    """A program that finds the landmarks in the views' albedo, in place of landmarks.json and of
    our own detector; see `providers`."""
    click_agree_mm: float = 2.5
    """How far a click's ray may pass from its landmark; farther ones are left out and named."""
    detected_agree_mm: float = 5.0
    """The same for our own detector, which no view contradicts as surely as a person's click."""
    landmark_outlier_mm: float = 18.0
    """A landmark this far from the fitted shape model, with no neighbour alike, is left out."""
    least_open_sky: float = 0.08
    """Vertices that see less than this share of all directions follow cavities of the scan only."""
    quiet_rounds: int = 2
    """Rounds of smoothing of the scan's vertex noise."""
    modes: ModesConfig = dataclasses.field(default_factory=ModesConfig)
    """How the template's modes are fitted."""
    nonrigid: NonrigidConfig = dataclasses.field(default_factory=NonrigidConfig)
    """How the template is bent onto the scan."""
    ears: EarConfig = dataclasses.field(default_factory=EarConfig)
    """How ears are found."""
    ears_after_mm: float = 20.0
    """Ears are searched for when all but them was fitted with stiffnesses down to this."""
