"""Specular albedo, roughness, translucency and stretch of the skin's facets by region."""

from __future__ import annotations

import numpy as np

from sim.head.grid import smoothstep
from sim.skin.complexion import Complexion
from sim.skin.parts import Patch

EYE_ROUGHNESS = 0.09
SPECULAR_RANGE = (0.008, 0.06)
ROUGHNESS_RANGE = (0.12, 0.42)


def skin_specular(patch: Patch, c: Complexion, relief_mm: np.ndarray) -> np.ndarray:
    """(h, columns) reflectance at normal incidence: high on nose and forehead, low on the cheeks.

    Pores and furrows reflect less than the plateaus between them; over the face the 95th
    percentile is about twice the 5th.
    """
    m = patch.mask
    logs = 0.30 * m("nose") + 0.18 * m("bridge") + 0.26 * m("forehead") + 0.14 * m("chin")
    logs = logs - 0.30 * m("below_eyes") - 0.14 * m("cheeks") - 0.10 * m("cheek_sides")
    logs -= 0.16 * m("neck") + 0.12 * m("jowls") + 0.10 * m("temples")
    logs += 0.30 * m("lips") + 0.12 * m("lids")
    logs += 0.09 * patch.noise(11.0, 3, 30) + 0.07 * patch.noise(1.8, 2, 31)
    logs += 0.05 * patch.noise(0.55, 1, 32)
    logs += 5.5 * np.clip(relief_mm, -0.09, 0.03) - 0.10 * c.age
    return np.asarray(0.0265 * np.exp(logs))


def skin_roughness(patch: Patch, c: Complexion) -> np.ndarray:
    """(h, columns) Beckmann m: .2 (greasy, lips) to .35 (dry neck)."""
    m = patch.mask
    rough = 0.305 - 0.065 * m("oily") - 0.03 * m("lids") - 0.10 * m("lips")
    rough += 0.025 * m("neck") + 0.015 * m("cheek_sides") + 0.012 * m("beard") * c.stubble
    rough += 0.02 * c.age
    rough += 0.012 * patch.noise(12.0, 2, 40) + 0.008 * patch.noise(1.5, 2, 41)
    return np.asarray(np.clip(rough, 0.185, 0.35))


def skin_translucency(patch: Patch) -> np.ndarray:
    """(h, columns) 0..1: ears, nose and lips let most light through."""
    m = patch.mask
    through = 0.55 + 0.42 * m("ears") + 0.25 * m("lips") + 0.28 * m("wings") + 0.18 * m("nose")
    through = through + 0.12 * m("lids") - 0.08 * m("forehead") + 0.025 * patch.noise(24.0, 2, 42)
    return np.asarray(np.clip(through, 0, 1))


def apply_look(
    look: str,
    patch: Patch,
    albedo: np.ndarray,
    specular: np.ndarray,
    roughness: np.ndarray,
) -> None:
    """Oily and dry patches, in place on (h, columns[, 3]); other looks change nothing here."""
    bare = (1 - patch.mask("eyes")) * (1 - 0.7 * patch.mask("lips"))
    if look == "oily":
        where = smoothstep(-0.5, 0.5, patch.noise(22.0, 3, 81) + 1.6 * patch.mask("oily") - 0.3)
        where = where * bare
        specular *= 1 + 0.42 * where
        roughness *= 1 - 0.36 * where
    elif look == "dry":
        where = smoothstep(-0.2, 0.8, patch.noise(18.0, 3, 82) + 0.7 * patch.mask("cheeks")) * bare
        flakes = smoothstep(0.2, 1.2, patch.noise(1.3, 3, 83)) * where
        specular *= 1 - 0.32 * where
        roughness += 0.075 * where
        pale = albedo.mean(axis=-1, keepdims=True) * 1.25 + 0.03
        albedo += (0.30 * flakes)[..., None] * (pale - albedo)


def facet_stretch(patch: Patch) -> np.ndarray:
    """(h, columns) 0..0.85 for the anisotropic look: uneven, none on eyes and lips."""
    uneven = 0.55 + 0.22 * patch.noise(30.0, 2, 84)
    return np.asarray(
        np.clip(uneven, 0, 0.85) * (1 - patch.mask("eyes")) * (1 - patch.mask("lips")), np.float32
    )
