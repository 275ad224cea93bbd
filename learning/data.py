"""Training pairs: a patch of a person's maps, and the same patch with light baked in."""

from __future__ import annotations

import collections
import dataclasses
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from learning import augment
from learning.clock import RENDERING, Clock
from learning.encoding import (
    OWN_CHANNELS,
    OWN_INPUTS,
    Reference,
    SpecularFrame,
    absolute_reference,
    covered_channels,
    encode_maps,
    local_contrast,
    network_input,
    relative_reference,
    shrink,
    smoothed_normal,
)
from learning.errors import TrainingError
from learning.maps import READ, to_batch, typical_texel_mm
from learning.patch_light import (
    Box,
    ScanLight,
    Scene,
    groups_around,
    join_scenes,
    sampled,
    target_environment,
)
from learning.render.environments import (
    Environment,
    RandomLightConfig,
    around,
    random_environment,
)
from learning.render.kept_shadows import shadows_of_scan
from learning.render.occlusion import PositionGrid
from learning.render.shading import Mode, ShadeOptions, SkinMaps, shade, unit
from learning.render.uv import texel_surface
from lightstage.commands import ProgressCallback, quiet
from processing.dataset import Store

MARGIN_PX = 8
"""Texels read around a patch, so that its normals need no texel that is missing."""


@dataclasses.dataclass(frozen=True)
class DataConfig:
    """Which patches are trained on.

    Attributes:
        patch_px: side of a patch.
        stride_px: step from one patch to the next.
        min_coverage: smallest share of a patch's texels that must be measured.
        held_out_subjects: number of people, the last ones by name, who are scored and never trained
            on.
        patches_in_memory: number of patches that are kept decoded, at most.
        shadow_rows: rows of the grid on which shadows and ambient occlusion are baked; 0 for
            neither.
        target: `one` environment for the whole training, near which all inputs and all draws of
            the rendering loss are, as published; or `each` set of a scan has its own, unless the
            lights have a target.
        shadow_sets: number of sets of light positions per scan around the one target, or of targets
            per scan.
        specular_frame: specular normals are in the shape's `tangent` space, as published, or
            in the axes of the `head`.
        relative: whether colours are encoded relative to the lit texture's mean and normals
            relative to the shape's (see learning.encoding); the published networks do not.
        whole: whether the whole texture is shown, shrunk to the patch's size, and its albedo
            trained on, as published; else these six channels stay empty.
        detail_px: standard deviation of the blur relative to which the texture's contrast
            bypasses the network; 0 for none, as published.
    """

    patch_px: int = 512
    stride_px: int = 256
    min_coverage: float = 0.5
    held_out_subjects: int = 1
    patches_in_memory: int = 64
    shadow_rows: int = 384
    target: Literal["one", "each"] = "one"
    shadow_sets: int = 64
    specular_frame: SpecularFrame = "tangent"
    relative: bool = False
    whole: bool = True
    detail_px: float = 0.0


@dataclasses.dataclass(frozen=True)
class Region:
    """Part of a scan's maps as tensors (1, c, h, w); `area` is relative to texel_mm squared.

    Attributes:
        maps: by their names in docs/formats.md, and shape_normal, area; of a whole scan
            smooth_normal too.
        texel_mm: edge of a texel of area 1.
    """

    maps: dict[str, Tensor]
    texel_mm: float

    def skin(self, variation: augment.Variation, openness: Tensor) -> SkinMaps:
        """As the renderer takes it, with (1, 1, h, w) ambient occlusion."""
        one = torch.ones_like(self.maps["area"])
        return SkinMaps(
            # A store's confidence, and with it the area, is 0 wherever no skin is.
            diffuse_albedo=augment.recolour(
                self.maps["diffuse_albedo"], variation, self.maps["area"] > 0
            ),
            specular_albedo=self.maps["specular_albedo"],
            diffuse_normal=self.maps["diffuse_normal"],
            specular_normal=self.maps["specular_normal"],
            shininess=variation.shininess * one,
            translucency=variation.translucency * one,
            position_mm=self.maps["position"],
            area=self.maps["area"],
            texel_mm=self.texel_mm,
            ambient_occlusion=openness,
            edges=self.maps["edges"],
        )


