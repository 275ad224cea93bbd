"""What is exported: a mesh with UV and the maps in its texture, looked through before anything."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np

from learning.errors import MapsError
from learning.map_checks import (
    compared_texels,
    require_albedo,
    require_millimetres,
    require_same_surface,
)
from learning.map_folders import MARK, require_texture_maps
from learning.maps import SHININESS
from lightstage.formats.exr import read_half_exr
from lightstage.formats.mesh import Mesh, read_mesh, vertex_normals
from lightstage.formats.processed import MAPS, ProcessedFolder
from lightstage.formats.template import load_template
from processing.atlas.raster import Raster, rasterise
from processing.atlas.tangents import (
    TangentFrames,
    from_tangent_space,
    tangent_frames,
    to_tangent_space,
)

NORMALS = ("diffuse_normal", "specular_normal")
NEEDED = ("diffuse_albedo", "specular_albedo", *NORMALS)
OPTIONAL = ("roughness", "ambient_occlusion", "confidence")
NO_NORMAL = 1e-6
"""Squared length below which a texel of a map has no normal."""


@dataclasses.dataclass(frozen=True)
class Source:
    """A mesh and the maps in its texture.

    Attributes:
        mesh: mm, in its own axes, with UV.
        normals: (n, 3) unit, of its vertices; zero where all its triangles are degenerate.
        frames: MikkTSpace's tangents of its corners.
        raster: of the texture.
        nearest: (rows, columns) int32, the covered texel, as a flat index, whose value a texel
            shows; outside of the surface the nearest one, so that filtering shows no seam.
        folder: of the maps.
        maps: by name, (rows, columns) or (rows, columns, 3) float16, finite.
        notes: what a user should know.
        photo_mm: (n, 3) from the mesh to its photograph's expression; None of a captured head.
    """

    mesh: Mesh
    normals: np.ndarray
    frames: TangentFrames
    raster: Raster
    nearest: np.ndarray
    folder: Path
    maps: dict[str, np.ndarray]
    notes: tuple[str, ...] = ()
    photo_mm: np.ndarray | None = None

    @property
    def size(self) -> tuple[int, int]:
        """Rows and columns of the maps."""
        rows, columns = self.nearest.shape
        return rows, columns

    @property
    def covered(self) -> np.ndarray:
        """(rows, columns) bool, where the mesh is."""
        return self.raster.face >= 0

    def spread(self, image: np.ndarray) -> np.ndarray:
        """A (rows, columns[, 3]) map; texels beside the surface get the nearest one's value."""
        flat = image.reshape(len(self.nearest.ravel()), -1)
        return flat[self.nearest.ravel()].reshape(image.shape)

    def tangent(self, name: str) -> np.ndarray:
        """(rows, columns, 3) float32 normals of a map in MikkTSpace's frame, spread.

        A texel without a normal shows the mesh's: (0, 0, 1).
        """
        texels = self.raster.texels()
        world = self.maps[name].reshape(-1, 3)[texels].astype(np.float32)
        found = to_tangent_space(
            world, self.raster, texels, self.mesh.triangles(), self.normals, self.frames
        )
        found[np.einsum("kc,kc->k", world, world) < NO_NORMAL] = (0, 0, 1)
        out = np.empty((self.nearest.size, 3), np.float32)
        out[texels] = found
        return out[self.nearest.ravel()].reshape(*self.nearest.shape, 3)


def maps_folder(given: Path, option: str = "") -> Path:
    """The folder of maps that is meant: of a processed folder, a fit or an avatar its atlas.

    Args:
        given: any of these, or maps.
        option: by which it was given; empty of an argument.

    Raises:
        MapsError: none, several, or one camera's (see `require_texture_maps`).
    """
    for atlas in (given / "atlas", given / "fit" / "atlas"):
        if not (given / MARK).is_file() and (atlas / MARK).is_file():
            return atlas
    require_texture_maps(given, option)
    return given


