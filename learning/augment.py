"""Other skins from the same scan: complexion, gloss and translucency."""

from __future__ import annotations

import dataclasses

import numpy as np
import torch
import torch.nn.functional as functional
from torch import Tensor

MELANIN = (0.71, 1.0, 1.95)
"""Eumelanin's absorption at 610, 550, 450 nm over that at 550 nm: wavelength^-3.33 [Donner2006]."""
HAEMOGLOBIN = (0.08, 1.0, 1.6)
"""Blood's (75 % oxygenated) absorption at the same wavelengths, relative to 550 nm."""


@dataclasses.dataclass(frozen=True)
class AugmentConfig:
    """Ranges of what is varied.

    Attributes:
        melanin: standard deviation of the added absorbance (natural logarithm, at 550 nm).
        haemoglobin: standard deviation of the added absorbance of blood (natural logarithm).
        pattern: of melanin and of blood that differ from place to place of a face, as the share
            of `melanin` and `haemoglobin`.
        beside: standard deviation of the logarithm of what eyes, hair and teeth reflect, for they
            differ from person to person as skin does; that of one colour beside the others is a
            third of it.
        shininess: smallest and largest exponent of the lobe.
        translucency: smallest and largest translucency.
    """

    melanin: float = 0.3
    haemoglobin: float = 0.08
    pattern: float = 0.0
    beside: float = 0.0
    shininess: tuple[float, float] = (12.0, 60.0)
    translucency: tuple[float, float] = (0.2, 0.8)

    def as_they_are(self) -> AugmentConfig:
        """The same with people's own complexions."""
        return dataclasses.replace(self, melanin=0.0, haemoglobin=0.0, beside=0.0)


@dataclasses.dataclass(frozen=True)
class Variation:
    """One draw.

    Attributes:
        gain: of red, green and blue diffuse albedo.
        shininess: Blinn-Phong's exponent.
        translucency: 0..1.
        pattern: (1, 3, 6, 4), or of any other size, absorbance that is added over the face; None
            for none.
        beside: gain of red, green and blue of what is not skin.
    """

    gain: tuple[float, float, float]
    shininess: float
    translucency: float
    pattern: Tensor | None = None
    beside: tuple[float, float, float] = (1.0, 1.0, 1.0)


PATCHES = (6, 4)
"""Places of a face, rows and columns, between which a pattern is smooth: some 40 mm apart."""


def draw(rng: np.random.Generator, config: AugmentConfig) -> Variation:
    """Draw a variation; the complexion moves along melanin's and blood's absorption."""
    absorbance = rng.normal(0, config.melanin) * np.array(MELANIN)
    absorbance += rng.normal(0, config.haemoglobin) * np.array(HAEMOGLOBIN)
    red, green, blue = np.exp(-absorbance).tolist()
    low, high = np.log(config.shininess)
    shininess = float(np.exp(rng.uniform(low, high)))
    translucency = float(rng.uniform(*config.translucency))
    pattern = None
    if config.pattern > 0:
        spread = config.pattern * np.array([config.melanin, config.haemoglobin])
        amount = rng.normal(size=(*PATCHES, 2)) * spread
        values = amount @ np.array([MELANIN, HAEMOGLOBIN])
        pattern = torch.from_numpy(values.transpose(2, 0, 1)[None].astype(np.float32))
    beside = (1.0, 1.0, 1.0)
    if config.beside > 0:
        change = config.beside * (rng.normal() + rng.normal(size=3) / 3)
        beside = tuple(np.exp(change).tolist())
    return Variation((red, green, blue), shininess, translucency, pattern, beside)


def recolour(albedo: Tensor, variation: Variation, skin: Tensor) -> Tensor:
    """(B, 3, h, w) albedo under a variation, at most 1.

    Complexion changes only where `skin`, (B, 1, h, w) bool, is. Eyes, hair and teeth elsewhere have
    a gain of their own.
    """
    gain = albedo.new_tensor(variation.gain).view(1, 3, 1, 1)
    if variation.pattern is not None:
        absorbance = functional.interpolate(
            variation.pattern.to(albedo), albedo.shape[2:], mode="bicubic", align_corners=False
        )
        gain = gain * torch.exp(-absorbance)
    beside = albedo.new_tensor(variation.beside).view(1, 3, 1, 1)
    return (albedo * torch.where(skin, gain, beside)).clamp(0, 1)
