"""Light straight from the lamps to points of the skin and from there in one direction.

Every lamp is asked at every point: one ray to a random place on its disc, Mitsuba's reflectance
for that direction. So no noise comes from picking lamps, and any number of light states shares
the rays: states differ by weights alone, and what is linear in them stays so.
"""

from __future__ import annotations

import numpy as np

from sim.light.lamps import Lamps
from sim.reference.lobes import (
    BODY,
    F0,
    MIN_COSINE,
    MIN_ROUGHNESS,
    MIRROR,
    SHORT,
    interface_of,
    levels_of,
    lobes_of,
)
from sim.reference.points import Points
from sim.reference.rays import Rays, vectors
from sim.reference.variant import LLVM, SCALAR, mitsuba

CHUNK = 1_000_000
ROUGHNESS_STEP = 0.01
"""One by one, points share an object where their roughness agrees this well."""
STATES = 8
"""States that one pass sums; more are done in several passes."""


def direct_light(
    rays: Rays,
    points: Points,
    lamps: Lamps,
    weights: np.ndarray,
    distribution: str,
    seed: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Light that leaves points toward their `view`.

    Args:
        rays: the mesh that casts shadows.
        points: n places.
        lamps: m lamps.
        weights: (s, m, 3) what a white diffuser at the origin facing each lamp would read.
        distribution: of facets.
        seed: of the places on the lamps.

    Returns:
        (s, n, 3) float32 of the layer below the surface as if its albedo were one, and
        (s, n, 3) float32 of the mirroring surface.
    """
    weights = np.asarray(weights, float)
    body = np.zeros((len(weights), len(points), 3), np.float32)
    mirror = np.zeros_like(body)
    lit = np.flatnonzero(weights.any(axis=(0, 2)))
    grey = bool((weights == weights[:, :, :1]).all())
    shown = weights[:, lit, :1] if grey else weights[:, lit]
    table = shown * lamp_strength(lamps)[lit][:, None]
    run = _sum_one_by_one if rays.variant == SCALAR else _sum_many
    for first in range(0, len(points), CHUNK):
        chosen = slice(first, first + CHUNK)
        part = points.part(chosen)
        for state in range(0, len(weights), STATES):
            states = slice(state, state + STATES)
            found = run(rays, part, lamps, lit, table[states], distribution, [seed, first])
            body[states, chosen], mirror[states, chosen] = found
    mirror *= (points.specular / F0)[:, None]
    return body, mirror


def lamp_strength(lamps: Lamps) -> np.ndarray:
    """(m,) radiant intensity along the axis, mm^2, of lamps of weight 1.

    A disc of radius a at a distance d whose every spot shines as I cos^e lights a diffuser at
    the origin facing it by the mean over the disc of I (d / r)^(e + 1) / r^2, which is to be pi.
    """
    d2 = np.sum(np.asarray(lamps.positions_mm, float) ** 2, axis=1)
    a2, e = lamps.radius_mm**2 / d2, lamps.exponent
    # (1 - (1 + x)^(-k)) / (k x), x the disc's relative area, tends to 1 as the disc shrinks.
    k = (e + 1) / 2
    share = -np.expm1(-k * np.log1p(a2)) / (k * a2) if lamps.radius_mm > 0 else np.ones_like(d2)
    return np.pi * d2 / share


def _sum_many(
    rays: Rays,
    points: Points,
    lamps: Lamps,
    lit: np.ndarray,
    table: np.ndarray,
    distribution: str,
    seed: list[int],
) -> np.ndarray:
    """(2, s, n, 3) sums over lamps, all points at once: `roughplastic` of each point's roughness.

    Mitsuba's object has one roughness; its parts (distribution, masking, Fresnel, tabulated T)
    are put together here as it does, with neighbours kept together, since rays that lie apart are
    traced ten times slower.
    """
    mi = mitsuba(LLVM)
    import drjit

    from sim.reference.kernel import sum_over_lamps

    states, _, channels = table.shape
    interface = interface_of(distribution)
    roughness = np.maximum(points.roughness, MIN_ROUGHNESS)
    kinds = {"beckmann": mi.MicrofacetType.Beckmann, "ggx": mi.MicrofacetType.GGX}
    rows = interface.rows(roughness)
    found = sum_over_lamps(
        rays.scene,
        mi.MicrofacetDistribution(kinds[distribution], mi.Float(roughness), True),
        mi.Float(np.nan_to_num(interface.enters).astype(np.float32).ravel()),
        mi.Float(rows.astype(np.float32)),
        vectors(mi.Point3f, points.position),
        vectors(mi.Point3f, points.start),
        vectors(mi.Vector3f, points.normal),
        vectors(mi.Vector3f, points.view),
        vectors(mi.Point3f, lamps.positions_mm[lit]),
        mi.UInt32(lit.astype(np.uint32)),
        vectors(mi.Vector3f, lamps.axes[lit]),
        [vectors(mi.Vector3f, v) for v in _across(lamps.axes[lit])],
        mi.Float(lamps.radius_mm),
        mi.Float(lamps.exponent),
        # One lamp's weights lie together: lamp, state, channel.
        mi.Float(np.ascontiguousarray(np.swapaxes(table, 0, 1), np.float32).ravel()),
        mi.UInt32(len(lit)),
        states * channels,
        mi.UInt32(int(np.random.default_rng(seed).integers(2**30))),
    )
    # One evaluation of all; asked for one by one, the loop would run again for each.
    drjit.eval(found)
    sums = np.stack([np.array(part) for part in found])
    sums = np.moveaxis(sums.reshape(2, states, channels, len(points)), 2, 3)
    cosine = np.einsum("nk,nk->n", points.normal, points.view)
    sums[0] *= (interface.exit(cosine, roughness) / np.pi)[:, None]
    return np.broadcast_to(sums, (2, states, len(points), 3))


def _sum_one_by_one(
    rays: Rays,
    points: Points,
    lamps: Lamps,
    lit: np.ndarray,
    table: np.ndarray,
    distribution: str,
    seed: list[int],
) -> np.ndarray:
    """The same as `_sum_many`, a pair of point and lamp at a time, by `roughplastic` itself."""
    mi = mitsuba(SCALAR)
    states, _, channels = table.shape
    body, mirror = mi.BSDFContext(), mi.BSDFContext()
    body.component, mirror.component = BODY, MIRROR
    rng = np.random.default_rng(seed)
    first, second = _across(lamps.axes[lit])
    sums = np.zeros((2, states, len(points), channels))
    levels = levels_of(points.roughness, ROUGHNESS_STEP)
    for i in range(len(points)):
        lobes = lobes_of(distribution, float(levels[i]))
        # Drawn for all lamps, so that a lamp's place does not depend on which others shine.
        drawn = rng.random((2, len(lamps.axes)))[:, lit]
        radius, turn = np.sqrt(drawn[0]), 2 * np.pi * drawn[1]
        place = lamps.positions_mm[lit] + lamps.radius_mm * radius[:, None] * (
            np.cos(turn)[:, None] * first + np.sin(turn)[:, None] * second
        )
        toward = place - points.position[i]
        distance2 = np.sum(toward**2, axis=1)
        toward /= np.sqrt(distance2)[:, None]
        facing = -np.sum(toward * lamps.axes[lit], axis=1)
        frame = mi.Frame3f(points.normal[i].tolist())
        local = frame.to_local(mi.Vector3f(points.view[i].tolist()))
        si = mi.SurfaceInteraction3f()
        si.wi = mi.Vector3f(_unit((local.x, local.y, max(local.z, MIN_COSINE))))
        start = points.start[i].astype(float)
        for k in np.flatnonzero((toward @ points.normal[i] > 0) & (facing > 0)):
            path = place[k] - start
            far = float(np.linalg.norm(path))
            ray = mi.Ray3f(start.tolist(), (path / far).tolist(), far * SHORT, 0.0, [])
            if rays.scene.ray_test(ray):
                continue
            out = frame.to_local(mi.Vector3f(toward[k].tolist()))
            arrives = facing[k] ** lamps.exponent / distance2[k]
            enters = lobes.body_scale * lobes.bsdf.eval(body, si, out)[0]
            sums[0, :, i] += table[:, k] * (enters * arrives)
            sums[1, :, i] += table[:, k] * (lobes.bsdf.eval(mirror, si, out)[0] * arrives)
    return np.broadcast_to(sums, (2, states, len(points), 3))


def _unit(vector: tuple[float, float, float]) -> list[float]:
    length = sum(part * part for part in vector) ** 0.5
    return [part / length for part in vector]


def _across(axes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors (m, 3) at right angles to axes and to each other."""
    away = np.where(np.abs(axes[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    first = np.cross(axes, away)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return first, np.cross(axes, first)
