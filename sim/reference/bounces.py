"""Light that reaches skin from other skin.

Rays from coarse nodes of the surface find the skin they face. The first bounce carries what leaves
that skin toward the node, its mirror included, computed for the lamps at the very place hit; later
bounces go between nodes, by the diffuse part alone. What arrives is smooth, so nodes 2 to 3 mm
apart hold it; the relief's normals do not turn it.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from sim.light.lamps import Lamps
from sim.reference.config import ReferenceConfig
from sim.reference.direct import direct_light
from sim.reference.lobes import interface_of
from sim.reference.points import START_MM, Points, Skin
from sim.reference.rays import Rays
from sim.reference.texels import Nodes, Texels

NODE_MM = 3.0
"""Nodes stand at most so far apart."""
GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))


def bounced_light(
    skin: Skin,
    rays: Rays,
    texels: Texels,
    lamps: Lamps,
    weights: np.ndarray,
    entered: np.ndarray,
    config: ReferenceConfig,
) -> np.ndarray:
    """Light that enters each texel after one to `config.bounces` bounces.

    Args:
        skin: the surface.
        rays: against it.
        texels: n patches.
        lamps: m lamps.
        weights: (s, m, 3) of the states.
        entered: (n, s, 3) direct light that entered.
        config: see there.

    Returns:
        (n, s, 3) float32.
    """
    count, states, _ = entered.shape
    step = 1
    while 2 * step * texels.spacing_mm <= NODE_MM:
        step *= 2
    nodes = texels.nodes(step)
    rng = np.random.default_rng([config.seed, 2])
    distribution = skin.subject.distribution
    interface = interface_of(distribution)
    roughness = nodes.gather(texels.points.roughness[:, None])[:, 0]
    first = np.zeros((len(nodes.area), states, 3))
    later = sparse.csr_matrix((len(nodes.area), len(nodes.area)))
    # A pass of rays at a time bounds the memory.
    passes = max(1, -(-len(nodes.area) * config.bounce_rays // 4_000_000))
    for part in np.array_split(np.arange(len(nodes.area)), passes):
        hits, owner, cosine = _cast(skin, rays, nodes, part, config.bounce_rays, rng)
        if not len(owner):
            continue
        entry = interface.entry(cosine, roughness[owner])
        body, mirror = direct_light(rays, hits, lamps, weights, distribution, config.seed + 1)
        seen = (body * hits.albedo + mirror) * (np.pi / config.bounce_rays * entry)[:, None]
        for state in range(states):
            for channel in range(3):
                first[:, state, channel] += np.bincount(
                    owner, seen[state, :, channel], len(nodes.area)
                )
        if config.bounces > 1:
            leaves = exits(distribution, hits) * entry / config.bounce_rays
            to = sparse.csr_matrix((leaves, (owner, texels.at(hits.uv))), (len(nodes.area), count))
            later = later + to @ nodes.share
    albedo = nodes.gather(texels.points.albedo)
    total = carried = first
    for _ in range(config.bounces - 1):
        shone = (carried * albedo[:, None]).reshape(len(albedo), -1)
        carried = (later @ shone).reshape(first.shape)
        total = total + carried
    return (
        nodes.spread_out(total.reshape(len(total), -1)).reshape(count, states, 3).astype(np.float32)
    )


def exits(distribution: str, points: Points) -> np.ndarray:
    """(n,) X of points toward their view (see `sim.reference.lobes`)."""
    cosine = np.einsum("nk,nk->n", points.normal, points.view)
    return interface_of(distribution).exit(cosine, points.roughness)


def _cast(
    skin: Skin, rays: Rays, nodes: Nodes, part: np.ndarray, count: int, rng: np.random.Generator
) -> tuple[Points, np.ndarray, np.ndarray]:
    """What rays from nodes hit: places, whose ray, and the ray's cosine there.

    Directions follow the cosine: a spiral on the unit disc, turned at random for each node.
    """
    index = np.arange(count) + rng.random((len(part), 1))
    radius = np.sqrt(index / count)
    turn = np.arange(count) * GOLDEN_ANGLE + 2 * np.pi * rng.random((len(part), 1))
    x, y, z = (
        radius * np.cos(turn),
        radius * np.sin(turn),
        np.sqrt(np.maximum(1 - index / count, 0)),
    )
    normal = nodes.normal[part]
    away = np.where(np.abs(normal[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    first = np.cross(normal, away)
    first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-12)
    second = np.cross(normal, first)
    toward = x[..., None] * first[:, None] + y[..., None] * second[:, None]
    toward = (toward + z[..., None] * normal[:, None]).reshape(-1, 3)
    # The mean of a bulging patch lies below it, by about its spread over the radius of the bulge.
    lift = START_MM + 0.05 * np.sqrt(nodes.spread[part])
    origin = np.repeat(nodes.position[part] + lift[:, None] * normal, count, axis=0)
    face, weights = rays.hit(origin, toward)
    corners = skin.vertices[skin.triangles[np.maximum(face, 0)]]
    outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    seen = np.flatnonzero((face >= 0) & (np.einsum("nk,nk->n", outward, toward) < 0))
    # Hits on one place lie together, so that their rays to the lamps run together.
    seen = seen[np.argsort(face[seen], kind="stable")]
    hits = skin.points(face[seen], weights[seen], -toward[seen])
    return hits, np.repeat(part, count)[seen], z.ravel()[seen]
