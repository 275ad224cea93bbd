"""Skins as other programs have them: Mitsuba's materials with a subject's textures."""

from __future__ import annotations

from typing import Any

import numpy as np

from sim.errors import SimError
from sim.people.subject import Subject

MATERIALS = ("lambert-ggx", "principled", "roughplastic")
"""A Lambertian base blended with a GGX mirror and no interface between them; Disney's principled
material; a rough dielectric over a diffuse base, as its authors wrote it."""
INDEX = 1.4
MIRROR_SHARE = 0.04
"""Weight of the mirror in `lambert-ggx`, which reflects alike from all sides."""
SMOOTHEST = 0.05


def material(name: str, subject: Subject) -> dict[str, Any]:
    """What Mitsuba is told of a material.

    Args:
        name: of `MATERIALS`.
        subject: whose textures it has.

    Raises:
        SimError: another name.
    """
    albedo = _texture(subject.diffuse_albedo)
    alpha = np.maximum(subject.roughness, SMOOTHEST).astype(np.float32)
    if name == "lambert-ggx":
        mirror = {"type": "roughconductor", "material": "none", "distribution": "ggx"}
        return {
            "type": "blendbsdf",
            "weight": MIRROR_SHARE,
            "base": {"type": "diffuse", "reflectance": albedo},
            "mirror": {**mirror, "alpha": _texture(alpha)},
        }
    if name == "principled":
        # Its roughness is the square root of the facets' alpha.
        rough = _texture(np.sqrt(alpha))
        return {"type": "principled", "base_color": albedo, "roughness": rough, "eta": INDEX}
    if name == "roughplastic":
        return {
            "type": "roughplastic",
            "distribution": "ggx",
            "alpha": float(np.median(alpha[subject.skin])) if subject.skin.any() else 0.28,
            "int_ior": INDEX,
            "nonlinear": True,
            "diffuse_reflectance": albedo,
        }
    raise SimError("material", found=repr(name), expected=", ".join(MATERIALS))


def _texture(image: np.ndarray) -> dict[str, Any]:
    import mitsuba as mi

    layers = image if image.ndim == 3 else image[..., None]
    pixels = mi.Bitmap(np.ascontiguousarray(layers, np.float32))
    return {"type": "bitmap", "bitmap": pixels, "raw": True, "wrap_mode": "clamp"}
