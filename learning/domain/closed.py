"""A domain's light from its skin, in closed form for lamps that stand still.

Every texture has the same lamps. Under a known skin all textures together are linear in the lamps'
colours, which non-negative least squares finds; a skin is known as one of those that people have,
a few numbers a person beside the mean person's albedo, which a Gauss-Newton step finds under known
lamps. In turns; where lamps stand is searched.
"""

from __future__ import annotations

import dataclasses
import time

import numpy as np

from learning.domain.sample import Sample
from learning.maps import SHININESS
from learning.networks.whole_face import WholeFaceNetwork
from learning.whole.light import Light, LightFit, LitSurface
from learning.whole.refine import known_skin
from learning.whole.together import Explained, KnownSkin, explain
from lightstage.commands import ProgressCallback, quiet


class LitSurfaces:
    """Several heads' texels, one after the other, as one surface."""

    def __init__(self, samples: list[Sample], camera_mm: np.ndarray) -> None:
        """Heads in the head frame, and the (3,) mm from where their highlights are seen."""
        self._parts = [LitSurface(s.mesh, s.raster, camera_mm) for s in samples]
        self._ends = np.cumsum([int(s.raster.covered.sum()) for s in samples])

    def split(self, values: np.ndarray, axis: int = 0) -> list[np.ndarray]:
        """Values of all n texels, which are along `axis`, head by head."""
        return np.split(values, self._ends[:-1], axis=axis)

    def seen(self, lamps_mm: np.ndarray) -> np.ndarray:
        """(L, n) share of each of (L, 3) lamps that each texel of all heads sees."""
        return np.concatenate([part.seen(lamps_mm) for part in self._parts], axis=1)

    def under(
        self,
        lamps_mm: np.ndarray,
        shininess: float = SHININESS,
        seen: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """(n, L) irradiance and (n, L) lobe, for (L, 3) lamps; `seen` is (L, n) of `seen`."""
        known = [None] * len(self._parts) if seen is None else self.split(seen, 1)
        each = [
            part.under(lamps_mm, shininess, own)
            for part, own in zip(self._parts, known, strict=True)
        ]
        irradiance, lobe = (np.concatenate(values) for values in zip(*each, strict=True))
        return irradiance, lobe

    def openness(self, dome: np.ndarray | None = None) -> np.ndarray:
        """(n,) share of even light of each texel; `dome` is (L, n) of `seen` for `DOME_MM`."""
        own = [None] * len(self._parts) if dome is None else self.split(dome, 1)
        return np.concatenate([p.openness(o) for p, o in zip(self._parts, own, strict=True)])


@dataclasses.dataclass(frozen=True)
class Found:
    """A light, and the skins under it.

    Attributes:
        light: in the head frame.
        albedo: of each head, (n, 3).
    """

    light: Light
    albedo: list[np.ndarray]


def find_light(
    samples: list[Sample],
    network: WholeFaceNetwork,
    camera_mm: np.ndarray,
    seconds: float,
    rounds: int,
    progress: ProgressCallback = quiet,
) -> Found:
    """Find the lamps that all textures have in common.

    Args:
        samples: of one domain.
        network: keeps the mean person and the modes.
        camera_mm: (3,) from where highlights are seen, head frame.
        seconds: at most.
        rounds: of light and skin, at most.
        progress: called with rounds done and their number.
    """
    until = time.monotonic() + seconds
    surface = LitSurfaces(samples, camera_mm)
    skins = [known_skin(network, s.answer, s.raster.covered, s.weight) for s in samples]
    texture = np.concatenate([s.colours for s in samples])
    fit = LightFit(surface, texture, np.concatenate([s.weight for s in samples]))
    known = [Explained(s.answer, np.zeros((0, 3)), 1.0) for s in skins]
    light: Light | None = None
    for done in range(rounds):
        albedo = np.concatenate(_albedos(skins, known))
        shine = [e.gloss * s.specular for s, e in zip(skins, known, strict=True)]
        light = fit.find(albedo, np.concatenate(shine), light, until)
        columns = [surface.split(values) for values in fit.columns(light.lamps_mm)]
        known = [
            explain(
                s.colours, s.weight, irradiance, lobe, skin, dataclasses.replace(e, rgb=light.rgb)
            )
            for s, skin, e, irradiance, lobe in zip(samples, skins, known, *columns, strict=True)
        ]
        light = dataclasses.replace(light, rgb=_mean(known, light.rgb))
        progress(done + 1, rounds)
        if time.monotonic() > until:
            break
    assert light is not None  # there is one round at least
    return Found(light, _albedos(skins, known))


def _albedos(skins: list[KnownSkin], known: list[Explained]) -> list[np.ndarray]:
    return [skin.albedo(e.along) for skin, e in zip(skins, known, strict=True)]


def _mean(known: list[Explained], before: np.ndarray) -> np.ndarray:
    """(L + 1, 3) colours on which the textures agree: the median of each one's logarithm."""
    logs = np.log(np.maximum(np.stack([e.rgb for e in known]), 1e-6))
    return np.where(before > 0, np.exp(np.median(logs, axis=0)), 0.0)
