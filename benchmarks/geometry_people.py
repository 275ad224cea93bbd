"""People of known shape under nine cameras: sessions for the benchmarks of `reconstruct`.

Run `python -m benchmarks.geometry_people [NAME ..] [--light reference]` to make them ahead of the
benchmarks, which make what they miss. They are kept beside the people of known reflectance. Frames
are linear and without noise; faces have no facets (geometry_smooth.py).
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from benchmarks.geometry_displaced import displaced, write_shape
from benchmarks.geometry_smooth import without_facets
from benchmarks.reflectance_people import SCALE, Known, folder
from lightstage.commands import quiet
from lightstage.formats.files import atomic_folder
from lightstage.patterns import pattern_levels, sequence_patterns
from lightstage.rig import default_rig
from sim.light.world import World
from sim.people.person import person_skin
from sim.people.subjects import load_subject
from sim.people.traits import Traits
from sim.reference.world import ReferenceWorld
from sim.session import SessionConfig, truth_path, write_direct
from sim.truth import write_truth

TEXTURE_ROWS = 3072

PEOPLE = (
    Known("lps", 0, None, "scan"),
    Known("plain", 201, Traits("female", 30, 3), "own"),
    Known("freckled", 202, Traits("male", 35, 1, "freckled"), "own"),
    Known("ict", 203, None, "ICT"),
)
RELIEF = Known("relief", 201, Traits("female", 30, 3), "own")
"""The plain person once more, the mesh displaced by its own relief (geometry_displaced.py)."""


def person(name: str) -> Known:
    """A person of the benchmark by name."""
    return next(known for known in (*PEOPLE, RELIEF) if known.name == name)


def session(known: Known, *, light: str = "direct", scale: float = SCALE) -> Path:
    """A person's session of nine views without noise, made where it is missing.

    Args:
        known: who.
        light: ``direct``, or ``reference`` with bounces and subsurface scattering.
        scale: share of the default rig's pixels a side.

    Returns:
        The session folder; truth is beside it.
    """
    root = folder() / f"geometry-{known.name}-{known.seed}-{light}-{scale:g}-smooth"
    if not root.is_dir():
        with atomic_folder(root, "session") as beside:
            _make(known, light, scale, beside / "session")
    return root / "session"


def _make(known: Known, light: str, scale: float, out: Path) -> None:
    rig = default_rig().scaled(scale)
    subject = load_subject(known.name, known.seed, None, TEXTURE_ROWS, known.traits)
    subject = without_facets(subject)
    if known is RELIEF:
        assert known.traits is not None
        skin = person_skin(known.seed, known.traits, TEXTURE_ROWS)
        subject = displaced(subject, skin.height_mm(subject.expression))
        del skin
    world = World(subject, rig, samples=3)
    (write_shape if known is RELIEF else write_truth)(world, truth_path(out))
    config = SessionConfig(sequence="binary")
    if light == "direct":
        write_direct(world, out, config, known.seed, quiet)
        return
    lit = ReferenceWorld(subject, rig)
    del world
    names = sequence_patterns("binary", rig)
    lit.prepare(np.stack([pattern_levels(name, rig) for name in names]))
    write_direct(lit, out, config, known.seed, quiet)


def main() -> None:
    """Make the people that are named, or all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=[known.name for known in PEOPLE])
    parser.add_argument("--light", choices=("direct", "reference"), default="direct")
    chosen = parser.parse_args()
    for name in chosen.names:
        print(session(person(name), light=chosen.light), flush=True)


if __name__ == "__main__":
    main()
