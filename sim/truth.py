"""What processing should find, in the processed folder's form."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from lightstage.commands import ProgressCallback, quiet
from lightstage.formats.environment import LightSet, write_lights
from lightstage.formats.exr import write_exr
from lightstage.formats.files import write_json
from lightstage.formats.landmarks import write_points_mm
from lightstage.formats.mesh import write_obj, write_ply
from lightstage.formats.processed import HEAD_SCHEMA, TRUTH_SCHEMA, ProcessedFolder
from lightstage.rig import Camera, Rig
from sim.light.scene import Scene, Surface
from sim.light.texture import raster_uv, texture_of
from sim.light.world import World
from sim.people.subject import Subject
from sim.people.traits import Traits
from sim.reference.world import ReferenceWorld

OCCLUSION_DIRECTIONS = 256
OCCLUSION_START_MM = 0.2
RELIT_CAMERA = "cam0"
"""Relit pictures are this camera's; the rig's first one's where there is none of this id."""
HIDDEN = 0.1
"""Skin that sees less of the sky, such as behind a closed lid, is not scored in the atlas."""
FACING = 0.15
"""A landmark whose normal makes a smaller cosine with the view is at the edge: hidden."""


def write_truth(world: World, out: Path, progress: ProgressCallback = quiet) -> Path:
    """Write a simulated session's truth.

    Views hold the subject's own maps as each camera sees them (confidence and mask are 1 on the
    skin that is scored); the atlas holds them in the subject's own UV; relit/ holds pictures under
    light sets that no pattern shows. The mesh is the subject's own.

    Args:
        world: the subject in its rig.
        out: folder, made.
        progress: of views, then atlas and relit pictures.

    Returns:
        `out`.
    """
    folder = ProcessedFolder(out)
    subject = world.subject
    occlusion = vertex_occlusion(world.scene)
    total = len(world.rig.cameras) + 2
    with ThreadPoolExecutor(2) as pool:
        for done, camera in enumerate(world.rig.cameras, 1):
            surface = world.surfaces[camera.id]
            maps = view_maps(surface, world.scene, occlusion)
            list(pool.map(lambda item, c=camera.id: folder.write_view(c, *item), maps.items()))
            folder.write_mask(camera.id, surface.picture(surface.skin))
            progress(done, total)
    write_ply(subject.mesh, folder.base_mesh)
    write_atlas(subject, occlusion, folder)
    write_points_mm(subject.landmarks_mm, folder.true_landmarks)
    progress(total - 1, total)
    front = RELIT_CAMERA if RELIT_CAMERA in world.surfaces else world.rig.cameras[0].id
    for lights, weights in relit_sets(world.rig):
        picture = world.relit(front, weights)
        write_exr(out / "relit" / f"{lights.name}.exr", picture)
        write_lights(lights, out / "relit" / f"{lights.name}.json")
    progress(total, total)
    return out


def write_atlas(
    subject: Subject,
    occlusion: np.ndarray,
    folder: ProcessedFolder,
    traits: Traits | None = None,
) -> None:
    """Write a subject's atlas, mesh, head pose and report: the part that needs no cameras.

    Args:
        subject: the person.
        occlusion: (n,) ambient occlusion of the mesh's vertices.
        folder: where to.
        traits: whose sex and age the report has; None where nobody knows them.
    """
    mesh = subject.mesh
    rows, columns = subject.diffuse_albedo.shape[:2]
    face, weights = raster_uv(mesh, rows, columns)
    triangles = mesh.triangles()
    covered = face >= 0
    open_share = texture_of(occlusion[:, None], triangles, face, weights)[..., 0]
    scored = (subject.skin & covered & (open_share > HIDDEN)).astype(np.float32)
    maps = {
        "diffuse_albedo": subject.diffuse_albedo,
        "specular_albedo": subject.specular_albedo,
        "diffuse_normal": subject.normal,
        "specular_normal": subject.normal,
        "position": texture_of(mesh.vertices, triangles, face, weights),
        "ambient_occlusion": open_share,
        "confidence": scored,
        "skin": scored,
    }
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(lambda item: folder.write_atlas(*item), maps.items()))
    write_obj(mesh, folder.registered_mesh)
    pose = {"schema": HEAD_SCHEMA, "head_from_world": subject.head_from_world.tolist()}
    write_json(folder.head_pose, pose)
    write_json(
        folder.root / "report.json",
        {
            "schema": TRUTH_SCHEMA,
            "subject": subject.name,
            "expression": subject.expression,
            "source": subject.source,
            "synthetic": subject.synthetic,
            "sex": traits.sex if traits else None,
            "age_years": traits.age_years if traits else None,
        },
    )


def view_maps(surface: Surface, scene: Scene, occlusion: np.ndarray) -> dict[str, np.ndarray]:
    """One camera's maps by name, each (h, w) or (h, w, 3), zero where it sees nothing."""
    corners = scene.triangles[surface.face]
    open_share = np.einsum("nc,nc->n", occlusion[corners], surface.barycentric)
    values = {
        "diffuse_albedo": surface.albedo,
        "ambient_occlusion": open_share.astype(np.float32),
        "specular_albedo": surface.specular,
        "diffuse_normal": surface.normal,
        "specular_normal": surface.normal,
        "position": surface.position,
        "confidence": surface.skin.astype(np.float32),
    }
    return {name: surface.picture(value) for name, value in values.items()}


