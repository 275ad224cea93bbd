"""A simulated session: a person photographed in the stage, with truth beside it."""

from __future__ import annotations

import dataclasses
import datetime
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from lightstage.commands import ProgressCallback
from lightstage.formats.exr import write_exr
from lightstage.formats.files import sha256_file
from lightstage.formats.landmarks import write_points_px
from lightstage.formats.session import Driven, Frame, SessionFile, save_session, session_id
from lightstage.patterns import pattern_levels, sequence_patterns
from lightstage.rig import save_rig
from sim.errors import SimError
from sim.truth import landmarks_px
from sim.world import World


@dataclasses.dataclass(frozen=True)
class SessionConfig:
    """How a session is simulated.

    Attributes:
        sequence: named sequence or comma-separated patterns.
        click_noise_px: of a landmark.
        texture_rows: of the subject.
    """

    sequence: str = "binary"
    click_noise_px: float = 0.5
    texture_rows: int = 1536


def truth_path(session: Path) -> Path:
    """Where a simulated session's truth lies."""
    return session.with_name(session.name + ".truth")


def require_new(out: Path) -> None:
    """SimError when a session is there already: photographs are never overwritten."""
    if (out / "session.json").exists() or (out / "journal.jsonl").exists():
        raise SimError(
            out, found="a session", expected="a new folder", hint="Remove it or name another."
        )


def write_direct(
    world: World, out: Path, config: SessionConfig, seed: int, progress: ProgressCallback
) -> Path:
    """Write a session of linear EXR frames without any device.

    Args:
        world: the person in the rig.
        out: session folder.
        config: see there.
        seed: of the landmark clicks.
        progress: of frames.

    Returns:
        `out`. session.json is written last, so a folder without it is unfinished.
    """
    patterns = sequence_patterns(config.sequence)
    levels = {name: pattern_levels(name, world.rig) for name in patterns}
    created = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    save_rig(world.rig, out / "rig.json")
    frames = []
    total = len(patterns) * len(world.rig.cameras)
    with ThreadPoolExecutor(2) as pool:
        for camera in world.rig.cameras:
            pictures = world.photograph(camera.id, np.stack(list(levels.values())))
            paths = [f"frames/{name}/{camera.id}.exr" for name in patterns]
            list(pool.map(lambda p, image: write_exr(out / p, image), paths, pictures))
            for name, path in zip(patterns, paths, strict=True):
                frames.append(
                    Frame(
                        pattern=name,
                        camera=camera.id,
                        path=path,
                        sha256=sha256_file(out / path),
                        encoding="linear",
                    )
                )
            progress(len(frames), total)
    write_landmarks(world, out, seed, config.click_noise_px)
    subject = world.subject
    file = SessionFile(
        id=session_id(subject.name, subject.expression, created),
        created_utc=created,
        subject=subject.name,
        expression=subject.expression,
        sequence=list(patterns),
        frames=sorted(frames, key=lambda f: (patterns.index(f.pattern), f.camera)),
        patterns={name: Driven(levels=level.tolist()) for name, level in levels.items()},
    )
    save_session(out, file)
    return out


def write_landmarks(world: World, out: Path, seed: int, noise_px: float) -> Path:
    """Write landmarks.json as someone would have clicked it."""
    rng = np.random.default_rng([seed, 68])
    points = {camera.id: landmarks_px(world, camera, rng, noise_px) for camera in world.rig.cameras}
    return write_points_px(points, out / "landmarks.json")
