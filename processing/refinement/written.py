"""Writing a view's exact maps, with the coarse ones where the mesh has a hole."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from lightstage.formats.processed import ProcessedFolder
from processing.parallel import cores
from processing.view_maps import MAP_NAMES, PixelMaps, pasted

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
