"""The compiled shading as an operation that torch differentiates (processors; not twice)."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from learning.render.kernel_backward import LIGHT_SUMS, backward
from learning.render.kernel_forward import forward, pack_lights
from learning.render.texel_blocks import BLOCKS_A_TASK, TEXELS

NEAREST_MM = 1.0
"""Within 1 mm of a lamp the inverse square has no meaning for a point light."""
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
        arrays = [_array(field) for field in maps]
        batch, _, texels = position.shape
        kind = arrays[0].dtype
        visible = np.zeros((batch, 0, texels), kind) if seen is None else _array(seen)
        packed = np.stack(
            [
                pack_lights(_array(p), _array(c), d.numpy(), NEAREST_MM)
                for p, c, d in zip(light_mm, rgb, distant, strict=True)
            ]
        )
        irradiance = np.empty((batch, 3, texels), kind)
        lobes = np.empty((batch, 3, texels), kind)
        around = (_array(ambient), _array(camera))
        surface = valid.contiguous().numpy()
        gloss = glossy.contiguous().numpy()
        forward(*arrays, gloss, surface, visible, packed, *around, paper, irradiance, lobes)
        found = torch.from_numpy(irradiance), torch.from_numpy(lobes)
        ctx.save_for_backward(*maps, seen, light_mm, rgb, ambient, camera, distant, found[1])
        # Without their own graph: arrays of the tensors that were saved.
        ctx.arrays = (arrays, surface, visible, packed, around)
        ctx.paper = paper
        return found

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, of_irradiance: Tensor, of_lobes: Tensor) -> tuple[Tensor | None, ...]:
        """What each tensor of `forward` is worth; None where it is not asked for."""
        saved = ctx.saved_tensors
        light_mm, distant, lobes = saved[6], saved[10], saved[11]
        arrays, surface, visible, packed, around = ctx.arrays
        asked = ctx.needs_input_grad
        batch, _, texels = arrays[0].shape
        lights, kind = packed.shape[1], packed.dtype

        def room(index: int, channels: int) -> np.ndarray:
            return np.zeros((batch, channels, texels if asked[index] else 0), kind)

        of_maps = [room(i, c) for i, c in enumerate((3, 3, 3, 1, 1))]
        of_seen = room(5, lights)
        tasks = -(-texels // (TEXELS * BLOCKS_A_TASK))
        light_sums = np.zeros((batch, tasks, lights, LIGHT_SUMS), kind)
        camera_sums = np.zeros((batch, tasks, 3), kind)
        ambient_sums = np.zeros((batch, tasks, 3), kind)
        backward(
            *arrays,
            surface,
            visible,
            packed,
            *around,
            ctx.paper,
            _array(lobes),
            _array(of_irradiance),
            _array(of_lobes),
            any(asked[i] for i in NORMALS),
            any(asked[i] for i in PLACES),
            bool(asked[7]),
            *of_maps,
            of_seen,
            light_sums,
            camera_sums,
            ambient_sums,
        )
        sums = torch.from_numpy(light_sums.sum(axis=1))
        found = [torch.from_numpy(g) if asked[i] else None for i, g in enumerate(of_maps)]
        if ctx.paper:
            # Its ambient light comes in after the sums.
            found[4] = None
        return (
            *found,
            torch.from_numpy(of_seen) if asked[5] else None,
            _of_places(light_mm, distant, sums) if asked[6] else None,
            sums[..., 4:] if asked[7] else None,
            torch.from_numpy(ambient_sums.sum(axis=1)) if asked[8] and not ctx.paper else None,
            torch.from_numpy(camera_sums.sum(axis=1)) if asked[9] else None,
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


def _array(values: Tensor) -> np.ndarray:
    return values.detach().contiguous().numpy()
