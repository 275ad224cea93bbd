"""Plain guesses of an albedo, to be measured beside the networks.

Harmonic division: irradiance of light from far away is a function of the normal alone, and nearly
one of nine spherical harmonics [Ramamoorthi2001]. They are fitted to the texture over the mean
person's albedo, a channel at a time, and the texture is divided by them.

Regression on neighbours: ridge regression from a texture's local means at several scales, normals
and places to the logarithm of the albedo, one texel at a time.

The fit without a network: the refinement of `learning.whole.refine`, begun with the mean person.
"""

from __future__ import annotations

import copy
import dataclasses

import cv2
import numpy as np
import torch
from torch import Tensor, nn

from learning.networks.whole_face import DARKEST, DEVIATION, WholeFace, WholeFaceNetwork

LEAST_IRRADIANCE = 0.03
BLURS = (0.0, 1 / 384, 1 / 96, 1 / 24)
"""Standard deviations of the local means, of a texture's rows; the whole face's is one more."""
UNIT_MM = 100.0
RIDGE = 1e-3
"""Of the features' mean square."""
TEXELS_A_TEXTURE = 10_000


def harmonic_division(
    texture: np.ndarray, mean_albedo: np.ndarray, normal: np.ndarray, shown: np.ndarray
) -> np.ndarray:
    """A texture over the irradiance that nine harmonics of its normals give.

    Args:
        texture: (rows, columns, 3) linear.
        mean_albedo: (rows, columns, 3) of the mean person.
        normal: (rows, columns, 3) unit.
        shown: (rows, columns) bool, where the texture shows the head.

    Returns:
        (rows, columns, 3) linear, 0 to 1; the mean person where nothing is shown.
    """
    basis = harmonics(normal[shown])
    out = mean_albedo.astype(np.float32).copy()
    for channel in range(3):
        mean, seen = mean_albedo[shown][:, channel], texture[shown][:, channel]
        columns = basis * mean[:, None]
        weights = np.linalg.solve(columns.T @ columns, columns.T @ seen)
        irradiance = np.maximum(basis @ weights, LEAST_IRRADIANCE)
        out[..., channel][shown] = np.clip(seen / irradiance, 0, 1)
    return out


def harmonics(normal: np.ndarray) -> np.ndarray:
    """(n, 9) spherical harmonics to the second order of (n, 3) unit normals, not normalised."""
    x, y, z = normal.T.astype(float)
    ones = np.ones_like(x)
    return np.stack([ones, x, y, z, x * y, y * z, x * z, x * x - y * y, 3 * z * z - 1], axis=1)


@dataclasses.dataclass(frozen=True)
class Texture:
    """A texture with what its regression sees, and the truth.

    Attributes:
        image: (rows, columns, 3) linear.
        normal: (rows, columns, 3) of the mesh, head frame.
        position_mm: (rows, columns, 3), head frame.
        shown: (rows, columns) bool.
    """

    image: np.ndarray
    normal: np.ndarray
    position_mm: np.ndarray
    shown: np.ndarray


class Neighbours:
    """Ridge regression of log albedo."""

    def __init__(self) -> None:
        """Nothing seen."""
        self._normal: np.ndarray | float = 0.0
        self._right: np.ndarray | float = 0.0
        self._weights: np.ndarray | None = None

    def add(
        self, texture: Texture, albedo: np.ndarray, skin: np.ndarray, rng: np.random.Generator
    ) -> None:
        """Add a texture whose albedo is known, at random texels of its skin."""
        places = np.flatnonzero(skin[texture.shown])
        places = rng.choice(places, min(TEXELS_A_TEXTURE, len(places)), replace=False)
        columns = _features(texture)[places]
        wanted = np.log(np.maximum(albedo[texture.shown][places], DARKEST))
        self._normal = self._normal + columns.T @ columns
        self._right = self._right + columns.T @ wanted
        self._weights = None

    def find(self, texture: Texture) -> np.ndarray:
        """(rows, columns, 3) albedo, zero where nothing is shown."""
        if self._weights is None:
            normal = np.asarray(self._normal)
            steady = RIDGE * np.trace(normal) / len(normal) * np.eye(len(normal))
            self._weights = np.linalg.solve(normal + steady, np.asarray(self._right))
        out = np.zeros(texture.image.shape, np.float32)
        out[texture.shown] = np.exp(np.minimum(_features(texture) @ self._weights, 0))
        return out


def _features(texture: Texture) -> np.ndarray:
    """(n, k) of the texels that are shown."""
    known = texture.shown.astype(np.float32)
    rows = len(known)
    found = [np.ones((int(texture.shown.sum()), 1))]
    for share in BLURS:
        image, weight = texture.image * known[..., None], known
        if share:
            image, weight = _blurred(image, share * rows), _blurred(weight, share * rows)
        mean = image[texture.shown] / np.maximum(weight[texture.shown], 1e-3)[:, None]
        found.append(np.log(np.maximum(mean, DARKEST)))
    whole = np.log(np.maximum(texture.image[texture.shown].mean(axis=0), DARKEST))
    found.append(np.broadcast_to(whole, found[-1].shape))
    place = texture.position_mm[texture.shown] / UNIT_MM
    found += [harmonics(texture.normal[texture.shown])[:, 1:], harmonics(place)[:, 1:]]
    return np.concatenate(found, axis=1).astype(float)


def _blurred(image: np.ndarray, sigma: float) -> np.ndarray:
    return np.asarray(cv2.GaussianBlur(image.astype(np.float32), (0, 0), sigma))


class MeanPerson(nn.Module):
    """Guesses the mean person for any face, everywhere with the same trust."""

    def __init__(self, network: WholeFaceNetwork) -> None:
        """Of the people that a network was trained on."""
        super().__init__()
        self._mean = network.mean_log_albedo, network.mean_log_specular

    def forward(self, inputs: Tensor) -> WholeFace:
        """As `WholeFaceNetwork.forward`."""
        diffuse, specular = (mean.exp().expand(len(inputs), -1, -1, -1) for mean in self._mean)
        sure, unsure = DEVIATION
        return WholeFace(diffuse, specular, specular * 0 + (sure * unsure) ** 0.5)


def without_network(network: WholeFaceNetwork) -> WholeFaceNetwork:
    """A network that has learned nothing but what people have in common, and knows it."""
    other = copy.deepcopy(network)
    mean = MeanPerson(network)
    other.forward = mean.forward  # type: ignore[method-assign]
    other.mode_doubt.copy_(torch.eye(len(other.mode_doubt)))
    return other
