"""Inference with the four networks, one after the other over the whole texture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from learning.data import DataConfig
from learning.encoding import shrink, smoothed_normal
from learning.four.channels import DIFFUSE_ALBEDO, PARTS, Seen, infer_in_sequence
from learning.four.networks import FourNetworks
from learning.infer import Inferred, Prepared, finish_maps, prepare, run_tiles
from learning.maps import from_batch, to_batch, typical_texel_mm
from learning.render.shading import unit
from learning.render.uv import texel_surface
from lightstage.commands import ProgressCallback, quiet
from lightstage.formats.mesh import Mesh


def infer_four(
    networks: FourNetworks,
    data: DataConfig,
    texture: np.ndarray,
    mesh: Mesh,
    head_from_mesh: np.ndarray,
    progress: ProgressCallback = quiet,
    named: tuple[str | Path, str | Path] = ("texture", "mesh"),
) -> Inferred:
    """Infer a texture's reflectance with networks in evaluation mode.

    Arguments (shapes too), errors and what is returned are as of `learning.infer.infer`; `progress`
    counts the tiles of all networks.
    """
    given = prepare(data, texture, mesh, head_from_mesh, named)
    spread: list[Tensor] = []

    def run_part(part: str, inputs: Tensor) -> Tensor:
        before = len(spread)

        def tile(done: int, total: int) -> None:
            progress(before * total + done, len(PARTS) * total)

        found, differs = run_tiles(networks.generator(part), inputs, None, given.patch_px, tile)
        spread.append(differs)
        return found

    with torch.inference_mode():
        found = infer_in_sequence(run_part, seen_texture(given))
    return finish_maps(found, spread[list(PARTS).index(DIFFUSE_ALBEDO)], given)


def seen_texture(given: Prepared) -> Seen:
    """What is known of a whole texture before any network has run."""
    surface = (given.position_mm, given.shape_normal, _smooth_normal(given))
    return Seen(given.lit, given.covered, *surface, given.reference)


def _smooth_normal(given: Prepared) -> Tensor:
    """The shape without its folds, as in training: from positions shrunk to a patch's size."""
    size = (given.patch_px, given.patch_px)
    weight = shrink(given.covered, size)
    position = shrink(given.position_mm, size) / weight.clamp_min(1e-3) * (weight > 0.5)
    surface = texel_surface(from_batch(position), from_batch(weight > 0.5))
    area, texel_mm = to_batch(surface.area_mm2), typical_texel_mm(surface.area_mm2)
    smooth = smoothed_normal(to_batch(surface.normal), area / texel_mm**2, texel_mm)
    large = torch.nn.functional.interpolate(
        smooth, size=given.covered.shape[2:], mode="bilinear", align_corners=False
    )
    return unit(large) * given.covered
