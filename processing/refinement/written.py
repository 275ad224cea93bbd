"""Writing a view's exact maps, with coarse ones in holes, or all coarse where none is exact."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from lightstage.commands import ProgressCallback, quiet
from lightstage.formats.mesh import Mesh
from lightstage.formats.processed import ProcessedFolder
from lightstage.rig import Camera
from processing.coarse_maps import has_coarse, read_coarse, write_as_view
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
    """Write a view's maps and mask, with those of `separate` where only they are known.

    Args:
        folder: may hold the coarse maps in its work folder.
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
    coarse = read_coarse(folder.root, camera_id) if has_coarse(folder.root, camera_id) else None
    holes = np.zeros_like(mask) if coarse is None else coarse.mask & ~mask
    if others is not None:
        holes &= ~others
    every, any_hole = mask | holes, bool(holes.any())
    confidence = float(maps.confidence.sum(dtype=float))

    def write(field: str, name: str) -> float:
        """Write one map; the sum of the coarse values that it keeps."""
        image, kept = pasted(mask, getattr(maps, field)), 0.0
        if coarse is not None and any_hole:
            known = coarse.values(name)[holes[coarse.mask]].astype(np.float32)
            if field == "confidence":
                known *= np.float32(share)
            image[holes] = known
            kept = float(known.sum(dtype=float))
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
    """Write the coarse maps as they are, since these last, and the mesh's ambient occlusion.

    Args:
        folder: with the maps of `separate` in its work folder.
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
        coarse = write_as_view(folder, camera.id)
        mask = coarse.mask
        sight = see(surface, camera, foreground)
        occlusion = np.ones(mask.shape, np.float32)
        occlusion[sight.mask] = sight.occlusion
        folder.write_view(camera.id, "ambient_occlusion", np.where(mask, occlusion, 0))
        trust = coarse.values("confidence").astype(np.float32)
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
