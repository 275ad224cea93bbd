"""The compiled shading as an operation that torch differentiates (processors; not twice)."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from learning.render.kernel_backward import LIGHT_SUMS, Gradients, Needed, Shaded, backward
from learning.render.kernel_facets import forward_facets
from learning.render.kernel_forward import forward, pack_lights
from learning.render.texel_blocks import NEAREST_MM, Lights, Skins, tasks_of


class Inputs(NamedTuple):
    """What `FusedLight.apply` takes, in its order; also which gradients are wanted, and these.

    Attributes:
        position: (B, 3, n) mm.
        diffuse_normal: (B, 3, n) of any length.
        specular_normal: (B, 3, n).
        shininess: (B, 1, n).
        occlusion: (B, 1, n) of the ambient light.
        seen: (B, L, n) or None.
        light_mm: (B, L, 3).
        rgb: (B, L, 3).
        ambient: (B, 3).
        camera: (B, 3) mm.
        distant: (B, L) bool.
        glossy: (B, n) bool, where the lobe is needed.
        valid: (B, n) bool, where a surface is.
        paper: whether as printed.
    """

    position: Any
    diffuse_normal: Any
    specular_normal: Any
    shininess: Any
    occlusion: Any
    seen: Any
    light_mm: Any
    rgb: Any
    ambient: Any
    camera: Any
    distant: Any = None
    glossy: Any = None
    valid: Any = None
    paper: Any = None


def can_fuse(reference: Tensor) -> bool:
    """Whether the compiled code takes tensors like this one."""
    return reference.device.type == "cpu" and reference.dtype in (torch.float32, torch.float64)


def fused_facets(given: Inputs) -> tuple[Tensor, Tensor]:
    """As `FusedLight` for mode `dielectric`; what comes back has no gradient."""
    skins, lights = _arrays(given)
    batch, _, texels = skins.position.shape
    kind = skins.position.dtype
    irradiance = np.empty((batch, 3, texels), kind)
    lobes = np.empty((batch, 3, texels), kind)
    forward_facets(skins, lights, array_of(given.glossy), irradiance, lobes)
    return torch.from_numpy(irradiance), torch.from_numpy(lobes)


def wants_gradient(given: Inputs) -> bool:
    """Whether any of the tensors is to be differentiated."""
    tensors = [value for value in given if isinstance(value, Tensor)]
    return torch.is_grad_enabled() and any(value.requires_grad for value in tensors)


def _arrays(of: Inputs) -> tuple[Skins, Lights]:
    """The inputs as compiled code takes them."""
    maps = (of.position, of.diffuse_normal, of.specular_normal, of.shininess, of.occlusion)
    skins = Skins(*(array_of(field) for field in (*maps, of.valid)))
    batch, _, texels = skins.position.shape
    kind = skins.position.dtype
    visible = np.zeros((batch, 0, texels), kind) if of.seen is None else array_of(of.seen)
    light_mm, rgb, distant = (array_of(x) for x in (of.light_mm, of.rgb, of.distant))
    packed = pack_lights(light_mm, rgb, distant, NEAREST_MM)
    return skins, Lights(packed, visible, array_of(of.ambient), array_of(of.camera))


class FusedLight(torch.autograd.Function):
    """`shading.direct` on a processor: sums over lights of the diffuse and the specular part."""

    @staticmethod
    def forward(ctx: Any, *given: Any) -> tuple[Tensor, Tensor]:
        """Of `Inputs`: irradiance and lobes, (B, 3, n) each."""
        of = Inputs(*given)
        maps = (of.position, of.diffuse_normal, of.specular_normal, of.shininess, of.occlusion)
        skins, lights = _arrays(of)
        batch, _, texels = skins.position.shape
        kind = skins.position.dtype
        irradiance = np.empty((batch, 3, texels), kind)
        lobes = np.empty((batch, 3, texels), kind)
        forward(skins, lights, array_of(of.glossy), of.paper, irradiance, lobes)
        found = torch.from_numpy(irradiance), torch.from_numpy(lobes)
        # Kept so that torch notices when one is changed before the backward pass.
        others = (of.seen, of.rgb, of.ambient, of.camera)
        ctx.save_for_backward(*maps, *others, of.light_mm, of.distant, found[1])
        # Without their own graph: arrays of the tensors that were saved.
        ctx.arrays = (skins, lights)
        ctx.paper = of.paper
        return found

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, of_irradiance: Tensor, of_lobes: Tensor) -> Inputs:
        """The gradient of each of the inputs; None where it is not needed."""
        light_mm, distant, lobes = ctx.saved_tensors[-3:]
        skins, lights = ctx.arrays
        asked = Inputs(*ctx.needs_input_grad)
        batch, _, texels = skins.position.shape
        count, kind, tasks = lights.packed.shape[1], lights.packed.dtype, tasks_of(texels)

        def room(some: bool, channels: int) -> np.ndarray:
            return np.zeros((batch, channels, texels if some else 0), kind)

        of = Gradients(
            room(asked.position, 3),
            room(asked.diffuse_normal, 3),
            room(asked.specular_normal, 3),
            room(asked.shininess, 1),
            # As printed, ambient light comes in after the sums.
            room(asked.occlusion and not ctx.paper, 1),
            room(asked.seen, count),
            np.zeros((batch, tasks, count, LIGHT_SUMS), kind),
            np.zeros((batch, tasks, 3), kind),
            np.zeros((batch, tasks, 3), kind),
        )
        wanted = Needed(
            asked.diffuse_normal or asked.specular_normal or asked.shininess,
            asked.position or asked.light_mm or asked.camera,
            asked.rgb,
        )
        gradient = Shaded(array_of(of_irradiance), array_of(of_lobes))
        backward(skins, lights, ctx.paper, array_of(lobes), gradient, wanted, of)
        sums, camera, ambient = (
            torch.from_numpy(x.sum(axis=1))
            for x in (of.light_sums, of.camera_sums, of.ambient_sums)
        )
        return Inputs(
            _filled(of.position),
            _filled(of.diffuse_normal),
            _filled(of.specular_normal),
            _filled(of.shininess),
            _filled(of.occlusion),
            _filled(of.seen),
            light_mm=_of_places(light_mm, distant, sums) if asked.light_mm else None,
            rgb=sums[..., 4:] if asked.rgb else None,
            ambient=ambient if asked.ambient and not ctx.paper else None,
            camera=camera if asked.camera else None,
        )


def _of_places(light_mm: Tensor, distant: Tensor, sums: Tensor) -> Tensor:
    """Gradient of the lights' places, from that of x, y, z and |P|^2 of packed lights."""
    near = sums[..., :3] + 2 * light_mm * sums[..., 3:4]
    scale = light_mm.square().sum(dim=-1, keepdim=True).clamp_min(1e-30).rsqrt()
    direction = light_mm * scale
    along = (sums[..., :3] * direction).sum(dim=-1, keepdim=True)
    return torch.where(distant[..., None], (sums[..., :3] - along * direction) * scale, near)


def _filled(values: np.ndarray) -> Tensor | None:
    """A gradient; None where it is not needed and has no room."""
    return torch.from_numpy(values) if values.shape[2] else None


def array_of(values: Tensor) -> np.ndarray:
    """A tensor's values as compiled code takes them: in order, without a graph."""
    return values.detach().contiguous().numpy()
