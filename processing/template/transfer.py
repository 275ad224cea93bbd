"""A whole folder of maps carried from one template's texture to another's."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from lightstage.commands import ProgressCallback, quiet
from lightstage.errors import FormatError
from lightstage.formats.exr import read_exr, write_exr
from lightstage.formats.files import atomic_folder
from lightstage.formats.mesh import Mesh, read_mesh, vertex_normals, write_obj
from lightstage.formats.png import write_png
from lightstage.formats.processed import MAPS
from lightstage.formats.template import Template
from processing.atlas.finish import gutter_sources
from processing.atlas.raster import Raster, rasterise, texel_size_mm
from processing.atlas.tangents import from_tangent_space, tangent_frames, to_tangent_space
from processing.registration.config import RegisterConfig
from processing.registration.stage import register_mesh
from processing.registration.start import named
from processing.template.config import TransferConfig
from processing.template.correspond import Surface, carried_vertices
from processing.template.regions import joined_to
from processing.template.resample import nearest, sampled

MASK = "mask.png"
MESH = "registered_mesh.obj"
OWN = ("*.exr", "*.png", MESH)
COUNTED = {"view": -1.0, "filled": 0.0, "coverage": 0.0, "skin": 0.0}
"""Maps of numbers that have no mean, and their values where nothing is."""
CHUNK = 1 << 20
"""Texels that are looked up at a time."""


@dataclasses.dataclass(frozen=True)
class Pair:
    """Two meshes that are on the same face: where maps are carried along.

    Attributes:
        first: the first template's topology and UV.
        second: the other's.
        first_frames: (n, 3) mm, the first's vertices whose tangents its maps are in.
        second_frames: (m, 3) mm, the other's vertices on the same person.
        facts: of the registration, where there was one.
    """

    first: Mesh
    second: Mesh
    first_frames: np.ndarray
    second_frames: np.ndarray
    facts: dict[str, Any]


@dataclasses.dataclass(frozen=True)
class Grid:
    """Texels of the new texture and where they are in the old one.

    Attributes:
        raster: of the new texture.
        texels: (k,) flat indices of those that both templates have.
        uv: (k, 2) float32 in the old texture.
        larger: (k,) float32, so many times is a texel's side as long on the surface as that of an
            old texture of as many rows.
        covered: share of the new texture's covered texels that both have.
        distance_mm: (k,) float32, between the two surfaces.
    """

    raster: Raster
    texels: np.ndarray
    uv: np.ndarray
    larger: np.ndarray
    covered: float
    distance_mm: np.ndarray


def pair_of_meshes(first: Path, second: Path, one: Template, other: Template) -> Pair:
    """Two meshes of one person, in one frame.

    Raises:
        FormatError: one is not of its template's topology.
    """
    mine, theirs = read_of(first, one), read_of(second, other)
    return Pair(mine, theirs, mine.vertices, theirs.vertices, {})


def registered_pair(
    one: Template,
    other: Template,
    person: Path | None,
    register: RegisterConfig,
    config: TransferConfig,
    progress: ProgressCallback = quiet,
) -> Pair:
    """The first template fitted to the other one.

    Args:
        one: whose texture maps are in.
        other: whose texture they go to.
        person: a mesh of the first template's topology on the person; gives tangents and the other
            template's mesh on that person.
        register: how the first is fitted to the other.
        config: settings.
        progress: called with (done, total).

    Raises:
        FormatError: the person's mesh is not of the template's topology.
        RegistrationError: the templates cannot be fitted to each other.
    """
    given = None if person is None else read_of(person, one).vertices
    whole, triangles = other.mesh, other.mesh.triangles()
    outer = joined_to(other.landmarks, triangles, len(whole.vertices))
    scan = Mesh(whole.vertices, triangles[outer[triangles].all(axis=1)])
    marks = whole.vertices[other.landmarks]
    with named(f"template {other.name}"):
        vertices, facts = register_mesh(scan, marks, one, register, progress)
    placed = one.mesh.with_vertices(vertices)
    if given is None:
        return Pair(placed, whole, vertices, whole.vertices, facts)
    places, _ = carried_vertices(placed, given, whole, config)
    return Pair(placed, whole, given, places, facts)


def read_of(path: Path, template: Template) -> Mesh:
    """A mesh of a template's topology, with the template's UV.

    Raises:
        FormatError: unreadable, or of another topology.
    """
    mesh, own = read_mesh(path), template.mesh
    if mesh.faces.shape != own.faces.shape or not np.array_equal(mesh.faces, own.faces):
        raise FormatError(
            path,
            field="faces",
            found=f"{len(mesh.vertices)} vertices, {len(mesh.faces)} faces",
            expected=f"those of the template {template.name}: {len(own.vertices)}, "
            f"{len(own.faces)}",
            hint="Name a mesh that was registered to that template.",
        )
    return own.with_vertices(mesh.vertices)


def transfer(
    maps: Path,
    pair: Pair,
    out: Path,
    rows: int | None,
    config: TransferConfig,
    progress: ProgressCallback = quiet,
) -> dict[str, Any]:
    """Carry all maps of a folder; writes `out` whole or not at all.

    Args:
        maps: folder with .exr and .png pictures, each the whole texture of the first template.
        pair: where they are carried along.
        out: folder to make or to replace, if it was made by this.
        rows: of the new maps; None keeps each one's size.
        config: settings.
        progress: called with (done, total).

    Returns:
        Facts, JSON-ready.

    Raises:
        FormatError: no maps, one that cannot be read, or that is not finite; meshes that have no
            place in common.
    """
    files = find_maps(maps)
    grids: dict[tuple[int, int], Grid] = {}
    carrier = Carrier(pair, config)
    with atomic_folder(out, MASK, own=OWN) as beside:
        for done, file in enumerate(files):
            progress(done, len(files))
            image, unit = _read(file)
            size = image.shape[:2]
            if rows is not None:
                size = (rows, max(1, round(rows * size[1] / size[0])))
            if size not in grids:
                grids[size] = carrier.grid(*size)
                _require_common(grids[size], maps)
            _write(beside / file.name, carrier.carry(file.stem, image, grids[size]), unit)
        largest = grids[max(grids)]
        seen = np.ones((*largest.raster.face.shape, 1), np.float32)
        if (maps / MASK).is_file():
            seen, _ = _read(maps / MASK)
        there = carrier.carry(MASK, seen[..., :1], largest)[..., 0] > 0.5
        write_png(beside / MASK, np.where(there, 255, 0).astype(np.uint8))
        write_obj(pair.second.with_vertices(pair.second_frames), beside / MESH)
        progress(len(files), len(files))
    away = largest.distance_mm
    return {
        "maps": [file.name for file in files],
        "carried_share": largest.covered,
        "distance_median_mm": float(np.median(away)),
        "distance_p95_mm": float(np.quantile(away, 0.95)),
        "registration": pair.facts,
    }


def _require_common(grid: Grid, maps: Path) -> None:
    if not len(grid.texels):
        raise FormatError(
            maps,
            field="meshes",
            found="no texel of the new texture that the old one has",
            expected="two meshes of one person in the same place",
            hint="Are --from-mesh and --to-mesh in the same axes and in mm?",
        )


def find_maps(folder: Path) -> list[Path]:
    """Pictures of a folder, by name; the mask is none.

    Raises:
        FormatError: no folder, or none in it.
    """
    if not folder.is_dir():
        raise FormatError(
            folder,
            found="a file" if folder.exists() else "no such folder",
            expected="a folder of maps, such as OUT/atlas",
        )
    files = sorted(
        path for path in folder.iterdir()
        if path.suffix.lower() in (".exr", ".png") and path.name != MASK and path.name[0] != "."
    )  # fmt: skip
    if not files:
        raise FormatError(
            folder,
            found="neither .exr nor .png in it",
            expected="a folder of maps, such as OUT/atlas",
        )
    return files


class Carrier:
    """Carries maps along a pair of meshes."""

    def __init__(self, pair: Pair, config: TransferConfig) -> None:
        """Prepare the surface that is sampled, and both meshes' tangents."""
        self._pair, self._config = pair, config
        self._surface = Surface(pair.first, config)
        self._old: dict[tuple[int, int], Raster] = {}

    def grid(self, rows: int, columns: int) -> Grid:
        """Where the texels of a new texture are in the old one."""
        first, second = self._pair.first, self._pair.second
        assert first.uvs is not None  # of templates
        assert second.uvs is not None
        raster = rasterise(second.uvs, second.triangle_uvs(), rows, columns)
        triangles, normals = second.triangles(), vertex_normals(second.vertices, second.triangles())
        texels = raster.texels()
        old_mm = _side_mm(first, self._pair.first_frames, rows, columns)
        new_mm = _side_mm(second, self._pair.second_frames, rows, columns)
        parts = []
        for start in range(0, len(texels), CHUNK):
            some = texels[start : start + CHUNK]
            normal = raster.at(normals, triangles, some).astype(float)
            normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
            found = self._surface.places(raster.at(second.vertices, triangles, some), normal)
            uv = found.of(first.uvs, first.triangle_uvs())
            there = found.there
            old, new = old_mm[found.face], new_mm[raster.face.ravel()[some]]
            ok = np.isfinite(new) & (old > 0) & np.isfinite(old)
            larger = np.divide(new, old, out=np.ones_like(new), where=ok)
            each = (uv, larger, found.distance_mm)
            parts.append((some[there], *(values[there].astype(np.float32) for values in each)))
        if not parts:  # a texture without a single covered texel
            parts.append((texels, np.zeros((0, 2), np.float32), *np.zeros((2, 0), np.float32)))
        kept, uv, larger, away = (np.concatenate(each) for each in zip(*parts, strict=True))
        share = len(kept) / len(texels) if len(texels) else 0.0
        return Grid(raster, kept, uv, larger, share, away)

    def carry(self, name: str, image: np.ndarray, grid: Grid) -> np.ndarray:
        """One map in the new texture.

        Args:
            name: of the map, which decides what it holds: tangent-space normals, other normals,
                numbers with no mean, or plain values.
            image: (h, w, c) float32.
            grid: of the new texture.

        Returns:
            (rows, columns, c) float32; beside the islands their nearest texel, 0 elsewhere.
        """
        old = self._raster_of(image.shape[:2])
        covered = old.face >= 0
        tangent = "tangent" in name and image.shape[2] == 3
        if tangent:
            image = self._decoded(image, old)
        if name in COUNTED or name == MASK:
            values, known = nearest(image, covered, grid.uv)
        else:
            larger = grid.larger * (len(image) / len(grid.raster.face))
            values, known = sampled(image, covered, grid.uv, larger, self._config.coarsest)
        if image.shape[2] == 3 and "normal" in name:
            length = np.linalg.norm(values, axis=1, keepdims=True)
            values = np.divide(values, length, out=np.zeros_like(values), where=length > 1e-6)
        if tangent:
            values = self._encoded(values, grid)
        out = np.full((grid.raster.face.size, image.shape[2]), COUNTED.get(name, 0.0), np.float32)
        out[grid.texels[known]] = values[known]
        shape = grid.raster.face.shape
        there = np.zeros(grid.raster.face.size, bool)
        there[grid.texels[known]] = True
        if name != MASK:
            gutter, source = gutter_sources(there.reshape(shape), self._config.gutter_px)
            beside = grid.raster.face.ravel()[gutter] < 0
            out[gutter[beside]] = out[source[beside]]
        return out.reshape(*shape, -1)

    def _raster_of(self, size: tuple[int, ...]) -> Raster:
        rows, columns = size[:2]
        if (rows, columns) not in self._old:
            first = self._pair.first
            assert first.uvs is not None  # of templates
            self._old[rows, columns] = rasterise(first.uvs, first.triangle_uvs(), rows, columns)
        return self._old[rows, columns]

    def _decoded(self, image: np.ndarray, raster: Raster) -> np.ndarray:
        """(h, w, 3) the old texture's tangent-space normals in the meshes' axes."""
        mesh, frames, normals = self._frames(self._pair.first, self._pair.first_frames)
        texels = raster.texels()
        out = np.zeros((raster.face.size, 3), np.float32)
        out[texels] = from_tangent_space(
            image.reshape(-1, 3)[texels], raster, texels, mesh.triangles(), normals, frames
        )
        return out.reshape(image.shape)

    def _encoded(self, world: np.ndarray, grid: Grid) -> np.ndarray:
        mesh, frames, normals = self._frames(self._pair.second, self._pair.second_frames)
        return to_tangent_space(world, grid.raster, grid.texels, mesh.triangles(), normals, frames)

    @staticmethod
    def _frames(mesh: Mesh, vertices: np.ndarray) -> tuple[Mesh, Any, np.ndarray]:
        assert mesh.uvs is not None  # of templates
        triangles = mesh.triangles()
        normals = vertex_normals(vertices, triangles)
        frames = tangent_frames(vertices, triangles, mesh.uvs, mesh.triangle_uvs(), normals)
        return mesh, frames, normals