def vertex_occlusion(scene: Scene, directions: int = OCCLUSION_DIRECTIONS) -> np.ndarray:
    """Cosine-weighted share of the sky that each vertex sees.

    Args:
        scene: the subject.
        directions: rays a vertex; the same well-spread set for all, turned to each normal.

    Returns:
        (n,) float32 in 0..1, 1 = open.
    """
    local = _cosine_directions(directions)
    normals = scene.normals
    tangent = np.cross(
        normals, np.where(np.abs(normals[:, :1]) < 0.9, [[1.0, 0, 0]], [[0, 1.0, 0]])
    )
    length = np.linalg.norm(tangent, axis=1, keepdims=True)
    tangent = np.divide(tangent, length, out=np.zeros_like(tangent), where=length > 0)
    bitangent = np.cross(normals, tangent)
    start = scene.vertices + OCCLUSION_START_MM * normals
    free = np.zeros(len(start))
    for x, y, z in local:
        toward = x * tangent + y * bitangent + z * normals
        free += ~scene.blocked(start, start + 1000.0 * toward)
    return (free / directions).astype(np.float32)


def _cosine_directions(count: int) -> np.ndarray:
    """(count, 3) directions around +z, as dense as the cosine (a spiral on the unit disc)."""
    index = np.arange(count) + 0.5
    radius = np.sqrt(index / count)
    angle = index * np.pi * (3.0 - np.sqrt(5.0))
    return np.stack(
        [radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1 - radius**2)], axis=1
    )


def relit_sets(rig: Rig) -> list[tuple[LightSet, np.ndarray]]:
    """Three light sets of a few coloured stage lights each: key, rim and split.

    Returns:
        For each the light set, and its weights (m, 3) over the rig's lights.
    """
    plans: dict[str, list[tuple[float, float, tuple[float, float, float]]]] = {
        # azimuth and elevation in degrees, light on a white diffuser that faces it
        "key": [(40, 30, (1.1, 1.0, 0.85)), (-60, 0, (0.12, 0.15, 0.20))],
        "rim": [(150, 20, (1.2, 1.1, 1.0)), (-150, 20, (0.9, 1.0, 1.2)), (0, 60, (0.2, 0.2, 0.2))],
        "split": [(-85, 10, (1.0, 0.35, 0.2)), (85, 10, (0.2, 0.45, 1.0))],
    }
    sets = []
    unit = rig.positions_mm / np.linalg.norm(rig.positions_mm, axis=1, keepdims=True)
    for name, spots in plans.items():
        weights = np.zeros((len(rig.lights), 3))
        for azimuth_deg, elevation_deg, rgb in spots:
            azimuth, elevation = np.deg2rad([azimuth_deg, elevation_deg])
            toward = np.array(
                [
                    np.sin(azimuth) * np.cos(elevation),
                    np.sin(elevation),
                    np.cos(azimuth) * np.cos(elevation),
                ]
            )
            # Two neighbouring lights share a spot, so that no set is one light at a time.
            nearest = np.argsort(-(unit @ toward), kind="stable")[:2]
            weights[nearest] += np.array(rgb) / 2
        lit = weights.max(axis=1) > 0
        sets.append((LightSet(name, rig.positions_mm[lit], weights[lit], np.zeros(3)), weights))
    return sets


def landmarks_px(
    world: World | ReferenceWorld, camera: Camera, rng: np.random.Generator, noise_px: float
) -> np.ndarray:
    """Landmarks as someone would click them in a camera's picture.

    Args:
        world: the subject.
        camera: the view.
        rng: of the clicks.
        noise_px: standard deviation of a click.

    Returns:
        (68, 2) pixels, NaN where hidden, outside the picture, or unknown on the subject.
    """
    known = np.isfinite(world.subject.landmarks_mm).all(axis=1)
    places = np.where(known[:, None], world.subject.landmarks_mm, 0.0)
    normals = _normals_at(world.scene, places)
    points, depth = camera.project(places)
    points = points + rng.normal(0.0, noise_px, points.shape)
    toward = camera.centre_mm - places
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    hidden = world.scene.blocked(places + 1.0 * normals, np.tile(camera.centre_mm, (68, 1)))
    hidden |= np.sum(toward * normals, axis=1) < FACING
    inside = (points >= 0).all(axis=1) & (points < [camera.width_px, camera.height_px]).all(axis=1)
    points[~known | hidden | ~inside | ~(depth > 0)] = np.nan
    return points


def _normals_at(scene: Scene, points_mm: np.ndarray) -> np.ndarray:
    """Normals of the vertices nearest to (n, 3) points."""
    return scene.normals[cKDTree(scene.vertices).query(points_mm)[1]]
