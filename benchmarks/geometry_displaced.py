"""A person whose relief is in the shape as well as in the shading: a truth without contradiction.

The relief of our own people bends the normals that shade, not the mesh. Here the mesh is displaced
by the same height, along the same normals, where skin is: down to the width of its finest edges
shape and shading are one surface.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np
from scipy import ndimage

from lightstage.formats.landmarks import write_points_mm
from lightstage.formats.mesh import Mesh, vertex_normals, write_ply
from lightstage.formats.processed import ProcessedFolder
from sim.light.texture import sample
from sim.light.world import World
from sim.people.subject import Subject
from sim.scans.subdivide import loop_subdivide

FADE_TEXELS = 24.0
"""Relief ends so far from skin, some 3 mm."""
BLUR_TEXELS = 1.0
"""Sigma of the height that vertices take: their edges are two texels long."""


def displaced(subject: Subject, height_mm: np.ndarray) -> Subject:
    """A person with relief in the mesh: split once more where skin is, then moved.

    Args:
        subject: smooth, with edges of half a millimetre; its normals have the relief already.
        height_mm: (rows, columns) along the mesh's smooth normals, in its UV.

    Returns:
        The person; textures, shading normals among them, as they were.
    """
    mesh = subject.mesh
    assert mesh.uvs is not None
    assert mesh.face_uvs is not None
    away = ndimage.distance_transform_edt(~subject.skin)
    share = np.clip(1 - away / FADE_TEXELS, 0, 1).astype(np.float32)
    height = cv2.GaussianBlur(height_mm.astype(np.float32), (0, 0), BLUR_TEXELS) * share
    finer = (sample(share, mesh.uvs) > 0)[mesh.face_uvs].any(axis=1)
    # Vertices keep their places in the list, and those on the border their places in the world.
    skin = loop_subdivide(Mesh(mesh.vertices, mesh.faces[finer], mesh.uvs, mesh.face_uvs[finer]))
    assert skin.uvs is not None
    assert skin.face_uvs is not None
    faces = np.concatenate([skin.faces, mesh.faces[~finer]])
    face_uvs = np.concatenate([skin.face_uvs, mesh.face_uvs[~finer]])
    own = np.zeros(len(skin.vertices))
    own[faces] = sample(height, skin.uvs)[face_uvs]
    moved = skin.vertices + own[:, None] * vertex_normals(skin.vertices, faces)
    return dataclasses.replace(subject, mesh=Mesh(moved, faces, skin.uvs, face_uvs))


def write_shape(world: World, root: Path) -> None:
    """Of a truth (sim/truth.py) what is asked about a shape: mesh, places, normals, skin.

    The rest takes minutes on meshes of millions of triangles.
    """
    folder = ProcessedFolder(root)
    for camera in world.rig.cameras:
        surface = world.surfaces[camera.id]
        folder.write_view(camera.id, "position", surface.picture(surface.position))
        folder.write_view(camera.id, "diffuse_normal", surface.picture(surface.normal))
        folder.write_mask(camera.id, surface.picture(surface.skin))
    write_ply(world.subject.mesh, folder.base_mesh)
    write_points_mm(world.subject.landmarks_mm, root / "landmarks_mm.json")