def read_source(given: Path, mesh: Path | None = None, template: Path | None = None) -> Source:
    """Read a processed folder, or a folder of maps and the mesh that they belong to.

    Args:
        given: a processed folder, a fit or an avatar (its atlas is taken), an atlas, or maps of
            `infer`.
        mesh: with the maps' UV, in the axes of their normals; where None registered_mesh.obj beside
            the maps, without the expression of its photograph where neutral_mesh.obj is there, too.
        template: whose exponents give the roughness where no map does.

    Raises:
        MapsError: no mesh, one without UV or not in mm; maps that are missing, of other sizes,
            negative, or of another template.
        FormatError: a file that cannot be read, or that has NaN.
    """
    folder = maps_folder(given)
    beside = ProcessedFolder(folder.parent)
    place = beside.registered_mesh if mesh is None else mesh
    if not place.exists():
        raise MapsError(
            place,
            field="--mesh",
            found="no such file",
            expected="the mesh of the maps",
            hint="Name it by --mesh; the atlas of a capture has its registered_mesh.obj one folder "
            "up.",
        )
    shape = read_mesh(place)
    _require_shape(shape, place)
    maps = _read_maps(folder)
    rows, columns = maps["diffuse_albedo"].shape[:2]
    triangles, corners = shape.triangles(), shape.triangle_uvs()
    assert shape.uvs is not None  # _require_shape
    raster = rasterise(shape.uvs, corners, rows, columns)
    if not (raster.face >= 0).any():
        raise MapsError(place, field="uv", found="no texel covered", expected="UV in 0..1")
    normals = vertex_normals(shape.vertices, triangles)
    texels = compared_texels(raster.face >= 0)
    place_mm, normal = (raster.at(each, triangles, texels) for each in (shape.vertices, normals))
    require_same_surface(maps, texels, place_mm, normal, folder, place)
    notes = []
    rough = _roughness(maps.get("roughness"), template, raster.face >= 0)
    if rough is not None:
        maps["roughness"] = rough
    else:
        notes.append("no map of roughness: the whole face has one number")
    if not np.any(maps["specular_albedo"]):
        notes.append("specular_albedo is 0 everywhere: nothing shines")
    frames = tangent_frames(shape.vertices, triangles, shape.uvs, corners, normals)
    maps = {name: image for name, image in maps.items() if name != "position"}
    nearest = nearest_covered(raster.face >= 0)
    source = Source(shape, normals, frames, raster, nearest, folder, maps, tuple(notes))
    if mesh is not None or not beside.neutral_mesh.exists():
        return source
    photo_mm = shape.vertices - _neutral_of(shape, beside.neutral_mesh)
    return dataclasses.replace(posed(source, -photo_mm), photo_mm=photo_mm)


def posed(source: Source, offsets: np.ndarray) -> Source:
    """A head with another expression; its normals follow the surface.

    The maps' normals stay as they are in each texel's frame, which turns with the triangles.

    Args:
        source: the head.
        offsets: (n, 3) of its vertices, mm.
    """
    mesh = source.mesh.with_vertices(source.mesh.vertices + offsets)
    triangles = mesh.triangles()
    assert mesh.uvs is not None  # read_source refuses a mesh without
    normals = vertex_normals(mesh.vertices, triangles)
    frames = tangent_frames(mesh.vertices, triangles, mesh.uvs, mesh.triangle_uvs(), normals)
    texels = source.raster.texels()
    maps = dict(source.maps)
    for name in NORMALS:
        flat = source.maps[name].reshape(-1, 3).copy()
        before = flat[texels].astype(np.float32)
        there = np.einsum("kc,kc->k", before, before) >= NO_NORMAL
        fine = to_tangent_space(
            before, source.raster, texels, triangles, source.normals, source.frames
        )
        turned = from_tangent_space(fine, source.raster, texels, triangles, normals, frames)
        flat[texels] = np.where(there[:, None], turned, 0)
        maps[name] = flat.reshape(source.maps[name].shape)
    return dataclasses.replace(source, mesh=mesh, normals=normals, frames=frames, maps=maps)


