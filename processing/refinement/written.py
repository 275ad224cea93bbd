"""Writing a view's exact maps; coarse ones stay in holes, and where none can be exact."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from lightstage.commands import ProgressCallback, quiet
from lightstage.formats.mesh import Mesh
from lightstage.formats.processed import ProcessedFolder
from lightstage.rig import Camera
from processing.lighting.lights import PatternLights
from processing.parallel import cores
from processing.refinement.config import RefineConfig
from processing.surface import lit_surface, see
from processing.view_maps import MAP_NAMES, PixelMaps, pasted

UNSPLIT_MM = 1e6
"""Open sky needs no finer triangles than the mesh's."""

MOST_AT_ONCE = 2
"""Maps read and written at once, at most: each takes 18 bytes a pixel of the whole picture."""


def write_refined(
    folder: ProcessedFolder,
    camera_id: str,
    mask: np.ndarray,
    maps: PixelMaps,
    occlusion: np.ndarray,
    share: float,
    others: np.ndarray | None = None,
) -> tuple[int, float]:
    """Write a view's maps and mask, those of `separate` kept where only they are known.

    Args:
        folder: may hold the coarse maps.
        camera_id: the view.
        mask: (h, w) bool with n true pixels.
        maps: of these.
        occlusion: (n,) of these, 1 = open.
        share: of their confidence that coarse maps keep.
        others: (h, w) bool, pixels that show an occluder and no skin: they keep no coarse maps.
            None where there are none.

    Returns:
        How many pixels the view has now, and their mean confidence.
    """
    every = mask
    if all(folder.view_path(camera_id, name).is_file() for name in MAP_NAMES.values()):
        coarse = folder.read_mask(camera_id)
        every = mask | (coarse if others is None else coarse & ~others)
    holes = every & ~mask
    any_hole = bool(holes.any())
    confidence = float(maps.confidence.sum(dtype=float))

    def write(field: str, name: str) -> float:
        """Write one map; the sum of the coarse values that it keeps."""
        image, kept = pasted(mask, getattr(maps, field)), 0.0
        if any_hole:
            coarse = folder.read_half_view(camera_id, name)[holes].astype(np.float32)
            if field == "confidence":
                coarse *= np.float32(share)
            image[holes] = coarse
            kept = float(coarse.sum(dtype=float))
        folder.write_view(camera_id, name, image)
        return kept

    with ThreadPoolExecutor(min(cores(), MOST_AT_ONCE)) as pool:
        kept = {field: pool.submit(write, field, name) for field, name in MAP_NAMES.items()}
        open_sky = pasted(mask, occlusion)
        open_sky[holes] = 1
        folder.write_view(camera_id, "ambient_occlusion", open_sky)
        folder.write_mask(camera_id, every)
        confidence += kept["confidence"].result()
        for each in kept.values():
            each.result()
    count = int(np.count_nonzero(every))
    return count, confidence / count if count else float("nan")


def keep_coarse(
    folder: ProcessedFolder,
    mesh: Mesh,
    lights: PatternLights,
    seen_by: list[tuple[Camera, np.ndarray]],
    config: RefineConfig,
    occluders: Mesh | None = None,
    progress: ProgressCallback = quiet,
) -> dict[str, Any]:
    """Write the mesh's ambient occlusion beside the coarse maps, which stay as they are.

    Args:
        folder: with the maps of `separate`.
        mesh: mm, world.
        lights: of the session's patterns.
        seen_by: cameras and their (h, w) bool foregrounds.
        config: see there.
        occluders: what else hides the sky from the skin.
        progress: counts views.

    Returns:
        Facts as of `refine`, with a warning.
    """
    surface = lit_surface(
        mesh,
        lights,
        offset_mm=config.shadow_offset_mm,
        smoothing_mm=config.smoothing_mm,
        directions=config.occlusion_directions,
        most_faces=config.most_faces,
        finest_mm=UNSPLIT_MM,
        occluders=occluders,
    )
    confidence: dict[str, float] = {}
    pixels = 0
    for done, (camera, foreground) in enumerate(seen_by, 1):
        mask = folder.read_mask(camera.id)
        sight = see(surface, camera, foreground)
        occlusion = np.ones(mask.shape, np.float32)
        occlusion[sight.mask] = sight.occlusion
        folder.write_view(camera.id, "ambient_occlusion", np.where(mask, occlusion, 0))
        trust = folder.read_view(camera.id, "confidence")[mask]
        confidence[camera.id] = round(float(trust.mean()), 4) if len(trust) else 0.0
        pixels += len(trust)
        progress(done, len(seen_by))
    return {
        "maps": "coarse",
        "views": len(seen_by),
        "pixels": pixels,
        "vertices": surface.coarse,
        "mean_confidence": confidence,
        "warnings": [
            f"{', '.join(lights.patterns)} cannot be refined: the maps are the coarse ones of "
            "`separate`, without shadows. `--sequence binary` gives exact ones"
        ],
    }
