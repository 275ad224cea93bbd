"""Pattern names to levels, from the lights' positions. Pure, no device.

Names are those of the session format: full, dark, x+ .. z- (binary gradients), lin-x+ .. lin-z-
(linear gradients), mux-1 and mux-2 (the binary gradients by colour), olat-NNN, and @parallel or
@cross after any of them (one polarisation bank).
"""

from __future__ import annotations

import re

import numpy as np

from lightstage.counting import counted
from lightstage.errors import PatternError
from lightstage.rig import Rig

BINARY = ("x+", "x-", "y+", "y-", "z+", "z-")
LINEAR = tuple(f"lin-{name}" for name in BINARY)
SEQUENCES: dict[str, tuple[str, ...]] = {
    "binary": ("full", *BINARY),
    "linear": ("full", *LINEAR),
    "full": ("full",),
    "ambient": ("dark", "full", *BINARY),
    "polarised": ("full@parallel", "full@cross"),
    "binary-polarised": tuple(
        f"{name}@{bank}" for bank in ("parallel", "cross") for name in ("full", *BINARY)
    ),
    "linear-polarised": tuple(
        f"{name}@{bank}" for bank in ("parallel", "cross") for name in ("full", *LINEAR)
    ),
    "mux": ("mux-1", "mux-2"),
}
"""Named sequences of patterns that `capture` takes; `olat` is one more, of each rig's own lights.
"""

OLAT = "olat"
MEANINGS: dict[str, str] = {
    "binary": "full and three pairs of half spheres; what processing expects",
    "linear": "full and three pairs of linear gradients",
    "full": "every lamp: previews, a check of the exposure",
    "ambient": "binary after a shot without light, which processing takes off all others",
    "polarised": "full by the vertical and by the horizontal bank",
    "binary-polarised": "binary by the vertical bank, then by the horizontal one",
    "linear-polarised": "linear by the vertical bank, then by the horizontal one",
    "mux": "x, y and z gradients at once in red, green and blue lights, then their complements",
    OLAT: "one light at a time, each at its full level",
}
"""What each named sequence is for: `binary` and `mux` in [Kampouris2018], the linear gradients and
their polarised shots in [Ma2007], two banks without moving a polariser in [Ghosh2011]."""

COLOURED = 0.8
"""A light with more than this share of its gain in one channel is of that colour."""
ON_PLANE = 1e-6
"""A lamp nearer to a splitting plane than this share of the radius is on it: half in each."""


def pattern_levels(name: str, rig: Rig) -> np.ndarray:
    """Levels of one pattern by its name alone, each light at level 1 where it is lit whole.

    `mux-1` shows x+, y+ and z+ at once in the red, green and blue light, `mux-2` x-, y- and z-
    [Kampouris2018]. A light has one level, so each takes the mean of the three, weighted by its own
    colour (`rgb_gain`): a red light follows x, a green one y, a blue one z, and the two shots hold
    all six binary gradients. A stage whose lights are all white shows the mean of x, y and z:
    a gradient along the diagonal in four steps and its complement. The two still sum to `full`, so
    they give its albedo and one axis of the separation; normals they cannot give.

    Args:
        name: a pattern name.
        rig: the lights.

    Returns:
        (n,) float64 in 0..1, in the rig's order of lights. A pair (x+ and x-, lin-x+ and lin-x-,
        mux-1 and mux-2) sums to `full`, and so do the two banks of a pattern to the pattern.

    Raises:
        PatternError: an unknown name, or a light that the rig does not have.
    """
    return _unpolarised(name.partition("@")[0], name, rig) * bank_mask(name, rig)


def bank_mask(name: str, rig: Rig) -> np.ndarray:
    """(n,) 1.0 for the lights that a pattern's @parallel or @cross leaves, all where it has none.

    Raises:
        PatternError: another word after the @, or a rig whose lights have no bank.
    """
    _, at, polarisation = name.partition("@")
    if not at:
        return np.ones(len(rig.lights))
    if polarisation not in ("parallel", "cross"):
        raise _unknown(name)
    # Cameras' polarisers stand upright, so parallel is lit by the vertical bank and cross by
    # the horizontal one. The other way round cross would keep ten times as much of the mirror
    # reflection: a lamp at the side whose field follows its meridian is reflected best
    # (across the plane of incidence), one whose field follows its latitude hardly at all.
    bank = "vertical" if polarisation == "parallel" else "horizontal"
    if all(light.bank is None for light in rig.lights):
        raise PatternError(
            f"pattern {name!r}",
            found="a rig whose lights have no bank",
            expected=f"lights with `bank: {bank}` in rig.json",
            hint="Without polarisers take patterns without @, such as the sequence binary.",
        )
    return np.array([light.bank == bank for light in rig.lights], float)


