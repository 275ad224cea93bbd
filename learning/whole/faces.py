"""Training pairs of whole faces: a person's albedo, and what a photograph in some light shows."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as functional
from torch import Tensor

from learning import augment
from learning.clock import RENDERING, Clock
from learning.devices import CPU, moved
from learning.encoding import shrink
from learning.errors import TrainingError
from learning.maps import from_batch, to_batch
from learning.networks.whole_face import KnownPeople, WholeFaceConfig, face_input
from learning.render.environments import (
    Environment,
    RandomLightConfig,
    random_environment,
    random_lights,
    stack,
)
from learning.render.kept_shadows import shadows_of_scan
from learning.render.occlusion import sharpened
from learning.render.shading import Mode, ShadeOptions, SkinMaps, shade, unit
from learning.render.skin import joined_skins
from learning.whole.closed_eyes import eyes_of
from learning.whole.displacement import displaced, displacement, edges_mm
from learning.whole.face import Face, face_of, read_small, tensors_of
from learning.whole.texture_layout import brows_to_lips, of_another_layout
from lightstage.commands import ProgressCallback, quiet
from processing.dataset import Store

FINER = 2
"""Faces are lit at so many times the network's resolution, so that edges of shadows are sharp."""
LARGEST_ROWS = 1536
"""Rows at most at which the shares of detail are fitted: finer ones count as one band."""
NAMED = 3
"""Scans that an error names."""
LEAST_ALBEDO = 1e-3
"""Albedo below which a logarithm is cut off."""


@dataclasses.dataclass(frozen=True)
class FacesConfig:
    """How whole faces are shown to the network.

    Attributes:
        held_out_subjects: number of people, the last ones by name, who are scored and never trained
            on.
        shadow_sets: number of sets of lights of each scan whose shadows are baked.
        white_balance: standard deviation of the logarithm of the photograph's red, green and blue.
        noise: standard deviation of the logarithm of a texel.
        ggx_share: share of the faces that are shaded with facets and Fresnel's rise (see
            `learning.render.shading`) instead of as the training is configured.
        partial_share: share of the pairs of which only the side toward some camera is shown.
        skin_share: share of the pairs of which only skin is shown: eyes that are closed, hair that
            was left out of a photograph.
        closed_share: share of the pairs of which the eyes are not shown, as where they are closed
            (`learning.whole.closed_eyes`).
        beside_skin: weight of eyes, hair and texels that were not captured, where skin has 1.
        displaced_mm: standard deviation of how far a texel shows another place of the face than
            its own, as in the texture of a photograph whose fitted shape is not the person's.
    """

    held_out_subjects: int = 1
    shadow_sets: int = 24
    white_balance: float = 0.05
    noise: float = 0.02
    ggx_share: float = 0.0
    partial_share: float = 0.3
    skin_share: float = 0.0
    closed_share: float = 0.0
    beside_skin: float = 0.1
    displaced_mm: float = 0.0


@dataclasses.dataclass(frozen=True)
class LargePair:
    """One scan at its texture's own size, and as the network sees it.

    Attributes:
        texture: (rows, columns, 3) linear, light in it.
        diffuse_albedo: (rows, columns, 3), the truth.
        covered: (rows, columns) bool, where a surface is.
        skin: (rows, columns) share of captured skin.
        small: (1, 3, h, w), the texture at the network's size.
        inputs: (1, 10, h, w), see `face_input`.
        skin_maps: that were lit, in this complexion.
        shape_normal: (1, 3, rows, columns), of the shape.
        environment: in which they were lit.
        visibility: (1, L, rows, columns), the share of each light that a texel sees.
    """

    texture: np.ndarray
    diffuse_albedo: np.ndarray
    covered: np.ndarray
    skin: np.ndarray
    small: Tensor
    inputs: Tensor
    skin_maps: SkinMaps
    shape_normal: Tensor
    environment: Environment
    visibility: Tensor


@dataclasses.dataclass(frozen=True)
class LitFaces:
    """Faces of one size in random light and complexion.

    Attributes:
        texture: (B, 3, h, w) linear.
        skin: a batch.
        environments: of each.
        visibility: of each, (1, L, h, w).
    """

    texture: Tensor
    skin: SkinMaps
    environments: list[Environment]
    visibility: list[Tensor]


