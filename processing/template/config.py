"""Settings of everything that is done to templates."""

from __future__ import annotations

import dataclasses

SMALLEST, LARGEST = 0.6, 1.6
"""A head's landmarks are so many times as far apart as our template's, at least and at most."""


@dataclasses.dataclass(frozen=True)
class ImportConfig:
    """How a template is made of somebody's mesh."""

    landmark_gap_mm: float = 4.0
    """A landmark given as a point is at most this far from the vertex that represents it."""
    smallest_size: float = SMALLEST
    """Smallest size of the mesh's face, relative to our template's, by its landmarks."""
    largest_size: float = LARGEST
    """Largest size of the mesh's face, relative to our template's, by its landmarks."""
    largest_misfit_mm: float = 12.0
    """Median distance of the landmarks to ours after the best similarity, at most."""
    region_gap_mm: float = 10.0
    """A vertex this far from our template, fitted to the mesh, is beyond it: shoulders."""
    region_angle_deg: float = 80.0
    """A vertex whose normal is so far from our template's is in no region."""
    region_stiffness_mm: float = 10.0
    """Regions need no more than our template fitted with stiffnesses down to this."""
    least_open_sky: float = 0.08
    """What sees less than this share of all directions is the inside of mouth or nose: no skin."""
    gap_rings: int = 4
    """Gaps in ears and hair that are narrower than twice so many rings of vertices belong to
    them."""
    eye_within_mm: float = 36.0
    """A part that is not joined to the face, all of it within this of an eye's landmarks, is an
    eye."""
    map_rows: int = 768
    """Rows of the maps of a template; columns are two thirds."""
    soft_rings: int = 4
    """Shininess and translucency change from region to region over about so many vertices."""


SHININESS = {"skin": 24.0, "lips": 40.0, "eyes": 160.0, "ears": 20.0, "hair": 12.0, "": 80.0}
"""Blinn-Phong exponent of each region, as our own template's; "" is what no region names, such as
teeth."""
TRANSLUCENCY = {"skin": 0.6, "lips": 0.8, "eyes": 0.1, "ears": 1.0, "hair": 0.3, "": 0.3}
"""The same for the share of light that passes: our own template's numbers."""


@dataclasses.dataclass(frozen=True)
class CheckConfig:
    """What counts as a fault of a template."""

    uv_rows: int = 3072
    """Overlaps are searched for at the texels of a texture of so many rows."""
    texture_rows: int = 6144
    """Rows of the atlas, whose texels are the unit of sizes."""
    least_open_sky: float = 0.08
    """A vertex that sees less than this share of all directions may be under other skin."""
    hidden_rings: int = 2
    """A landmark is under other skin where all vertices within this many rings see as little."""
    joined_mm: float = 1e-3
    """Two vertices of open borders that are no farther apart are one place that is not joined."""
    eye_mm: float = 22.0
    """A border is an eye's opening if its middle is nearer than this to the eye's, mm."""
    mouth_mm: float = 30.0
    """A border is the mouth's opening if its middle is nearer than this to the mouth's, mm."""
    neck_mm: float = 200.0
    """A border below the chin that is longer is the neck's."""
    smallest_size: float = SMALLEST
    """Smallest size of a template's face, relative to ours, by its landmarks."""
    largest_size: float = LARGEST
    """Largest size of a template's face, relative to ours, by its landmarks."""
    landmark_mm: float = 25.0
    """A landmark this far from our template's, after the best similarity, is reported."""
    largest_misfit_mm: float = 20.0
    """Registration refuses landmarks whose median distance is larger."""
    axes_deg: float = 20.0
    """Axes are another head frame where the landmarks are turned by more."""
    identity_deviations: float = 2.0
    """Identity modes are tried at so many standard deviations either way."""
    stretch_angle_deg: float = 60.0
    """Distortion is reported if the texture changes the angles of 5 % of the skin by more."""
    stretch_area: float = 4.0
    """Distortion is also reported if 5 % of the skin has this many times more or fewer texels than
    the median."""


@dataclasses.dataclass(frozen=True)
class TransferConfig:
    """How maps are carried from one template's texture to another's."""

    farthest_mm: float = 4.0
    """Places farther from the other surface than this have no counterpart, mm."""
    angle_deg: float = 75.0
    """Normals of the two surfaces at one place differ by less."""
    radian_mm: float = 10.0
    """Among vertices that are near a vertex, one whose normal is turned by a radian counts as so
    much farther."""
    neighbours: int = 24
    """Number of nearest shared vertices that move a vertex which the other template lacks."""
    gutter_px: int = 16
    """Islands reach so far into the gutter."""
    coarsest: int = 4
    """Where texels of the new texture are larger, the old one is read at up to 2 to the power of
    this times its texels' side."""


@dataclasses.dataclass(frozen=True)
class PopulationConfig:
    """How another head model's people become a template's population."""

    modes: int = 20
    """The first of its identity modes; with 100 no shape from photographs was nearer."""
    smooth_mm: float = 6.0
    """Distance over which the modes are smoothed, mm."""
    measure_share: float = 0.15
    """How differently a surface and a person are measured, of a measure's deviation among
    people."""