def complement(name: str) -> str | None:
    """The pattern that makes up `full` together with this one (same bank), None where none does."""
    base, at, polarisation = name.partition("@")
    if base in (*BINARY, *LINEAR):
        base = base[:-1] + ("-" if base.endswith("+") else "+")
    elif base in ("mux-1", "mux-2"):
        base = "mux-2" if base == "mux-1" else "mux-1"
    else:
        return None
    return base + at + polarisation


def sequence_patterns(name: str, rig: Rig | None = None) -> tuple[str, ...]:
    """Patterns of a sequence.

    Args:
        name: a named sequence, a pattern, or several of both with commas between.
        rig: its lights are what the sequence `olat` goes through.

    Raises:
        PatternError: `olat` without a rig.
    """
    patterns: list[str] = []
    for part in (part.strip() for part in name.split(",")):
        if part == OLAT:
            if rig is None:
                raise PatternError(
                    f"sequence {name!r}", found="no rig", expected="a rig whose lights are meant"
                )
            patterns += [f"olat-{light.id:03d}" for light in rig.lights]
        elif part:
            patterns += SEQUENCES.get(part, (part,))
    return tuple(patterns)


def has_coloured_lights(rig: Rig) -> bool:
    """Whether mux-1 and mux-2 hold six gradients here: some light of each channel, and of it alone.

    Where lights are white they hold one diagonal gradient and its complement.
    """
    shares = _colours(rig)
    return bool((shares.max(axis=0) > COLOURED).all())


def is_reserved(name: str) -> bool:
    """Whether a name is a pattern's or a sequence's already, or resembles one."""
    return (
        name in SEQUENCES
        or name in ("dark", OLAT, *BINARY)
        or name.startswith(("lin-", "olat-", "mux-"))
    )


def on_plane(rig: Rig) -> dict[str, list[int]]:
    """Lamps that are on a splitting plane, and so are lit half in both gradients of a pair.

    Returns:
        Axis x, y or z to the ids of such lights; axes without any are left out.
    """
    off = np.abs(_along(rig))
    return {
        axis: [light.id for light, on in zip(rig.lights, off[:, k] < ON_PLANE, strict=True) if on]
        for k, axis in enumerate("xyz")
        if (off[:, k] < ON_PLANE).any()
    }


def _along(rig: Rig) -> np.ndarray:
    """(n, 3) the lights' directions."""
    radii = np.linalg.norm(rig.positions_mm, axis=1, keepdims=True)
    return np.asarray(rig.positions_mm / radii)


def _colours(rig: Rig) -> np.ndarray:
    """(n, 3) shares of red, green and blue in each light; a third each where it gives nothing."""
    gains = rig.rgb_gains
    total = gains.sum(axis=1, keepdims=True)
    return np.where(total > 0, gains / np.where(total > 0, total, 1.0), 1 / 3)


def _half(along: np.ndarray) -> np.ndarray:
    """1 where this is positive, 0 where negative, 0.5 on the plane; any shape."""
    return np.where(np.abs(along) < ON_PLANE, 0.5, (along > 0).astype(float))


def _unpolarised(base: str, name: str, rig: Rig) -> np.ndarray:
    count = len(rig.lights)
    if base == "full":
        return np.ones(count)
    if base == "dark":
        return np.zeros(count)
    if base in (*BINARY, *LINEAR):
        along = _along(rig)[:, "xyz".index(base[-2])] * (1.0 if base[-1] == "+" else -1.0)
        return (1.0 + along) / 2.0 if base in LINEAR else _half(along)
    if base in ("mux-1", "mux-2"):
        return np.asarray(
            (_colours(rig) * _half(_along(rig) * (1.0 if base == "mux-1" else -1.0))).sum(1)
        )
    match = re.fullmatch(r"olat-(\d{3,})", base)
    if match:
        wanted = [int(match.group(1)) == light.id for light in rig.lights]
        if not any(wanted):
            raise PatternError(
                f"pattern {name}",
                found="no lamp of this id",
                expected=f"one of {counted(count, 'lamp')}",
            )
        return np.array(wanted, float)
    raise _unknown(name)


def _unknown(name: str) -> PatternError:
    return PatternError(
        f"pattern {name!r}",
        found="an unknown name",
        expected="full, dark, x+ x- y+ y- z+ z-, lin-x+ .., mux-1 mux-2, olat-NNN, each also "
        "@parallel, @cross",
        hint=f"Named sequences: {', '.join((*SEQUENCES, OLAT))}.",
    )
