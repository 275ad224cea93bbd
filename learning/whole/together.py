"""Skin and light solved together: a texture is explained by a person's tone and its lamps at once.

Solved in turns, skin and light hardly move along the valley in which a darker skin under a brighter
light looks the same. What distinguishes them is small: a highlight has the light's own strength and
colour, and people's skin differs in few directions. A Gauss-Newton step sees both at once.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from learning.gauss_newton import descended
from learning.networks.whole_face import DARKEST
from learning.whole.light import DARK

ROUNDS = 3
"""So often it is measured anew how far texels are off."""
STEPS = 30
SETTLED = 1e-3
"""A step that moves no unknown by as much is the last."""
LEAST_DAMPING = 1e-6
TOGETHER = 150.0
"""Number of neighbouring texels whose errors are treated as one, since unmodelled effects are
smooth. With 40 instead, people outside the training set come out too light where their normals are
off; with 150 the people of the training set hardly lose."""
TINT = 0.3
"""Standard deviation of the logarithm of a lamp's red, green and blue beside its mean."""
STRENGTH = 3.0
"""The same of a lamp's strength, beside that from which the search begins."""
GLOSS = 0.15
"""The same of a person's gloss: skin's F0 is known, its water and oil are not."""
LEAST_SPREAD = 0.03
"""Standard deviation of the misfit's natural logarithm, at least."""
FAR = 2.0
"""So many standard deviations off, a texel has half its weight."""
FAINTEST = 1e-4
"""Strength of a lamp, of the brightest one's, below which it is none."""


@dataclasses.dataclass(frozen=True)
class KnownSkin:
    """Among which skins the answer is sought, for n texels and K directions.

    Attributes:
        mean: (n, 3) natural logarithm of the mean person's diffuse albedo.
        modes: (n, 3, K) directions in which people differ, each one standard deviation long.
        answer: (K,) the network's, in standard deviations.
        doubt: (K, K) mean square of the network's error along them.
        specular: (n,) specular albedo.
    """

    mean: np.ndarray
    modes: np.ndarray
    answer: np.ndarray
    doubt: np.ndarray
    specular: np.ndarray

    def albedo(self, along: np.ndarray) -> np.ndarray:
        """(n, 3) linear diffuse albedo of the skin that is (K,) along the directions."""
        return np.exp(np.clip(self.mean + self.modes @ along, -7.0, 0.0))


@dataclasses.dataclass(frozen=True)
class Explained:
    """A texture's skin and light.

    Attributes:
        along: (K,) of the skin, in standard deviations of people.
        rgb: (L, 3) of the lamps.
        gloss: factor on the specular albedo.
        cost: what the squared errors and the distance from what was known before add up to.
    """

    along: np.ndarray
    rgb: np.ndarray
    gloss: float
    cost: float = math.inf


def explain(
    texture: np.ndarray,
    weight: np.ndarray,
    irradiance: np.ndarray,
    lobe: np.ndarray,
    skin: KnownSkin,
    begin: Explained,
) -> Explained:
    """Find the skin and the lamps' colours that give a texture, by damped Gauss-Newton steps.

    The squared error of the texture's logarithm, with less weight for dark texels and for those far
    off, is added to what is known before: the network's answer, lamps that are nearly white, a
    gloss that is nearly the mean person's.

    Args:
        texture: (n, 3) linear.
        weight: (n,) how much each texel counts, 0 or more.
        irradiance: (n, L) that each lamp of strength 1 gives, light from everywhere among them.
        lobe: (n, L) that each gives a surface of specular albedo 1.
        skin: among which skins.
        begin: where to begin; lamps of strength 0 stay so.

    Returns:
        The answer; `begin` itself where no texel counts.
    """
    used = (weight > 0) & (irradiance.sum(axis=1) > 0)
    if not used.any():
        return begin
    problem = _Problem(
        np.maximum(texture[used], DARKEST),
        weight[used],
        irradiance[used],
        lobe[used],
        dataclasses.replace(
            skin, mean=skin.mean[used], modes=skin.modes[used], specular=skin.specular[used]
        ),
        begin,
    )
    values = problem.start()
    for _ in range(ROUNDS):
        problem.set_outlier_scale(values)
        values, cost, _ = problem.descended(values)
    return problem.answer(values, cost)


