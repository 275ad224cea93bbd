"""Maps of all of a view's pixels, once what all views share is known."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
from numba import njit, prange

from lightstage.rig import Camera
from processing.albedo import pooled
from processing.frames.read import Frames
from processing.masks import edge_distance_px
from processing.readings import px_per_mm
from processing.refinement.config import RefineConfig
from processing.refinement.finish import (
    GIVEN,
    LEAST_WEIGHT,
    Maps,
    empty_maps,
    facing,
    finish,
    limits_of,
)
from processing.refinement.gloss import local_specular
from processing.refinement.gloss_search import around_of, grid_evidence, mistaken
from processing.refinement.joint import Given, solve_jointly, spread_of
from processing.refinement.joint_kernels import Solved
from processing.refinement.node_pixels import Photos, Picture, pixel_kernel
from processing.refinement.nodes import (
    GridKnows,
    NodeSites,
    banded_nodes,
    grid_light,
    node_sites,
    step_px,
)
from processing.refinement.scene import (
    Scene,
    View,
    from_edge,
    gloss_of,
    place_of,
    read_sight,
)
from processing.surface import Sight, at_vertices_to, depth_edges, depth_of, see

NEIGHBOURS_MM = (16.0, 4.0, 1.0)
"""Sigmas over which a pixel's neighbours have an albedo: the widest, where less is not trusted."""
BAND_PIXELS = 500_000
"""Pixels whose own light is gathered at a time: what they need is held no longer."""


@dataclasses.dataclass(frozen=True)
class SolvedView:
    """A view's maps.

    Attributes:
        mask: (h, w) bool, pixels that show the mesh.
        maps: of these.
        between_nodes: share of them whose light was interpolated.
    """

    mask: np.ndarray
    maps: Maps
    between_nodes: float


def solve_view(
    scene: Scene,
    frames: Frames,
    camera: Camera,
    foreground: np.ndarray,
    grid: View,
    found: Solved,
    config: RefineConfig,
) -> SolvedView:
    """Maps of all of a view's pixels.

    Args:
        scene: with its gloss found.
        frames: the camera's photographs.
        camera: the view.
        foreground: (h, w) bool.
        grid: pixels of the same view.
        found: the grid's pixels.
        config: see there.

    Returns:
        Maps; where a pixel cannot be solved, of no confidence: its neighbours' albedo and the
        mesh's normal and gloss.
    """
    knows = grid_knows(scene, grid, found, config)
    sites = light = None
    # Polarisers make what a lamp gives depend on the pixel: that is not interpolated.
    if step_px(px_per_mm(camera), config) > 1 and not scene.lights.polarised:
        light = grid_light(scene, camera, knows)
        sites = node_sites(scene, camera, foreground, light, knows, config)
    picture = pictured(scene, camera, foreground, sites, config)
    count = int(picture.first[-1])
    maps, done = empty_maps(count), np.zeros(count, bool)
    limits = limits_of(config, scene.doubt, scene.noisier)
    if sites is not None and light is not None:
        photos = photos_of(frames, scene.lights.colour, config)
        spread = spread_of(config.noise, knows.around)
        for nodes in banded_nodes(scene, sites, light, knows):
            pixel_kernel(photos, nodes, picture, spread, config.rounds, limits, maps, done)
    share = float(done.mean()) if count else 0.0
    left = picture.mask.copy()
    left[picture.mask] = ~done
    rows, columns = np.nonzero(left)
    places, of_grid = np.flatnonzero(~done), columns_of(knows)
    for first in range(0, len(places), BAND_PIXELS):
        band = slice(first, first + BAND_PIXELS)
        some = np.zeros(left.shape, bool)
        some[rows[band], columns[band]] = True
        sight = see(scene.surface, camera, some)
        met = sight.mask[rows[band], columns[band]]
        view = read_sight(frames, camera, sight, scene, config)
        inside = picture.inside[sight.mask] / np.float32(4)
        given = solve_exactly(scene, view, knows, of_grid, inside, config)
        finish(given, places[band][met], limits, maps)
    return SolvedView(picture.mask, maps, share)


def columns_of(knows: GridKnows) -> np.ndarray:
    """(n, 5 + 3 P): normal, roughness, specular albedo, and what wanders here."""
    rest = knows.around.rest.reshape(len(knows.roughness), -1)
    given = [knows.found.normal, knows.roughness, knows.specular, rest]
    return np.column_stack(given)