def _side_mm(mesh: Mesh, vertices: np.ndarray, rows: int, columns: int) -> np.ndarray:
    assert mesh.uvs is not None  # of templates
    corners = mesh.triangle_uvs()
    return texel_size_mm(vertices, mesh.triangles(), mesh.uvs, corners, rows, columns)


def _read(path: Path) -> tuple[np.ndarray, float]:
    """A map as (h, w, c) float32, and what a PNG's full value is (0 for an EXR)."""
    if path.suffix.lower() == ".exr":
        image = read_exr(path, finite=True)
        return image[..., None] if image.ndim == 2 else image, 0.0
    stored = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if stored is None or stored.dtype not in (np.uint8, np.uint16):
        raise FormatError(path, found="no readable picture", expected="a PNG of 8 or 16 bits")
    full = 255.0 if stored.dtype == np.uint8 else 65535.0
    if stored.ndim == 2:
        return (stored / full).astype(np.float32)[..., None], full
    image = (stored[..., [2, 1, 0, *range(3, stored.shape[2])]] / full).astype(np.float32)
    if "normal" in path.stem and image.shape[2] == 3:
        image = 2 * image - 1
    return image, full


def _write(path: Path, image: np.ndarray, full: float) -> None:
    """Write a map as the one it was made of."""
    plain = image[..., 0] if image.shape[2] == 1 else image
    if not full:
        spec = MAPS.get(path.stem)
        write_exr(path, plain, half=spec is not None and spec.half)
        return
    if "normal" in path.stem and image.shape[2] == 3:
        plain = (plain + 1) / 2
    kind = np.uint8 if full < 256 else np.uint16
    write_png(path, np.round(np.clip(plain, 0, 1) * full).astype(kind))
