"""Maps of all of a view's pixels, once what all views share is known."""

from __future__ import annotations

import dataclasses

import numpy as np

from processing.albedo import diffuse_albedo
from processing.pixels import PixelMaps
from processing.refinement.config import RefineConfig
from processing.refinement.gloss import local_specular
from processing.refinement.gloss_search import around_of, grid_evidence, mistaken
from processing.refinement.joint import (
    Solved,
    solve_jointly,
)
from processing.refinement.scene import ALL, BAND_PIXELS, Scene, View, gloss_of, place_of, steady
from processing.surface import Sight, at_vertices_to

LEAST_WEIGHT = 1e-6
"""Of a pixel in its neighbours' albedo."""


def solve_view(
    scene: Scene, view: View, grid: View, found: Solved, config: RefineConfig
) -> PixelMaps:
    """Maps of all of a view's pixels.

    Args:
        scene: with its gloss found.
        view: all pixels.
        grid: of the same view.
        found: the grid's pixels.
        config: see there.

    Returns:
        PixelMaps, zero where a pixel cannot be solved.
    """
    sight, mask = view.sight, view.sight.mask
    evidence = grid_evidence(scene, grid, found, config)
    roughness, specular = gloss_of(scene, grid.sight)
    spread = config.gloss_spread / np.sqrt(scene.doubt)
    shadows = grid.sight.shadows
    wrong = mistaken(scene, [found], config)
    wrong = at_vertices_to(wrong[:, None], shadows.corners, shadows.weights)[:, 0]
    specular = local_specular(
        evidence,
        specular,
        grid.sight.mask,
        config.specular_detail_mm * grid.px_per_mm,
        config.specular_detail_spread / np.sqrt(scene.doubt),
        config.specular_pool_mm * grid.px_per_mm,
        1 / (1 + (wrong / spread) ** 2),
    )
    around = around_of(scene, grid, found)
    start = found.normal
    whole = grid.sight.step == 1
    if not whole:
        flat = around.rest.reshape(len(around.rest), -1)
        of_grid = np.column_stack([start, roughness, specular, flat])
        # Where the grid has no pixel nearby the mesh's own gloss and normals are all there is.
        roughness, specular = gloss_of(scene, sight)
    parts = []
    for first in range(0, len(sight.normals), BAND_PIXELS):
        band = slice(first, first + BAND_PIXELS)
        if whole:
            begin, rest = start[band], around.rest[band]
        else:
            columns, near = enlarged(of_grid, grid.sight, sight, band)
            roughness[band][near], specular[band][near] = columns[near, 3:5].T
            length = np.linalg.norm(columns[:, :3], axis=1, keepdims=True)
            begin = np.where(
                length > 0.5, columns[:, :3] / np.maximum(length, 0.5), sight.normals[band]
            )
            begin = np.where(view.usable[band, None], begin, 0)
            rest = columns[:, 5:].reshape(-1, *around.rest.shape[1:])
        part = solve_jointly(
            view.rgb[band],
            scene.lights,
            place_of(scene, view, band),
            begin,
            roughness[band],
            specular[band],
            scene.interface,
            dataclasses.replace(around, rest=rest),
            config.noise,
            rounds=config.rounds,
        )
        # Light on its way to neighbours is asked of the grid alone.
        parts.append(dataclasses.replace(part, irradiance=part.irradiance[:, :0].copy()))
    solved = joined(parts)
    parts.clear()
    # A normal that the mesh could not have: mistaken shadows, or hair.
    agreement = np.einsum("nk,nk->n", solved.normal, sight.normals)
    seen = np.einsum("nk,nk->n", solved.normal, sight.views) > 0
    good = view.usable & (agreement > 0) & seen
    trust = steady(view, config) * np.clip(2 * agreement, 0, 1)
    if not scene.lights.polarised:
        trust *= np.clip(view.saturation / config.grey_saturation - 1, 0, 1)
    power = solved.power.mean(axis=1)
    trust *= power / (power + config.dark_power)
    trust /= 1 + solved.misfit / config.doubtful_misfit
    turn2 = 1 / np.maximum(solved.certainty, 1e-12)
    trust /= 1 + turn2 / np.radians(config.doubtful_turn_deg) ** 2
    confidence = np.where(good, trust, 0).astype(np.float32)
    # A pixel that is hardly trusted takes its neighbours' albedo.
    # Where none is trusted far around, they have one another still.
    weight = np.maximum(confidence[:, None] ** 2, LEAST_WEIGHT)
    np.multiply(solved.lit, weight, out=solved.lit)
    np.multiply(solved.power, weight, out=solved.power)
    albedo = diffuse_albedo(
        solved.lit, solved.power, mask, view.px_per_mm, config.albedo_prior_power
    )
    matte, normal = (
        steadied(found, sight.normals, confidence / config.steady_below, good)
        for found in (solved.matte, solved.normal)
    )
    albedo[~good] = 0
    specular, roughness = np.where(good, specular, 0), np.where(good, roughness, 0)
    return PixelMaps(matte, normal, albedo, specular, roughness, confidence)


def joined(parts: list[Solved]) -> Solved:
    """The pixels of several bands as one."""
    names = [field.name for field in dataclasses.fields(Solved)]
    return Solved(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def steadied(
    normals: np.ndarray, mesh: np.ndarray, trust: np.ndarray, good: np.ndarray
) -> np.ndarray:
    """(n, 3) unit normals, drawn to the mesh's where trust is below 1; zero where not good.

    In a nostril, which hardly any light enters, readings tell less of the surface than the mesh.
    """
    share = np.clip(trust, 0, 1)[:, None]
    mixed = share * normals + (1 - share) * mesh
    length = np.linalg.norm(mixed, axis=1, keepdims=True)
    good = good[:, None] & (length > 1e-6)
    return np.where(good, mixed / np.where(good, length, 1), 0)


def enlarged(
    values: np.ndarray, grid: Sight, view: Sight, band: slice = ALL
) -> tuple[np.ndarray, np.ndarray]:
    """Values (m, k) of a grid's pixels at n pixels of the whole view, linearly between them.

    Returns:
        (n, k), and (n,) bool whether the grid has a pixel near by.
    """
    rows, columns = (places[band] for places in np.nonzero(view.mask))
    image = np.zeros((*grid.mask.shape, values.shape[1] + 1), np.float32)
    image[grid.mask] = np.column_stack([values, np.ones(len(values))])
    y, x = rows / grid.step, columns / grid.step
    top = np.minimum(y.astype(int), image.shape[0] - 1)
    left = np.minimum(x.astype(int), image.shape[1] - 1)
    below, right = np.minimum(top + 1, image.shape[0] - 1), np.minimum(left + 1, image.shape[1] - 1)
    down, across = (y - top)[:, None].astype(np.float32), (x - left)[:, None].astype(np.float32)
    total = (1 - down) * ((1 - across) * image[top, left] + across * image[top, right])
    total += down * ((1 - across) * image[below, left] + across * image[below, right])
    near = total[:, -1] > 1e-3
    return total[:, :-1] / np.where(near, total[:, -1], 1)[:, None], near
