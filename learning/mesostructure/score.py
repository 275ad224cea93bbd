"""How much nearer to the truth the found normals and the found detail of the albedo are."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from learning.devices import CPU, device_of, moved
from learning.errors import TrainingError
from learning.mesostructure.data import PatchPool
from learning.mesostructure.evidence import MOST_TILT
from learning.mesostructure.network import Mesostructure

AT_ONCE = 8
"""Patches that are scored together."""


@dataclasses.dataclass(frozen=True)
class MesostructureScore:
    """Over captured skin of the people held out; simulated people are no real ones.

    Attributes:
        diffuse_normal_deg: mean angle to the true diffuse normals.
        specular_normal_deg: the same of specular normals.
        shape_diffuse_deg: of the shape's own normals to the true diffuse ones.
        shape_specular_deg: the same of specular ones.
        psnr_db: of the natural logarithm of the albedo's detail, whose peak is 1.
        psnr_skin_db: the same where all detail is taken for skin.
    """

    scored: ClassVar[str] = "normals and the detail of albedos"
    diffuse_normal_deg: float
    specular_normal_deg: float
    shape_diffuse_deg: float
    shape_specular_deg: float
    psnr_db: float
    psnr_skin_db: float

    def guesses(self) -> dict[str, float]:
        """See `Scored`."""
        return {"all detail taken for skin": self.psnr_skin_db}

    def sentence(self) -> str:
        """See `Scored`."""
        return (
            f"diffuse normals {self.diffuse_normal_deg:.2f} degrees from the true ones (the "
            f"shape's own {self.shape_diffuse_deg:.2f}), specular ones "
            f"{self.specular_normal_deg:.2f} ({self.shape_specular_deg:.2f}); detail of the "
            f"albedo's logarithm {self.psnr_db:.2f} dB ({self.psnr_skin_db:.2f} where all is "
            "taken for skin)"
        )


def score_patches(network: Mesostructure, held_out: PatchPool) -> MesostructureScore:
    """Score a network on all patches of the people held out.

    Raises:
        TrainingError: no captured skin to score on.
    """
    sums, device = np.zeros(6), device_of(network)
    texels = 0.0
    for first in range(0, len(held_out.patches), AT_ONCE):
        some = held_out.patches[first : first + AT_ONCE]
        given, true, weight = (torch.stack([p[i] for p in some]).float() for i in range(3))
        with torch.inference_mode():
            output = moved(network(given.to(device)), CPU)
        skin = weight[:, 0] > 0
        shading = true[:, 4:]
        each = (
            angle_deg(output[:, :2], true[:, :2]),
            angle_deg(output[:, 2:4], true[:, 2:4]),
            angle_deg(0 * true[:, :2], true[:, :2]),
            angle_deg(0 * true[:, 2:4], true[:, 2:4]),
            (output[:, 4:] - shading).square().mean(dim=1),
            shading.square().mean(dim=1),
        )
        sums += [float(values[skin].sum()) for values in each]
        texels += float(skin.sum())
    if not texels:
        raise TrainingError(
            "score",
            found="no captured skin on the people held out",
            expected="maps as they were when the training began",
            hint="Was the store written anew meanwhile?",
        )
    angles, squares = sums[:4] / texels, sums[4:] / texels
    psnr_db = -10 * np.log10(np.maximum(squares, 1e-12))
    return MesostructureScore(*map(float, (*angles, *psnr_db)))


def angle_deg(first: Tensor, second: Tensor) -> Tensor:
    """(B, h, w) degrees between the normals of two (B, 2, h, w) tilts."""
    normals = []
    for tilt in (first, second):
        length = tilt.square().sum(dim=1, keepdim=True).sqrt()
        tilt = tilt * (MOST_TILT / length.clamp_min(1e-12)).clamp_max(1)
        along = (1 - tilt.square().sum(dim=1, keepdim=True)).sqrt()
        normals.append(torch.cat([tilt, along], dim=1))
    cosine = (normals[0] * normals[1]).sum(dim=1)
    crossed = torch.linalg.cross(normals[0], normals[1], dim=1).norm(dim=1)
    return torch.rad2deg(torch.atan2(crossed, cosine))
