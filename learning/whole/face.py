"""One scan of a store as trainings light it: small maps, and shadows of sets of lights."""

from __future__ import annotations

import dataclasses

import numpy as np
import torch
from torch import Tensor

from learning.encoding import shrink
from learning.maps import READ, to_batch, typical_texel_mm
from learning.render.kept_shadows import KeptShadows
from learning.render.occlusion import DOME_MM, PositionGrid, bake_grid, openness
from learning.render.uv import TexelSurface, texel_surface
from processing.dataset import Store


@dataclasses.dataclass(frozen=True)
class Face:
    """One scan at `FINER` times the network's size.

    Attributes:
        maps: by their names in docs/formats.md, and shape_normal, ambient_occlusion, area, edges;
            (1, c, h, w).
        skin: (1, 1, h, w) share of skin that was captured.
        texel_mm: edge of a texel of area 1.
        light_position_mm: (n, 3) of each set of lights.
        visibility: (n, h, w) uint8, 255 = seen, of each set.
    """

    maps: dict[str, Tensor]
    skin: Tensor
    texel_mm: float
    light_position_mm: list[np.ndarray]
    visibility: list[Tensor]


def read_small(
    store: Store, scan: int, rows: int, columns: int
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """A scan's maps as means over larger texels, (rows, columns, c), and its share of skin."""
    everything = slice(None)
    read = {name: to_batch(store.read(scan, name, everything, everything)) for name in READ}
    captured = (read.pop("confidence") > 0).float()
    covered = (read["position"] != 0).any(dim=1, keepdim=True).float()
    size = (rows, columns)
    weight = shrink(covered, size)
    known = weight > 0.5

    def mean(image: Tensor) -> np.ndarray:
        values = shrink(image * covered, size) / weight.clamp_min(1e-3) * known
        return np.ascontiguousarray(values[0].permute(1, 2, 0).numpy())

    return {name: mean(image) for name, image in read.items()}, mean(captured)[..., 0]


def tensors_of(maps: dict[str, np.ndarray]) -> tuple[dict[str, Tensor], float, TexelSurface]:
    """A face's maps as the renderer takes them, the edge of a texel in mm, and the surface."""
    covered = (maps["position"] != 0).any(axis=2)
    surface = texel_surface(maps["position"], covered, smooth_px=1.0)
    texel_mm = typical_texel_mm(surface.area_mm2)
    tensors = {name: to_batch(image) for name, image in maps.items()}
    tensors["shape_normal"] = to_batch(surface.normal)
    tensors["area"] = to_batch(surface.area_mm2 / texel_mm**2)
    tensors["edges"] = to_batch(surface.edges_mm / texel_mm)
    return tensors, texel_mm, surface


def face_of(
    maps: dict[str, np.ndarray],
    skin: np.ndarray,
    sets: list[np.ndarray],
    kept: KeptShadows | None,
) -> Face:
    """A scan whose shadows of sets of (n, 3) lights are baked, or read where they are kept."""
    tensors, texel_mm, surface = tensors_of(maps)
    covered = (maps["position"] != 0).any(axis=2)
    grid = PositionGrid(maps["position"], surface.normal, covered, kept)
    # All lights at once: the tree of the surface's triangles is built once.
    baked = (255 * bake_grid(grid, np.concatenate([*sets, DOME_MM]))).astype(np.uint8)
    *parts, dome = np.split(baked, np.cumsum([len(at) for at in sets]))
    seen = [torch.from_numpy(part) for part in parts]
    tensors["ambient_occlusion"] = to_batch(openness(surface.normal, dome / 255))
    return Face(tensors, to_batch(skin), texel_mm, sets, seen)
