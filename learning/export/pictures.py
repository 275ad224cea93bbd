"""The 8-bit pictures of a head that glTF, OBJ and USD share; each is encoded once."""

from __future__ import annotations

import functools

import numpy as np

from learning.export.encode import (
    Curve,
    level,
    perceptual,
    plain,
    png,
    quantised,
    quantised_normals,
    srgb,
)
from learning.export.source import Source, m_of
from learning.maps import SHININESS
from learning.render.dielectric import F0

NORMAL = "specular_normal"
"""Whose directions a single normal map has: the surface's own, with its pores. Those of the diffuse
light are blurred by what scatters in the skin, which a renderer with subsurface adds by itself; a
material that takes two normals finds the other in the maps."""
CONSTANT_ROUGHNESS = float(m_of(np.array(SHININESS)))
"""Beckmann's m where there is no map: that of the renderer's constant exponent."""


class Pictures:
    """A head's pictures, made when they are first read; the bytes of PNG files, rows down."""

    def __init__(self, source: Source) -> None:
        """Nothing is computed yet."""
        self._source = source

    @functools.cached_property
    def base_colour(self) -> bytes:
        """Diffuse albedo, sRGB."""
        return png(self._encoded("diffuse_albedo", srgb))

    @functools.cached_property
    def normal(self) -> bytes:
        """Normals of `NORMAL` in MikkTSpace's frame, green up (OpenGL, glTF, Blender)."""
        return png(quantised_normals(self._source.tangent(NORMAL), np.uint8))

    @functools.cached_property
    def roughness(self) -> bytes | None:
        """Root of Beckmann's m; None without a map of it."""
        pixels = self._shares("roughness", perceptual)
        return None if pixels is None else png(pixels)

    @functools.cached_property
    def occlusion(self) -> bytes | None:
        """Ambient occlusion, 1 = open; None without a map of it."""
        pixels = self._shares("ambient_occlusion", plain)
        return None if pixels is None else png(pixels)

    @functools.cached_property
    def specular(self) -> bytes:
        """Specular albedo over `SPECULAR_WHITE`."""
        return png(self._encoded("specular_albedo", level))

    @functools.cached_property
    def occlusion_roughness(self) -> bytes | None:
        """What glTF packs: red occlusion, green roughness, blue no metal; None without both."""
        roughness = self._shares("roughness", perceptual)
        occlusion = self._shares("ambient_occlusion", plain)
        if roughness is None and occlusion is None:
            return None
        pixels = np.zeros((*self._source.size, 3), np.uint8)
        pixels[..., 0] = 255 if occlusion is None else occlusion
        pixels[..., 1] = 255 if roughness is None else roughness
        return png(pixels)

    @functools.cached_property
    def highest_specular(self) -> float:
        """What white red, green and blue of `specular_gltf` mean: 1 or more, in F0 of n = 1.4."""
        albedo = self._source.maps["specular_albedo"][self._source.covered]
        return float(max(1.0, float(albedo.max(initial=0)) / F0))

    @functools.cached_property
    def specular_gltf(self) -> bytes:
        """For KHR_materials_specular: alpha, the share of a mirror of F0; rgb, sRGB, what is more.

        The lobe is the specular albedo over F0 times Fresnel's; where that ratio is above 1, the
        colour raises the reflectance along the normal alone, and at grazing angles all is mirrored.
        """
        white = self.highest_specular
        pixels = np.empty((*self._source.size, 4), np.uint8)
        more = self._encoded("specular_albedo", lambda s: srgb(np.maximum(s / F0, 1) / white))
        pixels[..., :3] = more[..., None]
        pixels[..., 3] = self._encoded("specular_albedo", lambda s: s / F0)
        return png(pixels)

    def _encoded(self, name: str, curve: Curve) -> np.ndarray:
        return quantised(self._source.spread(self._source.maps[name]), curve, np.uint8)

    def _shares(self, name: str, curve: Curve) -> np.ndarray | None:
        return self._encoded(name, curve) if name in self._source.maps else None
