"""One geometry pass: which texels show the mesh, and where on it; all maps share it."""

from __future__ import annotations

import dataclasses

import numpy as np

from lightstage.formats.mesh import Mesh, vertex_normals
from processing.atlas.raster import Raster, overlap_share, rasterise, texel_size_mm
from processing.atlas.tangents import tangent_frames, to_tangent_space
from processing.atlas.tiles import Tiles, tiled
from processing.errors import AtlasError


@dataclasses.dataclass(frozen=True)
class Geometry:
    """The atlas's covered texels, tile after tile, and the mesh they lie on."""

    raster: Raster
    tiles: Tiles
    mesh: Mesh
    uvs: np.ndarray
    triangles: np.ndarray
    vertices: np.ndarray
    vertex_normals: np.ndarray

    @classmethod
    def of(cls, mesh: Mesh, rows: int) -> Geometry:
        """Rasterise a mesh's UV into rows x two thirds of it.

        Raises:
            AtlasError: no UV.
        """
        triangles = mesh.triangles()
        if mesh.uvs is None:
            raise AtlasError("registered mesh", found="no UV", expected="the template's UV")
        raster = rasterise(mesh.uvs, mesh.triangle_uvs(), rows, rows * 2 // 3)
        normals = vertex_normals(mesh.vertices, triangles)
        return cls(raster, tiled(raster.face), mesh, mesh.uvs, triangles, mesh.vertices, normals)

    def at(self, values: np.ndarray) -> np.ndarray:
        """(k, c) float32 of per-vertex values."""
        return self.raster.at(values, self.triangles, self.tiles.flat)

    def whole(self, chosen: np.ndarray) -> np.ndarray:
        """(k,) bool: texels of triangles whose three corners are all among (n,) chosen vertices."""
        inside = np.asarray(chosen, bool)[self.triangles].all(axis=1)
        return np.asarray(inside[self.raster.face.ravel()[self.tiles.flat]])

    def normals(self) -> np.ndarray:
        """(k, 3) float32 unit normals of the mesh."""
        values = self.at(self.vertex_normals)
        length = np.sqrt(np.einsum("kc,kc->k", values, values))[:, None]
        np.divide(values, length, out=values, where=length > 1e-9)
        return values

    def tangent(self, world: np.ndarray) -> np.ndarray:
        """(k, 3) float32 tangent-space normals of (k, 3) unit ones in world axes."""
        normals = self.vertex_normals
        frames = tangent_frames(
            self.vertices, self.triangles, self.uvs, self.mesh.triangle_uvs(), normals
        )
        return to_tangent_space(
            world, self.raster, self.tiles.flat, self.triangles, normals, frames
        )

    def overlap_share(self) -> float:
        """Share of the texture that more than one place of the mesh uses."""
        return overlap_share(self.uvs, self.mesh.triangle_uvs(), self.raster)

    def texel_mm_median(self, seen: np.ndarray) -> float:
        """Median side of a texel on the surface, over some of them.

        Args:
            seen: (k,) bool.
        """
        rows, columns = self.raster.face.shape
        size = texel_size_mm(
            self.vertices, self.triangles, self.uvs, self.mesh.triangle_uvs(), rows, columns
        )
        shown = np.bincount(self.raster.face.ravel()[self.tiles.flat][seen], minlength=len(size))
        order = np.argsort(size)
        return float(size[order[np.searchsorted(np.cumsum(shown[order]), 0.5 * shown.sum())]])
