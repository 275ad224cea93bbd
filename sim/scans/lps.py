"""Scans as subjects: what is made of a scan's textures; and the scanned head `lps`.

Infinite, 3D Head Scan by Lee Perry-Smith, CC BY 3.0, based on a work at www.triplegangers.com. The
scan is not part of this project: it is read from the folder that LIGHTSTAGE_DATA names, or from
``shared/data`` beside the checkout. What is ours are the annotations in ``sim/data``.
"""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy import ndimage

from lightstage.formats.files import read_json
from lightstage.formats.mesh import Mesh
from lightstage.formats.srgb import LUMINANCE
from lightstage.formats.template import default_template_path, load_template
from sim.errors import SimError
from sim.light.texture import raster_uv, tangent_frames
from sim.people.subject import Subject
from sim.scans.gltf import read_gltf
from sim.scans.head_data import head_data_folder
from sim.scans.scan_file import read_picture
from sim.scans.subdivide import loop_subdivide

SOURCE = (
    "Infinite, 3D Head Scan by Lee Perry-Smith, CC BY 3.0, based on a work at www.triplegangers.com"
)
MM_PER_UNIT = 52.0
"""The file has no unit; with this the head measures 228 mm from chin to crown, its eyes 65 mm."""
CENTRE_UNITS = (-0.1, 1.1, 1.3)
"""This place of the file, within the head behind the nose, goes to the sphere's centre."""
MEAN_SPECULAR = 0.028
DETAIL_TEXEL_MM = 0.35
"""A texel of a head's texture of 1024 rows."""
ANNOTATIONS = Path(__file__).parents[1] / "data" / "lps_landmarks.json"


def scan_folder() -> Path | None:
    """Folder of the scan, None where it is absent."""
    return head_data_folder("lps_head", "LeePerrySmith.glb")


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
    notes = read_json(ANNOTATIONS)
    albedo = linear_of(_read_picture(folder / "Map-COL.jpg", texture_rows))
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


def fine_detail(albedo: np.ndarray, scale: float) -> np.ndarray:
    """The colour map's detail of pores and hairs, -1 (dark) to 1.

    Args:
        albedo: (rows, columns, 3) linear.
        scale: texels of `DETAIL_TEXEL_MM`; the band is between .25 and 4 mm.

    Returns:
        (rows, columns) float32.
    """
    luminance = albedo @ LUMINANCE.astype(np.float32)
    logs = np.log(np.maximum(luminance, 1e-3))
    fine = ndimage.gaussian_filter(logs, 0.7 * scale) - ndimage.gaussian_filter(logs, 12 * scale)
    return np.asarray(np.tanh(fine / 0.25))


def skin_specular(albedo: np.ndarray, scale: float | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Specular albedo and Beckmann roughness that vary as fine as the skin's colour does.

    Both follow the colour map's fine detail (dark pores and hairs reflect less and are rougher)
    around values that are usual for skin (.028; m .2 to .35), with a broad part from redness.
    Procedural, not measured.

    Args:
        albedo: (rows, columns, 3) linear.
        scale: see `fine_detail`; None for a head's texture of 1024 rows a unit.

    Returns:
        (rows, columns) float32 reflectance at normal incidence, about .018 to .038, and m.
    """
    scale = albedo.shape[0] / 1024 if scale is None else scale
    detail = fine_detail(albedo, scale)
    luminance = albedo @ LUMINANCE.astype(np.float32)
    red = np.log(np.maximum(albedo[..., 0], 1e-3)) - np.log(np.maximum(luminance, 1e-3))
    broad = ndimage.gaussian_filter(red, 20 * scale)
    broad -= np.median(broad)
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
    """The scan's mesh in world mm, subdivided once."""
    if not path.is_file():
        raise SimError(path, found="no such file", expected="the scan's glTF mesh")
    mesh = read_gltf(path).mesh
    if mesh.uvs is None:
        raise SimError(path, field="uv", found="none", expected="texture coordinates")
    # The file's own v runs against glTF's rule.
    upward = np.stack([mesh.uvs[:, 0], 1.0 - mesh.uvs[:, 1]], axis=1)
    fine = loop_subdivide(dataclasses.replace(mesh, uvs=upward))
    return fine.with_vertices((fine.vertices - CENTRE_UNITS) * MM_PER_UNIT)


def resized(pixels: np.ndarray, rows: int, columns: int) -> np.ndarray:
    """A texture (h, w, k) in another size, (rows, columns, k) float32."""
    method = cv2.INTER_CUBIC if rows > len(pixels) else cv2.INTER_AREA
    return np.asarray(cv2.resize(pixels, (columns, rows), interpolation=method), np.float32)


def _read_picture(path: Path, rows: int) -> np.ndarray:
    """An 8-bit picture as (rows, rows, 3) float32 RGB 0..1."""
    return np.clip(resized(read_picture(path).pixels, rows, rows), 0.0, 1.0)


def linear_of(srgb: np.ndarray) -> np.ndarray:
    """Linear light (...) of (...) sRGB values 0..1 ([IEC61966]), float32."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4).astype(
        np.float32
    )


def _skin(notes: dict[str, Any], rows: int) -> np.ndarray:
    """Face and upper neck, from the outline annotated on the colour map."""
    mask = np.zeros((rows, rows), np.uint8)
    outline = np.array(notes["skin_outline"], float) * rows
    cv2.fillPoly(mask, [np.round(outline).astype(np.int32)], 1)
    return mask.astype(bool)


@functools.cache
def template_landmarks() -> np.ndarray:
    """(68, 3) mm of our own template, head frame."""
    template = load_template(default_template_path())
    marks = template.mesh.vertices[template.landmarks]
    marks.flags.writeable = False
    return marks


def head_from_landmarks(landmarks_mm: np.ndarray) -> np.ndarray:
    """(3, 4) rigid motion that fits landmarks best to the template's (least squares, no scale).

    Source: [Kabsch1976].

    Args:
        landmarks_mm: (68, 3), NaN where unknown; three known ones that are not in a line.
    """
    known = np.isfinite(landmarks_mm).all(axis=1)
    found, wanted = landmarks_mm[known], template_landmarks()[known]
    from_mean, to_mean = found.mean(axis=0), wanted.mean(axis=0)
    u, _, vt = np.linalg.svd((wanted - to_mean).T @ (found - from_mean))
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return np.concatenate([turn, (to_mean - turn @ from_mean)[:, None]], axis=1)
