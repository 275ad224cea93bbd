"""Many parametric people: maps and meshes alone, or whole sessions."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from lightstage.commands import ProgressCallback, quiet
from lightstage.formats.processed import ProcessedFolder
from lightstage.rig import default_rig
from sim.errors import SimError
from sim.head_modes import EXPRESSIONS
from sim.person import parametric_subject
from sim.scene import Scene
from sim.session import SessionConfig, require_new, truth_path, write_direct
from sim.truth import vertex_occlusion, write_atlas, write_truth
from sim.world import World

DEMO_SCALE = 0.1795
"""Sessions of a data set have the demo's picture size: 1080 rows of the default rig's 6016."""


def write_people(
    out: Path,
    subjects: int,
    expressions: int,
    seed: int,
    rows: int,
    progress: ProgressCallback = quiet,
) -> list[Path]:
    """Write each person's truth as a processed folder without views.

    Args:
        out: folder of PERSON-EXPRESSION folders.
        subjects: how many people.
        expressions: of each, neutral first.
        seed: of all of them; equal seeds give equal bytes.
        rows: of the maps.
        progress: of scans.

    Returns:
        The folders.
    """
    done: list[Path] = []
    for name, person_seed, expression in _scans(subjects, expressions, seed):
        subject = parametric_subject(name, person_seed, expression, rows)
        folder = ProcessedFolder(out / f"{name}-{expression}")
        write_atlas(subject, vertex_occlusion(Scene(subject)), folder)
        done.append(folder.root)
        progress(len(done), subjects * expressions)
    return done


def write_sessions(
    out: Path,
    subjects: int,
    expressions: int,
    seed: int,
    rows: int,
    progress: ProgressCallback = quiet,
) -> list[Path]:
    """Write a session of linear frames and its truth for each scan; arguments as `write_people`."""
    rig = default_rig().scaled(DEMO_SCALE)
    done: list[Path] = []
    for name, person_seed, expression in _scans(subjects, expressions, seed):
        session = out / f"{name}-{expression}"
        require_new(session)
        world = World(parametric_subject(name, person_seed, expression, rows), rig)
        write_truth(world, truth_path(session))
        done.append(write_direct(world, session, SessionConfig(), person_seed, quiet))
        progress(len(done), subjects * expressions)
    return done


def _scans(subjects: int, expressions: int, seed: int) -> Iterator[tuple[str, int, str]]:
    """Name, seed and expression of each scan."""
    names = ("neutral", *EXPRESSIONS)
    if expressions > len(names):
        raise SimError(
            "--expressions", found=str(expressions), expected=f"at most {len(names)} ({names})"
        )
    seeds = np.random.SeedSequence(seed).generate_state(subjects)
    for index, person_seed in enumerate(seeds.tolist()):
        for expression in names[:expressions]:
            yield f"person-{index:04d}", person_seed, expression
