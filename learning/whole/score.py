"""How well a whole-face network takes the light out of people it has not seen."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from learning.encoding import srgb_from_linear
from learning.errors import TrainingError
from learning.networks.whole_face import WholeFaceNetwork
from learning.whole.faces import FaceBatch, Faces
from learning.whole.sides import answer_of


@dataclasses.dataclass(frozen=True)
class FaceScore:
    """Over the captured skin of the people held out; simulated people are no real ones.

    Attributes:
        psnr_db: of the found diffuse albedo, sRGB-encoded.
        psnr_gain_db: the same after the best gain for each of red, green and blue, which nobody
            knows of a real person: what is left is the pattern.
        psnr_input_db: of the lit texture taken as albedo.
        psnr_mean_db: of the training people's mean albedo.
        psnr_tone_db: of the person's own mean tone, which nobody knows either.
        specular_rmse: of the specular albedo.
        specular_constant_rmse: of the best constant.
        deviation_ratio: mean expected error over the mean one; 1 where the network knows how far
            it can be trusted.
    """

    scored: ClassVar[str] = "diffuse albedo"
    psnr_db: float
    psnr_gain_db: float
    psnr_input_db: float
    psnr_mean_db: float
    psnr_tone_db: float
    specular_rmse: float
    specular_constant_rmse: float
    deviation_ratio: float

    def guesses(self) -> dict[str, float]:
        """See `Scored`."""
        return {"the lit texture": self.psnr_input_db, "the mean person": self.psnr_mean_db}

    def sentence(self) -> str:
        """See `Scored`."""
        return (
            f"PSNR {self.psnr_db:.2f} dB ({self.psnr_gain_db:.2f} after the best gain a channel); "
            f"the lit texture as albedo {self.psnr_input_db:.2f}, the mean person "
            f"{self.psnr_mean_db:.2f}, the person's true tone alone {self.psnr_tone_db:.2f}"
        )


def score_faces(network: WholeFaceNetwork, held_out: Faces, lights: int, seed: int) -> FaceScore:
    """Score on every scan of the people held out, under some random environments each.

    Args:
        network: in evaluation mode.
        held_out: their scans.
        lights: environments for each scan.
        seed: of the environments; independent of the training's.

    Raises:
        TrainingError: nothing to score.
    """
    rng = np.random.default_rng([seed, 3])
    pairs = [
        held_out.batch([index], rng) for index in range(len(held_out.faces)) for _ in range(lights)
    ]
    if not any(bool(pair.skin.any()) for pair in pairs):
        raise TrainingError(
            "score",
            found="no captured skin on the people held out",
            expected="maps as they were when the training began",
            hint="Was the store written anew meanwhile?",
        )
    found = [answer_of(network, pair.inputs) for pair in pairs]
    albedo = [face.diffuse_albedo for face in found]
    mean = network.mean_log_albedo.exp().cpu()
    tones = [mean_colour(pair.diffuse_albedo, pair.skin) for pair in pairs]
    gains = [
        _best_gain(value, pair.diffuse_albedo, pair.skin)
        for value, pair in zip(albedo, pairs, strict=True)
    ]
    specular = torch.cat([p.specular_albedo[p.skin > 0] for p in pairs])
    specular_answer = [s.specular_albedo[p.skin > 0] for s, p in zip(found, pairs, strict=True)]
    expected = [s.deviation[p.skin > 0] for s, p in zip(found, pairs, strict=True)]
    squares = torch.cat(
        [
            (srgb_from_linear(v) - srgb_from_linear(p.diffuse_albedo))
            .square()
            .mean(dim=1, keepdim=True)[p.skin > 0]
            for v, p in zip(albedo, pairs, strict=True)
        ]
    )
    return FaceScore(
        psnr_db(albedo, pairs),
        psnr_db([v * g for v, g in zip(albedo, gains, strict=True)], pairs),
        psnr_db([pair.texture for pair in pairs], pairs),
        psnr_db([mean] * len(pairs), pairs),
        psnr_db(tones, pairs),
        float((torch.cat(specular_answer) - specular).square().mean().sqrt()),
        float(specular.std(correction=0)),
        float(torch.cat(expected).square().mean().sqrt() / squares.mean().sqrt().clamp_min(1e-9)),
    )


def psnr_db(found: list[Tensor], pairs: list[FaceBatch]) -> float:
    """Peak signal to noise of diffuse albedos, sRGB-encoded, over skin of all pairs."""
    errors = [
        (srgb_from_linear(value) - srgb_from_linear(pair.diffuse_albedo)).square()[
            pair.skin.expand_as(pair.diffuse_albedo) > 0
        ]
        for value, pair in zip(found, pairs, strict=True)
    ]
    return -10 * float(np.log10(max(float(torch.cat(errors).mean()), 1e-12)))


def mean_colour(image: Tensor, skin: Tensor) -> Tensor:
    """(B, 3, 1, 1) mean of (B, 3, h, w) over skin, as large as a psnr of the pair needs."""
    total = (image * skin).sum(dim=(2, 3), keepdim=True)
    return (total / skin.sum(dim=(2, 3), keepdim=True).clamp_min(1)).expand_as(image)


def _best_gain(found: Tensor, true: Tensor, skin: Tensor) -> Tensor:
    """(B, 3, 1, 1) least squares gain, linear."""
    product = (found * true * skin).sum(dim=(2, 3), keepdim=True)
    return product / (found.square() * skin).sum(dim=(2, 3), keepdim=True).clamp_min(1e-12)
