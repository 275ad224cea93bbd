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

    All pictures under one light have one exposure, as on a stage: dark skin stays darker.

    Args:
        persons: who.
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
    columns = []
    for pictures in seen.values():
        exposed = np.concatenate(pictures) * auto_exposure(np.concatenate(pictures))
        height = pictures[0].shape[0] * len(expressions)
        people = [exposed[first : first + height] for first in range(0, len(exposed), height)]
        columns.append(
            np.concatenate(
                [np.concatenate(np.split(one, len(expressions)), axis=1) for one in people]
            )
        )
    return write_picture(np.concatenate(columns, axis=1), out, 1.0)
