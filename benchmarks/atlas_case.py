"""Our template as a person with a known texture, in nine views: what an atlas is scored on."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np

from lightstage.formats.mesh import vertex_normals, write_obj, write_ply
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.session import Session, SessionFile
from lightstage.formats.template import Template, default_template_path, load_template
from lightstage.rig import Camera, Rig, default_rig
from processing.rays import Hits, MeshRays, interpolate

BACKGROUND = 5.0
"""What pixels beside the head read: ten times the head, so that any bleeding shows."""
FINEST_MM = 1.6
"""Period of the texture's finest waves."""
BAND_ROWS = 256
"""Rows cast at once, which bounds the memory of a view of 24 megapixels."""

Texture = Callable[[np.ndarray], np.ndarray]


@dataclasses.dataclass(frozen=True)
class AtlasCase:
    """A processed folder without an atlas.

    Attributes:
        template: the person too.
        session: cameras only.
        out: views and meshes.
    """

    template: Template
    session: Session
    out: ProcessedFolder


def skin(points_mm: np.ndarray) -> np.ndarray:
    """(n, 3) albedo with waves of 60 mm down to pores of 1.6 mm."""
    x, y, z = points_mm.T
    slow = 0.5 + 0.15 * np.sin(x / 9) * np.cos(y / 11)
    wave = 2 * np.pi / FINEST_MM
    fine = 0.04 * np.sin(wave * x) * np.sin(wave * y) + 0.04 * np.sin(wave * z)
    return np.stack([slow + fine, 0.8 * slow + fine, 0.6 * slow + 0.5 * fine], axis=1)


def even(points_mm: np.ndarray) -> np.ndarray:
    """(n, 3) one tone."""
    return np.full((len(points_mm), 3), 0.4)


def make_case(
    root: Path, scale: float, texture: Texture, *, gain_sigma: float, noise: float, views: int = 9
) -> AtlasCase:
    """Render views of the textured template.

    A pixel shows the point at its middle, so that truth at a texel is one number.

    Args:
        root: folder to make.
        scale: of the default rig's cameras, 1 = 6016 x 4016.
        texture: albedo of points.
        gain_sigma: each view is brighter or darker by so much.
        noise: of every pixel.
        views: so many of the rig's cameras.
    """
    rng = np.random.default_rng(3)
    case = case_at(root, scale, views=views)
    template, rig, out = case.template, case.session.rig, case.out
    mesh, triangles = template.mesh, template.mesh.triangles()
    normals = vertex_normals(mesh.vertices, triangles)
    rays = MeshRays(mesh.vertices, triangles)
    for camera in rig.cameras:
        gain = 1 + gain_sigma * rng.normal()
        shape = (camera.height_px, camera.width_px)
        albedo = np.full((*shape, 3), BACKGROUND, np.float32)
        normal = np.zeros((*shape, 3), np.float32)
        mask = np.zeros(shape, bool)
        for top in range(0, shape[0], BAND_ROWS):
            rows = slice(top, min(top + BAND_ROWS, shape[0]))
            mask[rows], albedo[rows], normal[rows] = _band(
                camera, rows, rays, mesh.vertices, normals, triangles, texture, gain
            )
            albedo[rows] += noise * rng.normal(size=albedo[rows].shape)
        flat = np.where(mask, 0.9, 0).astype(np.float32)
        maps = {
            "diffuse_albedo": albedo,
            "diffuse_normal": normal,
            "specular_normal": normal,
            "specular_albedo": 0.03 * flat,
            "ambient_occlusion": flat,
            "roughness": flat / 3,
            "confidence": flat,
        }
        for name, values in maps.items():
            out.write_view(camera.id, name, values)
        out.write_mask(camera.id, mask)
    write_obj(mesh, out.registered_mesh)
    write_ply(mesh, out.base_mesh)
    return case


def case_at(root: Path, scale: float, *, views: int = 9) -> AtlasCase:
    """A case rendered before, or one whose folder is still to be filled."""
    rig = default_rig().scaled(scale)
    file = SessionFile(
        id="bench", created_utc="", subject="s", expression="neutral", sequence=[], frames=[]
    )
    session = Session(root, file, Rig(rig.lights, rig.cameras[:views]))
    return AtlasCase(load_template(default_template_path()), session, ProcessedFolder(root))


def _band(
    camera: Camera,
    rows: slice,
    rays: MeshRays,
    vertices: np.ndarray,
    normals: np.ndarray,
    triangles: np.ndarray,
    texture: Texture,
    gain: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Some rows of a view: mask (h, w), albedo (h, w, 3), normal (h, w, 3)."""
    shape = (rows.stop - rows.start, camera.width_px)
    row, column = (index.ravel() for index in np.indices(shape))
    hits, _ = rays.cast_pixels(camera, row + rows.start, column)
    hit = hits.face >= 0
    albedo = np.full((len(hit), 3), BACKGROUND, np.float32)
    normal = np.zeros((len(hit), 3), np.float32)
    seen = Hits(hits.face[hit], hits.barycentric[hit], hits.distance_mm[hit])
    albedo[hit] = gain * texture(interpolate(vertices, triangles, seen))
    normal[hit] = interpolate(normals, triangles, seen)
    return hit.reshape(shape), albedo.reshape(*shape, 3), normal.reshape(*shape, 3)