@dataclasses.dataclass(frozen=True)
class Batch:
    """What one training step takes.

    Attributes:
        inputs: (B, 9, h, w).
        target: (B, 13, h, w).
        covered: (B, 1, h, w), 1 where a surface is.
        covered_channels: (B, 13, h, w), the same for each of the target's channels.
        skin: the patches' true maps.
        environment: the light that is baked into the inputs.
        visibility: (B, L, h, w) its shadows.
        draws: other environments around the same target, with their shadows.
        texture: (B, 3, h, w) linear, what `inputs` encodes.
        reference: of the encoding.
        smooth_normal: (B, 3, h, w) unit normals of the shape without what is finer than some mm.
        options: how the light was baked into the inputs, and how the rendering loss shades.
        places: (scan, row, column) of each patch.
    """

    inputs: Tensor
    target: Tensor
    covered: Tensor
    covered_channels: Tensor
    skin: SkinMaps
    environment: Environment
    visibility: Tensor
    draws: tuple[Scene, ...]
    texture: Tensor
    reference: Reference
    smooth_normal: Tensor
    options: ShadeOptions
    places: list[tuple[int, int, int]]


class PatchData:
    """Patches of some people of a store."""

    def __init__(
        self,
        store: Store,
        subjects: set[str],
        config: DataConfig,
        lights: RandomLightConfig,
        variation: augment.AugmentConfig,
        rng: np.random.Generator,
        mode: Mode = "physical",
        progress: ProgressCallback = quiet,
        clock: Clock | None = None,
        draws: int = 0,
        seed: int = 0,
        shadows: Path | None = None,
    ) -> None:
        """Find the patches, draw sets of lights and bake their shadows.

        Args:
            store: the data.
            subjects: whose patches.
            config: which patches.
            lights: which environments.
            variation: which other skins.
            rng: randomness of the sets of lights.
            mode: of the shading.
            progress: called with scans.
            clock: what is drawn counts on it as data and rendering.
            draws: environments of each pair beside the input's own, for the rendering loss.
            seed: of the one target, which people trained on and held out share.
            shadows: folder of kept shadows; None where they are baked each time.

        Raises:
            TrainingError: no patch is covered enough.
        """
        self._store, self._config = store, config
        self._clock = clock or Clock()
        self._lights, self._variation = lights, variation
        self._options = ShadeOptions(mode)
        self._draws = draws
        self._shadows = shadows
        one = config.target == "one" or lights.target is not None
        self._target = target_environment(lights, mode, seed) if one else None
        self._patches: collections.OrderedDict[tuple[int, int, int], Region]
        self._patches = collections.OrderedDict()
        self._whole: dict[int, Region] = {}
        self._light: dict[int, ScanLight] = {}
        self.places: list[tuple[int, int, int]] = []
        chosen = [scan for scan in store.scans if scan.subject in subjects]
        for done, scan in enumerate(chosen):
            origins = store.patch_origins(
                scan.index, config.patch_px, config.stride_px, config.min_coverage
            )
            if origins:
                self.places += [(scan.index, row, column) for row, column in origins]
                whole = self._read_whole(scan.index)
                self._light[scan.index] = self._bake(scan.index, rng)
                self._whole[scan.index] = whole
            progress(done + 1, len(chosen))
        if not self.places:
            raise TrainingError(
                store.path,
                field=f"patches of {config.patch_px} texels",
                found=f"none covered by {100 * config.min_coverage:.0f} % on maps of "
                f"{store.scans[0].rows} x {store.scans[0].columns}",
                expected="at least one",
                hint="Set a smaller patch_px in [data] of --config, make maps of more rows, or see "
                "whether their confidence is 0.",
            )

    def batch(self, places: list[tuple[int, int, int]], rng: np.random.Generator) -> Batch:
        """Light patches at random; the same place gives another pair each time."""
        return self._batch(places, rng.spawn(len(places)))

    def draw(self, count: int, rng: np.random.Generator, share: slice = slice(None)) -> Batch:
        """A batch of random patches, or a share of it: what is drawn is the whole batch's."""
        chosen = rng.integers(0, len(self.places), count)[share]
        return self._batch([self.places[int(i)] for i in chosen], rng.spawn(count)[share])

    def _batch(self, places: list[tuple[int, int, int]], rngs: list[np.random.Generator]) -> Batch:
        return join([self._example(*of) for of in zip(places, rngs, strict=True)])

    def patch(self, place: tuple[int, int, int]) -> Region:
        """A patch's maps, from memory where they were read before."""
        found = self._patches.pop(place, None)
        if found is None:
            found = self._read_patch(place)
            while len(self._patches) >= self._config.patches_in_memory:
                self._patches.popitem(last=False)
        self._patches[place] = found
        return found

    def _example(self, place: tuple[int, int, int], rng: np.random.Generator) -> Batch:
        scan, row, column = place
        region, whole, light = self.patch(place), self._whole[scan], self._light[scan]
        size, info = self._config.patch_px, self._store.scans[scan]
        box = (row / info.rows, column / info.columns, size / info.rows, size / info.columns)
        everything = (0.0, 0.0, 1.0, 1.0)
        variation = augment.draw(rng, self._variation)
        skin = region.skin(variation, light.openness(box, size))
        whole_skin = whole.skin(variation, light.openness(everything, size))
        group, sets = light.draw(rng, 1 + self._draws)
        sharpness = float(np.exp(rng.uniform(0, np.log(8))))
        scene, *draws = self._scenes(light, group, sets, box, sharpness, rng)
        options = self._options
        covered = (skin.area > 0).to(skin.area)
        with torch.no_grad():
            # As printed light is negative behind the horizon, which no photograph shows.
            with self._clock.part(RENDERING):
                texture = shade(skin, scene.environment, options, scene.visibility)
                texture = texture.clamp_min(0) * covered
                whole_seen = light.shadows(group, sets[0], everything, size, 1.0)
                whole_texture = shade(whole_skin, scene.environment, options, whole_seen)
                whole_texture = whole_texture.clamp_min(0)
            whole_covered = (whole_skin.area > 0).to(texture)
            whole_texture = whole_texture * whole_covered
            shape_normal = region.maps["shape_normal"]
            reference = absolute_reference(shape_normal, self._config.specular_frame)
            if self._config.relative:
                reference = relative_reference(whole_texture, whole_covered, shape_normal)
            if self._config.detail_px > 0:
                white, blur_px = reference.texture, self._config.detail_px
                detail = local_contrast(texture, covered, white, blur_px)
                reference = dataclasses.replace(reference, detail=detail)
            inputs = network_input(texture, shape_normal, whole_texture, reference)
            channels = covered_channels(covered, whole_covered)
            if not self._config.whole:
                inputs[:, OWN_INPUTS:], channels[:, OWN_CHANNELS:] = 0, 0
            target = encode_maps(skin, whole_skin.diffuse_albedo, channels, reference)
        return Batch(
            inputs,
            target,
            covered,
            channels,
            skin,
            scene.environment,
            scene.visibility,
            tuple(draws),
            texture,
            reference,
            unit(sampled(whole.maps["smooth_normal"], box, size)) * covered,
            self._options,
            [place],
        )

    def _scenes(
        self,
        light: ScanLight,
        group: int,
        sets: list[int],
        box: Box,
        sharpness: float,
        rng: np.random.Generator,
    ) -> list[Scene]:
        """Environments around a group's target, with the shadows of some of its sets."""
        target = self._target
        if target is None:
            places = light.groups[group].target_mm
            target = random_environment(rng, self._lights, places, self._options.mode == "paper")
        size = self._config.patch_px
        return [
            Scene(
                around(target, rng, self._lights, light.groups[group].sets_mm[index]),
                light.shadows(group, index, box, size, sharpness),
            )
            for index in sets
        ]

    def _read_patch(self, place: tuple[int, int, int]) -> Region:
        scan, row, column = place
        info, size = self._store.scans[scan], self._config.patch_px
        top, left = max(0, row - MARGIN_PX), max(0, column - MARGIN_PX)
        rows = slice(top, min(info.rows, row + size + MARGIN_PX))
        columns = slice(left, min(info.columns, column + size + MARGIN_PX))
        arrays = {name: self._store.read(scan, name, rows, columns) for name in READ}
        inner = (slice(row - top, row - top + size), slice(column - left, column - left + size))
        return _region(arrays, inner)

    def _read_whole(self, scan: int) -> Region:
        """The whole scan, shrunk to a patch's size; what no texel covers stays empty."""
        size = (self._config.patch_px, self._config.patch_px)
        region = _region(self._shrunk(scan, size), (slice(None), slice(None)))
        maps = region.maps
        smooth = smoothed_normal(maps["shape_normal"], maps["area"], region.texel_mm)
        return Region({**maps, "smooth_normal": smooth}, region.texel_mm)

    def _shrunk(self, scan: int, size: tuple[int, int]) -> dict[str, np.ndarray]:
        everything = slice(None)
        seen = to_batch(self._store.read(scan, "confidence", everything, everything) > 0)
        weight = shrink(seen, size)
        arrays = {}
        for name in READ:
            if name != "confidence":
                image = to_batch(self._store.read(scan, name, everything, everything))
                mean = shrink(image * seen, size) / weight.clamp_min(1e-3) * (weight > 0.5)
                arrays[name] = mean[0].permute(1, 2, 0).numpy()
        arrays["confidence"] = (weight > 0.5).float()[0].permute(1, 2, 0).numpy()
        return arrays

    def _bake(self, scan: int, rng: np.random.Generator) -> ScanLight:
        config, info = self._config, self._store.scans[scan]
        groups = groups_around(self._target, config.shadow_sets, self._draws, self._lights, rng)
        if not config.shadow_rows:
            return ScanLight(groups, None)
        rows = min(config.shadow_rows, info.rows)
        columns = max(2, round(rows * info.columns / info.rows))
        arrays = self._shrunk(scan, (rows, columns))
        covered = arrays["confidence"][:, :, 0] > 0
        surface = texel_surface(arrays["position"], covered, smooth_px=1.0)
        kept = shadows_of_scan(self._shadows, info.sha256, "skin")
        return ScanLight(groups, PositionGrid(arrays["position"], surface.normal, covered, kept))