def grid_knows(scene: Scene, grid: View, found: Solved, config: RefineConfig) -> GridKnows:
    """What a grid gives all pixels of its view."""
    sight, around = grid.sight, around_of(scene, grid, found)
    evidence = grid_evidence(scene, grid, found, config)
    roughness, specular = gloss_of(scene, sight)
    spread = config.gloss_spread / np.sqrt(scene.doubt)
    wrong = mistaken(scene, [found], config)
    wrong = at_vertices_to(wrong[:, None], sight.shadows.corners, sight.shadows.weights)[:, 0]
    specular = local_specular(
        evidence,
        specular,
        sight.mask,
        config.specular_detail_mm * grid.px_per_mm,
        config.specular_detail_spread / np.sqrt(scene.doubt),
        config.specular_pool_mm * grid.px_per_mm,
        1 / (1 + (wrong / spread) ** 2),
    )
    inside = from_edge(sight, config) * sight.step
    nothing = np.zeros((len(specular), 3), np.float32)
    given = finish_given(scene, grid, found, roughness, specular, nothing, inside)
    alone = empty_maps(len(given))
    finish(given, np.arange(len(given)), limits_of(config, scene.doubt, scene.noisier), alone)
    # A pixel that is hardly trusted takes its neighbours' albedo.
    # Where none is trusted far around, they have one another still.
    weight = np.maximum(alone.confidence[:, None] ** 2, LEAST_WEIGHT)
    prior = _neighbours_albedo(found.lit * weight, found.power * weight, grid, config)
    return GridKnows(grid, found, around, roughness, specular, prior)


def _neighbours_albedo(
    lit: np.ndarray, power: np.ndarray, grid: View, config: RefineConfig
) -> np.ndarray:
    """(n, 3) float32 albedo around each pixel of a grid, from farther away where it is not known.

    Args:
        lit: (n, 3) light times irradiance, by trust.
        power: (n, 3) squared irradiance, by trust.
        grid: the pixels.
        config: see there.
    """
    mask = grid.sight.mask
    near = lit.sum(axis=0) / np.maximum(power.sum(axis=0), 1e-30)
    for wide_mm in NEIGHBOURS_MM:
        wide_px = wide_mm * grid.px_per_mm
        top, bottom = (
            np.stack([pooled(values[:, c], mask, wide_px) for c in range(3)], axis=1)
            for values in (lit, power)
        )
        known = bottom + config.albedo_prior_power
        near = (top + config.albedo_prior_power * near) / known
    return np.asarray(near, np.float32)


