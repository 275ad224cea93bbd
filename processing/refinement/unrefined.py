"""Sessions that cannot be refined keep their coarse maps; the mesh adds what it alone gives."""

from __future__ import annotations

from typing import Any

import numpy as np

from lightstage.commands import ProgressCallback, quiet
from lightstage.formats.mesh import Mesh
from lightstage.formats.processed import ProcessedFolder
from lightstage.rig import Camera
from processing.lighting.lights import PatternLights
from processing.refinement.config import RefineConfig
from processing.surface import lit_surface, see

UNSPLIT_MM = 1e6
"""Open sky needs no finer triangles than the mesh's."""


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