class _Problem:
    """The unknowns are the skin's place, the logarithms of the lamps' colours, and of the gloss."""

    def __init__(
        self,
        texture: np.ndarray,
        weight: np.ndarray,
        irradiance: np.ndarray,
        lobe: np.ndarray,
        skin: KnownSkin,
        begin: Explained,
    ) -> None:
        self._known = np.log(texture)
        self._trust = weight[:, None] * (texture / (texture + DARK)) ** 2
        self._irradiance, self._lobe, self._skin, self._begin = irradiance, lobe, skin, begin
        brightest = max(float(begin.rgb.max(initial=0.0)), 1e-6)
        self._strength = np.log(np.maximum(begin.rgb, FAINTEST * brightest))
        self._certain = np.linalg.inv(skin.doubt)
        self._far = FAR * LEAST_SPREAD

    def start(self) -> np.ndarray:
        """The unknowns to begin with."""
        gloss = np.log(self._begin.gloss)
        return np.concatenate([self._begin.along, self._strength.ravel(), [gloss]])

    def answer(self, values: np.ndarray, cost: float) -> Explained:
        """The skin and lamps of (u,) values of the unknowns."""
        along, strength, gloss = self._parts(values)
        faint = self._begin.rgb <= 0
        rgb = np.where(faint, 0.0, np.exp(strength))
        return Explained(along, rgb, float(np.exp(gloss)), cost)

    def set_outlier_scale(self, values: np.ndarray) -> None:
        """Measure from where on a texel counts as far off."""
        along, strength, gloss = self._parts(values)
        rgb = np.exp(strength)
        made = self._skin.albedo(along) * (self._irradiance @ rgb)
        made += np.exp(gloss) * self._skin.specular[:, None] * (self._lobe @ rgb)
        counts, square = self._squares(self._known - np.log(np.maximum(made, DARKEST)))
        some = np.sqrt(square[counts > 0])
        spread = 1.4826 * float(np.median(some)) if some.size else 0.0
        self._far = FAR * max(spread, LEAST_SPREAD)

    def _squares(self, off: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n,) how much each texel counts, and how far it is off, squared."""
        counts = self._trust.sum(axis=1)
        return counts, (self._trust * off**2).sum(axis=1) / np.maximum(counts, 1e-12)

    def descended(self, values: np.ndarray) -> tuple[np.ndarray, float, np.ndarray]:
        """Values of the unknowns of less cost, and their cost and normal matrix."""
        return descended(
            values,
            self.equations,
            lambda here, step: here + np.clip(step, -1.0, 1.0),
            STEPS,
            least_step=SETTLED,
            least_damping=LEAST_DAMPING,
        )

    def equations(self, values: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """Cost, normal matrix and half the gradient at values of the unknowns."""
        along, strength, gloss = self._parts(values)
        modes, count, lamps = self._skin.modes, len(along), len(strength)
        rgb = np.exp(strength)
        albedo = self._skin.albedo(along)
        shine = np.exp(gloss) * self._skin.specular[:, None] * self._lobe
        matt, mirrored = albedo * (self._irradiance @ rgb), shine @ rgb
        made = np.maximum(matt + mirrored, FAINTEST * DARKEST)
        off = self._known - np.log(np.maximum(made, DARKEST))
        counts, square = self._squares(off)
        # Cauchy's cost, and the weights that its slope has.
        scale = (FAR / self._far) ** 2 / TOGETHER
        ratio = square / self._far**2
        cost = scale * self._far**2 * float((counts * np.log1p(ratio)).sum())
        trust = self._trust * (scale / (1 + ratio))[:, None]

        size = count + 3 * lamps + 1
        normal, slope = np.zeros((size, size)), np.zeros(size)
        columns = np.zeros((len(off), size))
        for c in range(3):
            columns[:] = 0.0
            columns[:, :count] = modes[:, c] * (matt[:, c] / made[:, c])[:, None]
            each = albedo[:, c, None] * self._irradiance + shine
            here = slice(count + c, count + 3 * lamps, 3)
            columns[:, here] = each * rgb[:, c] / made[:, c, None]
            columns[:, -1] = mirrored[:, c] / made[:, c]
            weighted = columns * trust[:, c, None]
            normal += weighted.T @ columns
            slope -= weighted.T @ off[:, c]
        return self._with_known(values, cost, normal, slope)

    def _with_known(
        self, values: np.ndarray, cost: float, normal: np.ndarray, slope: np.ndarray
    ) -> tuple[float, np.ndarray, np.ndarray]:
        """The same with what is known before."""
        along, strength, gloss = self._parts(values)
        count, lamps = len(along), len(strength)
        beside = along - self._skin.answer
        cost += float(beside @ self._certain @ beside) + (gloss / GLOSS) ** 2
        normal[:count, :count] += self._certain
        slope[:count] += self._certain @ beside
        normal[-1, -1] += 1 / GLOSS**2
        slope[-1] += gloss / GLOSS**2
        # Of each lamp: how far its channels are from their mean, and that from where it began.
        grey = np.full((3, 3), 1 / 3)
        metric = (np.eye(3) - grey) / TINT**2 + grey / STRENGTH**2
        for index in range(lamps):
            moved = strength[index] - self._strength[index].mean()
            here = slice(count + 3 * index, count + 3 * index + 3)
            cost += float(moved @ metric @ moved)
            normal[here, here] += metric
            slope[here] += metric @ moved
        return cost, normal, slope

    def _parts(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        count = len(self._begin.along)
        return values[:count], values[count:-1].reshape(-1, 3), float(values[-1])
