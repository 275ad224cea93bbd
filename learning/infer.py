"""Inference: reflectance maps of a whole texture with light in it, in tiles that do not show.

Instance norm takes its statistics over a tile, so neighbouring tiles disagree however wide they
overlap. Dense normalisation [Ho2024]: a first pass over all tiles keeps every layer's statistics, a
second one normalises each place by those of the tiles around it, interpolated; then overlapping
tiles are blended.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from learning.data import DataConfig
from learning.devices import CPU, device_of
from learning.encoding import (
    OWN_INPUTS,
    Reference,
    Reflectance,
    absolute_reference,
    decode_maps,
    local_contrast,
    network_input,
    relative_reference,
    shrink,
)
from learning.errors import MapsError
from learning.infer_checks import UNSEEN, look_through, require_head
from learning.maps import from_batch, to_batch
from learning.networks.generator import Generator
from learning.render.shading import unit
from learning.render.uv import rasterise, texel_surface
from lightstage.commands import ProgressCallback, quiet
from lightstage.formats.environment import LightSet
from lightstage.formats.mesh import Mesh

DISAGREEMENT = 0.05
"""Standard deviation of the tiles' albedo (sRGB-encoded) at which the confidence is a half."""


@dataclasses.dataclass(frozen=True)
class Inferred:
    """Maps by their names, (rows, columns[, 3]) float32, normals in the mesh's axes.

    Attributes:
        maps: diffuse_albedo, specular_albedo, diffuse_normal, specular_normal, confidence.
        tiles: how many.
        notes: what a user should know of the texture or the maps, a line each.
        light: found in the texture, in the mesh's axes; None where none was sought.
        detail_share: (rows, columns) float32, part of the texture's finest detail that was taken
            for the skin's own, 0..1; None where no light was found.
    """

    maps: dict[str, np.ndarray]
    tiles: int
    notes: tuple[str, ...] = ()
    light: LightSet | None = None
    detail_share: np.ndarray | None = None


@dataclasses.dataclass(frozen=True)
class Prepared:
    """A texture and its mesh as networks of patches take them; batches of one.

    Attributes:
        covered: (1, 1, rows, columns), 1 where the mesh's surface is.
        photographed: the same, 0 where the texture is black.
        lit: (1, 3, rows, columns) the texture; 0 where no surface is.
        whole: (1, 3, patch, patch) the texture shrunk to a patch.
        position_mm: (1, 3, rows, columns) in the head frame.
        shape_normal: (1, 3, rows, columns) unit, in the head frame.
        reference: of the encoding.
        head_from_mesh: (3, 4) pose.
        patch_px: side of a tile.
        notes: what a user should know of the texture.
    """

    covered: Tensor
    photographed: Tensor
    lit: Tensor
    whole: Tensor
    position_mm: Tensor
    shape_normal: Tensor
    reference: Reference
    head_from_mesh: np.ndarray
    patch_px: int
    notes: list[str]


def prepare(
    data: DataConfig,
    texture: np.ndarray,
    mesh: Mesh,
    head_from_mesh: np.ndarray,
    named: tuple[str | Path, str | Path] = ("texture", "mesh"),
) -> Prepared:
    """Look through a texture and a mesh, and bring them to what networks of patches take.

    Args:
        data: how the networks were trained; tiles are as large as its patches.
        texture: (rows, columns, 3) linear, with light and shadow in it.
        mesh: with the texture's UV.
        head_from_mesh: (3, 4) pose from the mesh's axes to the head frame, mm.
        named: the texture's and the mesh's names in errors.

    Raises:
        MapsError: a texture smaller than a patch, black or badly exposed; a mesh that is flat or
            not of a head's size in mm.
    """
    rows, columns = texture.shape[:2]
    patch_px = data.patch_px
    if min(rows, columns) < patch_px:
        raise MapsError(
            named[0],
            found=f"{rows} x {columns} texels",
            expected=f"at least {patch_px} a side, as the network was trained on",
        )
    require_head(mesh, named[1])
    raster = rasterise(mesh, rows, columns)
    covered = raster.covered
    notes = look_through(texture, covered, named[0])
    position = raster.interpolate(mesh.vertices)
    surface = texel_surface(position, covered)
    rotation, offset_mm = head_from_mesh[:, :3], head_from_mesh[:, 3]
    seen = to_batch(covered)
    lit = to_batch(texture) * seen
    size = (patch_px, patch_px)
    # Black texels of a surface were not photographed: they are no shadow on it.
    photographed = seen * (lit.amax(dim=1, keepdim=True) > UNSEEN)
    weight = shrink(photographed, size)
    whole = shrink(lit, size) / weight.clamp_min(1e-3) * (weight > 0.5)
    shape = to_batch(surface.normal @ rotation.T)
    reference = absolute_reference(shape, data.specular_frame)
    if data.relative:
        reference = relative_reference(whole, (weight > 0.5).to(whole), shape)
    if data.detail_px > 0:
        detail = local_contrast(lit, seen, reference.texture, data.detail_px)
        reference = dataclasses.replace(reference, detail=detail)
    placed = to_batch(position @ rotation.T + offset_mm) * seen
    return Prepared(
        seen, photographed, lit, whole, placed, shape, reference, head_from_mesh, patch_px, notes
    )


