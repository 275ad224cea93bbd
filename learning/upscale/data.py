"""Pairs for super-resolution: textures and albedos of people, and the same with fewer texels.

A texture with fewer texels is what a camera further away would have recorded: the mean of linear
light over each texel. Patches are mirrored left to right, as a face and its light could be, and
the template's layout is the same on both sides. They are not turned nor flipped upside down: no
texture of this layout has its brows under its eyes, and a network may well know where up is.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import torch
import torch.nn.functional as functional
from torch import Tensor

from learning.augment import AugmentConfig
from learning.encoding import linear_from_srgb, srgb_from_linear
from learning.errors import TrainingError
from learning.maps import to_batch
from learning.networks.whole_face import WholeFaceConfig
from learning.render.environments import RandomLightConfig
from learning.render.shading import Mode
from learning.upscale.config import PicturesConfig
from learning.whole.faces import Faces, FacesConfig
from lightstage.commands import ProgressCallback, quiet
from processing.dataset import Store


@dataclasses.dataclass(frozen=True)
class Picture:
    """A texture or an albedo at its own size, and with fewer texels.

    Attributes:
        high: (3, rows, columns) half floats, sRGB-encoded.
        low: (3, rows / times, columns / times), sRGB-encoded.
        skin: (rows, columns) bool, where captured skin is.
        origins: (n, 2) rows and columns of `low` where a patch shows enough surface.
    """

    high: Tensor
    low: Tensor
    skin: np.ndarray
    origins: Tensor


@dataclasses.dataclass(frozen=True)
class PatchPairs:
    """What a step takes, sRGB-encoded.

    Attributes:
        inputs: (B, 3, p, p).
        target: (B, 3, times p, times p).
    """

    inputs: Tensor
    target: Tensor


class Pictures:
    """Lit textures and albedos of some people of a store, in memory."""

    def __init__(
        self,
        store: Store,
        subjects: set[str],
        times: int,
        count: int,
        config: PicturesConfig,
        lights: RandomLightConfig,
        variation: AugmentConfig,
        rng: np.random.Generator,
        mode: Mode = "physical",
        progress: ProgressCallback = quiet,
    ) -> None:
        """Light each scan of `subjects` at random, as often as `count` pictures need.

        Raises:
            TrainingError: no patch is covered enough, or maps are smaller than one.
        """
        self._config, self._times = config, times
        how = FacesConfig(shadow_sets=config.shadow_sets)
        faces = Faces(store, subjects, WholeFaceConfig(), how, lights, variation, rng, mode)
        lit = max(1, round(count / (2 * len(faces.faces))))
        self.pictures: list[Picture] = []
        for index in range(len(faces.faces)):
            for pair in faces.large(index, lit, rng):
                there = pair.covered[..., None]
                for image in (pair.texture * there, pair.diffuse_albedo * there):
                    self.pictures.append(self._picture(image, pair.covered, pair.skin > 0.5))
            progress(index + 1, len(faces.faces))
        if not any(len(picture.origins) for picture in self.pictures):
            side = times * config.patch_px
            raise TrainingError(
                store.path,
                field=f"patches of {side} texels",
                found=f"none covered by {100 * config.min_coverage:.0f} %",
                expected="at least one",
                hint=f"Lower pictures.patch_px, {config.patch_px}: patches are {times} times as "
                "large. Or are the maps empty?",
            )

    def mean_srgb(self) -> Tensor:
        """(3,) mean colour of what shows a surface."""
        colours = torch.cat([p.low[:, p.low.amax(dim=0) > 0] for p in self.pictures], dim=1)
        return colours.mean(dim=1)

    def draw(self, count: int, rng: np.random.Generator, share: slice = slice(None)) -> PatchPairs:
        """Random patches of random pictures, or a share of them: all are drawn."""
        usable = [picture for picture in self.pictures if len(picture.origins)]
        pairs = [self._patch(usable[int(rng.integers(len(usable)))], rng) for _ in range(count)]
        pairs = pairs[share]
        return PatchPairs(
            torch.stack([low for low, _ in pairs]), torch.stack([high for _, high in pairs])
        )

    def _patch(self, picture: Picture, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
        size, times = self._config.patch_px, self._times
        row, column = picture.origins[int(rng.integers(len(picture.origins)))].tolist()
        low = picture.low[:, row : row + size, column : column + size]
        top, left, side = times * row, times * column, times * size
        high = picture.high[:, top : top + side, left : left + side].float()
        if rng.random() < self._config.mirrored_share:
            return low.flip(2), high.flip(2)
        return low, high

    def _picture(self, image: np.ndarray, covered: np.ndarray, skin: np.ndarray) -> Picture:
        """Of (rows, columns, 3) linear; what `times` does not divide is left out at the end."""
        times, size = self._times, self._config.patch_px
        rows, columns = (times * (side // times) for side in covered.shape)
        whole = srgb_from_linear(to_batch(image[:rows, :columns]))
        seen = to_batch(covered[:rows, :columns].astype(np.float32))
        low = downsampled(whole, times)
        origins = torch.empty((0, 2), dtype=torch.long)
        if min(low.shape[2:]) >= size:
            share = functional.avg_pool2d(functional.avg_pool2d(seen, times), size, stride=1)
            # Sums of floats may miss a whole one by their rounding.
            origins = (share[0, 0] >= self._config.min_coverage - 1e-6).nonzero()
        return Picture(whole[0].half(), low[0], skin[:rows, :columns], origins)


def downsampled(picture: Tensor, times: int) -> Tensor:
    """Means of linear light over `times` x `times` texels of (B, 3, h, w) sRGB-encoded pictures.

    `times` divides both sides.
    """
    linear = linear_from_srgb(picture.clamp_min(0))
    return srgb_from_linear(functional.avg_pool2d(linear, times), float("inf"))
