"""Stage `refine`: exact maps of each view, with the mesh's positions, shadows and lobes."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lightstage.commands import ProgressCallback, quiet
from lightstage.errors import FormatError
from lightstage.formats.mesh import Mesh, read_ply, write_ply
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.session import Session
from lightstage.rig import Camera, Rig
from processing.frames.read import photographed_patterns, read_foreground, read_frames
from processing.lighting.interface import ENTERED_SHARE
from processing.lighting.lights import fix_normals, pattern_lights
from processing.rays import MeshRays
from processing.refinement.config import RefineConfig
from processing.refinement.detail import NormalView, displaced
from processing.refinement.every_pixel import solve_view
from processing.refinement.gloss_search import find_gloss
from processing.refinement.noise import measured_noise, times_as_noisy
from processing.refinement.scene import Scene, View, prepare_scene, read_view
from processing.refinement.written import keep_coarse, write_refined


def refine(
    session: Session, out: Path, config: RefineConfig, progress: ProgressCallback = quiet
) -> dict[str, Any]:
    """Solve reflectance again with the mesh, and write the views' maps and masks to OUT/views.

    Gloss, light from skin to skin and scattering are found first, from a grid of every view's
    pixels; then each view's pixels are solved one by one. Patterns that cannot be solved
    so, such as those of `mux`, keep the coarse maps, and the facts warn of it.

    Returns:
        Facts: pixels, vertices, mean confidence, gloss and scattering found.

    Raises:
        FormatError: no base mesh, or no decoded photographs.
        ProcessingError: a camera that sees nothing of the mesh.
    """
    folder = ProcessedFolder(out)
    folder.detailed_mesh.unlink(missing_ok=True)  # that of an earlier run
    mesh = read_ply(folder.base_mesh)
    cameras = [session.rig.camera(camera_id) for camera_id in session.camera_ids()]
    lights = pattern_lights(session, read_frames(out, cameras[0].id).patterns)
    seen_by = [(camera, read_foreground(out, camera.id)) for camera in cameras]
    occluders = read_ply(folder.occluders) if folder.occluders.is_file() else None
    others = seen_occluders(mesh, measured_alone(occluders, folder), seen_by)
    seen_by = [(camera, lit & ~others[camera.id]) for camera, lit in seen_by]
    if not fix_normals(lights):
        return keep_coarse(folder, mesh, lights, seen_by, config, occluders, progress)
    steps = 3 + config.gloss_rounds + len(cameras)
    scene = prepare_scene(mesh, lights, seen_by, config, occluders)
    progress(1, steps)
    grids = [
        read_view(read_frames(out, camera.id), camera, lit, scene, config, config.gloss_pixels)
        for camera, lit in seen_by
    ]
    photographed = [photographed_patterns(out, camera.id) for camera in cameras]
    scene, config, noise = with_noise(scene, config, grids, photographed)
    progress(2, steps)
    scene, found, choices = find_gloss(
        scene, grids, config, lambda done, _: progress(2 + done, steps)
    )
    confidence: dict[str, float] = {}
    between: dict[str, float] = {}
    pixels = 0
    for done, (camera, lit) in enumerate(seen_by):
        solved = solve_view(
            scene, read_frames(out, camera.id), camera, lit, grids[done], found[done], config
        )
        maps, occlusion = solved.maps.pixel_maps(), solved.maps.occlusion
        between[camera.id] = round(solved.between_nodes, 4)
        count, mean = write_refined(
            folder,
            camera.id,
            solved.mask,
            maps,
            occlusion,
            config.coarse_confidence,
            others[camera.id],
        )
        confidence[camera.id] = round(mean, 4)
        pixels += count
        progress(3 + config.gloss_rounds + done, steps)
    detail = write_detailed(folder, mesh, session.rig, config) if config.detail_edge_mm > 0 else {}
    seen = np.unique(np.concatenate([grid.sight.shadows.corners.ravel() for grid in grids]))
    roughness = float(scene.gloss.roughness[seen].mean())
    return {
        "maps": "exact",
        "lights": lights.source,
        "views": len(cameras),
        "pixels": pixels,
        "vertices": len(scene.surface.vertices),
        "mean_confidence": confidence,
        "between_nodes": between,
        "roughness_mean": round(roughness, 4),
        "specular_mean": round(float(scene.gloss.specular[seen].mean()), 5),
        "mirror_lobe": scene.facets.name,
        "mirror_lobe_tails": scene.facets.tails,
        "mirror_lobe_stretch": round(scene.facets.stretch, 3),
        "mirror_rises_at_grazing_angles": scene.facets.rises,
        "diffuse_layer_below_the_mirror": scene.facets.covers,
        "light_from_skin_to_skin": bool(scene.bounces),
        "scattering": scene.scattering,
        "noise": noise,
        "left_out_readings": {step.name: step.fact for step in choices},
        ENTERED_SHARE: round(scene.interface.entered_share(roughness), 4),
        "specular_normals": "all channels and the highlights, the relief of the diffuse light "
        "calmed by scattering",
        **detail,
        "warnings": [],
    }


def with_noise(
    scene: Scene, config: RefineConfig, grids: list[View], photographed: Sequence[Collection[str]]
) -> tuple[Scene, RefineConfig, str]:
    """The scene and configuration with the photographs' own noise, and how it was found.

    Args:
        scene: so far.
        config: as configured.
        grids: of each view.
        photographed: of each view, the patterns that its camera took.
    """
    if config.noise_from_photographs:
        found, measured = measured_noise(
            [grid.rgb for grid in grids], scene.lights.patterns, photographed, config.noise
        )
        if measured:
            scene = dataclasses.replace(scene, noisier=times_as_noisy(found, config.noise))
            config = dataclasses.replace(config, noise_sensor=found.sensor, noise_floor=found.floor)
            dark = found.sensor * np.sqrt(found.floor)
            white = np.hypot(found.sensor, dark)
            return scene, config, f"measured: {dark:.2g} without light, {white:.2g} of a white"
    return scene, config, "as configured"


def measured_alone(occluders: Mesh | None, folder: ProcessedFolder) -> Mesh | None:
    """The occluders without the hull at their end, which casts shadows and is no surface.

    A pixel that shows the hull shows something that was not matched. It may be skin: it keeps its
    coarse maps, as without the hull.

    Raises:
        FormatError: a hull that is no part of these occluders.
    """
    if occluders is None or not folder.hull.is_file():
        return occluders
    hull, triangles = read_ply(folder.hull), occluders.triangles()
    first = len(triangles) - len(hull.faces)
    start = len(occluders.vertices) - len(hull.vertices)
    if min(first, start) < 0 or not np.array_equal(triangles[first:], hull.faces + start):
        raise FormatError(
            folder.hull,
            found="a hull that is not at the end of occluders.ply",
            expected="both of one run of `reconstruct`",
            hint="Run `lightstage-processing reconstruct` again, or remove the hull's file where "
            "occluders.ply is one of your own.",
        )
    return Mesh(occluders.vertices[:start], triangles[:first]) if first else None


def seen_occluders(
    mesh: Mesh, occluders: Mesh | None, seen_by: list[tuple[Camera, np.ndarray]]
) -> dict[str, np.ndarray]:
    """(h, w) bool of each camera: foreground that shows an occluder, which has no maps of skin."""
    if occluders is None:
        return {camera.id: np.zeros_like(foreground) for camera, foreground in seen_by}
    rays = MeshRays(mesh.vertices, mesh.triangles(), occluders)
    return {camera.id: rays.stopped(camera, foreground) for camera, foreground in seen_by}


def write_detailed(
    folder: ProcessedFolder, mesh: Mesh, rig: Rig, config: RefineConfig
) -> dict[str, Any]:
    """Write OUT/detailed_mesh.ply, the mesh with the refined specular normals' relief.

    Returns:
        Facts: its vertices, share that a camera showed, height (root mean square, mm).
    """
    views = read_normals(folder, rig, config.coarse_confidence)
    found = displaced(mesh, views, config.detail_edge_mm, config.detail_below_mm)
    write_ply(found.mesh, folder.detailed_mesh)
    height = found.height_mm[found.known]
    return {
        "detailed_vertices": len(found.mesh.vertices),
        "detailed_share": round(float(found.known.mean()), 4),
        "detail_rms_mm": round(float(np.sqrt(np.mean(height**2))), 5) if len(height) else 0.0,
    }


def read_normals(folder: ProcessedFolder, rig: Rig, coarse: float) -> list[NormalView]:
    """Every view's specular normals, trusted by their confidence.

    Args:
        folder: with refined maps.
        rig: its cameras.
        coarse: confidence up to which nothing is measured: coarse maps fill the mesh's holes.
    """
    views = []
    for name in folder.view_ids():
        normals = folder.read_view(name, "specular_normal")
        confidence = folder.read_view(name, "confidence")
        measured = folder.read_mask(name) & (np.linalg.norm(normals, axis=2) > 0.5)
        views.append(
            NormalView(
                rig.camera(name), normals, np.where(measured & (confidence > coarse), confidence, 0)
            )
        )
    return views
