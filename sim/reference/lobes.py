"""Mitsuba's `roughplastic` taken apart: what it lets in, what it lets out, what it mirrors.

Skin is a rough dielectric of n = 1.4 over a layer that scatters. Mitsuba's diffuse part is
K T(v) T(l) albedo / pi, its T tabulated: the share of light that the facets seen from a direction
let through, n = 1.4. K is what the inside mirrors back, and is not what conserves energy
for a rough interface: K times the mean of T is .97 at m = .1 and .88 at m = .3. We keep T and
scale the lobe so that all light that entered leaves again where the albedo is one:

    diffuse = albedo / pi  X(v) T(l),   X = T / (2 integral of T(mu) mu)
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

INDEX = 1.4
F0 = ((INDEX - 1) / (INDEX + 1)) ** 2
MIRROR, BODY = 0, 1
"""Components of `roughplastic`: the rough mirror and the layer below it."""
TABLE = 64
"""Mitsuba tabulates T at so many equal steps of the cosine, linear between them."""
MIN_ROUGHNESS = 0.02
ROUGHNESSES = np.linspace(MIN_ROUGHNESS, 0.62, 16)
"""Roughnesses whose T and X are tabulated; those beyond take the nearest."""
MIN_COSINE = 1e-3
"""Relief may turn from the viewer where the surface does not; n . v is kept above this."""
SHORT = 0.9995
"""A ray ends this share of the way to the lamp, lest a lamp on a surface hide behind it."""


class Lobes:
    """Skin of one roughness.

    Args:
        distribution: ``beckmann`` or ``ggx``.
        roughness: m.

    Attributes:
        bsdf: Mitsuba's scalar `roughplastic`, white inside, with its own Fresnel outside.
        body_scale: times the object's diffuse part gives ours.
        exits: (64,) X at cosines in equal steps 0..1.
        enters: (64,) T there.
    """

    def __init__(self, distribution: str, roughness: float) -> None:
        self.bsdf, body = body_at_normal(
            {
                "type": "roughplastic",
                "distribution": distribution,
                "alpha": roughness,
                "int_ior": INDEX,
                "ext_ior": 1.0,
                "nonlinear": False,
                "diffuse_reflectance": {"type": "rgb", "value": 1.0},
            }
        )
        shape = body / body[-1]
        cosines = np.linspace(0, 1, TABLE)
        low, high, a, b = shape[:-1], shape[1:], cosines[:-1], cosines[1:]
        # 2 mu T over steps on which T is linear.
        mean = float((((low * (2 * a + b) + high * (a + 2 * b)) / 3) * (b - a)).sum())
        self.exits = shape / mean
        self.enters = shape * (1.0 - facets_mirror(distribution, roughness))
        self.body_scale = float(self.exits[-1] * self.enters[-1] / body[-1])


class Interface:
    """T and X of skin of any roughness, bilinear between Mitsuba's tables.

    Args:
        distribution: ``beckmann`` or ``ggx``.

    Attributes:
        enters: (r, 64) T at equal steps of m and of the cosine.
        exits: (r, 64) X there.
    """

    def __init__(self, distribution: str) -> None:
        self._distribution = distribution
        self.enters = np.full((len(ROUGHNESSES), TABLE), np.nan)
        self.exits = np.full((len(ROUGHNESSES), TABLE), np.nan)

    def rows(self, roughness: np.ndarray) -> np.ndarray:
        """Places (...) between the tables' rows, within range; rows are filled when first used."""
        step = ROUGHNESSES[1] - ROUGHNESSES[0]
        last = len(ROUGHNESSES) - 1
        places = (np.asarray(roughness, float) - ROUGHNESSES[0]) / step
        places = np.clip(places, 0, last - 1e-6)
        for row in np.union1d(np.floor(places), np.floor(places) + 1).astype(int):
            # Mitsuba takes a good part of a second for each.
            if np.isnan(self.enters[row, 0]):
                lobes = lobes_of(self._distribution, float(ROUGHNESSES[row]))
                self.enters[row], self.exits[row] = lobes.enters, lobes.exits
        return places

    def entry(self, cosine: np.ndarray, roughness: np.ndarray) -> np.ndarray:
        """T at (...) cosines of the angle to the light."""
        return self._between(self.enters, cosine, self.rows(roughness))

    def exit(self, cosine: np.ndarray, roughness: np.ndarray) -> np.ndarray:
        """X at (...) cosines of the angle to the viewer, kept above `MIN_COSINE`."""
        return self._between(self.exits, np.maximum(cosine, MIN_COSINE), self.rows(roughness))

    def _between(self, table: np.ndarray, cosine: np.ndarray, rows: np.ndarray) -> np.ndarray:
        y, x = rows, np.clip(cosine, 0, 1) * (TABLE - 1)
        row, column = y.astype(int), np.minimum(x.astype(int), TABLE - 2)
        y, x = y - row, x - column
        upper = table[row, column] * (1 - x) + table[row, column + 1] * x
        lower = table[row + 1, column] * (1 - x) + table[row + 1, column + 1] * x
        return upper * (1 - y) + lower * y


