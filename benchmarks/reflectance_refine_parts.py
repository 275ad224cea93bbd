"""What the parts of `refine` cost on one view, and its sum over lamps beside a plain one."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np
from numba import njit, prange

from lightstage.formats.mesh import read_ply
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.session import Session
from processing.frames.read import read_foreground, read_frames
from processing.lighting.lights import pattern_lights
from processing.lighting.lobe import transport
from processing.refinement.config import RefineConfig
from processing.refinement.every_pixel import solve_view
from processing.refinement.gloss_search import find_gloss
from processing.refinement.joint import lamps_of
from processing.refinement.joint_light import Lamps, gather
from processing.refinement.scene import Scene, View, gloss_of, place_of, prepare_scene, read_view
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
        "of refine: rays to lights and sky",
        lambda: prepare_scene(mesh, lights, [(camera, lit)], config),
    )
    grid = clock.run(
        "of refine: readings of a grid",
        lambda: read_view(frames, camera, lit, scene, config, config.gloss_pixels),
    )
    scene_found, found, _ = clock.run(
        "of refine: gloss and ways of light", lambda: find_gloss(scene, [grid], config)
    )
    solved = clock.run(
        "of refine: every pixel",
        lambda: solve_view(scene_found, frames, camera, lit, grid, found[0], config),
    )
    clock.run(
        "of refine: writing the maps",
        lambda: write_refined(
            folder, name, solved.mask, solved.maps.pixel_maps(), solved.maps.occlusion,
            config.coarse_confidence,
        ),
    )  # fmt: skip
    compare_light(scene_found, grid, clock)
    return clock.seconds


def compare_light(scene: Scene, grid: View, clock: Clock) -> None:
    """Sum the lamps' light at a grid's pixels, eight lamps at once and one after the other.

    Eight at once give slopes of light and lobe, too. The rows' names state the largest difference.
    """
    place, sight = place_of(scene, grid), grid.sight
    points, normals, views, roughness = (
        np.ascontiguousarray(values, np.float32)
        for values in (
            place.points_mm, sight.normals, place.views, gloss_of(scene, sight)[0],
        )
    )  # fmt: skip
    given = points, normals, views, roughness, sight.shadows.corners, sight.shadows.weights
    lamps = lamps_of(scene.lights, place, scene.interface)
    found = np.zeros((len(points), len(scene.lights.patterns), 12), np.float32)

    def plain() -> tuple[np.ndarray, np.ndarray]:
        return transport(
            scene.lights, points, normals, views, roughness, sight.shadows, scene.interface
        )

    _gathered(*given, lamps, found)
    known = plain()
    off = max(float(np.abs(found[:, :, 4 * k] - known[k]).max()) for k in range(2))
    count = f"{len(points):,} pixels"
    clock.run(
        f"light at {count}, eight lamps at once (off by {off:.1g} at most)",
        lambda: _gathered(*given, lamps, found),
    )
    # What is skipped where there is none, as it was before: zeros are read and added.
    nothing = np.zeros((len(scene.surface.vertices), *lamps.bounced.shape[1:]), np.float32)
    dark = np.zeros((len(scene.lights.patterns), 3, 4), np.float32)
    all_read, again = lamps._replace(bounced=nothing, stray=dark), np.zeros_like(found)
    clock.run(
        "the same, other skin's and polarisers' light added though there is none",
        lambda: _gathered(*given, all_read, again),
    )
    if not (len(lamps.bounced) or len(lamps.stray)) and not np.array_equal(found, again):
        raise AssertionError("what is skipped changes the light")
    clock.run("its plain twin, one lamp after the other, without slopes", plain)


@njit(parallel=True, cache=True, error_model="numpy")
def _gathered(
    points: np.ndarray, normals: np.ndarray, views: np.ndarray, roughness: np.ndarray,
    corners: np.ndarray, weights: np.ndarray, lamps: Lamps, out: np.ndarray,
) -> None:  # fmt: skip
    for i in prange(len(points)):
        gather(points[i], normals[i], views[i], roughness[i], corners[i], weights[i], lamps, out[i])
