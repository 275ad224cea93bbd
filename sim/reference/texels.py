"""The skin as a set of small patches: texels of the subject's UV, and coarser nodes over them."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
from scipy import ndimage, sparse

from lightstage.formats.mesh import connected
from sim.errors import SimError
from sim.light.texture import raster_uv
from sim.reference.points import Points, Skin, unit

MAX_TEXELS = 64_000_000
MULTIPLE = 16


@dataclasses.dataclass(frozen=True)
class Nodes:
    """A coarser layer: each node gathers the texels around it by a tent in UV.

    A texel's shares in its nodes sum to one, so gathering and spreading are each other's adjoint,
    weighted by area: what is built of them is symmetric and keeps energy.

    Attributes:
        share: (n texels, k nodes) sparse.
        area: (k,) mm^2.
        position: (k, 3) mm, the mean of a node's texels.
        normal: (k, 3) unit.
        spread: (k,) mm^2, the variance of a node's texels along the surface.
        texel_area: (n,) mm^2.
    """

    share: sparse.csr_matrix
    area: np.ndarray
    position: np.ndarray
    normal: np.ndarray
    spread: np.ndarray
    texel_area: np.ndarray

    def gather(self, values: np.ndarray) -> np.ndarray:
        """Area-weighted means (k, c) of texels' values (n, c)."""
        return (self.share.T @ (values * self.texel_area[:, None])) / self.area[:, None]

    def spread_out(self, values: np.ndarray) -> np.ndarray:
        """Texels' values (n, c) from nodes' (k, c)."""
        return self.share @ values


class Texels:
    """A subject's surface in patches of about one size.

    Args:
        skin: the surface.
        texel_mm: wanted mean spacing.

    Attributes:
        points: n texels that lie on the surface.
        area: (n,) mm^2.
        spacing_mm: mean spacing.
    """

    def __init__(self, skin: Skin, texel_mm: float) -> None:
        mesh = skin.subject.mesh
        assert mesh.uvs is not None
        corners = skin.vertices[skin.triangles]
        area = np.linalg.norm(
            np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
        )
        flat = mesh.uvs[skin.uv_triangles]
        u, v = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
        uv_area = np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
        rows, columns = skin.subject.diffuse_albedo.shape[:2]
        density = area[uv_area > 0].sum() / max(uv_area.sum(), 1e-12)  # mm^2 of a unit of UV
        finer = np.sqrt(density / (rows * columns)) / texel_mm
        self.shape = tuple(
            max(MULTIPLE, MULTIPLE * round(n * finer / MULTIPLE)) for n in (rows, columns)
        )
        if self.shape[0] * self.shape[1] > MAX_TEXELS:
            raise SimError(
                f"subject {skin.subject.name}",
                field="texel_mm",
                found=f"{self.shape[0]} x {self.shape[1]} texels for {texel_mm} mm",
                expected=f"at most {MAX_TEXELS}",
                hint="Is the mesh in mm, and does its UV fill the tile?",
            )
        face, weights = raster_uv(mesh, *self.shape)
        self.covered = (face >= 0) & (area[face] > 0)
        self._face = face[self.covered]
        self.points: Points = skin.points(self._face, weights[self.covered])
        texel = 1.0 / (self.shape[0] * self.shape[1])
        self.area = (area[self._face] / uv_area[self._face] * texel).astype(np.float64)
        self.spacing_mm = float(np.sqrt(self.area.mean()))
        self._charts = _charts(skin.uv_triangles)[self._face]
        self._layers: dict[int, Nodes] = {}

    def __len__(self) -> int:
        return len(self.area)

    @functools.cached_property
    def _nearest(self) -> np.ndarray:
        """(rows, columns) int32 index of the texel that is nearest in UV."""
        index = np.full(self.shape, -1, np.int32)
        index[self.covered] = np.arange(len(self), dtype=np.int32)
        row, column = ndimage.distance_transform_edt(
            ~self.covered, return_distances=False, return_indices=True
        )
        return index[row, column]

    def at(self, uv: np.ndarray) -> np.ndarray:
        """(m,) index of the texel nearest to each (m, 2) place."""
        column = np.clip((uv[:, 0] * self.shape[1]).astype(int), 0, self.shape[1] - 1)
        row = np.clip(((1.0 - uv[:, 1]) * self.shape[0]).astype(int), 0, self.shape[0] - 1)
        return self._nearest[row, column]

    def sample(self, values: np.ndarray, uv: np.ndarray) -> np.ndarray:
        """Texels' values (n, c) at places (m, 2), bilinear; (m, c) float32."""
        rows, columns = self.shape
        x = np.clip(uv[:, 0] * columns - 0.5, 0, columns - 1)
        y = np.clip((1.0 - uv[:, 1]) * rows - 0.5, 0, rows - 1)
        left, top = x.astype(int), y.astype(int)
        right, below = np.minimum(left + 1, columns - 1), np.minimum(top + 1, rows - 1)
        x, y = (x - left)[:, None], (y - top)[:, None]
        near = np.asarray(values, np.float32)
        upper = near[self._nearest[top, left]] * (1 - x) + near[self._nearest[top, right]] * x
        lower = near[self._nearest[below, left]] * (1 - x) + near[self._nearest[below, right]] * x
        return (upper * (1 - y) + lower * y).astype(np.float32)

    def nodes(self, step: int) -> Nodes:
        """The layer whose nodes are `step` texels apart; kept once made."""
        if step not in self._layers:
            self._layers[step] = self._layer(step)
        return self._layers[step]

    def _layer(self, step: int) -> Nodes:
        row, column = np.nonzero(self.covered)
        wide = self.shape[1] // step + 3
        tall = self.shape[0] // step + 3
        keys, shares = [], []
        y, x = (row + 0.5) / step + 0.5, (column + 0.5) / step + 0.5
        top, left = np.floor(y).astype(np.int64), np.floor(x).astype(np.int64)
        for down in (0, 1):
            for right in (0, 1):
                keys.append((self._charts * tall + top + down) * wide + left + right)
                across = np.abs(1 - down - (y - top)) * np.abs(1 - right - (x - left))
                shares.append(across)
        # A texel shares nodes with its own chart only: charts that touch in UV lie far apart.
        found, index = np.unique(np.concatenate(keys), return_inverse=True)
        texel = np.tile(np.arange(len(self)), 4)
        share = sparse.csr_matrix(
            (np.concatenate(shares).astype(np.float32), (texel, index)), (len(self), len(found))
        )
        area = share.T @ self.area
        kept = area > 1e-9 * self.area.mean()
        share, area = share[:, kept], area[kept]
        place = np.asarray(self.points.position, float)
        mean = (share.T @ (place * self.area[:, None])) / area[:, None]
        square = (share.T @ (np.sum(place**2, axis=1) * self.area)) / area
        normal = unit(share.T @ (self.points.smooth * self.area[:, None]))
        spread = np.maximum(square - np.sum(mean**2, axis=1), 0.0) / 2
        return Nodes(share, area, mean, normal, spread, self.area)


def _charts(uv_triangles: np.ndarray) -> np.ndarray:
    """(t,) int64 which connected piece of the UV each triangle belongs to."""
    count = int(uv_triangles.max()) + 1
    label = connected(uv_triangles[:, [0, 1, 1, 2]].reshape(-1, 2), count)
    return label[uv_triangles[:, 0]].astype(np.int64)
