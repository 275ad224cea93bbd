"""A texture of more rows than those in which light and skin are sought.

Light is smooth from texel to texel of a large texture, and so is all that is found of it. What is
finer than the rows of the search is taken from the photographs alone, as the ratio of a texel to
its neighbours' mean: the next band of a Laplacian pyramid [Burt1983].
"""

from __future__ import annotations

import dataclasses
import math

import cv2
import numpy as np

from learning.photo.sampling import averaged, sampled
from learning.photo.several import DARK
from learning.render.uv import UvRaster, nearest_known
from learning.vectors import unit
from learning.whole.detail import enlarged
from lightstage.formats.mesh import Mesh
from lightstage.rig import Camera

MOST_DETAIL = 1.0
"""Logarithm at which detail is cut."""
AT_ONCE = 2**20
"""Texels that are sampled at once."""


@dataclasses.dataclass(frozen=True)
class Shown:
    """A photograph, and where a texture is taken from it.

    Attributes:
        rgb_linear: (h, w, 3).
        camera: of it.
        mesh: the head as it shows it, in the camera's world.
        texels: (h, w) bool at the size of the search, texels that are mostly from it as the mesh
            has them.
        texels_a_pixel: of that size, along a side.
    """

    rgb_linear: np.ndarray
    camera: Camera
    mesh: Mesh
    texels: np.ndarray
    texels_a_pixel: float


def rows_of_search(rows: int, most: int) -> int:
    """Rows in which a texture's light is sought: a whole part of its own, to a multiple of 3."""
    parts = math.ceil(rows / most)
    return rows if parts == 1 else max(3, 3 * round(rows / parts / 3))


def finest(photographs: list[Shown], raster: UvRaster) -> np.ndarray:
    """What photographs show that is finer than the texels of the search.

    A photograph with fewer pixels than these texels shows nothing finer and is passed over.

    Args:
        photographs: that a texture is from.
        raster: of the large texture.

    Returns:
        (rows, columns, 3) float32, natural logarithm; 0 where nothing is known.
    """
    rows, columns = raster.covered.shape
    found = np.zeros((rows, columns, 3), np.float32)
    for each in photographs:
        if each.texels_a_pixel >= 1:
            continue
        here = raster.covered & (enlarged(each.texels, rows, columns) > 0.999)
        if here.any():
            found += _finer(_sampled(each, raster, here), here, each.texels.shape)
    return found


def _sampled(shown: Shown, raster: UvRaster, here: np.ndarray) -> np.ndarray:
    """(rows, columns, 3) float32 logarithm of a photograph at the texels `here`; 0 elsewhere."""
    out = np.zeros((here.size, 3), np.float32)
    texels = np.flatnonzero(here)
    # A texel that holds many pixels shows their mean: of half of its side, as the interpolation
    # between the means is one of as much.
    pixels = int(shown.texels.shape[0] / (2 * shown.texels_a_pixel * len(here)))
    rgb, scale = averaged(shown.rgb_linear, pixels)
    corners, weights = raster.face.ravel(), raster.barycentric.reshape(-1, 3)
    for start in range(0, len(texels), AT_ONCE):
        part = texels[start : start + AT_ONCE]
        triangles = shown.mesh.vertices[raster.triangles[corners[part]]]
        place, _ = shown.camera.project(np.einsum("nck,nc->nk", triangles, weights[part]))
        out[part] = np.log(np.maximum(sampled(rgb, place * scale), 0) + DARK)
    return out.reshape(*here.shape, 3)


def _finer(logarithm: np.ndarray, known: np.ndarray, size: tuple[int, ...]) -> np.ndarray:
    """(rows, columns, 3) what is finer than `size` texels; 0 where it is not known."""
    around = cv2.resize(logarithm, size[::-1], interpolation=cv2.INTER_AREA)
    weight = cv2.resize(known.astype(np.float32), size[::-1], interpolation=cv2.INTER_AREA)
    logarithm -= enlarged(around / np.maximum(weight, 1e-6)[..., None], *known.shape)
    # A mean of few texels is no mean of the neighbours.
    logarithm *= (known & (enlarged(weight, *known.shape) > 0.999))[..., None]
    return np.clip(logarithm, -MOST_DETAIL, MOST_DETAIL, out=logarithm)


def brighter(image: np.ndarray, logarithm: np.ndarray) -> np.ndarray:
    """A (rows, columns, 3) linear image with `finest` detail put in, in its own memory.

    It stays 0 where it is 0 and there is no detail.
    """
    image += DARK
    image *= np.exp(logarithm)
    image -= DARK
    return np.maximum(image, 0, out=image)


class Enlarging:
    """Maps of the search at a larger texture's size."""

    def __init__(self, known: np.ndarray, raster: UvRaster) -> None:
        """A map's border does not fade into what is beside the surface.

        Args:
            known: (h, w) bool, texels of the search that hold the surface.
            raster: of the large texture.
        """
        self._nearest = nearest_known(known)
        self._covered = raster.covered

    def map(self, image: np.ndarray) -> np.ndarray:
        """(rows, columns[, c]) float32 of an (h, w[, c]) map; zero where no surface is."""
        out = enlarged(image[self._nearest], *self._covered.shape)
        out *= self._covered if image.ndim == 2 else self._covered[..., None]
        return out

    def normals(self, normal: np.ndarray, low: np.ndarray, own: np.ndarray) -> np.ndarray:
        """Unit normals: the mesh's own at all rows, turned as those of the search are.

        Enlarged as they are, normals would smooth the mesh's folds, and their difference from the
        mesh's would pass for relief.

        Args:
            normal: (h, w, 3) unit, of the search.
            low: (h, w, 3) unit, the mesh's own there.
            own: (rows, columns, 3) unit, the mesh's own.
        """
        found = self.map(normal - low)
        found += own
        return unit(found)

    def labels(self, labels: np.ndarray) -> np.ndarray:
        """(rows, columns) int16 of (h, w) labels: those of the texel of the search around each."""
        size = self._covered.shape[::-1]
        return cv2.resize(labels.astype(np.int16), size, interpolation=cv2.INTER_NEAREST)
