"""Lengths that were measured: photographs alone do not show how large anything is."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Collection, Mapping, Sequence

import numpy as np

from lightstage.errors import LightstageError, MotionError, one_error
from lightstage.poses_from_photos.points import Clicks, place
from lightstage.rig import Camera

WARN_SHARE, MOST_SHARE = 0.01, 0.1
"""Lengths that contradict each other by more are warned of, and refused."""
_LENGTH = re.compile(r"(?P<first>[^:=]+):(?P<second>[^:=]+)=(?P<mm>[0-9.eE+-]+)")


@dataclasses.dataclass(frozen=True)
class Length:
    """A measured distance between two cameras' lenses, or between two clicked points.

    Attributes:
        first, second: a camera's id, or a point's name.
        mm: the distance.
    """

    first: str
    second: str
    mm: float

    def __str__(self) -> str:
        return f"{self.first}:{self.second}={self.mm:g}"


@dataclasses.dataclass(frozen=True)
class Scale:
    """How large COLMAP's unit is.

    Attributes:
        mm_per_unit: the factor.
        misfits: of each length, by what share it differs from what it is with this factor.
        click_residual_px: median of the clicks that were used, None without clicks.
    """

    mm_per_unit: float
    misfits: dict[str, float]
    click_residual_px: float | None

    def warnings(self) -> list[str]:
        """Warnings of lengths that contradict each other a little."""
        return [
            f"the length {name} is {100 * share:+.1f} % off the others' scale"
            for name, share in self.misfits.items()
            if abs(share) > WARN_SHARE
        ]


def parse_length(text: str) -> Length:
    """A length as the command line has it, such as ``cam0:cam3=952.6``.

    Raises:
        MotionError: another form, or no positive number.
    """
    match = _LENGTH.fullmatch(text.strip())
    try:
        mm = float(match["mm"]) if match else 0.0
    except ValueError:
        mm = 0.0
    if not match or not 0 < mm < 1e9 or match["first"].strip() == match["second"].strip():
        raise MotionError(
            "--length",
            found=repr(text),
            expected="FIRST:SECOND=MM with a positive number, such as cam0:cam3=952.6",
        )
    return Length(match["first"].strip(), match["second"].strip(), mm)


def require_known(
    lengths: Sequence[Length], cameras: Collection[str], clicks: Collection[str]
) -> None:
    """MotionError for every name of a length that is no camera and no clicked point."""
    points = [*clicks] if len(clicks) < 20 else ["a landmark, 0 to 67, that was clicked"]
    problems: list[LightstageError] = [
        MotionError(
            "--length",
            found=f"no camera and no point {name}",
            expected=f"one of {', '.join([*cameras, *points])}",
            hint="Points are those of --points or --landmarks.",
        )
        for name in _names(lengths)
        if name not in cameras and name not in clicks
    ]
    if problems:
        raise one_error(problems)


def _names(lengths: Sequence[Length]) -> list[str]:
    return list(dict.fromkeys(n for length in lengths for n in (length.first, length.second)))


def find_scale(lengths: Sequence[Length], cameras: Mapping[str, Camera], clicks: Clicks) -> Scale:
    """How many mm a unit has, least squares over the lengths.

    Args:
        lengths: at least one.
        cameras: by id.
        clicks: points' names to their clicks.

    Raises:
        MotionError: a name that is no camera and no point, a point that cannot be placed, or
            lengths that contradict each other; all in one message.
    """
    require_known(lengths, cameras, clicks)
    problems: list[LightstageError] = []
    residuals: list[float] = []
    places: dict[str, np.ndarray] = {}
    for name in _names(lengths):
        if name in cameras:
            places[name] = cameras[name].centre_mm
            continue
        try:
            placed = place(name, clicks[name], cameras)
        except MotionError as error:
            problems.append(error)
            continue
        places[name] = placed.position
        residuals.append(placed.residual_px)
    if problems:
        raise one_error(problems)
    units = np.array([np.linalg.norm(places[each.first] - places[each.second]) for each in lengths])
    mm = np.array([each.mm for each in lengths])
    if not units.min() > 1e-9 * max(1.0, units.max()):
        raise MotionError("--length", found="two points in one place", expected="a length")
    factor = float(units @ mm / (units @ units))
    misfits = mm / (factor * units) - 1
    if np.abs(misfits).max() > MOST_SHARE:
        contradictions = ", ".join(
            f"{length} ({100 * share:+.0f} %)"
            for length, share in zip(lengths, misfits, strict=True)
        )
        raise MotionError(
            "--length",
            found=f"lengths that contradict each other: {contradictions}",
            expected=f"agreement within {100 * MOST_SHARE:.0f} %",
            hint="Are they in mm, and between the points that are named?",
        )
    return Scale(
        factor,
        {str(each): float(share) for each, share in zip(lengths, misfits, strict=True)},
        float(np.median(residuals)) if residuals else None,
    )
