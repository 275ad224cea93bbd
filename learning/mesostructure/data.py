"""Patches of lit textures: the network's input, and the true tilts.

A texture's light is never found exactly: its lamps are off by some degrees, are stronger or
weaker, and edges of shadows are some texels beside the true ones. So is the light by which these
textures are divided.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import torch
from torch import Tensor

from learning.augment import AugmentConfig
from learning.encoding import shrink
from learning.errors import TrainingError
from learning.maps import from_batch
from learning.mesostructure.config import LitPatchesConfig
from learning.mesostructure.evidence import detail_of, evidence, frame_of, slope_of
from learning.networks.whole_face import DARKEST, WholeFaceConfig
from learning.render.environments import Environment, RandomLightConfig
from learning.render.shading import Mode, ShadeOptions, direct
from learning.whole.detail import enlarged
from learning.whole.faces import Faces, FacesConfig, LargePair
from learning.whole.light import F0
from learning.whole.unlit import light_edges, lit_enough, matt, misplaced, over_light
from lightstage.commands import ProgressCallback, quiet
from processing.dataset import Store

FACETS = ShadeOptions("ggx")
"""As `learning.whole.light` takes a texture's light apart."""
ACROSS = (3, 5)
"""Channels of the evidence that change their sign in a mirror."""
SAID_ACROSS = (0, 2)
"""The same of a network's output."""


@dataclasses.dataclass(frozen=True)
class LitPatches:
    """What a step takes.

    Attributes:
        inputs: (B, 9, p, p), see `learning.mesostructure.evidence`.
        target: (B, 7, p, p), see `learning.mesostructure.network`.
        weight: (B, 1, p, p), 1 where captured skin is.
    """

    inputs: Tensor
    target: Tensor
    weight: Tensor


@dataclasses.dataclass(frozen=True)
class LitTexture:
    """A whole texture, as `LitPatches`, (rows, columns, c)."""

    inputs: np.ndarray
    target: np.ndarray
    weight: np.ndarray


class PatchPool:
    """Random patches of some people of a store, each lit many times, in memory."""

    def __init__(
        self,
        store: Store,
        subjects: set[str],
        config: LitPatchesConfig,
        lights: RandomLightConfig,
        variation: AugmentConfig,
        rng: np.random.Generator,
        mode: Mode = "physical",
        progress: ProgressCallback = quiet,
    ) -> None:
        """Light the scans of `subjects` in turn and cut patches out of them.

        Raises:
            TrainingError: no patch shows enough skin.
        """
        self._config = config
        how = FacesConfig(shadow_sets=config.shadow_sets)
        faces = Faces(store, subjects, WholeFaceConfig(), how, lights, variation, rng, mode)
        self.patches: list[tuple[Tensor, Tensor, Tensor]] = []
        of_each_scan = max(1, round(config.textures / len(faces.faces)))
        for index in range(len(faces.faces)):
            for pair in faces.large(index, of_each_scan, rng):
                self._cut(lit_texture(pair, config, rng), rng)
            progress(index + 1, len(faces.faces))
        if not self.patches:
            raise TrainingError(
                store.path,
                field=f"patches of {config.patch_px} texels",
                found=f"none that shows skin in {100 * config.min_known:.0f} % of it",
                expected="at least one",
                hint=f"Lower patches.patch_px, {config.patch_px}. Or are the maps empty?",
            )

    def draw(self, count: int, rng: np.random.Generator, share: slice = slice(None)) -> LitPatches:
        """Random patches, or a share of them: all are drawn."""
        drawn = [self._one(rng) for _ in range(count)][share]
        return LitPatches(*(torch.stack([patch[i] for patch in drawn]).float() for i in range(3)))

    def _one(self, rng: np.random.Generator) -> tuple[Tensor, Tensor, Tensor]:
        inputs, target, weight = self.patches[int(rng.integers(len(self.patches)))]
        if rng.random() < self._config.mirrored_share:
            return mirrored(inputs, ACROSS), mirrored(target, SAID_ACROSS), weight.flip(2)
        return inputs, target, weight

    def _cut(self, lit: LitTexture, rng: np.random.Generator) -> None:
        size = self._config.patch_px
        rows, columns = lit.weight.shape[:2]
        if min(rows, columns) < size:
            return
        summed = np.zeros((rows + 1, columns + 1))
        summed[1:, 1:] = lit.weight[..., 0].cumsum(axis=0).cumsum(axis=1)
        known = summed[size:, size:] - summed[:-size, size:] - summed[size:, :-size]
        known += summed[:-size, :-size]
        places = np.argwhere(known >= max(self._config.min_known * size**2, 1))
        if not len(places):
            return
        for row, column in places[rng.integers(len(places), size=self._config.of_each)]:
            here = (slice(row, row + size), slice(column, column + size))
            cut = (planes(lit.inputs[here]), planes(lit.target[here]), planes(lit.weight[here]))
            self.patches.append(cut)


