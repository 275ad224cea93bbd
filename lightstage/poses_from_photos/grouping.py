"""Whether cameras share a focal length: what is tried, and which of it explains pictures better."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

GAPS = (1.03, 1.08, 1.2)
"""Ratios of neighbouring focal lengths at which cameras are parted into lenses; each is tried."""
BETTER = 0.985
"""More lenses are taken where their cost is below this share of that with fewer: a camera at the
side, whose own focal length is a quarter less, lowers the cost of all by 3 % alone."""
FEWER_POINTS = 0.9
"""Cameras that are placed by fewer observations than this share of another try's are no rival."""


@dataclasses.dataclass(frozen=True)
class JobLens:
    """Cameras of one focal length in a try.

    Attributes:
        cameras: names.
        focal_px: to begin with; None where unknown.
        open: whether these cameras may turn out to have several.
        centre_px: principal point.
    """

    cameras: tuple[str, ...]
    focal_px: float | None
    open: bool
    centre_px: tuple[float, float]


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What a try came to.

    Attributes:
        lenses: how many.
        cameras: placed.
        observations: of points, in all pictures.
        cost: mean robust cost of an observation.
    """

    lenses: int
    cameras: int
    observations: int
    cost: float


def apart(lenses: Sequence[JobLens]) -> list[JobLens]:
    """The same, each camera of an open lens with a lens of its own."""
    return [
        dataclasses.replace(lens, cameras=(name,))
        for lens in lenses
        for name in lens.cameras
        if lens.open
    ] + [lens for lens in lenses if not lens.open]


def parted(lenses: Sequence[JobLens], focal_px: Mapping[str, float]) -> list[list[JobLens]]:
    """Groupings to try: open lenses parted where focal lengths leave a gap, coarsest first.

    Args:
        lenses: as given.
        focal_px: of each camera as found with a lens of its own; a camera without stays with the
            first of its lens.

    Returns:
        Groupings with more lenses than given, each another one; a lens begins with its cameras'
        median.
    """
    out: list[list[JobLens]] = []
    for gap in sorted(GAPS, reverse=True):
        grouping = [
            part
            for lens in lenses
            for part in (_parts(lens, focal_px, gap) if lens.open else [lens])
        ]
        if len(grouping) > len(lenses) and grouping not in out:
            out.append(grouping)
    return out


def _parts(lens: JobLens, focal_px: Mapping[str, float], gap: float) -> list[JobLens]:
    known = sorted((name for name in lens.cameras if name in focal_px), key=focal_px.__getitem__)
    groups: list[list[str]] = []
    for name in known:
        if groups and focal_px[name] <= gap * focal_px[groups[-1][-1]]:
            groups[-1].append(name)
        else:
            groups.append([name])
    if len(groups) < 2:
        return [lens]
    largest = max(groups, key=len)
    largest += [name for name in lens.cameras if name not in focal_px]
    return [
        dataclasses.replace(
            lens,
            cameras=tuple(name for name in lens.cameras if name in group),
            focal_px=_median([focal_px[name] for name in group if name in focal_px]),
        )
        for group in groups
    ]


def _median(values: Sequence[float]) -> float:
    return sorted(values)[len(values) // 2]


def best(outcomes: Sequence[Outcome]) -> int:
    """Which try is taken: the one with fewest lenses that no other explains clearly better.

    What places more cameras goes before all else.

    Args:
        outcomes: at least one.
    """
    most = max(outcome.cameras for outcome in outcomes)
    whole = [i for i, outcome in enumerate(outcomes) if outcome.cameras == most]
    observed = max(outcomes[i].observations for i in whole)
    rivals = [i for i in whole if outcomes[i].observations >= FEWER_POINTS * observed]
    least = min(outcomes[i].cost for i in rivals)
    good = [i for i in rivals if BETTER * outcomes[i].cost <= least]
    return min(good, key=lambda i: (outcomes[i].lenses, outcomes[i].cost))
