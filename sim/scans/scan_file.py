"""What a scan's file holds, before anything is assumed about it."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np

from lightstage.formats.exr import read_exr
from lightstage.formats.mesh import Mesh
from sim.errors import SimError


@dataclasses.dataclass(frozen=True)
class Picture:
    """A texture as its file has it.

    Attributes:
        where: the file.
        pixels: (rows, columns, 3) float32; 0..1 where the file holds integers.
        linear: whether pixels are linear light (OpenEXR) and not sRGB.
    """

    where: str
    pixels: np.ndarray
    linear: bool


@dataclasses.dataclass(frozen=True)
class ScanFile:
    """A scan as its file has it.

    Attributes:
        where: the file.
        mesh: triangles in the file's own unit and axes; UV in OBJ's sense (v upward) or None.
        mm_per_unit: the format's unit: glTF has metres, OBJ none (None).
        colour: albedo texture, or None.
        colour_factor: linear, multiplies the colour.
        normals: tangent-space normals, or None.
        roughness: perceptual roughness in its green channel, as glTF defines it, or None.
        roughness_factor: multiplies it.
    """

    where: Path
    mesh: Mesh
    mm_per_unit: float | None
    colour: Picture | None = None
    colour_factor: tuple[float, float, float] = (1.0, 1.0, 1.0)
    normals: Picture | None = None
    roughness: Picture | None = None
    roughness_factor: float = 1.0


def read_picture(path: Path) -> Picture:
    """Read a texture's file; SimError when it is missing or no picture."""
    if not path.is_file():
        raise SimError(path, found="no such file", expected="a texture")
    if path.suffix.lower() == ".exr":
        pixels = read_exr(path, finite=True)
        if pixels.ndim == 2:
            pixels = np.repeat(pixels[:, :, None], 3, axis=2)
        return Picture(str(path), pixels, True)
    return decode_picture(path.read_bytes(), str(path))


def decode_picture(data: bytes, where: str) -> Picture:
    """Decode PNG, JPEG and what else OpenCV reads, of 8 or 16 bits; SimError otherwise."""
    flags = cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
    found = cv2.imdecode(np.frombuffer(data, np.uint8), flags) if data else None
    if found is None:
        raise SimError(where, found="no readable picture", expected="a texture: PNG or JPEG")
    pixels = np.asarray(found)[:, :, ::-1]
    tops = {"uint8": 255.0, "uint16": 65535.0}
    if pixels.dtype.name in tops:
        top = tops[pixels.dtype.name]
        return Picture(where, (pixels / top).astype(np.float32), False)
    raise SimError(where, found=f"{pixels.dtype} pixels", expected="8 or 16 bits, or OpenEXR")


def merged(
    points: np.ndarray,
    faces: np.ndarray,
    uvs: np.ndarray | None,
    face_uvs: np.ndarray | None,
) -> Mesh:
    """A mesh whose vertices are one where they are in one place; UV keep their own indices.

    Files repeat a vertex at each UV seam; the surface itself has none. Vertices of no face are
    left out: they are no part of the head and would count for its size.

    Args:
        points: (n, 3), finite.
        faces: (t, 3) into points.
        uvs: (k, 2) or None.
        face_uvs: (t, 3) into UV or None.
    """
    used, faces = np.unique(faces, return_inverse=True)
    points, faces = points[used], faces.reshape(-1, 3)
    step = max(float(np.ptp(points, axis=0).max()), 1e-30) * 1e-6
    _, first, inverse = np.unique(
        np.round(points / step), axis=0, return_index=True, return_inverse=True
    )
    joined = inverse.ravel()[faces].astype(np.int32)
    if uvs is None or face_uvs is None:
        return Mesh(points[first], joined)
    return Mesh(points[first], joined, uvs, face_uvs.astype(np.int32))