def planes(image: np.ndarray) -> Tensor:
    """(h, w, c) to (c, h, w) half floats."""
    return torch.from_numpy(np.ascontiguousarray(image.transpose(2, 0, 1))).half()


def mirrored(image: Tensor, across: tuple[int, int]) -> Tensor:
    """A (c, h, w) patch left to right; the channels `across` change their sign."""
    sign = torch.ones(len(image), 1, 1, dtype=image.dtype)
    sign[list(across)] = -1
    return image.flip(2) * sign


def lit_texture(pair: LargePair, config: LitPatchesConfig, rng: np.random.Generator) -> LitTexture:
    """What a texture shows under a light that was found nearly, and the truth.

    Args:
        pair: a lit scan.
        config: how far off the light is.
        rng: randomness.
    """
    skin, covered = pair.skin_maps, pair.covered
    low = WholeFaceConfig()

    def smooth(image: Tensor) -> np.ndarray:
        """As the whole-face network sees it, (rows, columns[, c])."""
        return enlarged(from_batch(shrink(image, (low.rows, low.columns))), *covered.shape)

    logarithm = np.log(np.maximum(pair.diffuse_albedo, DARKEST))
    least, most = np.log(config.contrast)
    more = (np.exp(rng.uniform(least, most)) - 1) * detail_of(logarithm, covered)
    logarithm = np.minimum(logarithm + more, 0)
    noise = rng.normal(0, config.noise, pair.texture.shape)
    texture = pair.texture * np.exp(more + noise)
    light, seen = _nearly(pair, config, rng)
    shape = dataclasses.replace(
        skin, diffuse_normal=pair.shape_normal, specular_normal=pair.shape_normal
    )
    with torch.inference_mode():
        given, lobe, rim = direct(shape, light, FACETS, seen)
    assert rim is not None
    irradiance = from_batch(given)
    specular = smooth(skin.specular_albedo)[..., None]
    shine = specular * (from_batch(lobe) + from_batch(rim) / F0)
    level = irradiance.mean(axis=2)
    unlit = over_light(texture, irradiance, shine)
    edges = light_edges(level, covered)
    known = lit_enough(level, covered) & ~edges & matt(texture, shine)
    known &= texture.max(axis=2) > DARKEST
    albedo = np.maximum(smooth(skin.diffuse_albedo), DARKEST)
    known &= ~misplaced(unlit / albedo, edges, known)
    position, normal = from_batch(skin.position_mm), from_batch(pair.shape_normal)
    frame = frame_of(normal, position, covered)
    slope = slope_of(
        frame,
        position,
        light.position_mm[0].numpy(),
        light.rgb[0].mean(dim=1).numpy(),
        seen[0].numpy(),
        level,
    )
    found = detail_of(np.log(unlit), known)
    true = detail_of(logarithm, known)
    tilts = [frame.tilt_of(from_batch(n)) for n in (skin.diffuse_normal, skin.specular_normal)]
    target = np.concatenate([*tilts, found - true], axis=2)
    weight = (pair.skin > 0.5) & known
    return LitTexture(evidence(found, slope, level, known), target, weight[..., None])


def _nearly(
    pair: LargePair, config: LitPatchesConfig, rng: np.random.Generator
) -> tuple[Environment, Tensor]:
    """The light and its shadows, as they are found."""
    light = pair.environment
    lamps = light.position_mm.numpy().astype(float)
    distance = np.linalg.norm(lamps, axis=2, keepdims=True)
    beside = np.tan(np.radians(config.lamp_deg)) * rng.normal(size=lamps.shape)
    moved = lamps + distance * beside
    gain = np.exp(rng.normal(0, config.strength, (*lamps.shape[:2], 1)))
    ambient = np.exp(rng.normal(0, 2 * config.strength))
    found = dataclasses.replace(
        light,
        position_mm=torch.from_numpy(moved.astype(np.float32)),
        rgb=light.rgb * torch.from_numpy(gain.astype(np.float32)),
        ambient_rgb=light.ambient_rgb * float(ambient),
    )
    shift = np.rint(rng.normal(0, config.shadow_px, (pair.visibility.shape[1], 2))).astype(int)
    seen = [
        torch.roll(one, (int(down), int(across)), dims=(0, 1))
        for one, (down, across) in zip(pair.visibility[0], shift, strict=True)
    ]
    return found, torch.stack(seen)[None]
