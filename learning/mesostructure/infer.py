"""Pores and folds of a whole texture, at the size at which a network knows them."""

from __future__ import annotations

import copy
import dataclasses
import math

import cv2
import numpy as np
import torch

from learning.devices import CPU, moved
from learning.maps import from_batch, to_batch
from learning.mesostructure.evidence import detail_of, evidence
from learning.mesostructure.network import Mesostructure
from learning.whole.detail import enlarged

TILE_PX = 256
"""Side of a tile; with 32 channels its features are 8 MB a layer."""
LEAST_SHARE = 0.5
"""Least share of the rows that a network was trained on; pores cannot be seen in fewer."""


@dataclasses.dataclass(frozen=True)
class TrainedMesostructure:
    """A network, and where it runs.

    Attributes:
        network: in evaluation mode.
        rows: of the textures that it was trained on.
        device: where it runs, as a copy.
    """

    network: Mesostructure
    rows: int
    device: torch.device = CPU

    @property
    def least_rows(self) -> int:
        """Of a texture that shows what the network knows."""
        return math.ceil(LEAST_SHARE * self.rows)


@dataclasses.dataclass(frozen=True)
class Found:
    """What a texture shows of its mesostructure.

    Attributes:
        diffuse_tilt: (rows, columns, 2) float32, see `evidence.Frame`.
        specular_tilt: the same.
        shading: (rows, columns, 3) float32, natural logarithm of the light that the tilts alone
            let a texel have more.
    """

    diffuse_tilt: np.ndarray
    specular_tilt: np.ndarray
    shading: np.ndarray


def find(
    trained: TrainedMesostructure,
    unlit: np.ndarray,
    known: np.ndarray,
    slope: np.ndarray,
    level: np.ndarray,
) -> Found:
    """Find tilts and their shading.

    Args:
        trained: the network.
        unlit: (rows, columns, 3) texture over its light, see `learning.whole.unlit`.
        known: (rows, columns) bool, where that shows skin.
        slope: (h, w, 2), see `evidence.slope_of`, of any size.
        level: (h, w) irradiance.

    Returns:
        Of the texture's size; 0 where nothing is known.
    """
    rows, columns = known.shape
    size = (trained.rows, round(columns * trained.rows / rows))
    there = _resized(known.astype(np.float32), size) > 0.999
    detail = detail_of(_resized(np.log(unlit), size), there)
    given = evidence(detail, _resized(slope, size), _resized(level, size), there)
    output = in_tiles(trained, given) * there[..., None]
    if size != (rows, columns):
        output = _resized(output, (rows, columns)) * known[..., None]
    return Found(output[..., :2], output[..., 2:4], output[..., 4:])


def in_tiles(
    trained: TrainedMesostructure, given: np.ndarray, tile_px: int = TILE_PX
) -> np.ndarray:
    """A network's answer to (h, w, c) evidence, (h, w, `SAID_CHANNELS`) float32.

    Any size of tiles gives the same but for rounding; those in which nothing is known are left out.
    """
    network, reach = trained.network, trained.network.reach_px
    if trained.device != CPU:
        network = copy.deepcopy(network).to(trained.device)
    rows, columns = given.shape[:2]
    output = np.zeros((rows, columns, network.last.out_channels), np.float32)
    with torch.inference_mode():
        for top in range(0, rows, tile_px):
            for left in range(0, columns, tile_px):
                here = (slice(top, top + tile_px), slice(left, left + tile_px))
                if not given[here][..., -1].any():
                    continue
                first, begin = max(0, top - reach), max(0, left - reach)
                seen = given[first : top + tile_px + reach, begin : left + tile_px + reach]
                answer = moved(network(to_batch(seen).to(trained.device)), CPU)
                inner = from_batch(answer)[top - first :, left - begin :]
                output[here] = inner[: output[here].shape[0], : output[here].shape[1]]
    return output


def _resized(image: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """(h, w[, c]) at another size: means over larger texels, or linear between texels."""
    if image.shape[:2] == size:
        return np.asarray(image, np.float32)
    if image.shape[0] < size[0]:
        return enlarged(image, *size)
    shrunk = cv2.resize(np.asarray(image, np.float32), size[::-1], interpolation=cv2.INTER_AREA)
    return np.asarray(shrunk)