def pictured(
    scene: Scene,
    camera: Camera,
    foreground: np.ndarray,
    sites: NodeSites | None,
    config: RefineConfig,
) -> Picture:
    """Which pixels of a (h, w) foreground show the mesh, and how far each is from an edge.

    Between safe nodes all do, and there is no edge; elsewhere rays decide.
    """
    needed = foreground
    if sites is not None:
        safe = np.zeros(foreground.shape, bool)
        cells = sites.safe.repeat(sites.sight.step, axis=0).repeat(sites.sight.step, axis=1)
        height, width = np.minimum(cells.shape, safe.shape).tolist()
        safe[:height, :width] = cells[:height, :width]
        needed = foreground & ~safe
    near = cv2.dilate(needed.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
    depth = depth_of(scene.surface, camera, near & foreground)
    mask = foreground & ~(needed & np.isinf(depth))
    edges = depth_edges(depth, config.depth_step_mm, needed)
    distance = edge_distance_px(mask & ~edges)
    np.multiply(distance, 4, out=distance)
    inside = np.minimum(distance, 255, out=distance).astype(np.uint8)
    first = np.concatenate([[0], np.cumsum(np.count_nonzero(mask, axis=1))])
    return Picture(mask, first, inside)


def photos_of(frames: Frames, white: np.ndarray, config: RefineConfig) -> Photos:
    """What compiled code takes of a camera's photographs; `white` is (3,), the lights' colour."""
    return Photos(
        np.asarray(frames.half).view(np.uint16),
        np.asarray(frames.clipped),
        np.float32(frames.scale),
        frames.window.top,
        frames.window.left,
        np.concatenate([white, white / np.linalg.norm(white)]).astype(np.float32),
        config.dark_level,
    )


def solve_exactly(
    scene: Scene,
    view: View,
    knows: GridKnows,
    of_grid: np.ndarray,
    inside: np.ndarray,
    config: RefineConfig,
) -> np.ndarray:
    """(n, GIVEN) what `finish` takes of n pixels whose own light is gathered.

    Args:
        scene: with its gloss found.
        view: the pixels.
        knows: what the grid gives.
        of_grid: (m, 5 + 3 P) its columns, see `columns_of`.
        inside: (n,) pixels to the nearest edge.
        config: see there.
    """
    sight = view.sight
    # Where the grid has no pixel nearby the mesh's own gloss and normals are all there is.
    roughness, specular = gloss_of(scene, sight)
    # Where the grid was not solved, as at clipped pixels, light that wanders in the skin is not
    # known, which is not none.
    known = np.einsum("nk,nk->n", of_grid[:, :3], of_grid[:, :3]) > 0.5
    columns, near = enlarged(of_grid, known, knows.view.sight, sight)
    roughness[near], specular[near] = columns[near, 3:5].T
    length = np.linalg.norm(columns[:, :3], axis=1, keepdims=True)
    begin = np.where(length > 0.5, columns[:, :3] / np.maximum(length, 0.5), sight.normals)
    begin = np.where(view.usable[:, None], begin, 0)
    rest = columns[:, 5:].reshape(-1, *knows.around.rest.shape[1:])
    # What its neighbours have, a pixel of the grid has too that was not solved itself.
    prior, _ = enlarged(knows.prior, np.ones(len(known), bool), knows.view.sight, sight)
    pixels = Given(
        view.rgb,
        scene.lights,
        place_of(scene, view),
        begin,
        roughness,
        specular,
        scene.interface,
        dataclasses.replace(knows.around, rest=rest),
        config.noise,
    )
    solved = solve_jointly(pixels, config.rounds)
    return finish_given(scene, view, solved, roughness, specular, prior, inside)


def finish_given(
    scene: Scene,
    view: View,
    solved: Solved,
    roughness: np.ndarray,
    specular: np.ndarray,
    prior: np.ndarray,
    inside: np.ndarray,
) -> np.ndarray:
    """(n, GIVEN) float32 what `finish` takes of n solved pixels."""
    sight = view.sight
    albedo = np.divide(
        solved.lit, solved.power, out=np.zeros_like(solved.lit), where=solved.power > 0
    )
    # Polarised light needs no colour to show what is mirrored.
    colourful = np.full_like(view.saturation, 1e9) if scene.lights.polarised else view.saturation
    given = np.column_stack(
        [
            solved.normal, solved.matte, albedo, solved.power, solved.misfit, solved.certainty,
            colourful, sight.normals, facing(sight.normals, sight.views), inside, prior,
            roughness, specular, view.usable, sight.occlusion, sight.views,
            solved.matte_turn2,
        ]
    ).astype(np.float32, copy=False)  # fmt: skip
    assert given.shape[1] == GIVEN
    return given


def enlarged(
    values: np.ndarray, known: np.ndarray, grid: Sight, view: Sight
) -> tuple[np.ndarray, np.ndarray]:
    """Values (m, k) of a grid's pixels at n pixels of the whole view, linearly between them.

    Args:
        values: of the grid's pixels.
        known: (m,) bool, those that have values.
        grid: its pixels.
        view: all pixels.

    Returns:
        (n, k), and (n,) bool whether the grid has a value near by.
    """
    number = np.full(grid.mask.shape, -1, np.int32)
    number[grid.mask] = np.where(known, np.arange(len(values)), -1)
    rows, columns = np.nonzero(view.mask)
    flat = np.ascontiguousarray(values, np.float32)
    found, near = np.zeros((len(rows), flat.shape[1]), np.float32), np.zeros(len(rows), bool)
    _enlarge(rows, columns, grid.step, number, flat, found, near)
    return found, near


@njit(parallel=True, cache=True, error_model="numpy")
def _enlarge(
    rows: np.ndarray, columns: np.ndarray, step: int, number: np.ndarray, values: np.ndarray,
    found: np.ndarray, near: np.ndarray,
) -> None:  # fmt: skip
    """Fill in what `enlarged` returns; `number` is (h, w) the grid's pixels, -1 where none is."""
    for i in prange(len(rows)):
        top, left = rows[i] // step, columns[i] // step
        down = np.float32(rows[i] - top * step) / np.float32(step)
        right = np.float32(columns[i] - left * step) / np.float32(step)
        total = np.float32(0)
        for y in range(2):
            for x in range(2):
                own = number[min(top + y, len(number) - 1), min(left + x, number.shape[1] - 1)]
                if own < 0:
                    continue
                one = np.float32(1)
                share = (down if y else one - down) * (right if x else one - right)
                total += share
                for k in range(values.shape[1]):
                    found[i, k] += share * values[own, k]
        near[i] = total > 1e-3
        if near[i]:
            for k in range(values.shape[1]):
                found[i, k] /= total
