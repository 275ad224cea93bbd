"""Procedural skin in the head's UV tile: colour, gloss, pores and wrinkles of one person.

All patterns live on the surface of the neutral head in mm, so they stay on the face when it moves
and are round where the UV is stretched. Colour is mixed in optical density: melanin and blood
absorb, each with its own colour, as in the two-layer pictures of skin ([Donner2006]).
"""

from __future__ import annotations

import dataclasses

import numpy as np

from sim.head_grid import smoothstep
from sim.skin_masks import Face, add_eyes, brow_share, face_of, hair_share, lash_share

# Linear albedo of the lightest skin, and optical density (natural log) of one unit of pigment.
LIGHT_ALBEDO = np.array([0.58, 0.40, 0.30])
MELANIN_DENSITY = np.array([1.50, 1.80, 2.02])
BLOOD_DENSITY = np.array([0.13, 0.62, 0.50])
MOUTH_ALBEDO = np.array([0.05, 0.02, 0.018], np.float32)


@dataclasses.dataclass(frozen=True)
class Complexion:
    """What makes one person's skin.

    Attributes:
        melanin: 0 the lightest to 1 the darkest.
        yellowness: shift of hue, about -1 to 1.
        blood: strength of cheeks, nose and lips, about 1.
        stubble: 0 none to 1 a shadow of a beard.
        freckles: 0 none to 1 many.
        pores: strength of the relief, about 1.
        age: 0 smooth to 1 lined.
        hair: linear albedo of brows and hair.
        iris: linear albedo.
        moles: how many.
    """

    melanin: float
    yellowness: float
    blood: float
    stubble: float
    freckles: float
    pores: float
    age: float
    hair: tuple[float, float, float]
    iris: tuple[float, float, float]
    moles: int


@dataclasses.dataclass(frozen=True)
class Skin:
    """Maps in UV, (rows, columns) float32 each.

    Attributes:
        diffuse_albedo: (rows, columns, 3) linear.
        specular_albedo: reflectance at normal incidence.
        roughness: Beckmann m.
        translucency: 0..1.
        height_mm: relief over the mesh.
        skin: bool, face skin or lips, no brows.
    """

    diffuse_albedo: np.ndarray
    specular_albedo: np.ndarray
    roughness: np.ndarray
    translucency: np.ndarray
    height_mm: np.ndarray
    skin: np.ndarray


def random_complexion(rng: np.random.Generator) -> Complexion:
    """Draw a person's colours: all tones from light to dark, hair and eyes that go with them."""
    melanin = float(rng.beta(1.1, 1.3))
    fair = max(0.0, 1.0 - 2.2 * melanin)
    hair_light = fair * rng.uniform() ** 1.5
    hair = np.array([0.022, 0.016, 0.013]) * (1 - hair_light) + hair_light * np.array(
        [0.20, 0.13, 0.07]
    )
    blue = fair * rng.uniform()
    iris = np.array([0.09, 0.045, 0.022]) * (1 - blue) + blue * np.array([0.14, 0.20, 0.24])
    bearded = rng.uniform() < 0.5
    return Complexion(
        melanin=melanin,
        yellowness=float(rng.normal(0, 0.5)),
        blood=float(rng.uniform(0.7, 1.3)),
        stubble=float(bearded * rng.uniform(0.3, 1.0)),
        freckles=float((rng.uniform() < 0.35) * fair * rng.uniform(0.3, 1.0)),
        pores=float(rng.uniform(0.7, 1.3)),
        age=float(rng.uniform() ** 1.3),
        hair=(float(hair[0]), float(hair[1]), float(hair[2])),
        iris=(float(iris[0]), float(iris[1]), float(iris[2])),
        moles=int(rng.integers(2, 9)),
    )


