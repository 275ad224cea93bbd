"""How heads differ: anatomical fields, each a smooth displacement of the neutral head in mm.

A field's size is one standard deviation over adults; `Field` has the share of it that sex and age
account for. Sizes are chosen so that measures over many draws have the means and deviations of
adult anthropometry ([Farkas1994], [Dodgson2004]); a test draws them and compares.
"""

from __future__ import annotations

import dataclasses
import functools

import numpy as np

from sim.head.eyes import around_eyes
from sim.head.grid import smoothstep
from sim.head.mesh import grid_vertices, hair_share, neutral_mesh, vertex_normals_of

Triple = tuple[float, float, float]
Term = tuple[Triple, Triple, Triple]
"""Displacement (x away from the middle), centre and spread of a Gaussian window, all in mm."""


@dataclasses.dataclass(frozen=True)
class Field:
    """How a field hangs together with a person's traits.

    Attributes:
        terms: Gaussian windows, mirrored to both sides.
        male: mean of men in standard deviations; women's is its negative.
        age: growth of the mean in standard deviations per 18 years after the age of 45.
        one_sided: the window is not mirrored and the displacement is the same for x < 0.
    """

    terms: tuple[Term, ...] = ()
    male: float = 0.0
    age: float = 0.0
    one_sided: bool = False

    @property
    def rest(self) -> float:
        """What is left to chance, in standard deviations."""
        return float(np.sqrt(max(1.0 - self.male**2 - 0.8 * self.age**2, 0.12)))


