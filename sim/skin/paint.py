"""Procedural skin: colour, gloss, pores and wrinkles of one person, on our tile or any texture.

All patterns live on the surface of the neutral head in mm, so they stay on the face when it moves
and are round where the UV is stretched. Colour follows from melanin and blood (sim.skin.pigments).
What does not depend on the expression is painted once; an expression only deepens creases.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from sim.skin.colour import Marks, person_marks, skin_colour
from sim.skin.complexion import Complexion, random_complexion
from sim.skin.creases import (
    Line,
    add_creases,
    crease_chart,
    crease_depths,
    crease_height,
    person_lines,
)
from sim.skin.eyes import paint_eyes
from sim.skin.gloss import (
    EYE_ROUGHNESS,
    ROUGHNESS_RANGE,
    SPECULAR_RANGE,
    apply_look,
    facet_stretch,
    skin_roughness,
    skin_specular,
    skin_translucency,
)
from sim.skin.hair import (
    HairCharts,
    brow_share,
    draw_hair,
    lash_share,
    scalp_share,
    stubble_share,
)
from sim.skin.makeup import MakeUp, put_on, random_make_up
from sim.skin.parts import Face, Patch, face_from, face_of
from sim.skin.relief import skin_relief

MOUTH_ALBEDO = np.array([0.05, 0.02, 0.018], np.float32)


@dataclasses.dataclass(frozen=True)
class Skin:
    """Maps over a texture, (rows, columns) float32 each.

    Attributes:
        diffuse_albedo: (rows, columns, 3) linear.
        specular_albedo: reflectance at normal incidence.
        roughness: Beckmann m (or that of GGX).
        translucency: 0..1.
        relief_mm: pores, net and hair over the mesh, without creases.
        skin: bool, face skin or lips, no hair.
        anisotropy: 0..0.9, None where facets are round.
        distribution: of the facets, ``beckmann`` or ``ggx``.
        lines: the person's creases.
        age: 0 smooth to 1 lined.
        face: what was painted.
    """

    diffuse_albedo: np.ndarray
    specular_albedo: np.ndarray
    roughness: np.ndarray
    translucency: np.ndarray
    relief_mm: np.ndarray
    skin: np.ndarray
    anisotropy: np.ndarray | None
    distribution: str
    lines: tuple[Line, ...]
    age: float
    face: Face

    def height_mm(self, expression: str | None = None) -> np.ndarray:
        """(rows, columns) float32 mm: the relief with the creases of an expression."""
        chart = crease_chart(self.lines, crease_depths(self.age, expression), self.face.texel_mm)
        return add_creases(self.relief_mm, self.face, chart)


@dataclasses.dataclass(frozen=True)
class _Plan:
    """All that chance decides, drawn before the first strip."""

    complexion: Complexion
    marks: Marks
    hair: HairCharts
    make_up: MakeUp | None
    lines: tuple[Line, ...]


def make_skin(complexion: Complexion, face: Face, rng: np.random.Generator) -> Skin:
    """Paint one person's skin, strip by strip.

    Args:
        complexion: its colours and strengths.
        face: our own tile (`face_of`) or any head's texture (`face_from`); its seed is the noise.
        rng: where spots, hairs and lines are. The same draws whatever the texture's size.

    Returns:
        The maps.
    """
    c = complexion
    plan = _Plan(
        c,
        person_marks(c, rng),
        draw_hair(rng, c.brow, face.texel_mm, c.lashes),
        random_make_up(c, rng) if c.look == "make-up" else None,
        person_lines(rng),
    )
    shape = (face.rows, face.columns)
    albedo = np.empty((*shape, 3), np.float32)
    specular, roughness, through, relief = (np.empty(shape, np.float32) for _ in range(4))
    bare = np.empty(shape, bool)
    stretch = np.empty(shape, np.float32) if c.look == "anisotropic" else None
    resting = crease_chart(plan.lines, crease_depths(c.age, None), face.texel_mm)
    for patch in face.strips():
        part = patch.rows
        creases = crease_height(patch, resting)
        albedo[part], specular[part], roughness[part], relief[part], bare[part] = _paint(
            patch, plan, creases
        )
        through[part] = skin_translucency(patch) * (1 - 0.9 * patch.mask("eyes"))
        if stretch is not None:
            stretch[part] = facet_stretch(patch)
    if face.covered is not None:
        bare &= face.covered
    return Skin(
        albedo,
        specular,
        roughness,
        through,
        relief,
        bare,
        stretch,
        "ggx" if c.look == "ggx" else "beckmann",
        plan.lines,
        c.age,
        face,
    )


def _paint(
    patch: Patch, plan: _Plan, creases_mm: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Albedo, specular, roughness, relief and bare skin of one strip."""
    c = plan.complexion
    eyes = patch.mask("eyes")
    relief = skin_relief(patch, c.pores, c.age)
    hollow = relief + 0.35 * creases_mm
    albedo = skin_colour(patch, c, plan.marks, hollow)
    specular, roughness = skin_specular(patch, c, hollow), skin_roughness(patch, c)
    apply_look(c.look, patch, albedo, specular, roughness)
    if plan.make_up is not None:
        put_on(plan.make_up, patch, albedo, specular, roughness)
    brow, lash = brow_share(patch, plan.hair), lash_share(patch, plan.hair)
    beard = stubble_share(patch, c.stubble)
    scalp, strands = scalp_share(patch, c.recession_mm, c.hair_cover)
    tone = np.array(c.brow_hair, np.float32)
    for share, colour in ((beard, tone), (brow, tone), (lash, 0.55 * tone)):
        albedo += share[..., None] * (colour - albedo)
    shaded = np.array(c.hair, np.float32) * (1 + 0.6 * strands)[..., None]
    albedo += scalp[..., None] * (shaded - albedo)
    hair = np.maximum(np.maximum(brow, scalp), lash)
    mouth = patch.mouth_inside()
    albedo += 0.9 * mouth[..., None] * (MOUTH_ALBEDO - albedo)
    paint_eyes(albedo, patch, c.iris, c.age)
    specular *= 1 - 0.45 * np.maximum(hair, 0.5 * beard)
    specular += eyes * (0.026 - specular)
    roughness += 0.05 * np.maximum(scalp, brow)
    roughness = np.clip(roughness, *ROUGHNESS_RANGE)
    roughness += eyes * (EYE_ROUGHNESS - roughness)
    relief = relief + scalp * (0.09 * strands) + 0.05 * brow + 0.03 * beard
    free = (patch.mask("skin") + patch.mask("lips") > 0.5) & (np.maximum(hair, beard) < 0.3)
    free &= mouth < 0.3
    return (
        np.clip(albedo, 0.004, 0.95),
        np.clip(specular, *SPECULAR_RANGE),
        roughness,
        relief.astype(np.float32),
        free,
    )


__all__ = [
    "Complexion",
    "Skin",
    "face_from",
    "face_of",
    "make_skin",
    "random_complexion",
]
