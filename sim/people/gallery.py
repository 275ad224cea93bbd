"""A contact sheet: people of a table, in several expressions, under several lights."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from lightstage.commands import ProgressCallback, quiet
from lightstage.rig import Rig
from sim.light.portrait import portrait
from sim.light.relight import auto_exposure, require_picture, write_picture
from sim.people.dataset import Person
from sim.people.person import person_expressions

CAMERA = "cam0"


def write_gallery(
    persons: Sequence[Person],
    expressions: Sequence[str],
    lights: Sequence[str],
    rig: Rig,
    rows: int,
    out: Path,
    progress: ProgressCallback = quiet,
) -> Path:
    """Write a picture with a row for each person and a column for each expression and light.

    All pictures under one light have one exposure, as on a stage: dark skin stays darker. All are
    cut to the box that holds everyone.

    Args:
        persons: the simulated people.
        expressions: the columns of each light.
        lights: patterns or environments (`sim.light.portrait.portrait`).
        rig: lamps and cameras; the frontal one looks.
        rows: of the textures.
        out: .png or .exr.
        progress: of pictures.

    Returns:
        `out`.
    """
    require_picture(out)
    count = len(persons) * len(expressions) * len(lights)
    seen: dict[str, list[np.ndarray]] = {light: [] for light in lights}
    done = 0
    for person in persons:
        for subject in person_expressions(
            person.name, person.seed, expressions, rows, person.traits
        ):
            for light in lights:
                seen[light].append(portrait(subject, rig, CAMERA, light))
                done += 1
                progress(done, count)
    box = _box(np.concatenate(list(seen.values())))
    columns = []
    for uncut in seen.values():
        pictures = [picture[box] for picture in uncut]
        exposed = np.concatenate(pictures) * auto_exposure(np.concatenate(pictures))
        height = pictures[0].shape[0] * len(expressions)
        people = [exposed[first : first + height] for first in range(0, len(exposed), height)]
        columns.append(
            np.concatenate(
                [np.concatenate(np.split(one, len(expressions)), axis=1) for one in people]
            )
        )
    return write_picture(np.concatenate(columns, axis=1), out, 1.0)


def _box(pictures: np.ndarray) -> tuple[slice, slice]:
    """Rows and columns of (n, h, w, 3) pictures in which anyone is seen, and a little margin."""
    lit = pictures.max(axis=(0, 3)) > 0
    sides = []
    for axis in (1, 0):
        at = np.flatnonzero(lit.any(axis=axis))
        margin = lit.shape[1] // 40
        first, last = (at[0], at[-1]) if len(at) else (0, lit.shape[1 - axis] - 1)
        sides.append(slice(max(0, first - margin), last + margin + 1))
    return sides[0], sides[1]
