"""How well a generator takes the light out of people it has not seen."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from learning.data import Batch, PatchData
from learning.devices import CPU, device_of
from learning.encoding import (
    Reflectance,
    decode_colour,
    decode_maps,
    encode_colour,
    srgb_from_linear,
)
from learning.errors import TrainingError
from learning.networks.generator import Generator
from learning.render.shading import unit


@dataclasses.dataclass(frozen=True)
class Score:
    """Over the texels of some patches of the people held out; simulated people are no real ones.

    Attributes:
        psnr_db: of the found diffuse albedo, sRGB-encoded.
        psnr_input_db: of the lit texture taken as albedo.
        psnr_mean_db: of the training people's mean albedo at the same place.
        psnr_flat_db: of the training people's tone alone, the constant output that suits them best:
            relative to the lit texture's where the network's colours are. Not the tone of the
            person held out, of which `whole.score` has the figure.
        detail: correlation of the found albedo with the true one, each less its patch's mean;
            0 of a constant.
        detail_input: the same of the lit texture taken as albedo.
        specular_rmse: of the specular albedo.
        specular_constant_rmse: of the best constant.
        diffuse_normal_deg: mean angle.
        specular_normal_deg: mean angle.
    """

    scored: ClassVar[str] = "diffuse albedo"
    psnr_db: float
    psnr_input_db: float
    psnr_mean_db: float
    psnr_flat_db: float
    detail: float
    detail_input: float
    specular_rmse: float
    specular_constant_rmse: float
    diffuse_normal_deg: float
    specular_normal_deg: float

    def guesses(self) -> dict[str, float]:
        """See `Scored`."""
        return {
            "the lit texture": self.psnr_input_db,
            "the mean person": self.psnr_mean_db,
            "the training people's tone alone": self.psnr_flat_db,
        }

    def sentence(self) -> str:
        """See `Scored`."""
        return (
            f"PSNR {self.psnr_db:.2f} dB; the lit texture as albedo {self.psnr_input_db:.2f}, the "
            f"mean person {self.psnr_mean_db:.2f}, the training people's tone alone "
            f"{self.psnr_flat_db:.2f}; correlation with the true detail {self.detail:.2f}"
        )


def answers_of(generator: Generator) -> Callable[[Batch], Reflectance]:
    """What a generator on any device finds on patches, which are on the processor."""
    device = device_of(generator)

    def answers(batch: Batch) -> Reflectance:
        return decode_maps(generator(batch.inputs.to(device)).to(CPU), batch.reference)

    return answers


def score(
    answers: Callable[[Batch], Reflectance],
    held_out: PatchData,
    trained_on: PatchData,
    patches: int,
    seed: int,
) -> Score:
    """Score on patches spread evenly over those of the people held out, under random lights.

    Args:
        answers: what the networks find.
        held_out: their patches.
        trained_on: for the baseline of the mean person.
        patches: how many, at most.
        seed: of the lights; independent of the training's.

    Raises:
        TrainingError: nothing to score.
    """
    count = min(patches, len(held_out.places))
    chosen = np.linspace(0, len(held_out.places) - 1, count).round().astype(int)
    rng = np.random.default_rng([seed, 3])
    batches = [held_out.batch([held_out.places[i]], rng) for i in chosen]
    if not any(bool(b.covered.any()) for b in batches):
        raise TrainingError(
            "score",
            found="no covered texel in the patches of the people held out",
            expected="maps as they were when the training began",
            hint="Was the store written anew meanwhile?",
        )
    tone = torch.stack([_tone(trained_on.draw(1, rng)) for _ in range(2 * count)]).mean(dim=0)
    with torch.inference_mode():
        found = [answers(batch) for batch in batches]

    def mean_square(values: list[Tensor]) -> float:
        texels = [
            (v - srgb_from_linear(b.skin.diffuse_albedo)).square()[b.covered.expand_as(v) > 0]
            for v, b in zip(values, batches, strict=True)
        ]
        return float(torch.cat(texels).mean())

    def texels(values: list[Tensor]) -> Tensor:
        pairs = zip(values, batches, strict=True)
        return torch.cat([v[b.covered > 0] for v, b in pairs])

    def correlation(values: list[Tensor]) -> float:
        pairs = []
        for value, b in zip(values, batches, strict=True):
            both = torch.cat([value, srgb_from_linear(b.skin.diffuse_albedo)])
            both = both.flatten(2)[:, :, b.covered.flatten() > 0]
            pairs.append((both - both.mean(dim=2, keepdim=True)).flatten(1))
        found, true = torch.cat(pairs, dim=1)
        return float((found * true).sum() / (found.norm() * true.norm()).clamp_min(1e-9))

    albedo = [srgb_from_linear(f.diffuse_albedo) for f in found]
    lit = [srgb_from_linear(b.texture) for b in batches]
    mean = [srgb_from_linear(_mean_albedo(trained_on, b)) for b in batches]
    flat = [
        srgb_from_linear(decode_colour(tone, b.reference.albedo)).expand_as(b.texture)
        for b in batches
    ]
    specular_truth = texels([b.skin.specular_albedo for b in batches])
    specular_found = texels([f.specular_albedo for f in found])
    return Score(
        _psnr(mean_square(albedo)),
        _psnr(mean_square(lit)),
        _psnr(mean_square(mean)),
        _psnr(mean_square(flat)),
        correlation(albedo),
        correlation(lit),
        float((specular_found - specular_truth).square().mean().sqrt()),
        float(specular_truth.std(correction=0)),
        _mean_angle_deg([f.diffuse_normal for f in found], batches, "diffuse_normal"),
        _mean_angle_deg([f.specular_normal for f in found], batches, "specular_normal"),
    )


def _mean_albedo(trained_on: PatchData, batch: Batch) -> Tensor:
    (_, row, column) = batch.places[0]
    places = [p for p in trained_on.places if p[1:] == (row, column)] or trained_on.places
    albedos = [trained_on.patch(place).maps["diffuse_albedo"] for place in places]
    return torch.cat(albedos).mean(dim=0, keepdim=True)


def _tone(batch: Batch) -> Tensor:
    """(1, 3, 1, 1) mean of a patch's albedo as the network's output would have to be."""
    encoded = encode_colour(batch.skin.diffuse_albedo, batch.reference.albedo)
    total = (encoded * batch.covered).sum(dim=(2, 3), keepdim=True)
    return total / batch.covered.sum().clamp_min(1)


def _psnr(mean_square: float) -> float:
    return -10 * float(np.log10(max(mean_square, 1e-12)))


def _mean_angle_deg(found: list[Tensor], batches: list[Batch], name: str) -> float:
    angles = []
    for normal, batch in zip(found, batches, strict=True):
        cosine = (unit(normal) * unit(getattr(batch.skin, name))).sum(dim=1, keepdim=True)
        angles.append(torch.rad2deg(torch.acos(cosine.clamp(-1, 1)))[batch.covered > 0])
    return float(torch.cat(angles).mean())
