"""Stage `separate`: coarse maps of each view, lights far away, no shadows."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from lightstage.commands import ProgressCallback, quiet
from lightstage.formats.session import Session
from processing.coarse_maps import SCALE_WHITE, write_coarse
from processing.errors import ProcessingError
from processing.frames.read import read_foreground, read_frames
from processing.lighting.lights import PatternLights, pattern_lights
from processing.parallel import over_views, workers
from processing.separation.choice import METHODS, chosen_method, normals_of
from processing.separation.config import SeparateConfig, relief_of
from processing.separation.view import separate_view

BYTES_A_PIXEL, BYTES_OF_ARRAYS = 50, 400
"""What a view takes at most for a pixel of its picture: by the one pass of `colour`, and by methods
that make arrays of all readings."""
MOST_ILL_POSED = 0.5
"""Share of all views' pixels above which the maps mean nothing."""
DIM = 0.15
"""Median reading of the face under its brightest pattern, of white, below which noise and not
patterns or lamps may be what hides the normals: dark skin reads about .07, light skin .4."""
MEDIAN_PIXELS = 10_000
"""About so many pixels of a view show the median of its albedo."""
COLOUR_SPREAD = 0.02
"""Lights whose colours differ by more than this get a warning."""


def separate(
    session: Session, out: Path, config: SeparateConfig, progress: ProgressCallback = quiet
) -> dict[str, Any]:
    """Write every view's coarse maps to OUT/work: albedos, normals, roughness, confidence.

    Returns:
        Facts: method, normals, lights, views, pixels, mean confidence, share of pixels that are
        ill-posed (eyes, teeth, grey hair, rims: confidence below .5), warnings.

    Raises:
        ProcessingError: patterns that no method, or not the chosen one, can separate; more than
            `MOST_ILL_POSED` of the face ill-posed though it is well lit.
    """
    cameras = session.camera_ids()
    confidence: dict[str, float] = {}
    ill_posed: dict[str, float] = {}
    counted_px: dict[str, int] = {}
    pixels = 0
    warnings: list[str] = []
    lights = pattern_lights(session, read_frames(out, cameras[0]).patterns)
    method = chosen_method(lights, config)
    warnings += _warnings(lights, method)

    def one(camera_id: str) -> tuple[float, float, int, float]:
        frames = read_frames(out, camera_id)
        mask = read_foreground(out, camera_id)
        camera = session.rig.camera(camera_id)
        maps = separate_view(method, frames, mask, camera, lights, config)
        write_coarse(out, camera_id, maps)
        found = maps.confidence
        some = maps.albedo[:: max(1, len(found) // MEDIAN_PIXELS)]
        albedo = float(np.median(some[some.any(axis=1)])) if some.any() else 0.0
        return float(found.mean()), float((found < 0.5).mean()), len(found), albedo

    sizes = [session.rig.camera(c).width_px * session.rig.camera(c).height_px for c in cameras]
    each = BYTES_A_PIXEL if method == "colour" else BYTES_OF_ARRAYS
    at_once = workers(each * max(sizes))
    for camera_id, (mean, unsure, count, albedo) in over_views(one, cameras, at_once):
        confidence[camera_id] = round(mean, 4)
        ill_posed[camera_id] = round(unsure, 4)
        counted_px[camera_id] = count
        if albedo > 1:
            warnings.append(
                f"{camera_id}: the median diffuse albedo is {albedo:,.1f}, more than a white's 1, "
                f"so that albedo and gloss are not the skin's; {SCALE_WHITE}"
            )
        pixels += count
        progress(len(confidence), len(cameras))
    share = sum(each * counted_px[camera] for camera, each in ill_posed.items()) / max(pixels, 1)
    if share > MOST_ILL_POSED:
        worst = max(ill_posed, key=lambda camera: ill_posed[camera])
        found = f"{100 * share:.0f} % of the face ill-posed ({worst}: {ill_posed[worst]:.0%})"
        dim, lost = _face_reading(out, worst), _lost_share(out, worst)
        fault = ProcessingError(
            out / "work" / "coarse",
            field="confidence",
            found=found,
            expected=f"at most {100 * MOST_ILL_POSED:g} %",
            hint=(
                f"{lost:.0%} of the face is clipped or no number in some photograph: expose less, "
                "by what `full` shows, which clips first. "
                if lost > MOST_ILL_POSED
                else "Do the photographs show the patterns that session.json names, and do the "
                "rig's lamps where it has them? `lightstage check SESSION` shows more. "
            )
            + "--force continues, and the report then shows the maps.",
        )
        if dim < DIM:
            warnings.append(
                f"{found}: the face reads {dim:.2g} of white under its brightest pattern, so that "
                "noise hides part of the normals; give more light or longer exposures"
            )
        elif config.forced:
            warnings.append(f"forced: {fault}")
        else:
            raise fault
    return {
        "method": method,
        "diffuse_normals": normals_of(method, config),
        "specular_normals": relief_of(METHODS[method].relief, config),
        "lights": lights.source,
        "views": len(cameras),
        "pixels": pixels,
        "mean_confidence": confidence,
        "ill_posed_share": ill_posed,
        "warnings": warnings,
    }


def _face_reading(out: Path, camera_id: str) -> float:
    """Median of what one camera's face reads under its brightest pattern, 1 = white."""
    shown = read_frames(out, camera_id).brightest()[read_foreground(out, camera_id)]
    return float(np.median(shown)) if len(shown) else 0.0


def _lost_share(out: Path, camera_id: str) -> float:
    """Share of one camera's face that some photograph shows clipped, or as no number."""
    usable = read_frames(out, camera_id).valid[read_foreground(out, camera_id)]
    return float(1 - usable.mean()) if len(usable) else 0.0


def _warnings(lights: PatternLights, method: str) -> list[str]:
    if method == "mux" or lights.colour_spread <= COLOUR_SPREAD:
        return []
    return [
        f"light colours differ by up to {lights.colour_spread:.2f} of their mean; "
        "separation by colour takes them as equal"
    ]
