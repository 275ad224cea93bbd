"""The compiled shading as an operation that torch differentiates (processors; not twice)."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from learning.render.kernel_backward import LIGHT_SUMS, Asked, Gradients, Shaded, backward
from learning.render.kernel_forward import forward, pack_lights
from learning.render.texel_blocks import NEAREST_MM, Lights, Skins, tasks_of

PLACES = (0, 6, 9)
NORMALS = (1, 2, 3)
"""Arguments of `FusedLight` that share a part of the chain rule."""


def can_fuse(reference: Tensor) -> bool:
    """Whether the compiled code takes tensors like this one."""
    return reference.device.type == "cpu" and reference.dtype in (torch.float32, torch.float64)


class FusedLight(torch.autograd.Function):
    """`shading.direct` on a processor: sums over lights of the diffuse and the specular part."""

    @staticmethod
    def forward(
        ctx: Any,
        position: Tensor,
        diffuse_normal: Tensor,
        specular_normal: Tensor,
        shininess: Tensor,
        occlusion: Tensor,
        seen: Tensor | None,
        light_mm: Tensor,
        rgb: Tensor,
        ambient: Tensor,
        camera: Tensor,
        distant: Tensor,
        glossy: Tensor,
        valid: Tensor,
        paper: bool,
    ) -> tuple[Tensor, Tensor]:
        """(B, c, n) fields; lights (B, L, 3), camera and ambient (B, 3); glossy, valid (B, n)."""
        maps = (position, diffuse_normal, specular_normal, shininess, occlusion)
        skins = Skins(*(array_of(field) for field in (*maps, valid)))
        batch, _, texels = position.shape
        kind = skins.position.dtype
        visible = np.zeros((batch, 0, texels), kind) if seen is None else array_of(seen)
        packed = pack_lights(array_of(light_mm), array_of(rgb), array_of(distant), NEAREST_MM)
        irradiance = np.empty((batch, 3, texels), kind)
        lobes = np.empty((batch, 3, texels), kind)
        lights = Lights(packed, visible, array_of(ambient), array_of(camera))
        forward(skins, lights, array_of(glossy), paper, irradiance, lobes)
        found = torch.from_numpy(irradiance), torch.from_numpy(lobes)
        ctx.save_for_backward(*maps, seen, light_mm, rgb, ambient, camera, distant, found[1])
        # Without their own graph: arrays of the tensors that were saved.
        ctx.arrays = (skins, lights)
        ctx.paper = paper
        return found

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, of_irradiance: Tensor, of_lobes: Tensor) -> tuple[Tensor | None, ...]:
        """What each tensor of `forward` is worth; None where it is not asked for."""
        saved = ctx.saved_tensors
        light_mm, distant, lobes = saved[6], saved[10], saved[11]
        skins, lights = ctx.arrays
        asked = ctx.needs_input_grad
        batch, _, texels = skins.position.shape
        count, kind = lights.packed.shape[1], lights.packed.dtype

        def room(index: int, channels: int) -> np.ndarray:
            return np.zeros((batch, channels, texels if asked[index] else 0), kind)

        tasks = tasks_of(texels)
        of = Gradients(
            room(0, 3),
            room(1, 3),
            room(2, 3),
            room(3, 1),
            room(4, 1),
            room(5, count),
            np.zeros((batch, tasks, count, LIGHT_SUMS), kind),
            np.zeros((batch, tasks, 3), kind),
            np.zeros((batch, tasks, 3), kind),
        )
        wanted = Asked(
            any(asked[i] for i in NORMALS), any(asked[i] for i in PLACES), bool(asked[7])
        )
        worth = Shaded(array_of(of_irradiance), array_of(of_lobes))
        backward(skins, lights, ctx.paper, array_of(lobes), worth, wanted, of)
        sums = torch.from_numpy(of.light_sums.sum(axis=1))
        found = [torch.from_numpy(g) if asked[i] else None for i, g in enumerate(of[:6])]
        if ctx.paper:
            # Its ambient light comes in after the sums.
            found[4] = None
        return (
            *found,
            _of_places(light_mm, distant, sums) if asked[6] else None,
            sums[..., 4:] if asked[7] else None,
            torch.from_numpy(of.ambient_sums.sum(axis=1)) if asked[8] and not ctx.paper else None,
            torch.from_numpy(of.camera_sums.sum(axis=1)) if asked[9] else None,
            None,
            None,
            None,
            None,
        )


def _of_places(light_mm: Tensor, distant: Tensor, sums: Tensor) -> Tensor:
    """What the lights' places are worth, from what x, y, z and |P|^2 of packed lights are."""
    near = sums[..., :3] + 2 * light_mm * sums[..., 3:4]
    scale = light_mm.square().sum(dim=-1, keepdim=True).clamp_min(1e-30).rsqrt()
    direction = light_mm * scale
    along = (sums[..., :3] * direction).sum(dim=-1, keepdim=True)
    return torch.where(distant[..., None], (sums[..., :3] - along * direction) * scale, near)


def array_of(values: Tensor) -> np.ndarray:
    """A tensor's values as compiled code takes them: in order, without a graph."""
    return values.detach().contiguous().numpy()
