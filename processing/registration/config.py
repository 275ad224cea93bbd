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
    """A closest point farther than this share of the stiffness does not count."""
    least_mm: float = 3.0
    far_share: float = 0.7
    """... nor than this share of the way to the nearest landmark: pose and coarse stiffnesses bring
    what is far from all of them, the neck, only roughly to its place."""
    normal_deg: float = 60.0
    """Nor does one whose normal is farther than this from the vertex's."""
    unmoved_mm: float = 0.02
    """A vertex that moved no farther since its closest point was found keeps it: its tangent plane
    is the same within a micrometre."""
    borders: bool = True
    """The mesh's open borders (neck, lids) follow those of the scan that are nearest to them ..."""
    border_share: float = 1.0
    """... if not farther than this share of the stiffness, and nearest to the mesh's border too,
    give or take as much: a scan that ends well before the mesh does ends in the middle of it."""
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
    """A match farther than the stiffness and than this does not count ..."""
    normal_deg: float = 75.0
    """... nor one whose normal is farther than this."""
    hold: float = 0.1
    """A match holds its vertex along the surface with this share of its pull onto it."""
    around_mm: float = 12.0
    """The scan's points within this of the mesh's part are matched; skin around is drawn alike."""


@dataclasses.dataclass(frozen=True)
class ModesConfig:
    """The model fit's settings."""

    iterations: int = 20
    landmark_sigma_mm: float = 3.0
    landmark_robust_mm: float = 20.0
    """A landmark this far away pulls a quarter as strongly as by its distance."""
    surface_sigma_mm: float = 3.0
    surface_samples: int = 150
    """The surface counts like so many independent points; its neighbours are not independent."""
    largest_identity: float = 2.5
    """Standard deviations. Expressions are kept within 0 and 1."""
    expression_sigma: float = 0.3
    scale_sigma: float = 0.05
    gate_mm: float = 20.0
    normal_gate_deg: float = 50.0


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
    hold: float = 0.03
    """A match holds its vertex along the surface with this share of its pull onto it."""
    settled_below_mm: float = 41.0
    """Below this stiffness what has no match is held where it is with that share as well: coarse
    stiffnesses have put it there, and fine ones would let it creep."""
    landmark_pull: float = 50.0
    """A landmark pulls so many times as hard as the plate resists: a point on a thin plate that
    rests on springs is held by 8 l^2, so the pull follows the stiffness l down."""
    fine_pull: float = 2.0
    """The same where the stiffness is below the size of a landmark's own error ..."""
    fine_mm: float = 12.0
    """... and there only along the surface, which the scan knows better."""
    contradicted_mm: float = 4.0
    """A landmark is left out if all others predict it elsewhere by more than this ..."""
    contradicted_times: float = 6.0
    """... and by so many times what is usual among them ..."""
    off_surface_mm: float = 1.5
    """... or if it hovers farther from the scan than this ..."""
    off_surface_times: float = 5.0
    """... and than so many times their median."""
    intricate_stiffness_mm: float = 1.2
    """Ears that were not found as wholes stop following below this."""
    yield_times: float = 1 / 16
    """Where it folds, the scan pulls so many times as hard from then on: as if the plate were twice
    as stiff there, since its resistance grows with the fourth power of the stiffness."""
    unfold_rounds: int = 5
    """At most so many further rounds undo folds and crossings at the last stiffness."""
    mend_rounds: int = 20
    """At most so often are places that still fold or cross smoothed and checked again."""
    gate: GateConfig = dataclasses.field(default_factory=GateConfig)
    both_ways: BothWaysConfig = dataclasses.field(default_factory=BothWaysConfig)
    plate: PlateConfig = dataclasses.field(default_factory=PlateConfig)

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
    """What is farther from the skin without ears is an ear's."""
    reach: float = 1.5
    """It is sought within so many times the ear's size around its centre."""
    least_points: int = 50
    radian_mm: float = 15.0
    """In the search for closest points a turn of the normal by a radian counts like so many mm."""
    rounds: int = 30
    points: int = 2000
    """Of the scan's ear that are used; more add time and no information."""
    size: tuple[float, float] = (0.6, 1.5)
    """An ear outside these sizes against the template's is no ear ..."""
    residual_share: float = 0.25
    """... nor one that fits worse than this share of its size (median)."""
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
    """So often is what alternates from vertex to vertex of the scan, its noise, taken down."""
    modes: ModesConfig = dataclasses.field(default_factory=ModesConfig)
    nonrigid: NonrigidConfig = dataclasses.field(default_factory=NonrigidConfig)
    ears: EarConfig = dataclasses.field(default_factory=EarConfig)
    ears_after_mm: float = 20.0
    """Ears are searched for when all but them was fitted with stiffnesses down to this."""
