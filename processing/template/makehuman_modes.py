"""MakeHuman's sliders as a population's modes, and its expressions under ICT's names."""

from __future__ import annotations

import numpy as np

from lightstage.formats.expression_sides import left_share
from lightstage.formats.template import Modes
from processing.registration.both_ways import vertex_areas

DEVIATION = 1 / 6
"""Of a slider, where 1 is its end. With a third, heads drawn from all sliders at once are
caricatures: they differ by 11 mm, ICT's people by 5."""
MOST = 100
"""Identity modes are no more."""
STILL_MM = 1e-3
"""A mode that moves no vertex farther is left out."""
ICT = {
    "eye-left-closure": "eyeBlink_L", "eye-right-closure": "eyeBlink_R",
    "eye-left-opened-up": "eyeWide_L", "eye-right-opened-up": "eyeWide_R",
    "eye-left-slit": "eyeSquint_L", "eye-right-slit": "eyeSquint_R",
    "eyebrows-left-down": "browDown_L", "eyebrows-right-down": "browDown_R",
    "eyebrows-left-extern-up": "browOuterUp_L", "eyebrows-right-extern-up": "browOuterUp_R",
    "eyebrows-left-inner-up": "browInnerUp_L", "eyebrows-right-inner-up": "browInnerUp_R",
    "nose-left-elevation": "noseSneer_L", "nose-right-elevation": "noseSneer_R",
    "mouth-open": "jawOpen", "mouth-pursing": "mouthPucker", "mouth-protusion": "mouthFunnel",
}  # fmt: skip
"""ICT's names [Li2020] of the same movements; the others keep MakeHuman's."""
BOTH_SIDES = {
    "mouth-corner-puller": "mouthSmile",
    "mouth-depression": "mouthFrown",
    "mouth-retraction": "mouthStretch",
}
"""Movements that ICT has for each side of its own."""


def population(
    sliders_mm: np.ndarray, people_mm: np.ndarray, mean_mm: np.ndarray, area_mm2: np.ndarray
) -> np.ndarray:
    """Principal components of people whose sliders are drawn independently.

    A slider's standard deviation is `DEVIATION` of the way to its end; each of the people is as
    likely as the others. What moves the whole head, as if it were rigid, is taken out.

    Args:
        sliders_mm: (k, n, 3) offsets at the sliders' ends.
        people_mm: (p, n, 3) offsets of equally likely people from their mean.
        mean_mm: (n, 3) the mean head.
        area_mm2: (n,) of the surface around each vertex: variance is counted over the surface.

    Returns:
        (at most `MOST`, n, 3) offsets of one standard deviation each, ordered by variance. With as
        many modes as rows, their outer product is the population's covariance.
    """
    rows = np.concatenate([DEVIATION * sliders_mm, people_mm / np.sqrt(max(len(people_mm), 1))])
    modes = principal(without_rigid(rows.astype(float), mean_mm, area_mm2), area_mm2)[:MOST]
    return np.asarray(modes[np.abs(modes).max(axis=(1, 2), initial=0) > STILL_MM])


def principal(rows: np.ndarray, area: np.ndarray) -> np.ndarray:
    """(k, n, 3) principal components of the covariance rows^T rows, ordered by variance.

    Args:
        rows: (k, n, 3) independent offsets of one standard deviation each.
        area: (n,) of the surface around each vertex: variance is counted over the surface.
    """
    weight = np.sqrt(area / area.sum())[:, None]
    mix, _, _ = np.linalg.svd((rows * weight).reshape(len(rows), -1), full_matrices=False)
    return np.asarray(np.tensordot(mix.T, rows, axes=1))


def without_rigid(offsets: np.ndarray, mean_mm: np.ndarray, area_mm2: np.ndarray) -> np.ndarray:
    """(k, n, 3) offsets without the small rigid motion that is nearest to each.

    Args:
        offsets: (k, n, 3) mm.
        mean_mm: (n, 3), what they move.
        area_mm2: (n,) weights.
    """
    centred = mean_mm - np.average(mean_mm, axis=0, weights=area_mm2)
    axes = np.eye(3)
    motions = np.stack(
        [np.broadcast_to(axis, centred.shape) for axis in axes]
        + [np.cross(axis, centred) for axis in axes]
    ).reshape(6, -1)
    weight = np.repeat(np.sqrt(area_mm2), 3)
    flat = offsets.reshape(len(offsets), -1)
    strength = np.linalg.lstsq((motions * weight).T, (flat * weight).T, rcond=None)[0]
    return np.asarray((flat - strength.T @ motions).reshape(offsets.shape))


def expressions(
    offsets_mm: np.ndarray, names: tuple[str, ...], x_mm: np.ndarray
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Expressions under ICT's names where it has the same movement, else MakeHuman's.

    Args:
        offsets_mm: (e, n, 3).
        names: e of MakeHuman's.
        x_mm: (n,) places of the vertices in the head frame, left of the head above 0.

    Returns:
        Offsets and names; what ICT has for each side is split in two whose sum it is. Those that
        move no vertex are left out.
    """
    left = left_share(x_mm)[:, None]
    found: list[tuple[str, np.ndarray]] = []
    for name, offset in zip(names, offsets_mm, strict=True):
        if np.abs(offset).max(initial=0) <= STILL_MM:
            continue
        if name in BOTH_SIDES:
            found.append((f"{BOTH_SIDES[name]}_L", left * offset))
            found.append((f"{BOTH_SIDES[name]}_R", (1 - left) * offset))
        else:
            found.append((ICT.get(name, name), offset))
    if not found:
        return np.zeros((0, len(x_mm), 3)), ()
    return np.stack([offset for _, offset in found]), tuple(name for name, _ in found)


def modes_of(
    sliders_mm: np.ndarray,
    people_mm: np.ndarray,
    expression_mm: np.ndarray,
    expression_names: tuple[str, ...],
    mean_mm: np.ndarray,
    triangles: np.ndarray,
) -> Modes:
    """All modes of the kept vertices; see `population` and `expressions`.

    Args:
        sliders_mm: (k, n, 3).
        people_mm: (p, n, 3).
        expression_mm: (e, n, 3).
        expression_names: e of MakeHuman's.
        mean_mm: (n, 3) the mean head, in the head frame.
        triangles: (t, 3) of it.
    """
    area = vertex_areas(mean_mm, triangles)
    expression, names = expressions(expression_mm, expression_names, mean_mm[:, 0])
    return Modes(population(sliders_mm, people_mm, mean_mm, area), expression, names)
