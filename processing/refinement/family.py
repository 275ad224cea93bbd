"""Which family of mirror lobes a face has: that which leaves least unexplained."""

from __future__ import annotations

import dataclasses

import numpy as np

from processing.lighting.facets import BECKMANN, Facets
from processing.refinement.config import RefineConfig
from processing.refinement.gloss import better_gloss, sum_at_vertices
from processing.refinement.joint import gloss_evidence, solve_jointly
from processing.refinement.scattering import unscattered
from processing.refinement.scene import Scene, View, given_of, steady

ROUNDS = 3
"""Steps by which each family's gloss and normals are fitted: the first one's order may be wrong."""
STRETCH = 1.2
"""By what factor a lobe's stretch is tried wider, as long as that helps."""
MOST_STRETCHED = 2.0
SURE = 0.98
"""Another family than the simplest must leave this share of its residuals or less."""


def best_facets(scene: Scene, views: list[View], config: RefineConfig) -> Facets:
    """The family of lobes that explains some pixels of all views best.

    Args:
        scene: with the light from skin to skin found.
        views: of which about `config.family_pixels` each are asked.
        config: see there.

    Returns:
        Beckmann's round lobe unless another one is clearly better.
    """
    best, least = BECKMANN, unexplained(scene, views, BECKMANN, config)
    tailed = Facets(tails=True)
    left = unexplained(scene, views, tailed, config)
    if left < SURE * least:
        best, least = tailed, left
    for factor in (STRETCH, 1 / STRETCH):
        stretch = factor
        found = False
        while 1 / MOST_STRETCHED <= stretch <= MOST_STRETCHED:
            tried = dataclasses.replace(best, stretch=stretch)
            left = unexplained(scene, views, tried, config)
            if not left < SURE * least:
                break
            best, least, found = tried, left, True
            stretch *= factor
        if found:
            break
    return best


def unexplained(scene: Scene, views: list[View], facets: Facets, config: RefineConfig) -> float:
    """Median squared residual over its variance once gloss and normals are fitted to a family.

    Colour decides, as for gloss: what bounces and scattering do to a pattern's light would count
    for more than the lobe's shape, in all channels alike. 0 where no pixel can be asked.
    """
    scene = dataclasses.replace(scene, facets=facets)
    bands = [np.arange(0, len(v.rgb), -(-len(v.rgb) // config.family_pixels)) for v in views]
    trust = [steady(view, config)[band] for view, band in zip(views, bands, strict=True)]
    normals = [
        np.where(view.usable[band, None], view.sight.normals[band], 0)
        for view, band in zip(views, bands, strict=True)
    ]
    left = 0.0
    for done in range(ROUNDS):
        sums = np.zeros((len(scene.surface.vertices), 5))
        misfits = []
        for k, (view, band) in enumerate(zip(views, bands, strict=True)):
            around = unscattered(*view.rgb[band].shape[:2])
            given = given_of(scene, view, band, normals[k], around, config.gloss_noise)
            solved = solve_jointly(given, rounds=1)
            normals[k] = solved.normal
            misfits.append(solved.misfit[(solved.misfit > 0) & (trust[k] > 0.5)])
            if done == ROUNDS - 1:
                continue
            evidence = gloss_evidence(dataclasses.replace(given, normals=normals[k]))
            shadows = given.place.shadows
            evidence *= trust[k][:, None]
            sums += sum_at_vertices(evidence, shadows.corners, shadows.weights, len(sums))
        every = np.concatenate(misfits)
        left = float(np.median(every)) if len(every) else 0.0
        if done == ROUNDS - 1:
            break
        gloss = better_gloss(
            scene.gloss,
            sums,
            scene.surface,
            roughness_pool_mm=config.roughness_pool_mm,
            specular_pool_mm=config.specular_pool_mm,
            prior=config.gloss_prior,
            spread=config.gloss_spread,
        )
        scene = dataclasses.replace(scene, gloss=gloss)
    return left