@functools.lru_cache(maxsize=512)
def lobes_of(distribution: str, roughness: float) -> Lobes:
    """The same, kept."""
    return Lobes(distribution, roughness)


@functools.cache
def interface_of(distribution: str) -> Interface:
    """The same, kept."""
    return Interface(distribution)


def facets_mirror(distribution: str, roughness: float) -> float:
    """Share of light along the normal that facets of this roughness mirror, by quadrature.

    Facets seen along the normal are distributed as D times their cosine, which for a slope
    tan t of Beckmann is exponential in (tan t / m)^2 and for GGX has the cumulative share
    x / (1 + x) of the same x [Walter2007].
    """
    nodes, weights = np.polynomial.legendre.leggauss(96)
    share = (nodes + 1) / 2
    x = -np.log1p(-share) if distribution == "beckmann" else share / (1 - share)
    cosine = 1 / np.sqrt(1 + roughness**2 * x)
    return float(np.sum(weights / 2 * fresnel(cosine)))


def fresnel(cosine: np.ndarray) -> np.ndarray:
    """Unpolarised reflectance (...) of n = 1.4 at (...) cosines by Fresnel [BornWolf1999]."""
    inside = np.sqrt(1 - (1 - cosine**2) / INDEX**2)
    crossed = (cosine - INDEX * inside) / (cosine + INDEX * inside)
    parallel = (INDEX * cosine - inside) / (INDEX * cosine + inside)
    return (crossed**2 + parallel**2) / 2


def levels_of(roughness: np.ndarray, step: float) -> np.ndarray:
    """(...) roughness rounded to multiples of a step, float64, at least `MIN_ROUGHNESS`."""
    return np.round(np.maximum(np.round(roughness / step) * step, MIN_ROUGHNESS), 6)


def body_at_normal(kind: dict[str, Any]) -> tuple[Any, np.ndarray]:
    """Mitsuba's scalar object, and (64,) pi K T(1) T(mu) at cosines in equal steps."""
    import mitsuba as mi

    before = mi.variant()
    mi.set_variant("scalar_rgb")
    bsdf = mi.load_dict(kind)
    si = mi.SurfaceInteraction3f()
    si.wi = mi.Vector3f(0, 0, 1)
    context = mi.BSDFContext()
    context.component = BODY
    out = []
    for cosine in np.maximum(np.linspace(0, 1, TABLE), 1e-6):
        out_direction = mi.Vector3f(float(np.sqrt(1 - cosine**2)), 0.0, float(cosine))
        out.append(np.pi * bsdf.eval(context, si, out_direction)[0] / cosine)
    if before is not None:
        mi.set_variant(before)
    return bsdf, np.array(out)
