"""Make-up: colours that follow neither melanin nor blood."""

from __future__ import annotations

import dataclasses

import numpy as np

from sim.head.grid import ROW_LID_UP, smoothstep
from sim.skin.complexion import Complexion
from sim.skin.hair import eye_place
from sim.skin.parts import Patch
from sim.skin.pigments import skin_rgb

_LIPSTICKS = ((0.34, 0.022, 0.030), (0.42, 0.085, 0.10), (0.20, 0.018, 0.045), (0.40, 0.14, 0.11))
_SHADOWS = ((0.10, 0.055, 0.035), (0.13, 0.11, 0.20), (0.28, 0.16, 0.12), (0.05, 0.075, 0.09))
_BLUSH = (0.55, 0.17, 0.18)


@dataclasses.dataclass(frozen=True)
class MakeUp:
    """What a person has put on; colours are linear albedos, shares 0..1.

    Attributes:
        foundation: an even skin colour.
        lipstick: of the lips.
        shadow: of the upper lids.
        cover: share of the foundation.
        blush: share on the cheeks.
        liner: share along the upper lashes.
    """

    foundation: tuple[float, float, float]
    lipstick: tuple[float, float, float]
    shadow: tuple[float, float, float]
    cover: float
    blush: float
    liner: float


def random_make_up(c: Complexion, rng: np.random.Generator) -> MakeUp:
    """Draw make-up whose foundation is near the person's own tone, a little more yellow."""
    tone = skin_rgb(0.92 * c.melanin, 1.25 * c.blood, c.eumelanin) * (1.03, 1.01, 0.95)
    return MakeUp(
        foundation=(float(tone[0]), float(tone[1]), float(tone[2])),
        lipstick=_LIPSTICKS[int(rng.integers(len(_LIPSTICKS)))],
        shadow=_SHADOWS[int(rng.integers(len(_SHADOWS)))],
        cover=float(rng.uniform(0.45, 0.7)),
        blush=float(rng.uniform(0.12, 0.28)),
        liner=float(rng.uniform(0.5, 0.85)),
    )


def put_on(
    m: MakeUp, patch: Patch, albedo: np.ndarray, specular: np.ndarray, roughness: np.ndarray
) -> None:
    """Paint make-up over bare skin, in place on (h, columns[, 3])."""
    lips, eyes = patch.mask("lips"), patch.mask("eyes")
    face = smoothstep(-128, -112, patch.place[..., 1]) * smoothstep(-10, 15, patch.place[..., 2])
    face = face * (1 - lips) * (1 - eyes) * (1 - patch.mask("ears"))
    face = face * (1 + 0.06 * patch.noise(1.0, 2, 91))
    _mix(albedo, m.cover * face, m.foundation)
    specular *= 1 - 0.12 * m.cover * face
    roughness += 0.03 * m.cover * face
    _mix(albedo, m.blush * patch.mask("cheeks") * face, _BLUSH)
    across, row = eye_place(patch)
    above = ROW_LID_UP - row
    lid = smoothstep(1.3, 0.8, np.abs(across)) * smoothstep(-0.3, 0.2, above)
    _mix(albedo, 0.62 * lid * smoothstep(6.5, 1.5, above) * (1 - eyes), m.shadow)
    edge = smoothstep(1.12, 1.0, np.abs(across - 0.05))
    liner = edge * smoothstep(0.1, 0.35, above) * smoothstep(1.1, 0.7, above)
    _mix(albedo, m.liner * liner, (0.012, 0.011, 0.011))
    _mix(albedo, 0.86 * lips, m.lipstick)
    specular *= 1 + 0.25 * lips
    roughness -= 0.03 * lips


def _mix(albedo: np.ndarray, share: np.ndarray, colour: tuple[float, float, float]) -> None:
    albedo += np.clip(share, 0, 1)[..., None].astype(np.float32) * (
        np.array(colour, np.float32) - albedo
    )