def infer(
    generator: Generator,
    data: DataConfig,
    texture: np.ndarray,
    mesh: Mesh,
    head_from_mesh: np.ndarray,
    progress: ProgressCallback = quiet,
    named: tuple[str | Path, str | Path] = ("texture", "mesh"),
) -> Inferred:
    """Infer a texture's reflectance; arguments and errors as `prepare`.

    Args:
        generator: in evaluation mode.
        data: how it was trained.
        texture: (rows, columns, 3) linear, with light in it.
        mesh: with the texture's UV.
        head_from_mesh: (3, 4) pose.
        progress: called with tiles done, twice as many as there are.
        named: names in errors.

    Returns:
        Maps in the mesh's axes; zero where no surface is, albedo at most 1. Confidence is 1 where
        all tiles that see a texel find the same albedo, 0 where the texture is black.
    """
    given = prepare(data, texture, mesh, head_from_mesh, named)
    lit, whole, reference = given.lit, given.whole, given.reference
    inputs = network_input(lit, given.shape_normal, torch.zeros_like(lit), reference)
    inputs = inputs[:, :OWN_INPUTS]
    context = network_input(whole, torch.zeros_like(whole), whole, reference)[:, OWN_INPUTS:]
    if not data.whole:
        context = torch.zeros_like(context)
    channels, spread = run_tiles(generator, inputs, context, given.patch_px, progress)
    return finish_maps(decode_maps(channels, reference), spread, given)


def finish_maps(found: Reflectance, spread: Tensor, given: Prepared) -> Inferred:
    """Maps as they are written.

    Args:
        found: the networks' answer for the whole texture.
        spread: (1, rows, columns) standard deviation of the albedo between tiles.
        given: what they were given.
    """
    seen, notes = given.covered, list(given.notes)
    confidence = 1 / (1 + (spread[:, None] / DISAGREEMENT) ** 2) * given.photographed
    beyond = float(((found.diffuse_albedo > 1).any(dim=1, keepdim=True) * seen).sum() / seen.sum())
    if beyond > 0:
        warning = f"diffuse albedo above 1 was cut off on {100 * beyond:.2g} % of the surface"
        notes.append(f"{warning}; is the texture too bright?")
    maps = {
        "diffuse_albedo": found.diffuse_albedo.clamp(0, 1),
        "specular_albedo": found.specular_albedo.clamp(0, 1),
        "confidence": confidence,
    }
    out = {name: from_batch(image * seen) for name, image in maps.items()}
    rotation = given.head_from_mesh[:, :3].astype(np.float32)
    for name, normal in (
        ("diffuse_normal", found.diffuse_normal),
        ("specular_normal", found.specular_normal),
    ):
        # Back into the mesh's axes: n_mesh = R^T n_head, rows times R.
        out[name] = from_batch(unit(normal) * seen) @ rotation
    rows, columns = seen.shape[2:]
    tiles = len(_origins(rows, given.patch_px)) * len(_origins(columns, given.patch_px))
    return Inferred(out, tiles, tuple(notes))