LOCAL: dict[str, Field] = {
    # Jaw and chin.
    "jaw_width": Field((((2.1, 0, 0), (53, -80, 18), (22, 26, 32)),), male=0.3),
    "jaw_angle": Field((((0.8, -4.0, -1.5), (52, -82, 12), (16, 16, 26)),), male=0.4),
    "chin_forward": Field((((0, 0, 3.4), (0, -108, 86), (24, 16, 26)),), male=0.25),
    "chin_width": Field((((2.2, 0, -0.6), (19, -110, 78), (11, 12, 18)),), male=0.5),
    "chin_point": Field((((0, -1.2, 1.8), (0, -112, 92), (9, 9, 14)),), male=-0.2),
    "below_lip": Field((((0, 0, -1.4), (0, -90, 92), (15, 6, 16)),), male=0.25),
    "below_chin": Field((((0, -4.0, 0.8), (0, -124, 45), (34, 16, 30)),), age=0.4),
    # Forehead and brow.
    "brow_ridge": Field(
        (((0, -0.6, 2.0), (22, 13, 90), (22, 8, 18)), ((0.4, 0, 1.0), (50, 12, 72), (9, 8, 14))),
        male=0.75,
    ),
    "between_brows": Field((((0, 0, 1.4), (0, 15, 95), (12, 9, 14)),), male=0.5),
    "forehead_slope": Field((((0, 0, -4.0), (0, 62, 76), (50, 24, 40)),), male=0.45),
    "forehead_round": Field((((0, 0, 2.2), (0, 42, 90), (40, 14, 26)),), male=-0.4),
    "temples_hollow": Field((((-2.2, 0, -0.8), (62, 22, 50), (12, 18, 20)),), age=0.4),
    "brow_height": Field((((0, 1.7, 0), (32, 17, 84), (26, 9, 22)),), male=-0.5, age=-0.35),
    "brow_arch": Field((((0, 1.3, 0), (44, 18, 78), (13, 8, 16)),), male=-0.5, age=-0.2),
    # Nose.
    "nose_length": Field((((0, -2.6, 0.8), (0, -44, 102), (22, 15, 26)),), age=0.25),
    "nose_width": Field((((1.7, 0, 0), (13, -46, 96), (9, 10, 16)),), male=0.3),
    "nose_forward": Field((((0, 0, 2.2), (0, -42, 108), (14, 14, 20)),), male=0.2),
    "nose_root": Field((((0, 0, 2.0), (0, -4, 92), (9, 11, 16)),), male=0.35),
    "nose_hump": Field((((0, 0.2, 1.5), (0, -21, 102), (7, 8, 12)),), male=0.35, age=0.2),
    "tip_up": Field((((0, 1.9, 0), (0, -43, 108), (13, 9, 16)),), male=-0.35, age=-0.5),
    "tip_round": Field((((1.2, 0, 0.3), (7, -42, 107), (6, 8, 8)),), male=0.2),
    "bridge_width": Field((((1.0, 0, 0), (8, -16, 94), (7, 15, 14)),), male=0.2),
    "wings_high": Field((((0, 1.2, 0), (13, -49, 96), (6, 6, 12)),)),
    # Mouth.
    "lips_full": Field(
        (
            ((0, 1.0, 0.9), (0, -66, 96), (19, 4.5, 18)),
            ((0, -1.1, 1.0), (0, -82, 94), (18, 5, 18)),
        ),
        male=-0.25,
        age=-0.35,
    ),
    "upper_lip": Field((((0, 0.9, 0.7), (0, -66, 96), (17, 4, 16)),), age=-0.25),
    "philtrum": Field((((0, -1.6, 0), (0, -72, 92), (32, 9, 24)),), male=0.2, age=0.35),
    "mouth_width": Field((((1.9, 0, -0.6), (26, -74, 84), (14, 13, 22)),), male=0.35, age=0.1),
    "mouth_forward": Field((((0, 0, 2.4), (0, -74, 92), (28, 18, 30)),)),
    "lower_lip_forward": Field((((0, 0, 1.5), (0, -80, 94), (22, 7, 20)),)),
    "corners_up": Field((((0, 1.0, 0), (25, -74, 82), (9, 8, 14)),), age=-0.5),
    # Eyes.
    "eye_spacing": Field((((1.8, 0, 0), (31, -8, 76), (17, 15, 22)),), male=0.05),
    "eye_depth": Field((((0, 0, -1.7), (31, -6, 76), (18, 14, 22)),), male=0.35, age=0.3),
    "lid_fold": Field((((0, -1.7, 1.6), (34, 2.0, 80), (13, 4.5, 16)),), age=0.5),
    "bags": Field((((0, -0.5, 1.7), (30, -20, 80), (11, 4.0, 16)),), age=0.7),
    "tear_trough": Field((((0, 0, -1.6), (21, -23, 82), (7, 6, 14)),), age=0.6),
    # Cheeks.
    "cheekbones": Field((((2.6, 0, 1.4), (60, -24, 46), (18, 14, 26)),)),
    "cheekbones_high": Field((((0.4, 2.6, 0.6), (52, -26, 60), (18, 14, 24)),), age=-0.3),
    "apples": Field((((0.4, 0.5, 2.0), (36, -38, 78), (13, 11, 20)),), male=-0.4, age=-0.5),
    "cheeks_hollow": Field((((-2.8, 0, -1.0), (52, -58, 50), (12, 15, 24)),), age=0.45),
    "nose_mouth_fold": Field(
        (
            ((0.6, 0, -1.7), (27, -57, 88), (3.8, 11, 14)),
            ((0, -0.9, 1.6), (36, -54, 80), (7, 12, 14)),
        ),
        male=0.1,
        age=0.8,
    ),
    "jowls": Field(
        (
            ((2.2, -2.8, 0.8), (43, -92, 42), (13, 14, 18)),
            ((-0.5, 0, -1.0), (25, -97, 72), (8, 10, 14)),
        ),
        age=0.8,
    ),
    "mouth_chin_fold": Field((((0, 0, -1.2), (27, -87, 82), (4.5, 9, 14)),), age=0.75),
    "weight": Field(
        (
            ((3.6, 0, 2.2), (48, -60, 54), (18, 24, 28)),
            ((2.0, -1.5, 1.0), (44, -96, 34), (20, 18, 30)),
            ((0, -6.0, 3.0), (0, -126, 45), (36, 18, 34)),
            ((3.4, 0, 0), (48, -130, -10), (22, 34, 50)),
        ),
        age=0.25,
    ),
    # Ears.
    "ears_out": Field((((2.6, 0, 0), (86, -12, -20), (14, 26, 16)),), male=0.1),
    "ears_long": Field(
        (
            ((0, -2.4, 0), (76, -42, -8), (14, 12, 16)),
            ((0, 2.0, 0), (82, 12, -14), (14, 12, 16)),
        ),
        male=0.45,
        age=0.55,
    ),
    "ears_wide": Field((((0, 0, -1.8), (84, -10, -28), (14, 26, 10)),), male=0.35),
    # Neck.
    "larynx": Field((((0, 0, 3.0), (0, -146, 32), (9, 9, 16)),), male=0.8),
    "neck_cords": Field((((0.4, 0, 2.4), (17, -145, 26), (5, 28, 14)),), age=0.7),
    # No face is the same on both sides.
    "nose_aside": Field((((0.9, 0, 0), (0, -34, 102), (16, 18, 20)),), one_sided=True),
    "chin_aside": Field((((1.2, 0, 0), (0, -104, 70), (34, 26, 40)),), one_sided=True),
    "right_brow_up": Field((((0, 0.8, 0), (-34, 15, 82), (16, 10, 20)),), one_sided=True),
    "left_corner_up": Field((((0, 0.7, 0), (26, -74, 84), (14, 12, 20)),), one_sided=True),
    "right_jaw_out": Field((((-1.4, 0, 0), (-54, -76, 20), (26, 28, 36)),), one_sided=True),
    "left_eye_down": Field((((0, -0.6, 0), (31, -8, 76), (16, 14, 20)),), one_sided=True),
}