def make_skin(complexion: Complexion, rows: int, rng: np.random.Generator) -> Skin:
    """Paint one person's skin.

    Args:
        complexion: its colours and strengths.
        rows: of the tile; columns are two thirds of it.
        rng: where spots and noise lie.

    Returns:
        The maps. Albedos lie in 0..1, normal skin between the lightest and the darkest tone.
    """
    face = face_of(rows, rows * 2 // 3, int(rng.integers(2**20)))
    brow = brow_share(face)
    hair = hair_share(face)
    pore, crease = _pores(face, complexion), _creases(face, complexion)
    height = (pore + crease) * (1 - face.eyes)
    albedo = _pigments(face, complexion, rng) * (1 + 1.2 * np.minimum(height, 0))[..., None]
    dark = np.array(complexion.hair, np.float32)
    albedo += (brow + hair - brow * hair)[..., None] * (dark - albedo)
    lash = lash_share(face)
    albedo += 0.85 * lash[..., None] * (np.float32(0.6) * dark - albedo)
    albedo += 0.9 * face.mouth_inside[..., None] * (MOUTH_ALBEDO - albedo)
    add_eyes(albedo, face, complexion.iris)
    gloss = _gloss(face, height)
    specular = gloss * (1 - 0.35 * np.maximum(brow, hair))
    specular += face.eyes * (0.026 - specular)
    roughness = 0.31 - 0.055 * face.oily - 0.05 * face.lips + 0.012 * face.noise(3.0, 2, 40)
    roughness = np.clip(roughness, 0.2, 0.35)
    roughness += face.eyes * (0.2 - roughness)
    through = 0.6 + 0.35 * face.ears + 0.2 * face.lips + 0.2 * face.nose
    through = through * (1 - 0.9 * face.eyes) * (1 - 0.5 * hair)
    bare = (face.skin + face.lips > 0.5) & (brow < 0.25) & (hair < 0.25) & (lash < 0.3)
    bare &= face.mouth_inside < 0.3
    return Skin(
        np.clip(albedo, 0.004, 0.95).astype(np.float32),
        np.clip(specular, 0.012, 0.05).astype(np.float32),
        roughness.astype(np.float32),
        np.clip(through, 0, 1).astype(np.float32),
        height.astype(np.float32),
        bare,
    )


def _pigments(face: Face, c: Complexion, rng: np.random.Generator) -> np.ndarray:
    """(rows, columns, 3) albedo of bare skin and lips."""
    melanin = c.melanin + (0.02 + 0.05 * c.melanin) * face.noise(45.0, 2, 1)
    melanin += 0.014 * face.noise(7.0, 3, 2) + 0.008 * face.noise(1.6, 2, 3)
    melanin += 0.05 * face.below_eyes - 0.02 * face.cheeks + 0.03 * face.forehead
    spots, label = face.cells(3.2, 4)
    freckle = smoothstep(1.5, 0.5, spots / (0.35 + 0.9 * label)) * (label < 0.55)
    melanin += 0.22 * c.freckles * freckle * face.freckled
    for _ in range(c.moles):
        melanin += face.spot(rng, 0.7, 1.9) * rng.uniform(0.25, 0.7)
    blood = 0.10 + 0.30 * face.cheeks + 0.30 * face.nose + 0.28 * face.ears + 0.14 * face.chin
    blood += 0.2 * face.lid_rims + 0.12 * face.below_eyes
    blood *= 1 + 0.18 * face.noise(9.0, 3, 5)
    blood += 0.03 * face.noise(2.2, 2, 6) + 0.05 * face.noise(30.0, 2, 7)
    for _ in range(c.moles):
        blood += face.spot(rng, 1.0, 2.6) * rng.uniform(0.1, 0.5)
    blood = np.maximum(blood, 0) * (1 - face.lips) + face.lips * (0.66 + 0.08 * face.noise(3, 2, 8))
    melanin += 0.10 * face.lips * (0.4 + c.melanin)
    density = melanin[..., None] * MELANIN_DENSITY.astype(np.float32)
    density += (c.blood * blood)[..., None] * BLOOD_DENSITY.astype(np.float32)
    density += c.yellowness * np.array([-0.02, 0.0, 0.09], np.float32)
    hairs, _ = face.cells(1.1, 9)
    beard = c.stubble * face.beard * (0.35 + 0.65 * smoothstep(0.55, 0.2, hairs))
    density += beard[..., None] * np.array([0.42, 0.40, 0.33], np.float32)
    return np.asarray(LIGHT_ALBEDO.astype(np.float32) * np.exp(-density))


def _pores(face: Face, c: Complexion) -> np.ndarray:
    """Relief of pores and the fine net between them, mm."""
    distance, label = face.cells(1.15, 20)
    width = 0.22 + 0.12 * label
    pit = -np.exp(-0.5 * (distance / width) ** 2) * (0.35 + 0.65 * label)
    coarse = 0.030 + 0.035 * face.nose + 0.022 * face.cheeks + 0.01 * face.forehead
    net = 0.010 * face.noise(0.9, 2, 21) + 0.008 * face.noise(2.4, 2, 22)
    return np.asarray(c.pores * (coarse * pit + net) * (1 - 0.75 * face.lips))


def _creases(face: Face, c: Complexion) -> np.ndarray:
    """Relief of lines: forehead, corners of the eyes, lips; mm."""
    wavy = face.position[..., 1] + 2.2 * face.noise(28.0, 2, 23)
    lines = -np.exp(-0.5 * ((np.mod(wavy, 9.5) - 4.75) / 0.8) ** 2)
    forehead = 0.22 * c.age * lines * face.forehead * (0.6 + 0.4 * face.noise(20.0, 1, 24))
    fan = np.sin(face.eye_angle * 17 + 1.5 * face.noise(9.0, 1, 25))
    crow = -0.10 * c.age * face.crow * smoothstep(0.2, 1.0, fan)
    grain = face.noise_of(face.position * np.array([1.0, 0.18, 0.18], np.float32), 1.5, 2, 26)
    lips = -0.05 * face.lips * np.maximum(grain, 0)
    return np.asarray(forehead + crow + lips + 0.03 * face.noise(5.0, 2, 27) * (1 - face.lips))


def _gloss(face: Face, height: np.ndarray) -> np.ndarray:
    """Specular albedo of skin: more on nose and forehead, less in pores and below the eyes."""
    region = 0.024 + 0.008 * face.oily + 0.006 * face.lips - 0.004 * face.below_eyes
    variation = 1 + 0.07 * face.noise(10.0, 3, 30) + 0.05 * face.noise(1.8, 2, 31)
    return np.asarray(region * variation * (1 + 4.5 * np.clip(height, -0.1, 0.03)))
