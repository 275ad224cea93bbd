"""A domain's light refined by descent through the renderer, with the network's reflectance.

All textures are rendered with the reflectance that a first network gives, under one environment,
whose lamps, ambient light and camera follow the slope of the mean absolute difference from the
textures (L1) [Lattas2021]. What one texture gets wrong, such as its tone, has a bounded part in
that slope.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import torch
from torch import Tensor

from learning.domain.sample import Sample
from learning.maps import SHININESS, skin_maps_from, to_batch
from learning.render.environments import Environment
from learning.render.shading import shade
from learning.render.skin import SkinMaps, joined_skins
from learning.whole.light import (
    AMBIENT_SHINE,
    FARTHEST_MM,
    NEAREST_MM,
    SHADING,
    LitSurface,
)
from lightstage.commands import ProgressCallback, quiet
from lightstage.formats.environment import LightSet

DIMMEST = 1e-4
"""Strength from which the descent of a lamp's logarithm begins, at least."""


@dataclasses.dataclass(frozen=True)
class Refined:
    """A light that descent has found.

    Attributes:
        light: head frame.
        camera_mm: (3,).
        before, after: mean absolute difference from the textures, linear.
    """

    light: LightSet
    camera_mm: np.ndarray
    before: float
    after: float


def descend(
    samples: list[Sample],
    light: LightSet,
    camera_mm: np.ndarray,
    steps: int,
    rate: float,
    shadow_steps: int,
    progress: ProgressCallback = quiet,
) -> Refined:
    """Move a light until the renderer gives the textures as nearly as it can.

    Args:
        samples: of one domain.
        light: to begin with, head frame.
        camera_mm: (3,) to begin with; its distance stays.
        steps: of Adam [Kingma2015], whose rate falls to 0 as a cosine.
        rate: the first.
        shadow_steps: steps between castings of the shadows, which have no slope.
        progress: called with steps done and their number.
    """
    scene = _Scene(samples)
    values = _Unknowns(light, camera_mm)
    optimiser = torch.optim.Adam(values.all, lr=rate)
    fall = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, max(steps, 1))
    seen = scene.seen(values.places())
    begin = values.kept()
    with torch.no_grad():
        first = float(scene.off(values.environment(), seen))
    for step in range(steps):
        if step and step % shadow_steps == 0:
            seen = scene.seen(values.places())
        optimiser.zero_grad()
        loss = scene.off(values.environment(), seen)
        loss.backward()
        optimiser.step()
        fall.step()
        progress(step + 1, steps)
    with torch.no_grad():
        last = float(scene.off(values.environment(), scene.seen(values.places())))
    if not last < first:
        values.back(begin)
        last = first
    return Refined(values.light(light.name), values.camera(), first, last)


class _Scene:
    """The heads with the network's reflectance, and their textures."""

    def __init__(self, samples: list[Sample]) -> None:
        self._surfaces = [LitSurface(s.mesh, s.raster, np.zeros(3)) for s in samples]
        openness = []
        skins = []
        for sample, surface in zip(samples, self._surfaces, strict=True):
            around = np.zeros(sample.raster.covered.shape, np.float32)
            around[sample.raster.covered] = surface.openness()
            openness.append(around)
            skins.append(_skin(sample, around))
        self._skin = joined_skins(skins, float(np.mean([skin.texel_mm for skin in skins])))
        self._open = torch.from_numpy(np.stack(openness))[:, None]
        self._texture = torch.cat([to_batch(s.answer.texture) for s in samples])
        weight = [s.weights for s in samples]
        self._weight = torch.from_numpy(np.stack(weight).astype(np.float32))[:, None]
        self._total = self._weight.sum().clamp_min(1e-6) * 3
        self._covered = [s.raster.covered for s in samples]

    def seen(self, lamps_mm: np.ndarray) -> Tensor:
        """(N, L, h, w) share of each lamp that each texel sees."""
        out = []
        for surface, covered in zip(self._surfaces, self._covered, strict=True):
            image = np.zeros((len(lamps_mm), *covered.shape), np.float32)
            if len(lamps_mm):
                image[:, covered] = surface.seen(lamps_mm)
            out.append(image)
        return torch.from_numpy(np.stack(out))

    def off(self, environment: Environment, seen: Tensor) -> Tensor:
        """Mean absolute difference from the textures."""
        made = shade(self._skin, environment, SHADING, seen)
        around = environment.ambient_rgb[:, :, None, None] * self._open
        made = made + AMBIENT_SHINE * self._skin.specular_albedo * around
        return ((made - self._texture).abs() * self._weight).sum() / self._total


def _skin(sample: Sample, openness: np.ndarray) -> SkinMaps:
    """The network's answer to a texture, as the renderer takes it."""
    answer, raster = sample.answer, sample.raster
    ones = np.ones(raster.covered.shape, np.float32)
    normal = raster.normals(sample.mesh)
    maps = {
        "diffuse_albedo": np.exp(answer.log_albedo) * raster.covered[..., None],
        "specular_albedo": answer.specular * raster.covered,
        "diffuse_normal": normal,
        "specular_normal": normal,
        "position": raster.interpolate(sample.mesh.vertices),
        "ambient_occlusion": openness,
    }
    return skin_maps_from(maps, raster.covered, SHININESS * ones, 0 * ones)


class _Unknowns:
    """Directions and distances, strengths, ambient light and the camera's direction."""

    def __init__(self, light: LightSet, camera_mm: np.ndarray) -> None:
        distance = np.linalg.norm(light.position_mm, axis=1, keepdims=True)
        away = float(np.linalg.norm(camera_mm))

        def own(values: np.ndarray) -> Tensor:
            return torch.tensor(values, dtype=torch.float32, requires_grad=True)

        self._direction = own(light.position_mm / distance)
        self._distance = own(np.log(distance))
        self._rgb = own(np.log(np.maximum(light.rgb, DIMMEST)))
        self._around = own(np.log(np.maximum(light.ambient_rgb, DIMMEST))[None])
        self._camera = own(np.asarray(camera_mm)[None] / away)
        self._away = away
        self.all = [self._direction, self._distance, self._rgb, self._around, self._camera]

    def environment(self) -> Environment:
        """What the values stand for, as a batch of one."""
        least, most = float(np.log(NEAREST_MM)), float(np.log(FARTHEST_MM))
        toward = torch.nn.functional.normalize(self._direction, dim=1)
        places = toward * self._distance.clamp(least, most).exp()
        camera = self._away * torch.nn.functional.normalize(self._camera, dim=1)
        distant = torch.zeros(1, len(places), dtype=torch.bool)
        return Environment(places[None], self._rgb.exp()[None], self._around.exp(), distant, camera)

    def places(self) -> np.ndarray:
        """(L, 3) where the lamps stand."""
        return self.environment().position_mm[0].detach().double().numpy()

    def camera(self) -> np.ndarray:
        """(3,) where the camera stands."""
        return self.environment().camera_mm[0].detach().double().numpy()

    def light(self, name: str) -> LightSet:
        """As a light set."""
        rgb, around = (each.detach().exp().double().numpy() for each in (self._rgb, self._around))
        return LightSet(name, self.places(), rgb, around[0])

    def kept(self) -> list[Tensor]:
        """A copy of the values."""
        return [value.detach().clone() for value in self.all]

    def back(self, values: list[Tensor]) -> None:
        """Take the values that were kept."""
        with torch.no_grad():
            for own, kept in zip(self.all, values, strict=True):
                own.copy_(kept)
