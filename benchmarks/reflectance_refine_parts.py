"""What the parts of `refine` cost on one view."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from lightstage.formats.mesh import read_ply
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.session import Session
from processing.frames.read import read_foreground, read_frames
from processing.lighting.lights import pattern_lights
from processing.refinement.config import RefineConfig
from processing.refinement.every_pixel import solve_view
from processing.refinement.gloss_search import find_gloss
from processing.refinement.scene import prepare_scene, read_view
from processing.refinement.written import write_refined

R = TypeVar("R")


@dataclasses.dataclass
class Clock:
    """Seconds of each part, wall and processor, in the order they were called."""

    seconds: dict[str, tuple[float, float]] = dataclasses.field(default_factory=dict)

    def run(self, name: str, call: Callable[[], R]) -> R:
        """Call, and keep what it took."""
        wall, own = time.perf_counter(), time.process_time()
        result = call()
        self.seconds[name] = (time.perf_counter() - wall, time.process_time() - own)
        return result


def refine_parts(
    opened: Session, out: Path, config: RefineConfig
) -> dict[str, tuple[float, float]]:
    """Seconds, wall and processor, of each part of the stage on a session of one view.

    Args:
        opened: the session.
        out: its decoded photographs and mesh; the maps are written there.
        config: of the stage.
    """
    clock, folder = Clock(), ProcessedFolder(out)
    (name,) = opened.camera_ids()
    camera, frames, lit = (
        opened.rig.camera(name),
        read_frames(out, name),
        read_foreground(out, name),
    )
    lights, mesh = pattern_lights(opened, frames.patterns), read_ply(folder.base_mesh)
    scene = clock.run(
        "rays to lights and sky", lambda: prepare_scene(mesh, lights, [(camera, lit)], config)
    )
    grid = clock.run(
        "readings of a grid",
        lambda: read_view(frames, camera, lit, scene, config, config.gloss_pixels),
    )
    scene_found, found, _ = clock.run(
        "gloss and ways of light", lambda: find_gloss(scene, [grid], config)
    )
    solved = clock.run(
        "every pixel", lambda: solve_view(scene_found, frames, camera, lit, grid, found[0], config)
    )
    clock.run(
        "writing the maps",
        lambda: write_refined(
            folder, name, solved.mask, solved.maps.pixel_maps(), solved.maps.occlusion,
            config.coarse_confidence,
        ),
    )  # fmt: skip
    return clock.seconds