BROAD: dict[str, Field] = {
    "size": Field(male=0.75),
    "head_width": Field(),
    "head_length": Field(),
    "crown_height": Field(),
    "face_width": Field(male=0.15),
    "face_height": Field(male=0.35),
    "chin_height": Field(male=0.8),
    "eye_opening": Field(male=-0.2, age=-0.3),
    "eye_width": Field(),
    "eye_tilt": Field(male=-0.2, age=-0.3),
    "neck_width": Field(male=0.8),
    "hair_volume": Field(age=-0.3),
}


def window(points: np.ndarray, centre: Triple, spread: Triple) -> np.ndarray:
    """Gaussian of height 1 about a place: (n, 3) mm to (n,)."""
    return np.asarray(np.exp(-0.5 * (((points - centre) / np.array(spread)) ** 2).sum(axis=-1)))


def paired(points: np.ndarray, *terms: Term) -> np.ndarray:
    """(n, 3) mm, the sum of mirrored windows, smooth across the middle."""
    folded = points.copy()
    folded[:, 0] = np.abs(folded[:, 0])
    total = np.zeros_like(points)
    for move, centre, spread in terms:
        out = window(folded, centre, spread)[:, None] * np.array(move)
        out[:, 0] *= points[:, 0] / np.sqrt(points[:, 0] ** 2 + 36.0)
        total += out
    return total


def _broad(p: np.ndarray) -> dict[str, np.ndarray]:
    x, y, z = p.T
    zero = np.zeros_like(x)
    eye = window(np.abs(p) * (1, 0, 1) + p * (0, 1, 0), (31.5, -8, 76), (15, 11, 20))
    neck = smoothstep(-95, -135, y)
    face = smoothstep(45, 5, y) * smoothstep(-30, 20, z)
    cranial = smoothstep(-60, 10, y) * (1 - 0.5 * face)
    fields = {
        "size": 0.026 * (p + np.array([0.0, 12.0, 10.0])),
        "head_width": np.stack([0.026 * x * cranial, zero, zero], axis=1),
        "head_length": np.stack([zero, zero, 0.032 * np.minimum(z, 0) * cranial], axis=1),
        "crown_height": np.stack([zero, 4.5 * smoothstep(25, 112, y), zero], axis=1),
        "face_width": np.stack([0.030 * x * face, zero, zero], axis=1),
        "face_height": np.stack([zero, 0.030 * np.clip(y, -119, 0), zero], axis=1),
        "chin_height": np.stack([zero, -3.5 * smoothstep(-84, -118, y), zero], axis=1),
        "eye_opening": np.stack([zero, 0.09 * eye * (y + 9), zero], axis=1),
        "eye_width": np.stack(
            [0.045 * eye * (np.abs(x) - 30) * np.sign(x), zero, -0.02 * eye * (np.abs(x) - 30)],
            axis=1,
        ),
        "eye_tilt": np.stack([zero, 0.06 * eye * (np.abs(x) - 30), zero], axis=1),
        "neck_width": np.stack([0.065 * neck * x, zero, 0.06 * neck * (z + 30)], axis=1),
        "hair_volume": 1.6 * hair_share()[:, None] * vertex_normals_of(),
    }
    if fields.keys() != BROAD.keys():
        raise KeyError("broad fields and their traits differ")
    return fields


@functools.cache
def identity_fields() -> tuple[tuple[str, ...], np.ndarray]:
    """Names and (k, n, 3) displacements in mm, each of one standard deviation, independent."""
    points = neutral_mesh().vertices
    fields = _broad(points)
    for name, field in LOCAL.items():
        if field.one_sided:
            move, centre, spread = field.terms[0]
            fields[name] = window(points, centre, spread)[:, None] * np.array(move)
        else:
            fields[name] = paired(points, *field.terms)
    stacked = np.stack([leave_eyes_round(f, rigid=True) for f in fields.values()])
    stacked.flags.writeable = False
    return tuple(fields), stacked


def leave_eyes_round(displacement: np.ndarray, *, rigid: bool) -> np.ndarray:
    """`around_eyes` for a displacement by vertex, (n, 3) mm."""
    index = grid_vertices()
    out = np.empty_like(displacement)
    out[index] = around_eyes(displacement[index], rigid=rigid)
    return out
