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
from processing.albedo import diffuse_albedo, diffuse_light
from processing.errors import ProcessingError
from processing.frames import read_foreground, read_frames
from processing.interface import skin_interface
from processing.lights import PatternLights, irradiance_vectors, pattern_lights, require_unpolarised
from processing.lobe import SKIN_F0, transport
from processing.masks import edge_distance_px
from processing.methods.colour import fit
from processing.normals import blurred, merged_detail, misfit, solve_normals
from processing.pixels import PixelMaps, write_maps
from processing.readings import px_per_mm, read_pixels
from processing.specular import Gloss, add_view, no_sums, solve_gloss
from processing.surface import LitSurface, Sight, depth_edges, lit_surface, see


@dataclasses.dataclass(frozen=True)
class RefineConfig:
    """What `refine` may be told."""

    most_faces: int = 120_000
    """A denser mesh is thinned: shadows are cast from its vertices."""
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
    """At most this many pixels of a view, evenly spread, give evidence of gloss."""
    gloss_prior_pixels: float = 2.0
    """The face's own mean counts as much as this many pixels at every vertex."""
    gloss_normal_px: float = 2.0
    """Sigma that calms the normals which take the gloss off the mean channel."""
    detail_px: float = 3.0
    """Relief finer than this sigma may come from all channels, coarser relief from chroma."""
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
        sight: what the camera sees of the mesh.
        rgb: (n, P, 3) float32 readings as the camera gave them.
        valid: (n,) bool, false where clipped.
        px_per_mm: pixels a millimetre.
    """

    sight: Sight
    rgb: np.ndarray
    valid: np.ndarray
    px_per_mm: float


@dataclasses.dataclass(frozen=True)
class Normals:
    """(n, 3) float32 unit diffuse normals, zero where unsolved; (n,) float32 confidence."""

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
    require_unpolarised(lights)
    steps = 2 * len(cameras) + 1
    surface = lit_surface(
        mesh,
        lights,
        offset_mm=config.shadow_offset_mm,
        smoothing_mm=config.smoothing_mm,
        directions=config.occlusion_directions,
        most_faces=config.most_faces,
    )
    progress(1, steps)
    sums = no_sums(config.roughness, len(surface.vertices))
    solved: list[Normals] = []
    for done, camera_id in enumerate(cameras):
        view = read_view(session, out, camera_id, surface)
        solved.append(solve_pixels(view, lights, config))
        few = _every(solved[-1].confidence, config.gloss_pixels)
        add_view(
            sums,
            lights,
            (view.rgb[few] / lights.colour).mean(axis=2),
            view.sight.points_mm[few],
            solved[-1].normal[few],
            view.sight.views[few],
            view.sight.shadows.of(few),
            solved[-1].confidence[few],
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
        view = read_view(session, out, camera_id, surface)
        mask = view.sight.mask
        maps = solve_albedo(view, solved[done], lights, gloss, config)
        write_maps(folder, camera_id, mask, maps)
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


def read_view(session: Session, out: Path, camera_id: str, surface: LitSurface) -> View:
    """Read one view and find what it shows of the mesh.

    Raises:
        ProcessingError: nothing of the mesh is seen.
    """
    frames = read_frames(out, camera_id)
    camera = session.rig.camera(camera_id)
    sight = see(surface, camera, read_foreground(out, camera_id))
    if not sight.mask.any():
        raise ProcessingError(
            f"camera {camera_id}",
            found="no pixel that shows the mesh",
            expected="a face in front of the camera",
            hint="Do base_mesh.ply and the rig belong to this session?",
        )
    rgb = frames.pixels(sight.mask)
    return View(sight, rgb, frames.valid[sight.mask], px_per_mm(camera))


def solve_pixels(view: View, lights: PatternLights, config: RefineConfig) -> Normals:
    """Normals of pixels from chroma and the irradiance vectors at their places on the mesh.

    The mesh's normals set the horizon of a first solve, the normals found that of a second.

    Args:
        view: readings.
        lights: of the P patterns.
        config: see there.

    Returns:
        Normals; confidence 0 where clipped, dark, grey, unsolved or not finite, and low at grazing
        angles, in the dark, at edges and where the readings do not fit.
    """
    sight = view.sight
    rgb, signal, saturation, usable = read_pixels(
        view.rgb, view.valid, lights.colour, config.dark_level
    )
    normal = sight.normals
    for _ in range(2):
        vectors = irradiance_vectors(
            lights,
            sight.points_mm,
            normal,
            sight.shadows,
            skin_interface(),
            config.roughness[len(config.roughness) // 2],
        )
        normal = solve_normals(signal, vectors)
    colourful = np.clip(saturation / config.grey_saturation - 1, 0, 1)
    # A normal that the mesh could not have: mistaken shadows, or hair.
    agreement = np.einsum("nk,nk->n", normal, sight.normals)
    solved = usable & (colourful > 0) & (agreement > 0)
    normal[~solved] = 0
    irradiance = np.einsum("npk,nk->np", vectors, normal)
    facing = np.clip(np.einsum("nk,nk->n", sight.normals, sight.views) / 0.4, 0, 1)
    light = np.clip(irradiance.max(axis=1) / config.dark_irradiance, 0, 1)
    edges = depth_edges(sight.depth_mm, config.depth_step_mm)
    inside = edge_distance_px(sight.mask & ~edges)[sight.mask]
    confidence = colourful * facing * light * fit(signal, irradiance)
    confidence *= np.clip(2 * agreement, 0, 1) * np.clip(inside / config.edge_px, 0, 1)
    confidence = np.where(solved, confidence, 0)
    mean = (rgb / lights.colour.astype(np.float32)).mean(axis=2)
    normal = add_detail(normal, signal, vectors, mean, sight, lights, config)
    return Normals(normal.astype(np.float32), confidence.astype(np.float32))


def add_detail(
    normal: np.ndarray,
    signal: np.ndarray,
    vectors: np.ndarray,
    mean: np.ndarray,
    sight: Sight,
    lights: PatternLights,
    config: RefineConfig,
) -> np.ndarray:
    """Give chroma's normals the fine relief that all channels together show with less noise.

    Chroma is free of gloss but weak, so that its normals are right on average and noisy. The mean
    channel less a typical skin's gloss is strong and slightly biased. Low frequencies stay with
    chroma; detail is shared between the two by how well each fits its readings.

    Args:
        normal: (n, 3) from chroma, zero where unsolved.
        signal: (n, P) chroma.
        vectors: (n, P, 3) irradiance vectors.
        mean: (n, P) mean channel.
        sight: of the n pixels.
        lights: of the P patterns.
        config: see there.

    Returns:
        (n, 3) unit normals, zero where unsolved.
    """
    solved = np.einsum("nk,nk->n", normal, normal) > 0.5
    smooth = blurred(normal, solved, sight.mask, config.gloss_normal_px)
    length = np.linalg.norm(smooth, axis=1, keepdims=True)
    smooth = np.where(solved[:, None] & (length > 1e-6), smooth / np.maximum(length, 1e-6), 0)
    middle = config.roughness[len(config.roughness) // 2]
    _, lobe = transport(lights, sight.points_mm, smooth, sight.views, middle, sight.shadows)
    matte = mean - np.float32(config.specular_prior) * lobe
    sharp = solve_normals(matte, vectors)
    return merged_detail(
        normal,
        sharp,
        misfit(signal, vectors, normal),
        misfit(matte, vectors, sharp),
        sight.mask,
        config.detail_px,
    )


def solve_albedo(
    view: View, normals: Normals, lights: PatternLights, gloss: Gloss, config: RefineConfig
) -> PixelMaps:
    """Albedo of one view's pixels with the gloss of the mesh.

    Args:
        view: its readings.
        normals: of its pixels.
        lights: of the P patterns.
        gloss: at the mesh's vertices.
        config: see there.

    Returns:
        PixelMaps, zero where there is no normal.
    """
    sight, mask, normal = view.sight, view.sight.mask, normals.normal
    solved = np.einsum("nk,nk->n", normal, normal) > 0.5
    rgb = np.where(solved[:, None, None], view.rgb, 0) / lights.colour.astype(np.float32)
    corners, weights = sight.shadows.corners, sight.shadows.weights
    roughness = (gloss.roughness[corners] * weights).sum(axis=1)
    specular = (gloss.specular[corners] * weights).sum(axis=1)
    e, lobe = transport(
        lights,
        sight.points_mm,
        normal,
        sight.views,
        roughness,
        sight.shadows,
        skin_interface(),
    )
    specular[~solved] = 0
    lit, power = diffuse_light(rgb, e, lobe, specular)
    lit[~solved], power[~solved] = 0, 0
    albedo = diffuse_albedo(lit, power, mask, view.px_per_mm, config.albedo_prior_power)
    albedo[~solved] = 0
    roughness = np.where(solved, roughness, 0)
    return PixelMaps(normal, normal, albedo, specular, roughness, normals.confidence)


def _every(confidence: np.ndarray, most: int) -> np.ndarray:
    """Indices of evenly spaced pixels that have some confidence, at most `most`."""
    chosen = np.flatnonzero(confidence > 0)
    return chosen[:: max(1, -(-len(chosen) // most))]