def run_tiles(
    generator: Generator,
    inputs: Tensor,
    context: Tensor | None,
    patch_px: int,
    progress: ProgressCallback = quiet,
) -> tuple[Tensor, Tensor]:
    """Run a generator over a large picture.

    Args:
        generator: on any device; its own instance norms are untouched afterwards.
        inputs: (1, c, rows, columns), the channels that change from tile to tile; on the processor,
            as the result is: a GPU holds one tile at a time.
        context: (1, n, patch_px, patch_px), those that are the same for all tiles; None for none.
        patch_px: side of a tile; tiles overlap by half.
        progress: called with tiles done of both passes.

    Returns:
        (1, out, rows, columns), and (1, rows, columns) standard deviation of the first pass's
        first channels (at most three; 0..1 scale) between tiles.
    """
    rows, columns = inputs.shape[2:]
    grid = (_origins(rows, patch_px), _origins(columns, patch_px))
    norms = [m for m in generator.modules() if isinstance(m, nn.InstanceNorm2d)]
    dense = DenseNorm(grid, patch_px, len(norms))
    hooks = [m.register_forward_hook(dense.hook(i)) for i, m in enumerate(norms)]
    tiles = [(i, j) for i in range(len(grid[0])) for j in range(len(grid[1]))]
    window = _window(patch_px)
    device = device_of(generator)
    context = inputs.new_zeros(1, 0, patch_px, patch_px) if context is None else context
    context = context.to(device)
    compared = min(3, generator.out_channels)
    total = inputs.new_zeros(1, generator.out_channels, rows, columns)
    weight = inputs.new_zeros(1, 1, rows, columns)
    moments = inputs.new_zeros(2, compared, rows, columns)
    try:
        with torch.inference_mode():
            for dense.second_pass in (False, True):
                for done, (i, j) in enumerate(tiles):
                    top, left = grid[0][i], grid[1][j]
                    part = (..., slice(top, top + patch_px), slice(left, left + patch_px))
                    dense.tile = (i, j)
                    tile = torch.cat([inputs[part].to(device), context], dim=1)
                    found = generator(tile).to(CPU)
                    if dense.second_pass:
                        total[part] += found * window
                        weight[part] += window
                    else:
                        first = (found[0, :compared] + 1) / 2
                        moments[part] += torch.stack([first, first**2]) * window
                    progress(done + 1 + dense.second_pass * len(tiles), 2 * len(tiles))
    finally:
        for hook in hooks:
            hook.remove()
    mean, square = moments / weight
    spread = (square - mean**2).clamp_min(0).mean(dim=0).sqrt()[None]
    return total / weight, spread


class DenseNorm:
    """Statistics of every tile and layer, and their use between tiles."""

    def __init__(self, grid: tuple[list[int], list[int]], patch_px: int, layers: int) -> None:
        """Tiles start at `grid`'s rows and columns."""
        self._grid, self._patch = grid, patch_px
        self._mean: list[Tensor | None] = [None] * layers
        self._deviation: list[Tensor | None] = [None] * layers
        self.second_pass = False
        self.tile = (0, 0)

    def hook(self, layer: int) -> Callable[..., Tensor | None]:
        """A forward hook that replaces an instance norm's result."""

        def replace(module: nn.Module, args: tuple[Tensor, ...], _: Tensor) -> Tensor | None:
            features = args[0]
            eps = float(getattr(module, "eps", 1e-5))
            if not self.second_pass:
                self._keep(layer, features, eps)
                return None
            mean, deviation = self._mean[layer], self._deviation[layer]
            assert mean is not None
            assert deviation is not None
            height, width = features.shape[2:]
            across = self._weights(0, height).to(features)
            down = self._weights(1, width).to(features)
            at = "klc,ki,lj->cij"
            return (features - torch.einsum(at, mean, across, down)) / torch.einsum(
                at, deviation, across, down
            )

        return replace

    def _keep(self, layer: int, features: Tensor, eps: float) -> None:
        variance, mean = torch.var_mean(features[0], dim=(1, 2), correction=0)
        size = (len(self._grid[0]), len(self._grid[1]), len(mean))
        means, deviations = self._mean[layer], self._deviation[layer]
        if means is None or deviations is None:
            means, deviations = features.new_zeros(size), features.new_zeros(size)
            self._mean[layer], self._deviation[layer] = means, deviations
        means[self.tile] = mean
        deviations[self.tile] = (variance + eps).sqrt()

    def _weights(self, axis: int, count: int) -> Tensor:
        """(tiles, count): how much each tile of a row counts at a feature of the current one."""
        origins = np.asarray(self._grid[axis], float)
        at = origins[self.tile[axis]] + (np.arange(count) + 0.5) * self._patch / count
        eye = np.eye(len(origins))
        centres = origins + self._patch / 2
        weights = np.stack([np.interp(at, centres, row) for row in eye])
        # Apple's GPUs take no double precision.
        return torch.from_numpy(weights.astype(np.float32))


def _origins(length: int, patch_px: int) -> list[int]:
    """Starts of tiles that overlap by half; the last one ends with the picture."""
    starts = list(range(0, length - patch_px, patch_px // 2))
    return [*starts, length - patch_px]


def _window(patch_px: int) -> Tensor:
    """(n, n) weights of a tile's middle; its border, which knows the padding, hardly counts.

    The border still counts where no other tile reaches: at the texture's own border.
    """
    at = (((torch.arange(patch_px) + 0.5) / patch_px - 0.125) / 0.75).clamp(0, 1)
    rise = torch.sin(torch.pi * at) ** 2
    return rise[:, None] * rise[None] + 1e-4
