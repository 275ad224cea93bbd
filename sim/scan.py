"""The scanned head `lps`: a real person's shape and skin, placed in the stage.

Infinite, 3D Head Scan by Lee Perry-Smith, CC BY 3.0, based on a work at www.triplegangers.com. The
scan is not part of this project: it is read from the folder that LIGHTSTAGE_DATA names, or from
``shared/data`` beside the checkout. What is ours are the annotations in ``sim/data``.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import trimesh
from scipy import ndimage

from lightstage.formats.mesh import Mesh
from lightstage.formats.template import default_template_path, load_template
from sim.errors import SimError
from sim.subdivide import loop_subdivide
from sim.subject import Subject
from sim.texture import raster_uv, tangent_frames

SOURCE = (
    "Infinite, 3D Head Scan by Lee Perry-Smith, CC BY 3.0, based on a work at www.triplegangers.com"
)
MM_PER_UNIT = 52.0
"""The file has no unit; with this the head measures 228 mm from chin to crown, its eyes 65 mm."""
CENTRE_UNITS = (-0.1, 1.1, 1.3)
"""This place of the file, within the head behind the nose, goes to the sphere's centre."""
MEAN_SPECULAR = 0.028
ANNOTATIONS = Path(__file__).parent / "data" / "lps_landmarks.json"


def scan_folder() -> Path | None:
    """Folder of the scan, None where it is absent."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("LIGHTSTAGE_DATA", beside)) / "lps_head"
    return folder if (folder / "LeePerrySmith.glb").is_file() else None


def load_scan(folder: Path, texture_rows: int = 1536) -> Subject:
    """Read the scan.

    The mesh is merged across its UV seams and subdivided once, so that it shows no facets. Colour
    is the colour map in linear light (some of it is baked shading, taken as albedo). Normals are
    the tangent-space map turned into world axes. Specular albedo and roughness were not measured;
    they are made from the colour map's fine detail (`skin_specular`).

    Args:
        folder: with LeePerrySmith.glb, Map-COL.jpg, Infinite-Level_02_Tangent_SmoothUV.jpg.
        texture_rows: side of the square textures.

    Raises:
        SimError: a file is missing or unreadable.
    """
    mesh = _read_mesh(folder / "LeePerrySmith.glb")
    notes = json.loads(ANNOTATIONS.read_text())
    albedo = _linear(_read_picture(folder / "Map-COL.jpg", texture_rows))
    tangent = _read_picture(folder / "Infinite-Level_02_Tangent_SmoothUV.jpg", texture_rows)
    specular, roughness = skin_specular(albedo)
    place = np.array(notes["points"], float)
    landmarks = (place - CENTRE_UNITS) * MM_PER_UNIT
    return Subject(
        name="lps",
        expression="neutral",
        mesh=mesh,
        diffuse_albedo=albedo,
        specular_albedo=specular,
        roughness=roughness,
        normal=world_normals(mesh, tangent),
        translucency=np.full(albedo.shape[:2], 0.5, np.float32),
        landmarks_mm=landmarks,
        skin=_skin(notes, texture_rows),
        head_from_world=head_from_landmarks(landmarks),
        source=SOURCE,
    )


def skin_specular(albedo: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Specular albedo and Beckmann roughness that vary as fine as the skin's colour does.

    Both follow the colour map's band of detail between 1 and 16 texels (dark pores and hairs
    reflect less and are rougher) around values that are usual for skin (.028; m .2 to .35), with a
    broad part from redness. Procedural, not measured.

    Args:
        albedo: (rows, columns, 3) linear.

    Returns:
        (rows, columns) float32 reflectance at normal incidence, about .018 to .038, and m.
    """
    scale = albedo.shape[0] / 1024
    luminance = albedo @ np.array([0.2126, 0.7152, 0.0722], np.float32)
    logs = np.log(np.maximum(luminance, 1e-3))
    fine = ndimage.gaussian_filter(logs, 0.7 * scale) - ndimage.gaussian_filter(logs, 12 * scale)
    red = np.log(np.maximum(albedo[..., 0], 1e-3)) - logs
    broad = ndimage.gaussian_filter(red, 20 * scale)
    broad -= np.median(broad)
    detail = np.tanh(fine / 0.25)
    specular = MEAN_SPECULAR * np.exp(0.25 * detail + 0.35 * np.tanh(broad / 0.2))
    roughness = 0.275 - 0.04 * detail - 0.05 * np.tanh(broad / 0.2)
    return (
        np.clip(specular, 0.018, 0.040).astype(np.float32),
        np.clip(roughness, 0.20, 0.35).astype(np.float32),
    )


