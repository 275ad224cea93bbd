"""A simulated session: a person photographed in the stage, with truth beside it."""

from __future__ import annotations

import dataclasses
import datetime
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from lightstage.commands import ProgressCallback
from lightstage.formats.exr import write_exr
from lightstage.formats.files import sha256_file, write_json
from lightstage.formats.landmarks import LANDMARKS, write_points_px
from lightstage.formats.session import Driven, Frame, SessionFile, save_session, session_id
from lightstage.patterns import pattern_levels, sequence_patterns
from lightstage.rig import save_rig
from sim.camera.flaws import CaptureFlaws
from sim.camera.shooting import Shooting
from sim.errors import SimError
from sim.light.polarised import behind_polarisers, is_polarised
from sim.light.world import World
from sim.reference.world import ReferenceWorld
from sim.truth import landmarks_px


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
    """The folder of a simulated session's truth."""
    return session.with_name(session.name + ".truth")


def flaws_path(session: Path) -> Path:
    """The record of what was done to the light, in the session's truth."""
    return truth_path(session) / "flaws.json"


def faults_path(session: Path) -> Path:
    """The log of what went wrong with the devices, in the session's truth."""
    return truth_path(session) / "faults.jsonl"


def require_new(out: Path) -> None:
    """SimError when a session is there already: photographs are never overwritten."""
    if (out / "session.json").exists() or (out / "journal.jsonl").exists():
        raise SimError(
            out, found="a session", expected="a new folder", hint="Remove it or name another."
        )


def write_direct(
    world: World | ReferenceWorld,
    out: Path,
    config: SessionConfig,
    seed: int,
    progress: ProgressCallback,
    flaws: CaptureFlaws | None = None,
    consent: str | None = None,
) -> Path:
    """Write a session of linear EXR frames without any device.

    Lens, room and sway are in the frames; shutter and sensor, and so bands, mosaic and noise, are
    not. What was done is written into the truth's folder.

    Args:
        world: the person in the rig.
        out: session folder.
        config: see there.
        seed: of the landmark clicks, lenses and sway.
        progress: of frames.
        flaws: what the apparatus does to the light; the default does nothing.
        consent: id of a consent record, None for none.

    Returns:
        `out`. session.json is written last, so a folder without it is unfinished.
    """
    patterns = sequence_patterns(config.sequence, world.rig)
    levels = {name: pattern_levels(name, world.rig) for name in patterns}
    created = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    save_rig(world.rig, out / "rig.json")
    shooting = Shooting(world, flaws or CaptureFlaws(), seed)
    through = [is_polarised(name) for name in patterns]
    filtered = shooting
    if any(through):
        filtered = Shooting(behind_polarisers(world), flaws or CaptureFlaws(), seed)
    frames: list[Frame] = []
    total = len(patterns) * len(world.rig.cameras)
    # Rays are cast anew for each pose of a swaying subject, so its photographs go pose by pose.
    together = 1 if shooting.sways else len(patterns)
    batches = []
    for polarised in (False, True):
        some = [k for k in range(len(patterns)) if through[k] == polarised]
        batches += [some[k : k + together] for k in range(0, len(some), together)]
    with ThreadPoolExecutor(2) as pool:
        for batch in batches:
            states = np.stack([levels[patterns[k]] for k in batch])
            for camera in world.rig.cameras:
                seen = filtered if through[batch[0]] else shooting
                pictures = seen.light(camera.id, states, batch)
                paths = [f"frames/{patterns[k]}/{camera.id}.exr" for k in batch]
                list(pool.map(lambda p, image: write_exr(out / p, image), paths, pictures))
                frames += [
                    Frame(
                        pattern=patterns[k],
                        camera=camera.id,
                        path=path,
                        sha256=sha256_file(out / path),
                        encoding="linear",
                    )
                    for k, path in zip(batch, paths, strict=True)
                ]
                progress(len(frames), total)
    write_json(flaws_path(out), shooting.record({name: k for k, name in enumerate(patterns)}))
    write_landmarks(world, out / LANDMARKS, seed, config.click_noise_px)
    subject = world.subject
    more: dict[str, Any] = {} if consent is None else {"consent": consent}
    file = SessionFile(
        id=session_id(subject.name, subject.expression, created),
        created_utc=created,
        subject=subject.name,
        expression=subject.expression,
        sequence=list(patterns),
        frames=sorted(frames, key=lambda f: (patterns.index(f.pattern), f.camera)),
        patterns={name: Driven(levels=level.tolist()) for name, level in levels.items()},
        **more,
    )
    save_session(out, file)
    return out


def write_landmarks(world: World | ReferenceWorld, path: Path, seed: int, noise_px: float) -> Path:
    """Write a session's landmarks.json as someone would have clicked it; returns `path`."""
    rng = np.random.default_rng([seed, 68])
    points = {camera.id: landmarks_px(world, camera, rng, noise_px) for camera in world.rig.cameras}
    return write_points_px(points, path)
