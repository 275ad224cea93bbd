"""The maps of a skin that the renderer takes, and the options of its shading."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, Literal

import torch
from torch import Tensor

from learning.errors import MapsError


@dataclasses.dataclass(frozen=True)
class SkinMaps:
    """A batch of skin textures: all that the renderer needs of a surface.

    Attributes:
        diffuse_albedo: (B, 3, H, W), 1 = perfect white, without occlusion.
        specular_albedo: (B, 1, H, W), reflectance at normal incidence.
        diffuse_normal: (B, 3, H, W), any length; zero where no surface is.
        specular_normal: (B, 3, H, W).
        shininess: (B, 1, H, W), Blinn-Phong's exponent.
        translucency: (B, 1, H, W), 0..1.
        position_mm: (B, 3, H, W).
        area: (B, 1, H, W), a texel's surface relative to `texel_mm` squared; 0 where no surface is:
            nothing is computed there, and the picture is 0.
        texel_mm: edge of a texel of area 1.
        ambient_occlusion: (B, 1, H, W), 1 = open; what is left of the ambient light.
        edges: (B, 2, H, W), how far apart neighbours across and down are on the skin, relative to
            `texel_mm`; the root of `area` where None, as if the texture were stretched nowhere.
    """

    diffuse_albedo: Tensor
    specular_albedo: Tensor
    diffuse_normal: Tensor
    specular_normal: Tensor
    shininess: Tensor
    translucency: Tensor
    position_mm: Tensor
    area: Tensor
    texel_mm: float
    ambient_occlusion: Tensor
    edges: Tensor | None = None

    def __post_init__(self) -> None:
        """MapsError when maps differ in size, or a map has another count of channels."""
        size = self.diffuse_albedo.shape[-2:]
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if not isinstance(value, Tensor):
                continue
            if value.shape[-2:] != size:
                raise MapsError(
                    "maps",
                    field=field.name,
                    found=f"{value.shape[-2]} x {value.shape[-1]} texels",
                    expected=f"{size[0]} x {size[1]}, as diffuse_albedo",
                )
            channels = CHANNELS[field.name]
            if value.ndim != 4 or value.shape[1] != channels:
                raise MapsError(
                    "maps",
                    field=field.name,
                    found=" x ".join(str(n) for n in value.shape),
                    expected=f"(batch, {channels}, rows, columns)",
                )


def joined_skins(skins: Sequence[SkinMaps], texel_mm: float) -> SkinMaps:
    """Skins of one size as one batch, whose texels have the edge `texel_mm`."""
    names = [f.name for f in dataclasses.fields(SkinMaps) if f.name != "texel_mm"]
    parts = {name: [getattr(skin, name) for skin in skins] for name in names}
    return SkinMaps(
        **{name: torch.cat(each) for name, each in parts.items() if each[0] is not None},
        texel_mm=texel_mm,
    )


CHANNELS = {
    "diffuse_albedo": 3,
    "specular_albedo": 1,
    "diffuse_normal": 3,
    "specular_normal": 3,
    "shininess": 1,
    "translucency": 1,
    "position_mm": 3,
    "area": 1,
    "ambient_occlusion": 1,
    "edges": 2,
}


Mode = Literal["dielectric", "physical", "paper", "ggx"]


@dataclasses.dataclass(frozen=True)
class ShadeOptions:
    """How to shade.

    Attributes:
        mode: `dielectric` for facets with exact Fresnel over a diffuse layer, what relighting
            takes; `physical`; `paper` for the formulas as printed; `ggx` for facets with Schlick's
            Fresnel, as other renderers draw them.
        subsurface_mm: the diffusion kernel's standard deviation on the skin; 0 for none. The
            paper's 1.4 mm, 21 px of its 6144 x 4096 texture, is read as a standard deviation.
        fade_normals: let the light of a normal shorter than 1 fade with its length, as that of
            several directions' mean does; a network's normals are short where it is unsure. The
            gradient then stays bounded however short they are, and a normal of zero is black.
            Without it normals count by their direction alone.
        engine: `auto` takes this package's compiled code on processors and torch's operations
            elsewhere; `eager` and `compiled` (torch.compile) take torch's everywhere. The picture
            is the same to rounding. Only torch's can be differentiated twice.
    """

    mode: Mode = "physical"
    subsurface_mm: float = 1.4
    fade_normals: bool = False
    engine: Literal["auto", "eager", "compiled"] = "auto"


def finite_without_surface(maps: SkinMaps) -> SkinMaps:
    """The maps with 0 in place of NaN and infinity where no surface is.

    Such a texel's picture is made 0 by factors of 0, and 0 x NaN is NaN: in the picture, by
    scattering in all skin around, and in the gradients of lamps and camera.
    """
    given = {name: value for name in CHANNELS if (value := getattr(maps, name)) is not None}
    if maps.area.is_meta:  # tensors without values have no NaN to see
        return maps
    # A sum that is finite has no NaN: masks of all maps would take as long as the shading.
    sums = [value.detach().sum(dtype=wide_enough(value)) for value in given.values()]
    if bool(torch.isfinite(torch.stack(sums)).all()):
        return maps
    empty = ~(maps.area > 0)
    finite: dict[str, Any] = {
        name: torch.where(empty & ~torch.isfinite(value), 0, value) for name, value in given.items()
    }
    return dataclasses.replace(maps, **finite)


def wide_enough(values: Tensor) -> torch.dtype:
    """The precision that shading is done in: float32 at least, whatever the maps are stored in."""
    return torch.promote_types(values.dtype, torch.float32)