def world_normals(mesh: Mesh, tangent_map: np.ndarray) -> np.ndarray:
    """Turn a tangent-space normal map into normals in the mesh's own axes.

    Args:
        mesh: with UV.
        tangent_map: (rows, columns, 3) 0..1, red along u, green along v upward, blue outward.

    Returns:
        (rows, columns, 3) float32 unit vectors, zero where no surface is.
    """
    rows, columns = tangent_map.shape[:2]
    face, weights = raster_uv(mesh, rows, columns)
    covered = face >= 0
    local = tangent_map[covered] * 2.0 - 1.0
    out = np.zeros((rows, columns, 3), np.float32)
    total = np.zeros((len(local), 3))
    for axis, frame in enumerate(tangent_frames(mesh)):
        direction = np.einsum("nck,nc->nk", frame[face[covered]], weights[covered])
        total += local[:, axis, None] * direction
    length = np.linalg.norm(total, axis=1, keepdims=True)
    out[covered] = np.divide(total, length, out=np.zeros_like(total), where=length > 1e-6)
    return out


def _read_mesh(path: Path) -> Mesh:
    try:
        scene = trimesh.load(path, process=False)
        part = next(iter(scene.geometry.values()))
        places, faces = np.asarray(part.vertices, float), np.asarray(part.faces, np.int32)
        uvs = np.asarray(part.visual.uv, float)
    except (OSError, ValueError, StopIteration, AttributeError) as error:
        raise SimError(path, found=str(error), expected="the scan's glTF mesh") from None
    # A vertex on a UV seam is there twice; the surface itself has no seam.
    merged, inverse = np.unique(np.round(places, 5), axis=0, return_inverse=True)
    # trimesh hands glTF's v turned over once; the file's own v ran against glTF's rule.
    upward = np.stack([uvs[:, 0], 1.0 - uvs[:, 1]], axis=1)
    fine = loop_subdivide(Mesh(merged, inverse.ravel()[faces].astype(np.int32), upward, faces))
    return fine.with_vertices((fine.vertices - CENTRE_UNITS) * MM_PER_UNIT)


def _read_picture(path: Path, rows: int) -> np.ndarray:
    """An 8-bit picture as (rows, rows, 3) float32 RGB 0..1."""
    picture = cv2.imread(str(path)) if path.is_file() else None
    if picture is None:
        raise SimError(path, found="no readable picture", expected="the scan's texture")
    rgb = np.asarray(picture)[:, :, ::-1].astype(np.float32) / 255.0
    method = cv2.INTER_CUBIC if rows > len(rgb) else cv2.INTER_AREA
    return np.clip(np.asarray(cv2.resize(rgb, (rows, rows), interpolation=method)), 0.0, 1.0)


def _linear(srgb: np.ndarray) -> np.ndarray:
    """IEC 61966-2-1 decoding."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4).astype(
        np.float32
    )


def _skin(notes: dict[str, Any], rows: int) -> np.ndarray:
    """Face and upper neck, from the outline annotated on the colour map."""
    mask = np.zeros((rows, rows), np.uint8)
    outline = np.array(notes["skin_outline"], float) * rows
    cv2.fillPoly(mask, [np.round(outline).astype(np.int32)], 1)
    return mask.astype(bool)


def head_from_landmarks(landmarks_mm: np.ndarray) -> np.ndarray:
    """(3, 4) rigid motion that lays landmarks best onto the template's (least squares, no scale).

    Source: [Kabsch1976].
    """
    template = load_template(default_template_path())
    wanted = template.mesh.vertices[template.landmarks]
    from_mean, to_mean = landmarks_mm.mean(axis=0), wanted.mean(axis=0)
    u, _, vt = np.linalg.svd((wanted - to_mean).T @ (landmarks_mm - from_mean))
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return np.concatenate([turn, (to_mean - turn @ from_mean)[:, None]], axis=1)
