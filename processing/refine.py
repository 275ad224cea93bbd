"""Stage `refine`: exact maps of each view, with the mesh's positions, shadows and lobes."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from lightstage.commands import ProgressCallback, quiet
from lightstage.formats.mesh import read_ply
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.session import Session
from processing.albedo import diffuse_albedo, diffuse_light, pooled, shrunk, specular_evidence
from processing.errors import ProcessingError
from processing.frames import read_foreground, read_frames
from processing.lights import PatternLights, irradiance_vectors, pattern_lights
from processing.lobe import SKIN_F0, transport
from processing.masks import edge_distance_px
from processing.normals import chroma_signal, solve_normals
from processing.separation import PixelMaps, fit, px_per_mm, trusted, write_maps
from processing.specular import Gloss, add_view, no_sums, solve_gloss
from processing.surface import LitSurface, Sight, depth_edges, lit_surface, see


@dataclasses.dataclass(frozen=True)
class RefineConfig:
    """What `refine` may be told."""

    shadow_offset_mm: float = 0.3
    """Shadow rays start this far off the mesh, beyond its own roughness."""
    smoothing_mm: float = 1.0
    """Over which the mesh's normals are averaged; they set the horizon."""
    occlusion_directions: int = 200
    """Directions over the sphere for ambient occlusion."""
    roughness: tuple[float, ...] = (0.18, 0.22, 0.26, 0.30, 0.34)
    """Beckmann's m that are tried, at least three; skin has .2 to .35."""
    roughness_pool_mm: float = 6.0
    specular_pool_mm: float = 3.0
    """Sigma over which all views' evidence is pooled on the mesh."""
    gloss_pixels: int = 120_000
    """At most this many pixels of a view give evidence of gloss."""
    gloss_prior_pixels: float = 10.0
    """The face's own mean counts as much as this many pixels at every vertex."""
    detail_pool_px: float = 2.0
    detail_prior_pixels: float = 60.0
    """Pixels' own evidence of specular albedo, over this sigma, against the mesh's answer."""
    specular_prior: float = SKIN_F0
    albedo_prior_power: float = 0.005
    """Weight of the neighbours' albedo against a pixel's squared irradiance (2 in the open)."""
    grey_saturation: float = 0.05
    """Below this saturation colour tells nothing; from twice as much it is trusted."""
    dark_level: float = 0.004
    """A pixel whose brightest pattern stays below this tells nothing (1 = white under `full`)."""
    dark_irradiance: float = 0.15
    """Confidence falls where the brightest pattern lights a pixel less than this."""
    edge_px: float = 3.0
    """Confidence falls to 0 over this many pixels before an edge of mask or depth."""
    depth_step_mm: float = 4.0
    """A larger step between neighbouring pixels is an edge."""


@dataclasses.dataclass(frozen=True)
class View:
    """One view's readings and what the mesh says of its n pixels.

    Attributes:
        camera_id: whose.
        sight: what the camera sees of the mesh.
        rgb: (n, P, 3) float32 readings in the lights' own colour, 0 where not usable.
        normal: (n, 3) unit diffuse normals, zero where unsolved.
        confidence: (n,) 0..1.
    """

    camera_id: str
    sight: Sight
    rgb: np.ndarray
    normal: np.ndarray
    confidence: np.ndarray


