"""What no view saw: values spread over the mesh, and the gutter around the UV islands."""

from __future__ import annotations

import cv2
import numba
import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from processing.atlas.raster import Raster
from processing.registration.laplacian import cotangent_laplacian, tie_components


class MeshFill:
    """Harmonic continuation over a mesh: smooth across UV seams, equal to what was seen at its rim.

    Confidence stays 0 there: it is a guess that keeps renders whole, not a measurement.
    """

    def __init__(
        self,
        vertices: np.ndarray,
        triangles: np.ndarray,
        raster: Raster,
        texels: np.ndarray,
        weight: np.ndarray,
    ) -> None:
        """Prepare for maps that share what was seen.

        Args:
            vertices: (n, 3) mm.
            triangles: (t, 3).
            raster: of the atlas.
            texels: (k,) flat indices of its covered texels.
            weight: (k,) float32, how well each was seen, 0 for not at all.
        """
        self._raster, self._texels, self._weight = raster, texels, weight
        self._triangles = np.ascontiguousarray(triangles, np.int32)
        ones = np.ones((len(texels), 1), np.float32)
        self._sums = self._gather(ones, len(vertices))[:, 0]
        seen = self._sums[self._sums > 0]
        self._known = self._sums > 0.2 * (np.median(seen) if len(seen) else 1.0)
        laplacian, _ = cotangent_laplacian(vertices, triangles)
        matrix = laplacian + tie_components(vertices, triangles, 1.0)
        # A trace of identity for vertices that no triangle joins to anything.
        matrix = (matrix + 1e-9 * sp.identity(len(vertices))).tocsr()
        unknown = ~self._known
        self._to_known = matrix[unknown][:, self._known]
        self._factor = None
        if unknown.any() and self._known.any():
            self._factor = splu(
                matrix[unknown][:, unknown].tocsc(),
                permc_spec="MMD_AT_PLUS_A",
                diag_pivot_thresh=0.0,
                options={"SymmetricMode": True},
            )

    def vertex_values(self, values: np.ndarray) -> np.ndarray:
        """Per-vertex continuation of (k, c) texel values: (n, c) float64."""
        sums = self._gather(values, len(self._sums))
        out = np.zeros(sums.shape)
        out[self._known] = sums[self._known] / self._sums[self._known, None]
        if self._factor is not None:
            out[~self._known] = self._factor.solve(-(self._to_known @ out[self._known]))
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
        b1, b2 = barycentric[texel]
        corners = triangles[face[texel]]
        for corner in range(3):
            b = b1 if corner == 1 else b2 if corner == 2 else 1.0 - b1 - b2
            for c in range(values.shape[1]):
                out[corners[corner], c] += weight[k] * b * values[k, c]


def gutter_sources(covered: np.ndarray, gutter_px: int) -> tuple[np.ndarray, np.ndarray]:
    """For each texel near an island, the nearest covered one.

    Args:
        covered: (rows, columns) bool.
        gutter_px: how far the gutter reaches.

    Returns:
        (g,) flat indices of gutter texels and (g,) of the texels they copy.
    """
    if covered.all() or not covered.any():
        none = np.zeros(0, np.int64)
        return none, none
    distance, labels = cv2.distanceTransformWithLabels(
        (~covered).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    distance, labels = np.asarray(distance).ravel(), np.asarray(labels).ravel()
    inside = np.flatnonzero(covered)
    source = np.zeros(int(labels.max()) + 1, np.int64)
    source[labels[inside]] = inside
    gutter = np.flatnonzero((distance > 0) & (distance <= gutter_px))
    return gutter, source[labels[gutter]]
