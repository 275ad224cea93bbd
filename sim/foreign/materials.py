"""Skins as other programs have them: Mitsuba's materials with a subject's textures."""

from __future__ import annotations

from typing import Any

import numpy as np

from sim.errors import SimError
from sim.people.subject import Subject
from sim.reference.lobes import F0, INDEX, body_at_normal, facets_mirror

WANDERING = "burley"
"""As `lambert-ggx`, but what enters the skin wanders in it: see `sim.foreign.wandering`."""
MATERIALS = ("lambert-ggx", "principled", "roughplastic", WANDERING)
"""A Lambertian base blended with a GGX mirror and no interface between them; Disney's principled
material; a rough dielectric over a diffuse base, as its authors wrote it; light inside the skin."""
SMOOTHEST = 0.05
LEAST_F0, MOST_F0 = 0.01, 0.07
"""`principled` has one index of refraction; two of it are blended for the texture between them."""


def material(name: str, subject: Subject, stretch: float = 1.0) -> dict[str, Any]:
    """Mitsuba's description of a material.

    At normal incidence it mirrors the subject's specular albedo; of the light that
    enters it the subject's diffuse albedo comes out again, but for `principled`, whose authors
    take what is mirrored off nothing.

    Args:
        name: of `MATERIALS`.
        subject: whose textures it has.
        stretch: the mirror's alpha along the tangent is so many times the texture's, across it
            the texture's divided by this.

    Raises:
        SimError: another name, or a stretch of one whose mirror is round.
    """
    albedo = _texture(subject.diffuse_albedo)
    alpha = np.maximum(subject.roughness, SMOOTHEST).astype(np.float32)
    mirrors = np.asarray(subject.specular_albedo, np.float32)
    if name not in MATERIALS:
        raise SimError("material", found=repr(name), expected=", ".join(MATERIALS))
    if name in ("lambert-ggx", WANDERING):
        base = np.zeros_like(subject.diffuse_albedo) if name == WANDERING else None
        return {
            "type": "blendbsdf",
            "weight": _texture(mirrors),
            "base": {"type": "diffuse", "reflectance": albedo if base is None else _texture(base)},
            "mirror": {
                "type": "roughconductor",
                "material": "none",
                "distribution": "ggx",
                "alpha_u": _texture(alpha * stretch),
                "alpha_v": _texture(alpha / stretch),
            },
        }
    if stretch != 1:
        raise SimError(
            "material", field="stretch", found=f"{stretch:g} of {name}", expected="1: it is round"
        )
    if name == "principled":
        # Its roughness is the square root of the facets' alpha, its specular 12.5 times F0.
        both = {"type": "principled", "base_color": albedo, "roughness": _texture(np.sqrt(alpha))}
        share = np.clip((mirrors - LEAST_F0) / (MOST_F0 - LEAST_F0), 0, 1)
        return {
            "type": "blendbsdf",
            "weight": _texture(share),
            "dull": {**both, "specular": LEAST_F0 / 0.08},
            "bright": {**both, "specular": MOST_F0 / 0.08},
        }
    # One roughness for all: Mitsuba's object has no texture of it.
    rough = float(np.median(alpha[subject.skin])) if subject.skin.any() else 0.28
    return {
        **_plastic(rough),
        "diffuse_reflectance": _texture(below_interface(subject.diffuse_albedo, rough)),
        "specular_reflectance": _texture(mirrors / np.float32(F0)),
    }


def _plastic(alpha: float) -> dict[str, Any]:
    return {
        "type": "roughplastic",
        "distribution": "ggx",
        "alpha": alpha,
        "int_ior": INDEX,
        "nonlinear": True,
    }


def below_interface(albedo: np.ndarray, alpha: float) -> np.ndarray:
    """Reflectance of the base of `roughplastic` whose entered light comes out again as given.

    Of the light that entered, M rho / (1 - f rho) comes out after all rounds below the interface;
    M and f are read from two bases that Mitsuba is asked for.

    Args:
        albedo: of any shape, share of the entered light that comes out.
        alpha: of the interface.
    """
    faint = 0.01
    white, dark = (
        body_at_normal(_plastic(alpha) | {"diffuse_reflectance": {"type": "rgb", "value": rho}})[1]
        for rho in (1.0, faint)
    )
    ratio = faint * white[-1] / dark[-1]
    back = (ratio - 1) / (ratio - faint)
    cosine = np.linspace(0, 1, len(dark))
    leaves = float(np.trapezoid(2 * cosine * dark / dark[-1], cosine))
    most = dark[-1] / faint * (1 - faint * back) * leaves / (1 - facets_mirror("ggx", alpha))
    albedo = np.asarray(albedo, np.float32)
    return np.asarray(np.minimum(albedo / (most + back * albedo), 1), np.float32)


def _texture(image: np.ndarray) -> dict[str, Any]:
    import mitsuba as mi

    layers = image if image.ndim == 3 else image[..., None]
    pixels = mi.Bitmap(np.ascontiguousarray(layers, np.float32))
    return {"type": "bitmap", "bitmap": pixels, "raw": True, "wrap_mode": "clamp"}
