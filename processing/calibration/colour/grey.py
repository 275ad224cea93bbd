"""A grey ball of known reflectance: does a camera read absolute albedo?"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from lightstage.formats.environment import LightSet
from processing.calibration.ball import Picture, find_ball, rays_through, sphere_hits
from processing.calibration.colour.config import GreyAlbedoConfig
from processing.calibration.colour.white import white_at
from processing.errors import ProcessingError


def ball_albedo(
    pictures: list[Picture], lights: LightSet, config: GreyAlbedoConfig, where: Path
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """What each camera reads the ball's albedo to be.

    Args:
        pictures: of a grey ball under the lights, linear rgb by the cameras' corrections and at
            their exposure.
        lights: what shone, on the session's scale.
        config: see there.
        where: to name in errors.

    Returns:
        Camera id to (3,) median of pixel / white, and facts: spread over the ball, by camera.

    Raises:
        ProcessingError: no ball in two cameras, or too little of it that is lit.
    """
    outline = find_ball(pictures, config.radius_mm, where)
    albedo: dict[str, np.ndarray] = {}
    facts: dict[str, Any] = {}
    for picture in pictures:
        camera = picture.camera
        rows, columns = np.nonzero(picture.valid)
        middle = camera.project(outline.centre_mm[None])[0][0]
        reach = 1.2 * outline.radius_mm * camera.fx_px / np.linalg.norm(camera.centre_mm)
        near = np.hypot(columns + 0.5 - middle[0], rows + 0.5 - middle[1]) < reach
        rows, columns = rows[near], columns[near]
        rays = rays_through(camera, np.stack([columns, rows], axis=1) + 0.5)
        points, hit = sphere_hits(outline.centre_mm, outline.radius_mm, camera.centre_mm, rays)
        normals = (points - outline.centre_mm) / outline.radius_mm
        seen = hit & (-np.einsum("nk,nk->n", normals, rays) > config.facing)
        white = white_at(points[seen], normals[seen], lights)
        ratio = picture.rgb[rows[seen], columns[seen]].astype(float)
        bright = white.min(axis=1) > config.lit_share * white.max(initial=0.0)
        if bright.sum() < 50:
            continue
        ratio = ratio[bright] / white[bright]
        albedo[camera.id] = np.median(ratio, axis=0)
        off = ratio / albedo[camera.id] - 1
        facts[camera.id] = {
            "albedo": np.round(albedo[camera.id], 5).tolist(),
            "spread_over_the_ball": round(float(1.4826 * np.median(np.abs(off))), 5),
        }
    if not albedo:
        raise ProcessingError(
            where,
            found="no lit part of the ball in any camera",
            expected="a grey ball in the middle of the stage",
            hint="Is the ball's radius right?",
        )
    return albedo, facts
