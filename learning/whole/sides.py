"""A whole face's two sides: a network's answer to a face and to its mirror image.

People are nearly symmetric and light may come from either side, so that a face's mirror image is as
likely as the face. A network's errors on the two are partly independent: their mean is nearer.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from learning.devices import CPU, device_of, moved
from learning.maps import from_batch
from learning.networks.whole_face import SIDEWAYS, WholeFace, WholeFaceNetwork

MIRRORED_MM = 5.0
"""Median distance between a face and its mirror image, texel by texel, at most."""


def sides_mirror(position_mm: np.ndarray) -> bool:
    """Whether a texture's columns, in reverse, are a face's other side.

    Args:
        position_mm: (h, w, 3) of a face in the head frame, zero without surface.
    """
    mirrored = position_mm[:, ::-1] * (-1, 1, 1)
    both = (position_mm != 0).any(axis=2) & (mirrored != 0).any(axis=2)
    apart = np.linalg.norm(position_mm - mirrored, axis=2)[both]
    return bool(apart.size) and float(np.median(apart)) < MIRRORED_MM


def answer_of(network: WholeFaceNetwork, inputs: Tensor) -> WholeFace:
    """What a network answers to faces, on the processor, without gradients.

    Args:
        network: in evaluation mode, on any device.
        inputs: (B, 10, rows, columns) of `face_input`.

    Returns:
        The mean of what its answers to the faces and to their mirror images have beside the mean
        person, in logarithms, where the mean person's shape is the same in a mirror; else its
        answer to the faces.
    """
    there = inputs.to(device_of(network))
    with torch.inference_mode():
        own = moved(network(there), CPU)
        if not sides_mirror(from_batch(network.mean_position_mm.cpu())):
            return own
        turned = there.flip(3)
        turned[:, list(SIDEWAYS)] *= -1
        other = moved(network(turned), CPU)
    albedo, specular = network.mean_log_albedo.cpu().exp(), network.mean_log_specular.cpu().exp()
    return WholeFace(
        _both(own.diffuse_albedo, other.diffuse_albedo, albedo).clamp(max=1.0),
        _both(own.specular_albedo, other.specular_albedo, specular).clamp(max=1.0),
        _both(own.deviation, other.deviation, torch.ones(1)),
    )


def _both(own: Tensor, mirrored: Tensor, mean: Tensor) -> Tensor:
    """Geometric mean of an image and a mirrored one, each beside what all people have."""
    return mean * (own / mean * (mirrored / mean).flip(-1)).sqrt()