@dataclasses.dataclass(frozen=True)
class FaceBatch:
    """What a step takes, at the network's size.

    Attributes:
        inputs: (B, 10, rows, columns), see `face_input`.
        diffuse_albedo: (B, 3, rows, columns), the truth.
        specular_albedo: (B, 1, rows, columns).
        weight: (B, 1, rows, columns), how much a texel counts.
        skin: (B, 1, rows, columns), 1 where captured skin is.
        texture: (B, 3, rows, columns) linear, what was shown.
    """

    inputs: Tensor
    diffuse_albedo: Tensor
    specular_albedo: Tensor
    weight: Tensor
    skin: Tensor
    texture: Tensor


class Faces:
    """All scans of some people of a store, in memory (3 MB each at the default size)."""

    def __init__(
        self,
        store: Store,
        subjects: set[str],
        size: WholeFaceConfig,
        config: FacesConfig,
        lights: RandomLightConfig,
        variation: augment.AugmentConfig,
        rng: np.random.Generator,
        mode: Mode = "physical",
        progress: ProgressCallback = quiet,
        clock: Clock | None = None,
        lit_on: torch.device = CPU,
        shadows: Path | None = None,
    ) -> None:
        """Read and shrink the scans, and bake the shadows of random sets of lights.

        What is drawn counts on `clock` as data and rendering. `draw` lights its batches on the
        device `lit_on`, and leaves them there; a copy of all scans is kept in its memory. Shadows
        are read from the folder `shadows`, and kept there, where one is given.
        """
        self._clock = clock or Clock()
        self._store, self._config = store, config
        self._lights, self._variation = lights, variation
        self._size = (size.rows, size.columns)
        self._options = ShadeOptions(mode)
        self._scans = [scan for scan in store.scans if scan.subject in subjects]
        size_px = (FINER * size.rows, FINER * size.columns)
        # Rays are cast outside Python's lock: a person in each thread.
        threads = ThreadPoolExecutor(len(os.sched_getaffinity(0)))
        try:
            baked = [
                threads.submit(
                    face_of,
                    *read_small(store, scan.index, *size_px),
                    [random_lights(rng, lights) for _ in range(config.shadow_sets)],
                    shadows_of_scan(shadows, scan.sha256, "the surface"),
                )
                for scan in self._scans
            ]
            self.faces: list[Face] = []
            for done, face in enumerate(baked):
                self.faces.append(face.result())
                progress(done + 1, len(self._scans))
        finally:
            threads.shutdown(cancel_futures=True)
        self._require_one_layout()
        self._placed = [moved(face, lit_on) for face in self.faces]
        self._without_eyes = torch.ones(1)
        if config.closed_share > 0:
            self._without_eyes = self._not_eyes().to(lit_on)

    @property
    def names(self) -> list[str]:
        """Whose scan each face is."""
        return [scan.subject for scan in self._scans]

    def _require_one_layout(self) -> None:
        """TrainingError where the texture of some scans is laid out in another way than most's."""
        other = of_another_layout(self._shrunk("position")) if self.faces else []
        if other:
            names = [f"{self._scans[i].subject} ({self._scans[i].expression})" for i in other]
            more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
            raise TrainingError(
                self._store.path,
                field="uv",
                found=f"{', '.join(names[:NAMED])}{more} in another texture layout than most",
                expected="all scans in one template's layout",
                hint="Build the store from folders that were processed with one template, or "
                "carry maps to it by `lightstage-processing template transfer`.",
            )

    def in_common(self, modes: int) -> KnownPeople:
        """What the people have in common, and the directions in which their albedo differs."""
        specular, position = self._shrunk("specular_albedo"), self._shrunk("position")
        logarithm = self._shrunk("diffuse_albedo").clamp_min(LEAST_ALBEDO).log()
        mean = logarithm.mean(dim=0, keepdim=True)
        beside = logarithm - mean
        # A person of several scans counts several times; with one scan there is no direction.
        _, size, directions = torch.linalg.svd(beside.flatten(1), full_matrices=False)
        found = min(modes, len(beside) - 1)
        kept, deviations = beside.new_zeros(modes, *beside.shape[1:]), beside.new_zeros(modes)
        kept[:found] = directions[:found].unflatten(1, tuple(beside.shape[1:]))
        deviations[:found] = size[:found] / len(beside) ** 0.5
        return KnownPeople(
            mean,
            specular.clamp_min(LEAST_ALBEDO).log().mean(dim=0, keepdim=True),
            position.mean(dim=0, keepdim=True),
            kept,
            deviations,
        )

    def _not_eyes(self) -> Tensor:
        """(1, 1, rows, columns), 0 where a texture with closed eyes is not shown, 1 elsewhere."""
        logarithm = self._shrunk("diffuse_albedo").clamp_min(LEAST_ALBEDO).log()
        mean, position = (
            images.mean(dim=0, keepdim=True) for images in (logarithm, self._shrunk("position"))
        )
        return to_batch(~eyes_of(from_batch(mean), from_batch(brows_to_lips(position))))

    def _shrunk(self, name: str) -> Tensor:
        """(people, c, rows, columns), a map of all scans at the network's size."""
        return torch.cat([shrink(face.maps[name], self._size) for face in self.faces])

    def draw(self, count: int, rng: np.random.Generator, share: slice = slice(None)) -> FaceBatch:
        """A batch of random scans, or a share of it: what is drawn is the whole batch's.

        It is on the device that it is lit on.
        """
        faces = [self._placed[int(index)] for index in rng.integers(0, len(self._placed), count)]
        return self._batch(faces[share], rng.spawn(count)[share], _mean_texel_mm(faces))

    def batch(self, chosen: list[int], rng: np.random.Generator) -> FaceBatch:
        """Light some scans at random, on the processor; a scan gives another pair each time."""
        faces = [self.faces[index] for index in chosen]
        return self._batch(faces, rng.spawn(len(faces)), _mean_texel_mm(faces))

    def _batch(
        self, faces: list[Face], rngs: list[np.random.Generator], texel_mm: float
    ) -> FaceBatch:
        lit = self._lit(faces, rngs, texel_mm)
        normal = torch.cat([face.maps["shape_normal"] for face in faces])
        captured = torch.cat([face.skin for face in faces])
        return self._photographed(lit.texture, lit.skin, normal, captured, rngs)

    def draw_large(self, rng: np.random.Generator) -> LargePair:
        """A random scan, lit at its texture's own size (at most `LARGEST_ROWS`)."""
        return next(self.large(int(rng.integers(len(self.faces))), 1, rng))

    def large(self, index: int, count: int, rng: np.random.Generator) -> Iterator[LargePair]:
        """One scan `count` times, each in other light and complexion, as `draw_large`."""
        small, scan = self.faces[index], self._scans[index]
        rows = min(scan.rows, LARGEST_ROWS)
        columns = round(scan.columns * rows / scan.rows)
        maps, captured = read_small(self._store, scan.index, rows, columns)
        size = (rows, columns)
        tensors, texel_mm, surface = tensors_of(maps)
        openness = small.maps["ambient_occlusion"]
        tensors["ambient_occlusion"] = functional.interpolate(openness, size, mode="bilinear")
        for _ in range(count):
            chosen = int(rng.integers(len(small.light_position_mm)))
            seen = _enlarged_shadows(small.visibility[chosen], size)
            lights = [small.light_position_mm[chosen]]
            face = Face(tensors, to_batch(captured), texel_mm, lights, [seen])
            yield self._large_pair(face, surface.area_mm2 > 0, captured, rng)

    def _large_pair(
        self, face: Face, covered: np.ndarray, captured: np.ndarray, rng: np.random.Generator
    ) -> LargePair:
        lit = self._lit([face], [rng], face.texel_mm)
        low = shrink(lit.texture, self._size)
        there = torch.ones_like(low[:, :1])
        normal = unit(shrink(face.maps["shape_normal"], self._size))
        position = shrink(lit.skin.position_mm, self._size)
        return LargePair(
            from_batch(lit.texture),
            from_batch(lit.skin.diffuse_albedo),
            covered,
            captured,
            low,
            face_input(low, normal, position, there),
            lit.skin,
            face.maps["shape_normal"],
            lit.environments[0],
            lit.visibility[0],
        )

    def _lit(self, faces: list[Face], rngs: list[np.random.Generator], texel_mm: float) -> LitFaces:
        environments, shadows, skins, modes = [], [], [], []
        for face, rng in zip(faces, rngs, strict=True):
            chosen = int(rng.integers(len(face.light_position_mm)))
            lights, multiplies = face.light_position_mm[chosen], self._options.mode == "paper"
            environments.append(random_environment(rng, self._lights, lights, multiplies))
            shadows.append(face.visibility[chosen][None].float() / 255)
            skins.append(_skin_maps(face, augment.draw(rng, self._variation)))
            facets = rng.random() < self._config.ggx_share
            modes.append("ggx" if facets else self._options.mode)
        skin = joined_skins(skins, texel_mm)
        texture = torch.empty_like(skin.diffuse_albedo)
        for mode in dict.fromkeys(modes):
            here = [index for index, own in enumerate(modes) if own == mode]
            light = moved(stack([environments[index] for index in here]), texture.device)
            seen = torch.cat([_padded(shadows[index], light.rgb.shape[1]) for index in here])
            some = (
                skin
                if len(here) == len(faces)
                else joined_skins([skins[i] for i in here], texel_mm)
            )
            with torch.no_grad(), self._clock.part(RENDERING):
                texture[here] = shade(some, light, ShadeOptions(mode), seen).clamp_min(0)
        return LitFaces(texture, skin, environments, shadows)

    def _photographed(
        self,
        texture: Tensor,
        skin: SkinMaps,
        normal: Tensor,
        captured: Tensor,
        rngs: list[np.random.Generator],
    ) -> FaceBatch:
        """At the network's size, with the flaws of photographs and the shape's own normals."""
        config, size = self._config, self._size
        normal = unit(shrink(normal, size))
        covered = (skin.area > 0).to(texture)
        surface = (shrink(covered, size) > 0.5).to(texture)
        if config.displaced_mm > 0:
            shifts = [displacement(rng, config.displaced_mm) for rng in rngs]
            both = displaced(torch.cat([texture, covered], 1), torch.cat(shifts), edges_mm(skin))
            texture, photographed = both[:, :3], shrink(both[:, 3:], size) > 0.5
        else:
            photographed = surface > 0
        small = shrink(texture, size)
        of_skin = (shrink(captured, size) > 0.5).to(texture)
        flaws, shown = [], []
        for own, only, rng in zip(normal.split(1), of_skin.split(1), rngs, strict=True):
            balance = np.exp(rng.normal(0, config.white_balance, (3, 1, 1)))
            flaws.append(balance * np.exp(rng.normal(0, config.noise, tuple(small.shape[1:]))))
            whole = self._shown(own, rng)
            shown.append(whole * only if rng.random() < config.skin_share else whole)
            if config.closed_share > 0 and rng.random() < config.closed_share:
                shown[-1] = shown[-1] * self._without_eyes
        small = small * torch.from_numpy(np.stack(flaws).astype(np.float32)).to(small)
        seen = surface * photographed * torch.cat(shown)
        small = small * seen
        weight = surface * (config.beside_skin + (1 - config.beside_skin) * of_skin)
        return FaceBatch(
            face_input(small, normal, shrink(skin.position_mm, size), seen),
            shrink(skin.diffuse_albedo, size),
            shrink(skin.specular_albedo, size),
            weight,
            of_skin * surface,
            small,
        )

    def _shown(self, normal: Tensor, rng: np.random.Generator) -> Tensor:
        """(1, 1, h, w), what one photograph from some side in front shows; mostly everything."""
        direction = rng.normal(size=3) * (0.7, 0.4, 0.2) + (0, 0, 1)
        reach = rng.uniform(-0.2, 0.4)
        if rng.random() >= self._config.partial_share:
            return torch.ones_like(normal[:, :1])
        toward = normal.new_tensor(direction / np.linalg.norm(direction)).view(1, 3, 1, 1)
        return ((normal * toward).sum(dim=1, keepdim=True) > reach).to(normal)


