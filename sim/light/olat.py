"""One light at a time: any light state of any points as a weighted sum of single lamps.

A point's answer to a lamp is two numbers (`sim.light.render.responses`), of its diffuse and of its
specular part; colour follows from albedo and lamp. They are made once for all states asked for,
tile by tile, so that seven patterns cost little more than one and memory stays bounded.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numba
import numpy as np

from sim.light.facets import SKIN_F0
from sim.light.lamps import Lamps
from sim.light.render import ROUND, TILE, Lobe, responses

Optics = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Positions, normals and views (t, 3) and lamps (k,) to factors (t, k) of the diffuse and of the
specular light: what filters before lamps and lens make of it (`sim.light.polarised`)."""

_0: Any = np.float32(0.0)


@numba.njit(cache=True, parallel=True, error_model="numpy", fastmath={"contract", "reassoc"})
def weigh_kernel(response: np.ndarray, columns: np.ndarray, out: np.ndarray) -> None:
    """Set out (n, j) to response (n, k) times columns (k, j), all float32.

    The same as a matrix product; most responses are zero and skipped. A library's threads would
    spin beside those of the other kernel and cost more than the product.
    """
    count, wide = columns.shape
    for i in numba.prange(len(response)):
        for j in range(wide):
            out[i, j] = _0
        for k in range(count):
            value = response[i, k]
            if value != _0:
                for j in range(wide):
                    out[i, j] += value * columns[k, j]


def states(
    position: np.ndarray,
    geometric: np.ndarray,
    normal: np.ndarray,
    view: np.ndarray,
    albedo: np.ndarray,
    specular: np.ndarray,
    roughness: np.ndarray,
    bits: np.ndarray,
    lamps: Lamps,
    weights: np.ndarray,
    lobe: Lobe = ROUND,
    optics: Optics | None = None,
) -> Iterator[tuple[slice, np.ndarray, np.ndarray]]:
    """Light that leaves surface points toward the camera under any number of states, in tiles.

    Args:
        position: (n, 3) mm, world.
        geometric: (n, 3) the mesh's unit normals: a lamp below their horizon gives nothing.
        normal: (n, 3) unit normals that shade.
        view: (n, 3) unit directions to the camera.
        albedo: (n, 3) diffuse albedo.
        specular: (n,) specular albedo, reflectance at normal incidence.
        roughness: (n,) m.
        bits: (n, ceil(m / 8)) uint8, bit k & 7 of byte k >> 3 set where lamp k is seen.
        lamps: m of them; their own weights are not used.
        weights: (s, m, 3): for s states, what a white diffuser at the origin facing the lamp
            reads because of it (formats.environment). Lamps that no state lights cost nothing.
        lobe: of the points.
        optics: filters before lamps and lens; none where absent.

    Yields:
        Which of the n points these t are, in order, and their diffuse and specular light, each
        (s, t, 3) float32.
    """
    weights = np.asarray(weights)
    count = len(weights)
    lit = np.flatnonzero(weights.any(axis=(0, 2)))
    columns = weights[:, lit].transpose(1, 0, 2).reshape(len(lit), 3 * count)
    columns = np.ascontiguousarray(columns, np.float32)
    light = np.empty((min(TILE, len(position)), 3 * count), np.float32)
    surface = (position, geometric, normal, view, roughness, bits)
    for tile, *parts in responses(*surface, lamps, lit, lobe):
        if optics is not None:
            passed = optics(position[tile], normal[tile], view[tile], lit)
            parts = [part * factor for part, factor in zip(parts, passed, strict=True)]
        colour = np.asarray(albedo[tile], np.float32)
        gloss = np.asarray(specular[tile], np.float32)[:, None] / np.float32(SKIN_F0)
        found = []
        for part, factor in zip(parts, (colour, gloss), strict=True):
            weigh_kernel(part, columns, light[: len(part)])
            each = light[: len(part)].reshape(-1, count, 3).transpose(1, 0, 2)
            # A broken albedo may make its own pixel NaN, without a word on stderr.
            with np.errstate(invalid="ignore", over="ignore"):
                found.append(each * factor)
        yield tile, found[0], found[1]


def shade(
    position: np.ndarray,
    geometric: np.ndarray,
    normal: np.ndarray,
    view: np.ndarray,
    albedo: np.ndarray,
    specular: np.ndarray,
    roughness: np.ndarray,
    bits: np.ndarray,
    lamps: Lamps,
    weights: np.ndarray,
    lobe: Lobe = ROUND,
) -> tuple[np.ndarray, np.ndarray]:
    """All tiles of `states` in one: diffuse and specular part, each (s, n, 3) float32."""
    shape = (len(weights), len(position), 3)
    diffuse, specular_light = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    surface = (position, geometric, normal, view, albedo, specular, roughness)
    for tile, body, mirror in states(*surface, bits, lamps, weights, lobe):
        diffuse[:, tile], specular_light[:, tile] = body, mirror
    return diffuse, specular_light
