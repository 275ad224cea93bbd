"""What no view saw: values spread over the mesh."""

from __future__ import annotations

import numba
import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from processing.atlas.raster import Raster
from processing.laplacian import cotangent_laplacian, tie_components

SEEN, BY_SYMMETRY, BY_DIFFUSION = 0, 1, 2
"""Values of the map `filled`."""


class MeshFill:
    """What no view saw, over the mesh: the other side of the face, else a harmonic continuation.

    A mirrored value takes the harmonic continuation of the difference between both sides along, so
    that it meets what was seen without a step. Confidence stays 0 there: it is a guess that keeps
    renders whole, not a measurement.
    """

    def __init__(
        self,
        vertices: np.ndarray,
        triangles: np.ndarray,
        raster: Raster,
        texels: np.ndarray,
        weight: np.ndarray,
        mirror: np.ndarray,
    ) -> None:
        """Prepare for maps that share what was seen.

        Args:
            vertices: (n, 3) mm.
            triangles: (t, 3).
            raster: of the atlas.
            texels: (k,) flat indices of its covered texels.
            weight: (k,) float32, how well each was seen, 0 for not at all.
            mirror: (n,) index of each vertex's counterpart on the other side, -1 for none.
        """
        self._raster, self._texels, self._weight = raster, texels, weight
        self._triangles = np.ascontiguousarray(triangles, np.int32)
        ones = np.ones((len(texels), 1), np.float32)
        self._sums = self._gather(ones, len(vertices))[:, 0]
        seen = self._sums[self._sums > 0]
        self._known = self._sums > 0.2 * (np.median(seen) if len(seen) else 1.0)
        self._mirror = mirror
        mirrored = (mirror >= 0) & self._known[mirror]
        self.kind = np.where(self._known, SEEN, np.where(mirrored, BY_SYMMETRY, BY_DIFFUSION))
        """(n,) SEEN, BY_SYMMETRY or BY_DIFFUSION."""
        laplacian, _ = cotangent_laplacian(vertices, triangles)
        matrix = laplacian + tie_components(vertices, triangles, 1.0)
        # A trace of identity for vertices that no triangle joins to anything.
        matrix = (matrix + 1e-9 * sp.identity(len(vertices))).tocsr()
        self._mirrored = mirrored
        self._difference = _Harmonic(matrix, self._known & mirrored)
        self._rest = _Harmonic(matrix, self._known | mirrored)

    def vertex_values(self, values: np.ndarray) -> np.ndarray:
        """Per-vertex continuation of (k, c) texel values: (n, c) float64.

        Guesses stay in the range of the vertices that were seen: the other side's value and the
        difference between both sides can add up to less than nothing.
        """
        sums = self._gather(values, len(self._sums))
        out = np.zeros(sums.shape)
        out[self._known] = sums[self._known] / self._sums[self._known, None]
        other = out[self._mirror]
        step = self._difference.fill(out - other)
        guessed = self._mirrored & ~self._known
        out[guessed] = other[guessed] + step[guessed]
        out = self._rest.fill(out)
        if self._known.any():
            known = out[self._known]
            np.clip(out, known.min(axis=0), known.max(axis=0), out=out)
        return out

    def _gather(self, values: np.ndarray, count: int) -> np.ndarray:
        out = np.zeros((count, values.shape[1]))
        _scatter(
            self._raster.face.ravel(),
            self._raster.barycentric.reshape(-1, 2),
            self._texels,
            self._triangles,
            self._weight,
            values,
            out,
        )
        return out


class _Harmonic:
    """Values of some vertices continued to all others."""

    def __init__(self, matrix: sp.csr_matrix, known: np.ndarray) -> None:
        self._known = known
        self._to_known = matrix[~known][:, known]
        self._factor = None
        if known.any() and not known.all():
            self._factor = splu(
                matrix[~known][:, ~known].tocsc(),
                permc_spec="MMD_AT_PLUS_A",
                diag_pivot_thresh=0.0,
                options={"SymmetricMode": True},
            )

    def fill(self, values: np.ndarray) -> np.ndarray:
        """(n, c) with the unknown ones replaced; zero where nothing is known at all."""
        out = values.copy()
        if self._factor is not None:
            out[~self._known] = self._factor.solve(-(self._to_known @ values[self._known]))
        elif not self._known.any():
            out[:] = 0
        return out


def mirrored_vertices(rest: np.ndarray, tolerance_mm: float) -> np.ndarray:
    """Each vertex's counterpart on the other side of the template.

    Args:
        rest: (n, 3) mm in the head frame, whose plane of symmetry is x = 0.
        tolerance_mm: a mirrored vertex with none nearer than this has no counterpart.

    Returns:
        (n,) indices, -1 for none.
    """
    distance, nearest = cKDTree(rest).query(rest * [-1, 1, 1])
    return np.where(distance < tolerance_mm, nearest, -1)


@numba.njit(cache=True)
def _scatter(
    face: np.ndarray,
    barycentric: np.ndarray,
    texels: np.ndarray,
    triangles: np.ndarray,
    weight: np.ndarray,
    values: np.ndarray,
    out: np.ndarray,
) -> None:
    for k in range(len(texels)):
        if weight[k] <= 0:
            continue
        texel = texels[k]
        b1, b2 = barycentric[texel, 0], barycentric[texel, 1]
        t = face[texel]
        for corner in range(3):
            b = b1 if corner == 1 else b2 if corner == 2 else 1.0 - b1 - b2
            for c in range(values.shape[1]):
                out[triangles[t, corner], c] += weight[k] * b * values[k, c]