def _enlarged_shadows(visibility: Tensor, size: tuple[int, int]) -> Tensor:
    """(n, h, w) uint8 of a coarser grid at another size, with edges as sharp as small lamps'."""
    seen = functional.interpolate(visibility[None].float() / 255, size, mode="bilinear")[0]
    return (255 * sharpened(seen)).to(torch.uint8)


def _skin_maps(face: Face, variation: augment.Variation) -> SkinMaps:
    one = torch.ones_like(face.maps["area"])
    maps = face.maps
    return SkinMaps(
        diffuse_albedo=augment.recolour(maps["diffuse_albedo"], variation, face.skin > 0.5),
        specular_albedo=maps["specular_albedo"],
        diffuse_normal=maps["diffuse_normal"],
        specular_normal=maps["specular_normal"],
        shininess=variation.shininess * one,
        translucency=variation.translucency * one,
        position_mm=maps["position"],
        area=maps["area"],
        texel_mm=face.texel_mm,
        ambient_occlusion=maps["ambient_occlusion"],
        edges=maps["edges"],
    )


def _mean_texel_mm(faces: list[Face]) -> float:
    """Edge of the mean texel of a batch, whose subsurface kernel is used for all of it."""
    return float(np.mean([face.texel_mm for face in faces]))


def _padded(visibility: Tensor, lights: int) -> Tensor:
    """(1, n, h, w) with more lights: those that are not there are seen."""
    missing = lights - visibility.shape[1]
    return functional.pad(visibility, (0, 0, 0, 0, 0, missing), value=1.0)
