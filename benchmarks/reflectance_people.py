"""People whose reflectance is known: sessions for the benchmarks of `separate` and `refine`.

Run `python -m benchmarks.reflectance_people` to make them all ahead of the benchmarks, which make
what they miss. A person is made once and kept in LIGHTSTAGE_BENCHMARK_DATA, or in a folder of the
system's temporary files. Frames are linear and without noise; `noisy` adds it.
"""

from __future__ import annotations

import dataclasses
import os
import tempfile
from pathlib import Path

import numpy as np

from lightstage.commands import quiet
from lightstage.formats.files import atomic_folder
from lightstage.patterns import pattern_levels, sequence_patterns
from lightstage.rig import Rig, default_rig
from sim.light.lamps import lamps_of
from sim.light.world import World
from sim.people.subjects import load_subject
from sim.people.traits import Traits
from sim.reference.world import ReferenceWorld
from sim.session import SessionConfig, truth_path, write_direct
from sim.truth import write_truth

CAMERAS = ("cam0", "cam1", "cam2")
SCALE = 0.25
"""1504 x 1004 pixels of the default rig's 24 megapixels."""
TEXTURE_ROWS = 3072
NEW_LIGHTS = 20
NOISE = 0.001


@dataclasses.dataclass(frozen=True)
class Known:
    """A person of the benchmark.

    Attributes:
        name: of the session's subject; ``lps`` is the scanned head, ``ict`` one of that model.
        seed: of the person.
        traits: who it is; None where the name determines it.
        skin: ``light`` or ``dark``, the table's column.
    """

    name: str
    seed: int
    traits: Traits | None
    skin: str


PEOPLE = (
    Known("tone1", 101, Traits("female", 24, 1), "light"),
    Known("tone1-freckled", 102, Traits("male", 35, 1, "freckled"), "light"),
    Known("tone2-ggx", 103, Traits("female", 45, 2, "ggx"), "light"),
    Known("tone3", 104, Traits("male", 30, 3), "light"),
    Known("tone3-old", 105, Traits("female", 78, 3, "dry"), "light"),
    Known("lps", 0, None, "light"),
    Known("tone4-oily", 106, Traits("male", 40, 4, "oily"), "dark"),
    Known("tone5", 107, Traits("female", 28, 5), "dark"),
    Known("tone5-anisotropic", 108, Traits("male", 52, 5, "anisotropic"), "dark"),
    Known("tone6", 109, Traits("female", 33, 6), "dark"),
    Known("tone6-make-up", 110, Traits("female", 26, 6, "make-up"), "dark"),
)


def folder() -> Path:
    """Where the people are kept."""
    named = os.environ.get("LIGHTSTAGE_BENCHMARK_DATA")
    return Path(named) if named else Path(tempfile.gettempdir()) / "lightstage-benchmarks"


def person(name: str) -> Known:
    """A person of the benchmark by name."""
    return next(known for known in PEOPLE if known.name == name)


def session(
    known: Known, *, light: str = "direct", sequence: str = "binary", scale: float = SCALE
) -> Path:
    """A person's session without noise, made where it is missing; truth is beside it.

    Args:
        known: who.
        light: ``direct``, or ``reference`` with bounces and subsurface scattering.
        sequence: named or comma-separated patterns, driven on and off.
        scale: share of the default rig's pixels a side.

    Returns:
        The session folder. Its truth holds `new_lights`, too.
    """
    patterns = sequence_patterns(sequence, default_rig())
    label = sequence if len(patterns) > 1 and "," not in sequence else "-".join(patterns)
    root = folder() / f"{known.name}-{known.seed}-{light}-{label}-{scale:g}"
    if not root.is_dir():
        with atomic_folder(root, "session") as beside:
            _make(known, light, sequence, scale, beside / "session")
    return root / "session"


def new_lights(session_path: Path, camera_id: str) -> np.ndarray:
    """(20, n, 3) float32: a view's skin under single lights that no pattern used, without noise.

    A perfect white at the origin that faces the light reads 1. Pixels are those of the truth's
    mask, in row order; positions of the lights are `new_rig`'s.
    """
    found = np.load(truth_path(session_path) / "new_lights" / f"{camera_id}.npy")
    return np.asarray(found, np.float32)


def new_rig(rig: Rig) -> Rig:
    """A rig of 20 lights in the frontal half and beyond, between the stage's own, at its radius."""
    stage = rig.positions_mm / np.linalg.norm(rig.positions_mm, axis=1, keepdims=True)
    radius_mm = float(np.linalg.norm(rig.positions_mm, axis=1).mean())
    index = np.arange(200) + 0.5
    z = 1 - index / 200 * 1.2
    turn = index * np.pi * (1 + np.sqrt(5))
    across = np.sqrt(1 - z**2)
    toward = np.stack([across * np.cos(turn), across * np.sin(turn), z], axis=1)
    apart = np.degrees(np.arccos(np.clip((toward @ stage.T).max(axis=1), -1, 1)))
    far = np.flatnonzero(apart > 5)
    chosen = toward[far[np.linspace(0, len(far) - 1, NEW_LIGHTS).astype(int)]]
    lights = tuple(
        dataclasses.replace(
            rig.lights[0],
            id=k,
            name=f"new{k:02d}",
            position_mm=tuple(radius_mm * w),
            rgb_gain=(1.0, 1.0, 1.0),
        )
        for k, w in enumerate(chosen)
    )
    return dataclasses.replace(rig, lights=lights)


def noisy(images: np.ndarray, rng: np.random.Generator, share: float = NOISE) -> np.ndarray:
    """Readings with the benchmark's pixel noise, standard deviation share sqrt(.25 + I)."""
    sigma = share * np.sqrt(0.25 + np.maximum(images, 0))
    return np.asarray(images + sigma * rng.standard_normal(images.shape), np.float32)


def benchmark_rig(scale: float = SCALE) -> Rig:
    """The default rig's lights and its first three cameras."""
    rig = default_rig().scaled(scale)
    return dataclasses.replace(rig, cameras=rig.cameras[: len(CAMERAS)])


def _make(known: Known, light: str, sequence: str, scale: float, out: Path) -> None:
    rig = benchmark_rig(scale)
    subject = load_subject(known.name, known.seed, None, TEXTURE_ROWS, known.traits)
    world = World(subject, rig)
    truth = write_truth(world, truth_path(out))
    lit: World | ReferenceWorld = world
    others = new_rig(rig)
    single = np.eye(NEW_LIGHTS)
    if light == "reference":
        lit = ReferenceWorld(subject, rig)
        names = sequence_patterns(sequence, rig)
        lit.prepare(np.stack([pattern_levels(name, rig) for name in names]))
    write_direct(lit, out, SessionConfig(sequence=sequence), known.seed, quiet)
    lamps = dataclasses.replace(lamps_of(others), weights=np.ones((NEW_LIGHTS, 3)))
    lone = (ReferenceWorld if light == "reference" else World)(subject, others, lamps=lamps)
    (truth / "new_lights").mkdir()
    for camera_id in CAMERAS:
        skin = world.surfaces[camera_id].picture(world.surfaces[camera_id].skin)
        pictures = lone.photograph(camera_id, single)[:, skin]
        np.save(truth / "new_lights" / f"{camera_id}.npy", pictures.astype(np.float16))


def main() -> None:
    """Make every person in both lights."""
    for light in ("direct", "reference"):
        for known in PEOPLE:
            print(session(known, light=light), flush=True)


if __name__ == "__main__":
    main()
