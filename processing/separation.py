"""Stage `separate`: coarse maps of each view by colour, lights far away, no shadows."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit, prange

from lightstage.commands import ProgressCallback, quiet
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.session import Session
from lightstage.rig import Camera
from processing.albedo import diffuse_albedo, diffuse_light, pooled, shrunk, specular_evidence
from processing.frames import read_foreground, read_frames
from processing.lights import PatternLights, far_field, no_shadows, pattern_lights
from processing.lobe import SKIN_F0, transport
from processing.normals import chroma_signal, solve_far_normals

COLOUR_SPREAD = 0.02
"""Lights whose colours differ by more than this are worth a warning."""


@dataclasses.dataclass(frozen=True)
class SeparateConfig:
    """What `separate` may be told."""

    iterations: int = 5
    roughness: float = 0.25
    """Beckmann's m of skin, for the lobe."""
    specular_pool_mm: float = 4.0
    """Sigma over which pixels share one specular albedo."""
    specular_prior: float = SKIN_F0
    specular_prior_share: float = 3.0
    """Weight of the prior against the median pixel's evidence: without shadows that is poor."""
    albedo_prior_power: float = 0.005
    """Weight of the neighbours' albedo against a pixel's squared irradiance (2 in the open)."""
    grey_saturation: float = 0.05
    """Below this saturation colour tells nothing; from twice as much it is trusted."""
    dark_level: float = 0.004
    """A pixel whose brightest pattern stays below this tells nothing (1 = white under `full`)."""


@dataclasses.dataclass(frozen=True)
class PixelMaps:
    """Maps of n pixels, 0 where unsolved: (n, 3) normal, albedo; (n,) specular, confidence."""

    normal: np.ndarray
    albedo: np.ndarray
    specular: np.ndarray
    confidence: np.ndarray


def separate(
    session: Session, out: Path, config: SeparateConfig, progress: ProgressCallback = quiet
) -> dict[str, Any]:
    """Write coarse diffuse albedo, specular albedo, normals and confidence of every view.

    Returns:
        Facts: views, pixels, mean confidence, warnings.
    """
    folder = ProcessedFolder(out)
    cameras = session.camera_ids()
    confidence: dict[str, float] = {}
    pixels = 0
    warnings: list[str] = []
    for done, camera_id in enumerate(cameras):
        frames = read_frames(out, camera_id)
        mask = read_foreground(out, camera_id)
        camera = session.rig.camera(camera_id)
        lights = pattern_lights(session, frames.patterns)
        if lights.colour_spread > COLOUR_SPREAD and not warnings:
            warnings.append(
                f"light colours differ by up to {lights.colour_spread:.2f} of their mean; "
                "separation by colour takes them as equal"
            )
        rgb = np.ascontiguousarray(frames.images[:, mask].transpose(1, 0, 2))
        views = -camera.pixel_rays()[1][mask]
        maps = separate_pixels(
            rgb, frames.valid[mask], views, mask, lights, px_per_mm(camera), config
        )
        write_maps(folder, camera_id, mask, maps)
        folder.write_mask(camera_id, mask)
        confidence[camera_id] = round(float(maps.confidence.mean()), 4)
        pixels += len(rgb)
        progress(done + 1, len(cameras))
    return {
        "views": len(cameras),
        "pixels": pixels,
        "mean_confidence": confidence,
        "warnings": warnings,
    }


