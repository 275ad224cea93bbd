"""Gloss, light from skin to skin and scattering, found from a grid of every view's pixels."""

from __future__ import annotations

import dataclasses

import numpy as np

from lightstage.commands import ProgressCallback, quiet
from processing.refinement.bounces import bounced_light, other_skin, vertex_irradiance
from processing.refinement.config import RefineConfig
from processing.refinement.gloss import better_gloss, sum_at_vertices
from processing.refinement.joint import Scattered, gloss_evidence, solve_searching
from processing.refinement.joint_kernels import Solved
from processing.refinement.model_choice import Step, best_model
from processing.refinement.scattering import scattered, unscattered
from processing.refinement.scene import ALL, Scene, View, given_of, steady
from processing.surface import LitSurface


def find_gloss(
    scene: Scene, grids: list[View], config: RefineConfig, progress: ProgressCallback = quiet
) -> tuple[Scene, list[Solved], list[Step]]:
    """Find gloss, the lobes' family, bounced light and scattering from grids of the views.

    Args:
        scene: before anything was found.
        grids: the views.
        config: see there.
        progress: of rounds.

    Returns:
        The scene with what was found, each grid's pixels as solved, and what steps beyond the
        simplest model of light gained.
    """
    surface = scene.surface
    between, entered, bounced = None, np.zeros(0), None
    steps: list[Step] = []
    if config.bounce_rays:
        rays = max(16, min(config.bounce_rays, config.bounce_rays_all // surface.coarse))
        between = other_skin(surface, rays)
        entered = vertex_irradiance(surface, scene.lights, scene.interface, config.roughness)
    solved = [solve_grid(scene, grid, None, config) for grid in grids]
    for done in range(config.gloss_rounds):
        if done:
            solved = [solve_grid(scene, g, b, config) for g, b in zip(grids, solved, strict=True)]
        if between is not None:
            albedo = vertex_albedo(surface, grids, solved)
            bounced = bounced_light(surface, between, entered, albedo)
        if done == 0 and config.choice_pixels:
            scene, steps = best_model(
                scene, grids, wandering(scene, grids, solved), bounced, config
            )
            if between is not None and not scene.facets.covers:
                entered = vertex_irradiance(
                    surface, scene.lights, scene.interface, config.roughness
                )
            solved = [solve_grid(scene, g, b, config) for g, b in zip(grids, solved, strict=True)]
        elif done == 0:
            scene = dataclasses.replace(scene, scattering=config.scattering[0])
        elif scene.bounces and bounced is not None:
            scene = dataclasses.replace(scene, bounced=bounced)
        scene = dataclasses.replace(scene, doubt=doubt(grids, solved, config))
        sums = np.zeros((len(surface.vertices), 5))
        for grid, found in zip(grids, solved, strict=True):
            evidence = grid_evidence(scene, grid, found, config)
            corners, weights = grid.sight.shadows.corners, grid.sight.shadows.weights
            sums += sum_at_vertices(evidence, corners, weights, len(surface.vertices))
        gloss = better_gloss(
            scene.gloss,
            sums,
            surface,
            roughness_pool_mm=config.roughness_pool_mm,
            specular_pool_mm=config.specular_pool_mm,
            prior=config.gloss_prior,
            spread=config.gloss_spread / np.sqrt(scene.doubt),
            wrong=mistaken(scene, solved, config),
        )
        scene = dataclasses.replace(scene, gloss=gloss)
        progress(done + 1, config.gloss_rounds)
    return scene, solved, steps


def mistaken(scene: Scene, solved: list[Solved], config: RefineConfig) -> np.ndarray:
    """(V,) what vertices' specular albedo is wrong by where light from elsewhere is mistaken.

    It goes as the face's mean albedo; 0 where no light wanders from skin to skin or inside it.
    """
    if not (scene.bounces or scene.scattering):
        return np.zeros(len(scene.bounced))
    lit, power = (sum(getattr(x, name).sum() for x in solved) for name in ("lit", "power"))
    albedo = float(lit / power) if power > 0 else 0.0
    bounced = scene.bounced.mean(axis=(1, 2))
    return np.asarray(albedo * (config.mistaken + config.mistaken_bounces * bounced))


def doubt(grids: list[View], solved: list[Solved], config: RefineConfig) -> float:
    """By what factor the residuals' variance is above what is expected, at least 1.

    Photographs may be noisier than configured; then their evidence has less weight.
    """
    misfits = [
        found.misfit[(found.misfit > 0) & (steady(grid, config) > 0.5)]
        for grid, found in zip(grids, solved, strict=True)
    ]
    every = np.concatenate(misfits)
    return max(1.0, float(np.median(every))) if len(every) else 1.0


def solve_grid(scene: Scene, view: View, before: Solved | None, config: RefineConfig) -> Solved:
    """One step with what the scene knows so far, from the step before or the mesh's normals.

    Normals stay near those of chroma, which do not depend on the gloss that is still searched.
    """
    if before is None:
        start = np.where(view.usable[:, None], view.sight.normals, 0)
        around = unscattered(len(start), len(scene.lights.patterns))
    else:
        start, around = before.normal, around_of(scene, view, before)
    given = given_of(scene, view, ALL, start, around, config.noise)
    return solve_searching(given, config.apart_deg)


def around_of(scene: Scene, view: View, solved: Solved) -> Scattered:
    """Light that wanders to each pixel of a view from its neighbours."""
    # A slope is shorter in the picture than it is.
    shrunk = float(np.sqrt(np.einsum("nk,nk->n", view.sight.normals, view.sight.views).mean()))
    px_per_mm = view.px_per_mm * shrunk
    return scattered(solved.irradiance, view.sight.mask, px_per_mm, scene.scattering)


def wandering(scene: Scene, grids: list[View], solved: list[Solved]) -> list[Scattered]:
    """What would wander to each view's pixels if all light wandered inside the skin."""
    whole = dataclasses.replace(scene, scattering=1.0)
    return [around_of(whole, grid, found) for grid, found in zip(grids, solved, strict=True)]


def grid_evidence(scene: Scene, view: View, solved: Solved, config: RefineConfig) -> np.ndarray:
    """(n, 5) the pixels' evidence of the gloss; those at steep angles and edges have none."""
    around = around_of(scene, view, solved)
    evidence = gloss_evidence(given_of(scene, view, ALL, solved.normal, around, config.gloss_noise))
    return np.asarray(evidence * steady(view, config)[:, None])


def vertex_albedo(surface: LitSurface, grids: list[View], solved: list[Solved]) -> np.ndarray:
    """(coarse, 3) diffuse albedo at the mesh's vertices; the face's mean where no view saw them."""
    sums = np.zeros((surface.coarse, 6))
    for grid, found in zip(grids, solved, strict=True):
        shadows = grid.sight.shadows
        both = np.column_stack([found.lit, found.power])
        # A split vertex is none of the mesh's: its share goes to nobody, others are near enough.
        all_sums = sum_at_vertices(both, shadows.corners, shadows.weights, len(surface.vertices))
        sums += all_sums[: surface.coarse]
    lit, power = sums[:, :3], sums[:, 3:]
    mean = lit.sum(axis=0) / np.maximum(power.sum(axis=0), 1e-30)
    enough = power > 1e-3
    albedo = np.where(enough, lit / np.where(enough, power, 1), mean)
    return np.clip(albedo, 0, 1)
