"""Cast shadows of a known topology without rays: a table of baked pictures, one bit a texel.

Visibility of every texel is baked once, on the mean shape, from directions spread evenly over the
sphere. A light between them gets the three nearest ones' pictures, mixed by its place in their
triangle and sharpened; so a shadow moves with its light and has a gradient. Pictures of one bit are
small enough to keep thousands, and many directions give more accuracy than a few smooth pictures.
"""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path

import numpy as np
import torch
from scipy.spatial import ConvexHull
from torch import Tensor

from learning.errors import CheckpointError
from learning.render.light_dome import even_directions
from learning.render.occlusion import bake_visibility
from learning.render.uv import rasterise
from lightstage.commands import ProgressCallback, quiet
from lightstage.formats.files import atomic_path
from lightstage.formats.mesh import Mesh

STEEPNESS = 4.0
"""How much steeper than the mixture the shadow's edge is: nearly that of the baked pictures."""


@dataclasses.dataclass(frozen=True)
class OcclusionConfig:
    """What is baked.

    Attributes:
        rows: of the texture that shadows are baked in; two thirds as many columns.
        directions: lights, far away, evenly over the sphere.
    """

    rows: int = 96
    directions: int = 2048


class OcclusionTable:
    """Baked pictures of visibility, and interpolation between them."""

    def __init__(self, bits: np.ndarray, covered: np.ndarray, face: np.ndarray) -> None:
        """A table.

        Args:
            bits: (d, ceil(t / 8)) uint8, packed visibility under `even_directions(d)`.
            covered: (rows, columns) bool, the t texels that show a surface.
            face: (rows, columns) int32 triangle that each texel shows, -1 for none, by which
                another UV is noticed.
        """
        self.bits, self.covered, self.face = bits, covered, face
        self.directions = even_directions(len(bits))
        self.triangles = ConvexHull(self.directions).simplices
        corners = self.directions[self.triangles].transpose(0, 2, 1)
        self._inverse = np.linalg.inv(corners)

    def pictures(self, indices: np.ndarray) -> np.ndarray:
        """(n, t) float32 visibility at some of the baked directions."""
        count = int(self.covered.sum())
        return np.unpackbits(self.bits[indices], axis=1, count=count).astype(np.float32)

    def mixed(self, directions: Tensor) -> Tensor:
        """(n, rows, columns): the three nearest pictures of (n, 3) directions, not yet sharpened.

        1 where there is no surface. Differentiable in the directions.
        """
        toward = directions.detach().cpu().double().numpy()
        places = np.einsum("tij,nj->nti", self._inverse, toward)
        nearest = self.triangles[places.min(axis=2).argmax(axis=1)]
        corners = torch.from_numpy(self.directions[nearest]).to(directions).mT
        weights = torch.linalg.solve(corners, directions[:, :, None])[:, :, 0].clamp_min(0)
        weights = weights / weights.sum(dim=1, keepdim=True).clamp_min(1e-12)
        seen = torch.from_numpy(self.pictures(nearest.ravel())).to(directions)
        flat = torch.einsum("nk,nkt->nt", weights, seen.unflatten(0, (-1, 3)))
        out = flat.new_ones((len(flat), *self.covered.shape))
        mask = torch.from_numpy(self.covered).to(directions.device)
        return out.masked_scatter(mask.expand_as(out), flat)

    def for_lights(self, position_mm: Tensor, size: tuple[int, int]) -> Tensor:
        """Visibility of lights for maps of a size.

        A lamp nearby counts as far away in its direction from the origin of the head's frame: at
        1 m a cheek, 8 cm off, sees it turned by 5 degrees.

        Args:
            position_mm: (L, 3) lights around the head's origin, none at it; differentiable.
            size: (rows, columns) of the maps.

        Returns:
            (L, rows, columns), 0..1: the share of the light that no other part of the head blocks.
            Below a texel's horizon it is that of its neighbours; the cosine is 0 there.
        """
        seen = torch.nn.functional.interpolate(
            self.mixed(position_mm)[None], size=size, mode="bilinear", align_corners=False
        )[0]
        return ((seen - 0.5) * STEEPNESS + 0.5).clamp(0, 1)

    def save(self, path: Path) -> Path:
        """Write as a compressed .npz; returns `path`."""
        with atomic_path(path) as beside, beside.open("wb") as file:
            np.savez_compressed(file, bits=self.bits, covered=self.covered, face=self.face)
        return path


def load_occlusion(path: Path) -> OcclusionTable:
    """Read what `OcclusionTable.save` wrote.

    Raises:
        CheckpointError: missing, damaged, or another kind of file.
    """
    if not path.is_file():
        raise CheckpointError(path, found="no such file", expected="a table of occlusion")
    try:
        with np.load(path, allow_pickle=False) as file:
            bits, covered, face = file["bits"], file["covered"], file["face"]
    except Exception as error:
        raise CheckpointError(path, found=str(error), expected="a table of occlusion") from None
    wide = -(-int(np.count_nonzero(covered)) // 8)
    if covered.dtype != bool or bits.dtype != np.uint8 or bits.shape[1:] != (wide,):
        raise CheckpointError(
            path, field="bits", found=str(bits.shape), expected=f"(directions, {wide}) uint8"
        )
    if face.shape != covered.shape or face.dtype != np.int32:
        raise CheckpointError(
            path, field="face", found=str(face.shape), expected=f"{covered.shape} int32"
        )
    return OcclusionTable(bits, covered, face)


def default_occlusion_path() -> Path:
    """The table of our own template, committed as data."""
    return Path(__file__).parents[1] / "data" / "occlusion.npz"


@functools.cache
def default_occlusion() -> OcclusionTable:
    """The table of our own template."""
    return load_occlusion(default_occlusion_path())


def bake_table(
    mesh: Mesh, config: OcclusionConfig | None = None, progress: ProgressCallback = quiet
) -> OcclusionTable:
    """Bake the cast shadows of a mesh in its texture, in the head frame."""
    chosen = config or OcclusionConfig()
    seen, covered = bake_dome(mesh, chosen.rows, even_directions(chosen.directions), progress)
    face = rasterise(mesh, *covered.shape).face
    return OcclusionTable(np.packbits(seen > 0.5, axis=1), covered, face)


def bake_dome(
    mesh: Mesh, rows: int, directions: np.ndarray, progress: ProgressCallback = quiet
) -> tuple[np.ndarray, np.ndarray]:
    """Cast shadows of distant lights.

    Args:
        mesh: with UV.
        rows: of the texture; two thirds as many columns.
        directions: (d, 3).
        progress: of the rays.

    Returns:
        (d, t) float32 visibility of the covered texels, and (rows, columns) bool, which those are.
    """
    raster = rasterise(mesh, rows, rows * 2 // 3)
    distant = np.ones(len(directions), bool)
    seen = bake_visibility(mesh, raster, directions, distant, progress, cast_only=True)
    return seen[:, raster.covered], raster.covered