def separate_pixels(
    rgb: np.ndarray,
    valid: np.ndarray,
    views: np.ndarray,
    mask: np.ndarray,
    lights: PatternLights,
    px_per_mm: float,
    config: SeparateConfig,
) -> PixelMaps:
    """Far-field separation of one view's pixels, each taken to lie at the sphere's centre.

    Normals come from chroma, which holds no mirror reflection; specular albedo from least squares
    on the lobe model, pooled over neighbours; diffuse albedo from what the lobe leaves.

    Args:
        rgb: (n, P, 3) what the mask's pixels read, in row order.
        valid: (n,) bool, false where clipped.
        views: (n, 3) unit, toward the camera.
        mask: (h, w) bool with n true pixels.
        lights: of the P patterns.
        px_per_mm: pixels a millimetre at the sphere's centre.
        config: see there.

    Returns:
        PixelMaps; confidence 0 and zeros where a pixel is clipped, dark, grey or not finite.
    """
    rgb, signal, saturation, usable = read_pixels(rgb, valid, lights.colour, config.dark_level)
    normal = solve_far_normals(signal, far_field(lights), views, config.iterations)
    colourful = np.clip(saturation / config.grey_saturation - 1, 0, 1)
    solved = usable & (colourful > 0) & (np.einsum("nk,nk->n", normal, normal) > 0.5)
    normal[~solved] = 0
    rgb = rgb / lights.colour.astype(np.float32)
    open_sky = no_shadows(len(rgb), lights)
    centre = np.zeros_like(normal)
    e, lobe = transport(lights, centre, normal, views, config.roughness, open_sky)
    each = specular_evidence(rgb.mean(axis=2), e, lobe)
    sigma = config.specular_pool_mm * px_per_mm
    weight = np.where(solved, each.weight, 0)
    typical = float(np.median(weight[solved])) if solved.any() else 0.0
    specular = shrunk(
        pooled(np.where(solved, each.weighed, 0), mask, sigma),
        pooled(weight, mask, sigma),
        config.specular_prior,
        config.specular_prior_share * typical,
    )
    specular = np.where(solved, specular, 0)
    lit, power = diffuse_light(rgb, e, lobe, specular)
    lit[~solved], power[~solved] = 0, 0
    albedo = diffuse_albedo(lit, power, mask, px_per_mm, config.albedo_prior_power)
    albedo[~solved] = 0
    facing = np.clip(np.einsum("nk,nk->n", normal, views) / 0.3, 0, 1)
    confidence = np.where(solved, colourful * facing * fit(signal, e), 0)
    return PixelMaps(normal, albedo, specular, confidence)


def read_pixels(
    rgb: np.ndarray, valid: np.ndarray, white: np.ndarray, dark_level: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Sort out the pixels that cannot be solved, and take chroma from the others.

    Args:
        rgb: (n, P, 3) readings.
        valid: (n,) bool, false where clipped.
        white: (3,) the lights' colour.
        dark_level: see SeparateConfig.

    Returns:
        (n, P, 3) float32 readings, 0 where a pixel is not usable; (n, P) and (n,) signal and
        saturation of `chroma_signal`; (n,) bool usable: valid, finite, every channel alive, and
        brighter than `dark_level` under some pattern.
    """
    clean = np.array(rgb, np.float32, order="C")
    usable = valid.copy()
    _sort_out(clean, usable, dark_level)
    signal, saturation = chroma_signal(clean, white)
    return clean, signal, saturation, usable


@njit(parallel=True, cache=True)
def _sort_out(rgb: np.ndarray, usable: np.ndarray, dark_level: float) -> None:
    """Zero the pixels that are not usable, in place."""
    for i in prange(len(rgb)):
        least = np.inf
        brightest = 0.0
        for c in range(3):
            total = 0.0
            highest = -np.inf
            for k in range(rgb.shape[1]):
                total += rgb[i, k, c]
                highest = max(highest, rgb[i, k, c])
            # A mirror reflection feeds every channel: one that reads nothing is dead, not dark.
            least = total if not total >= least else least
            brightest += highest / 3
        if not (least > 0 and np.isfinite(brightest) and brightest > dark_level):
            usable[i] = False
        if not usable[i]:
            rgb[i] = 0


def fit(signal: np.ndarray, irradiance: np.ndarray) -> np.ndarray:
    """(n,) 0..1: how well the chroma follows the irradiance; shadows and clutter do not."""
    power = np.einsum("np,np->n", irradiance, irradiance)
    total = np.einsum("np,np->n", signal, signal)
    both = np.einsum("np,np->n", signal, irradiance)
    safe = np.where((power > 0) & (total > 0), power * total, 1)
    share = np.where((power > 0) & (total > 0), 1 - both * both / safe, 1)
    residual = np.sqrt(np.clip(share, 0, 1))
    return np.clip((0.4 - residual) / 0.3, 0, 1)


def px_per_mm(camera: Camera) -> float:
    """Pixels a millimetre at the sphere's centre."""
    return camera.fx_px / max(float(np.linalg.norm(camera.centre_mm)), 1.0)


def write_maps(
    folder: ProcessedFolder,
    camera_id: str,
    mask: np.ndarray,
    maps: PixelMaps,
) -> None:
    """Write one view's maps, zero outside the mask.

    Both normals are one: the highlights' own is not solved yet, the diffuse one stands for it.
    """
    named = {
        "diffuse_normal": maps.normal,
        "specular_normal": maps.normal,
        "diffuse_albedo": maps.albedo,
        "specular_albedo": maps.specular,
        "confidence": maps.confidence,
    }
    for name, values in named.items():
        image = np.zeros((*mask.shape, *values.shape[1:]), np.float32)
        image[mask] = values
        folder.write_view(camera_id, name, image)