def refine(
    session: Session, out: Path, config: RefineConfig, progress: ProgressCallback = quiet
) -> dict[str, Any]:
    """Solve reflectance again with the mesh, and overwrite the views' maps and masks.

    Normals come first, view by view, and each view adds its evidence of the skin's gloss to the
    mesh; then every view's albedo is solved with the gloss that explains all of them.

    Returns:
        Facts: pixels, vertices, mean confidence, gloss found.

    Raises:
        FormatError: no base mesh, or no decoded photographs.
        ProcessingError: a camera that sees nothing of the mesh.
    """
    folder = ProcessedFolder(out)
    mesh = read_ply(folder.base_mesh)
    cameras = session.camera_ids()
    lights = pattern_lights(session, read_frames(out, cameras[0]).patterns)
    steps = 2 * len(cameras) + 1
    surface = lit_surface(
        mesh,
        lights,
        offset_mm=config.shadow_offset_mm,
        smoothing_mm=config.smoothing_mm,
        directions=config.occlusion_directions,
    )
    progress(1, steps)
    sums = no_sums(config.roughness, len(surface.vertices))
    for done, camera_id in enumerate(cameras):
        view = solve_view(session, out, camera_id, lights, surface, config)
        few = _every(view, config.gloss_pixels)
        add_view(
            sums,
            lights,
            view.rgb[few].mean(axis=2),
            view.sight.points_mm[few],
            view.normal[few],
            view.sight.views[few],
            view.sight.shadows.of(few),
            view.confidence[few],
        )
        progress(2 + done, steps)
    gloss = solve_gloss(
        sums,
        surface.average,
        rounds_roughness=surface.rounds(config.roughness_pool_mm),
        rounds_specular=surface.rounds(config.specular_pool_mm),
        prior_specular=config.specular_prior,
        prior_pixels=config.gloss_prior_pixels,
    )
    confidence: dict[str, float] = {}
    pixels = 0
    for done, camera_id in enumerate(cameras):
        view = solve_view(session, out, camera_id, lights, surface, config)
        mask = view.sight.mask
        scale = px_per_mm(session.rig.camera(camera_id))
        maps = solve_albedo(view, lights, gloss, scale, config)
        write_maps(folder, camera_id, mask, maps, maps.normal)
        occlusion = np.zeros(mask.shape, np.float32)
        occlusion[mask] = view.sight.occlusion
        folder.write_view(camera_id, "ambient_occlusion", occlusion)
        folder.write_mask(camera_id, mask)
        confidence[camera_id] = round(float(maps.confidence.mean()), 4)
        pixels += len(maps.confidence)
        progress(2 + len(cameras) + done, steps)
    seen = sums.count > 0
    return {
        "views": len(cameras),
        "pixels": pixels,
        "vertices": len(surface.vertices),
        "mean_confidence": confidence,
        "roughness_mean": round(float(gloss.roughness[seen].mean()), 4) if seen.any() else None,
        "specular_mean": round(float(gloss.specular[seen].mean()), 5) if seen.any() else None,
        "warnings": [],
    }


def solve_view(
    session: Session,
    out: Path,
    camera_id: str,
    lights: PatternLights,
    surface: LitSurface,
    config: RefineConfig,
) -> View:
    """Read one view and solve its normals with the mesh's positions and shadows.

    The mesh's normals set the horizon of a first solve, the normals found that of a second.

    Raises:
        ProcessingError: nothing of the mesh is seen.
    """
    frames = read_frames(out, camera_id)
    sight = see(surface, session.rig.camera(camera_id), read_foreground(out, camera_id))
    if not sight.mask.any():
        raise ProcessingError(
            f"camera {camera_id}",
            found="no pixel that shows the mesh",
            expected="a face in front of the camera",
            hint="Do base_mesh.ply and the rig belong to this session?",
        )
    rgb = np.ascontiguousarray(frames.images[:, sight.mask].transpose(1, 0, 2))
    normal, rgb, confidence = solve_pixels(rgb, frames.valid[sight.mask], sight, lights, config)
    edges = depth_edges(sight.depth_mm, config.depth_step_mm)
    inside = edge_distance_px(sight.mask & ~edges)[sight.mask]
    confidence *= np.clip(inside / config.edge_px, 0, 1)
    return View(camera_id, sight, rgb, normal, confidence)