def _neutral_of(mesh: Mesh, where: Path) -> np.ndarray:
    """(n, 3) vertices of a mesh's neutral one."""
    found = read_mesh(where).vertices
    if found.shape != mesh.vertices.shape:
        raise MapsError(
            where,
            found=f"{len(found)} vertices",
            expected=f"those of the registered mesh beside it, {len(mesh.vertices)}",
            hint="Run `fit` again, or name the mesh of the maps by --mesh.",
        )
    return found


def m_of(exponent: np.ndarray) -> np.ndarray:
    """(...) Beckmann's m of a lobe as wide as Blinn and Phong's exponent gives [Walter2007]."""
    return np.asarray(np.sqrt(2 / (exponent + 2)))


def _roughness(
    measured: np.ndarray | None, template: Path | None, covered: np.ndarray
) -> np.ndarray | None:
    """(rows, columns) float16 Beckmann's m; None where neither a map nor the template states it.

    Texels that were not measured, 0, would be mirrors: as in the renderer they have the template's,
    else the constant one.
    """
    if measured is not None and (measured[covered] > 0).all():
        return measured
    shininess = None if template is None else load_template(template).maps.get("shininess")
    if measured is None and shininess is None:
        return None
    exponent = np.full(covered.shape, SHININESS)
    if shininess is not None:
        exponent = cv2.resize(shininess, covered.shape[::-1])
    rough = m_of(exponent).astype(np.float16)
    return rough if measured is None else np.where(measured > 0, measured, rough)


def _require_shape(mesh: Mesh, where: Path) -> None:
    if mesh.uvs is None or mesh.face_uvs is None:
        raise MapsError(
            where,
            field="uv",
            found="none",
            expected="the maps' texture coordinates",
            hint="Give the mesh that the maps were made on; a base mesh has no UV.",
        )
    if mesh.uvs.min() < -1e-6 or mesh.uvs.max() > 1 + 1e-6:
        raise MapsError(
            where,
            field="uv",
            found=f"UV from {mesh.uvs.min():.3g} to {mesh.uvs.max():.3g}",
            expected="one tile, 0..1",
        )
    require_millimetres(mesh, where)


def _read_maps(folder: Path) -> dict[str, np.ndarray]:
    """The maps that are exported, and the one of positions, which shows whose they are."""
    maps: dict[str, np.ndarray] = {}
    for name in (*NEEDED, *OPTIONAL, "position"):
        path = folder / f"{name}.exr"
        if name not in NEEDED and not path.exists():
            continue
        image = read_half_exr(path)
        found, expected = (1 if image.ndim == 2 else image.shape[2]), MAPS[name].channels
        if found != expected:
            raise MapsError(
                path, found=f"{found} channels", expected=f"{expected}, as a map of this name has"
            )
        first = maps.get(NEEDED[0], image)
        if image.shape[:2] != first.shape[:2]:
            raise MapsError(
                path,
                found=f"{image.shape[0]} x {image.shape[1]} texels",
                expected=f"{first.shape[0]} x {first.shape[1]}, as diffuse_albedo",
                hint="Maps of one folder belong to one atlas; make them again together.",
            )
        if not name.endswith("_normal") and name != "position":
            require_albedo(image, path)
        maps[name] = image
    return maps


def nearest_covered(covered: np.ndarray) -> np.ndarray:
    """(rows, columns) int32 flat index of each texel's nearest covered one."""
    _, label = cv2.distanceTransformWithLabels(
        (~covered).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    owner = np.zeros(int(label.max()) + 1, np.int32)
    owner[label[covered]] = np.flatnonzero(covered)
    nearest: np.ndarray = owner[label]
    return nearest