def _region(arrays: dict[str, np.ndarray], inner: tuple[slice, slice]) -> Region:
    covered = arrays["confidence"][:, :, 0] > 0
    surface = texel_surface(arrays["position"], covered)
    texel_mm = typical_texel_mm(surface.area_mm2)
    maps = {name: to_batch(array[inner]) for name, array in arrays.items() if name != "confidence"}
    maps["shape_normal"] = to_batch(surface.normal[inner])
    maps["area"] = to_batch(surface.area_mm2[inner] / texel_mm**2)
    maps["edges"] = to_batch(surface.edges_mm[inner] / texel_mm)
    return Region(maps, texel_mm)


def join(examples: list[Batch]) -> Batch:
    """Many batches as one; the subsurface kernel is that of the mean texel."""
    skins = [example.skin for example in examples]
    fields = [f.name for f in dataclasses.fields(SkinMaps) if f.name != "texel_mm"]
    skin = SkinMaps(
        **{name: torch.cat([getattr(s, name) for s in skins]) for name in fields},
        texel_mm=float(np.mean([s.texel_mm for s in skins])),
    )
    scene = join_scenes([Scene(e.environment, e.visibility) for e in examples])
    draws = zip(*(e.draws for e in examples), strict=True)
    return Batch(
        torch.cat([e.inputs for e in examples]),
        torch.cat([e.target for e in examples]),
        torch.cat([e.covered for e in examples]),
        torch.cat([e.covered_channels for e in examples]),
        skin,
        scene.environment,
        scene.visibility,
        tuple(join_scenes(list(same)) for same in draws),
        torch.cat([e.texture for e in examples]),
        Reference(
            torch.cat([e.reference.texture for e in examples]),
            torch.cat([e.reference.albedo for e in examples]),
            torch.cat([e.reference.normal for e in examples]),
            torch.cat([e.reference.specular_normal for e in examples]),
            _joined([e.reference.detail for e in examples]),
        ),
        torch.cat([e.smooth_normal for e in examples]),
        examples[0].options,
        [place for e in examples for place in e.places],
    )


def _joined(parts: list[Tensor | None]) -> Tensor | None:
    given = [part for part in parts if part is not None]
    return torch.cat(given) if given else None