def solve_pixels(
    rgb: np.ndarray,
    valid: np.ndarray,
    sight: Sight,
    lights: PatternLights,
    config: RefineConfig,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normals of pixels from chroma and the mesh's irradiance vectors.

    Args:
        rgb: (n, P, 3) readings.
        valid: (n,) false where clipped.
        sight: of the n pixels.
        lights: of the P patterns.
        config: see there.

    Returns:
        (n, 3) unit normals, zero where unsolved; (n, P, 3) readings in the lights' own colour, 0
        where not usable; (n,) confidence, 0 where clipped, dark, grey, unsolved or not finite.
    """
    usable, saturation = trusted(rgb, valid, lights.colour, config.dark_level)
    rgb = np.where(usable[:, None, None], rgb, 0).astype(np.float32)
    signal, _ = chroma_signal(rgb, lights.colour)
    normal = solve_normals(signal, sight.vectors)
    vectors = irradiance_vectors(lights, sight.points_mm, normal, sight.shadows)
    normal = solve_normals(signal, vectors)
    colourful = np.clip(saturation / config.grey_saturation - 1, 0, 1)
    solved = usable & (colourful > 0) & (np.einsum("nk,nk->n", normal, normal) > 0.5)
    # A normal that the mesh could not have: mistaken shadows, or hair.
    agreement = np.einsum("nk,nk->n", normal, sight.normals)
    solved &= agreement > 0
    normal[~solved] = 0
    irradiance = np.einsum("npk,nk->np", vectors, normal)
    facing = np.clip(np.einsum("nk,nk->n", sight.normals, sight.views) / 0.4, 0, 1)
    light = np.clip(irradiance.max(axis=1) / config.dark_irradiance, 0, 1)
    confidence = colourful * facing * light * fit(signal, irradiance)
    confidence *= np.clip(2 * agreement, 0, 1)
    rgb = rgb / lights.colour.astype(np.float32)
    return normal, rgb, np.where(solved, confidence, 0)


def solve_albedo(
    view: View, lights: PatternLights, gloss: Gloss, scale: float, config: RefineConfig
) -> PixelMaps:
    """Albedo of one view's pixels with the gloss of the mesh.

    Args:
        view: its readings and normals.
        lights: of the P patterns.
        gloss: at the mesh's vertices.
        scale: pixels a millimetre.
        config: see there.

    Returns:
        PixelMaps, zero where there is no normal.
    """
    sight, mask = view.sight, view.sight.mask
    solved = np.einsum("nk,nk->n", view.normal, view.normal) > 0.5
    corners, weights = sight.shadows.corners, sight.shadows.weights
    roughness = (gloss.roughness[corners] * weights).sum(axis=1)
    pooled_specular = (gloss.specular[corners] * weights).sum(axis=1)
    e, a, b = transport(lights, sight.points_mm, view.normal, sight.views, roughness, sight.shadows)
    evidence = specular_evidence(view.rgb.mean(axis=2), e, a, b)
    trust = view.confidence * solved
    typical = float(np.median(evidence.weight[trust > 0])) if (trust > 0).any() else 1.0
    sigma = config.detail_pool_px
    # A Gaussian's sum over its neighbours holds no more than about 4 pi sigma^2 pixels.
    area = 4 * np.pi * sigma * sigma
    specular = shrunk(
        area * pooled(evidence.weighed * trust, mask, sigma),
        area * pooled(evidence.weight * trust, mask, sigma),
        pooled_specular,
        config.detail_prior_pixels * typical,
    )
    specular[~solved] = 0
    lit, power = diffuse_light(view.rgb, e, a, b, specular)
    lit[~solved], power[~solved] = 0, 0
    albedo = diffuse_albedo(lit, power, mask, scale, config.albedo_prior_power)
    albedo[~solved] = 0
    return PixelMaps(view.normal, albedo, specular, view.confidence)


def _every(view: View, most: int) -> np.ndarray:
    """Indices of evenly spaced pixels that have some confidence, at most `most`."""
    trusted_pixels = np.flatnonzero(view.confidence > 0)
    return trusted_pixels[:: max(1, -(-len(trusted_pixels) // most))]
