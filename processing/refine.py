"""Stage `refine`: exact maps of each view, with the mesh's positions, shadows and lobes."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from lightstage.commands import ProgressCallback, quiet
from lightstage.formats.mesh import Mesh, read_ply
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.session import Session
from lightstage.rig import Camera
from processing.albedo import diffuse_albedo
from processing.bounces import bounced_light, other_skin, vertex_irradiance
from processing.errors import ProcessingError
from processing.frames import Frames, read_foreground, read_frames
from processing.gloss import Gloss, better_gloss, local_specular, skin_gloss, sum_at_vertices
from processing.interface import skin_interface
from processing.joint import (
    Noise,
    Place,
    Scattered,
    Solved,
    gloss_evidence,
    solve_jointly,
)
from processing.lights import PatternLights, Shadows, pattern_lights, require_unpolarised
from processing.masks import edge_distance_px
from processing.pixels import MAP_NAMES, PixelMaps, write_maps
from processing.readings import px_per_mm, read_pixels
from processing.scattering import scattered, unscattered
from processing.surface import LitSurface, Sight, at_vertices_to, depth_edges, lit_surface, see

ALL = slice(None)
BAND_PIXELS = 1_000_000
"""Pixels that are solved at a time: what they need besides their maps is held no longer."""


@dataclasses.dataclass(frozen=True)
class RefineConfig:
    """What `refine` may be told."""

    most_faces: int = 120_000
    """A denser mesh is thinned: shadows are cast from its vertices."""
    finest_mm: float = 1.2
    """A coarser mesh is split to edges of this length, which hold the edges of shadows."""
    shadow_offset_mm: float = 0.1
    """Shadow rays start this far off the mesh, beyond its own roughness."""
    smoothing_mm: float = 1.0
    """Over which the mesh's normals are averaged."""
    occlusion_directions: int = 200
    """Directions over the sphere for ambient occlusion."""
    bounce_rays: int = 512
    """Rays of each vertex to other skin, at most; 0 leaves out light from skin to skin."""
    bounce_rays_all: int = 8_000_000
    """Rays of all vertices together, at most."""
    scattering: tuple[float, ...] = (0.0, 0.25, 0.5, 0.75)
    """Shares of light that wanders inside the skin that are tried."""
    noise_sensor: float = 0.001
    noise_model: float = 0.003
    noise_shade_gloss: float = 0.03
    noise_shade: float = 0.003
    """Of the readings: see `joint.Noise`; for gloss, colour counts more than the model of light."""
    gloss_rounds: int = 3
    """Steps of the search for roughness and specular albedo."""
    gloss_pixels: int = 500_000
    """At most this many pixels of a view, on a regular grid, give evidence of gloss."""
    roughness: float = 0.28
    """Beckmann's m to start from; skin has .2 to .35."""
    roughness_pool_mm: float = 5.0
    specular_pool_mm: float = 3.0
    """Sigma over which all views' evidence is pooled on the mesh."""
    specular_detail_mm: float = 0.5
    """Sigma over which one view's pixels share a specular albedo finer than the mesh's."""
    specular_detail_spread: float = 0.002
    """Standard deviation of that detail."""
    gloss_prior: float = 0.02
    """The face's own mean counts as this share of a typical vertex's evidence."""
    rounds: int = 2
    """Steps of the last solve of each pixel."""
    albedo_prior_power: float = 0.005
    """Weight of the neighbours' albedo against a pixel's squared irradiance (2 in the open)."""
    grey_saturation: float = 0.05
    """Below this saturation colour tells nothing; from twice as much it is trusted."""
    dark_level: float = 0.004
    """A pixel whose brightest pattern stays below this tells nothing (1 = white under `full`)."""
    dark_power: float = 0.1
    """Where a pixel's squared irradiance is so much (2 in the open) it is trusted by half."""
    doubtful_misfit: float = 40.0
    """Where the residual's variance is so many times what is expected, by half again."""
    doubtful_turn_deg: float = 2.0
    """Where noise turns the normal by so much, by half again."""
    coarse_confidence: float = 0.3
    """Share of their confidence that coarse maps keep where the mesh has a hole."""
    steady_below: float = 0.4
    """Normals of less confidence are drawn to the mesh's."""
    edge_px: float = 3.0
    """Confidence falls to 0 over this many pixels before an edge of mask or depth."""
    depth_step_mm: float = 4.0
    """A larger step between neighbouring pixels is an edge."""

    @property
    def noise(self) -> Noise:
        """Of the readings, for normals and albedo."""
        return Noise(self.noise_sensor, self.noise_model, self.noise_shade)

    @property
    def gloss_noise(self) -> Noise:
        """Of the readings, for gloss."""
        return Noise(self.noise_sensor, self.noise_model, self.noise_shade_gloss)


@dataclasses.dataclass(frozen=True)
class View:
    """One view's readings and what the mesh says of its n pixels.

    Attributes:
        sight: what the camera sees of the mesh.
        rgb: (n, P, 3) float32 readings in the lights' own colour, 0 where not usable.
        saturation: (n,) of the sum over patterns.
        usable: (n,) bool: not clipped, not dark, finite.
        px_per_mm: pixels a millimetre.
    """

    sight: Sight
    rgb: np.ndarray
    saturation: np.ndarray
    usable: np.ndarray
    px_per_mm: float


@dataclasses.dataclass
class Scene:
    """What all views share, and what has been found of it so far.

    Attributes:
        lights: of P patterns.
        surface: the mesh under them.
        gloss: of its vertices.
        bounced: (V, P, 3) float32 irradiance of its vertices by light from other skin.
        bounces: 1 where `bounced` explains the readings better than nothing does, else 0.
        scattering: share of light that wanders inside the skin.
    """

    lights: PatternLights
    surface: LitSurface
    gloss: Gloss
    bounced: np.ndarray
    bounces: float
    scattering: float


def refine(
    session: Session, out: Path, config: RefineConfig, progress: ProgressCallback = quiet
) -> dict[str, Any]:
    """Solve reflectance again with the mesh, and overwrite the views' maps and masks.

    Gloss, light from skin to skin and scattering are found first, from a grid of every view's
    pixels; then each view's pixels are solved one by one.

    Returns:
        Facts: pixels, vertices, mean confidence, gloss and scattering found.

    Raises:
        FormatError: no base mesh, or no decoded photographs.
        ProcessingError: a camera that sees nothing of the mesh.
    """
    folder = ProcessedFolder(out)
    mesh = read_ply(folder.base_mesh)
    cameras = [session.rig.camera(camera_id) for camera_id in session.camera_ids()]
    lights = pattern_lights(session, read_frames(out, cameras[0].id).patterns)
    require_unpolarised(lights)
    steps = 3 + config.gloss_rounds + len(cameras)
    seen_by = [(camera, read_foreground(out, camera.id)) for camera in cameras]
    scene = prepare_scene(mesh, lights, seen_by, config)
    progress(1, steps)
    grids = [
        read_view(read_frames(out, camera.id), camera, lit, scene, config, config.gloss_pixels)
        for camera, lit in seen_by
    ]
    progress(2, steps)
    found = find_gloss(scene, grids, config, lambda done, _: progress(2 + done, steps))
    confidence: dict[str, float] = {}
    pixels = 0
    for done, (camera, lit) in enumerate(seen_by):
        grid = view = grids[done]
        if grid.sight.step > 1:
            view = read_view(read_frames(out, camera.id), camera, lit, scene, config)
        maps = solve_view(scene, view, grid, found[done], config)
        mask = view.sight.mask
        occlusion = np.ones(mask.shape, np.float32)
        occlusion[mask] = view.sight.occlusion
        mask, maps = with_coarse(folder, camera.id, mask, maps, config.coarse_confidence)
        write_maps(folder, camera.id, mask, maps)
        folder.write_view(camera.id, "ambient_occlusion", np.where(mask, occlusion, 0))
        folder.write_mask(camera.id, mask)
        confidence[camera.id] = round(float(maps.confidence.mean()), 4)
        pixels += len(maps.confidence)
        progress(3 + config.gloss_rounds + done, steps)
    seen = np.unique(np.concatenate([grid.sight.shadows.corners.ravel() for grid in grids]))
    return {
        "views": len(cameras),
        "pixels": pixels,
        "vertices": len(scene.surface.vertices),
        "mean_confidence": confidence,
        "roughness_mean": round(float(scene.gloss.roughness[seen].mean()), 4),
        "specular_mean": round(float(scene.gloss.specular[seen].mean()), 5),
        "light_from_skin_to_skin": bool(scene.bounces),
        "scattering": scene.scattering,
        "specular_normals": "all channels and the highlights, the relief of the diffuse light "
        "calmed by scattering",
        "warnings": [],
    }


def prepare_scene(
    mesh: Mesh,
    lights: PatternLights,
    seen_by: list[tuple[Camera, np.ndarray]],
    config: RefineConfig,
) -> Scene:
    """Cast the mesh's rays; gloss is a typical skin's, and no light goes from skin to skin yet."""
    surface = lit_surface(
        mesh,
        lights,
        offset_mm=config.shadow_offset_mm,
        smoothing_mm=config.smoothing_mm,
        directions=config.occlusion_directions,
        most_faces=config.most_faces,
        finest_mm=config.finest_mm,
        seen_by=seen_by,
    )
    count = len(surface.vertices)
    dark = np.zeros((count, len(lights.patterns), 3), np.float32)
    return Scene(lights, surface, skin_gloss(count, config.roughness), dark, 0.0, 0.0)


def read_view(
    frames: Frames,
    camera: Camera,
    foreground: np.ndarray,
    scene: Scene,
    config: RefineConfig,
    most: int | None = None,
) -> View:
    """One view's readings, and what it shows of the mesh.

    Args:
        frames: the camera's photographs.
        camera: the view.
        foreground: (h, w) bool.
        scene: the mesh under the lights.
        config: see there.
        most: at most about so many pixels, on a regular grid; None for all.

    Raises:
        ProcessingError: nothing of the mesh is seen.
    """
    step = 1
    if most is not None:
        step = max(1, int(np.ceil(np.sqrt(foreground.sum() / most))))
    sight = see(scene.surface, camera, foreground, step)
    if not sight.mask.any():
        raise ProcessingError(
            f"camera {camera.id}",
            found="no pixel that shows the mesh",
            expected="a face in front of the camera",
            hint="Do base_mesh.ply and the rig belong to this session?",
        )
    chosen = np.zeros(foreground.shape, bool)
    chosen[::step, ::step] = sight.mask
    white = scene.lights.colour
    count = int(sight.mask.sum())
    rgb = np.empty((count, len(frames.patterns), 3), np.float32)
    saturation, usable = np.empty(count, np.float32), np.empty(count, bool)
    valid = frames.valid
    done = 0
    rows = max(1, BAND_PIXELS * step**2 // foreground.shape[1])
    for first in range(0, len(chosen), rows):
        some = np.zeros_like(chosen)
        some[first : first + rows] = chosen[first : first + rows]
        pixels = frames.pixels(some)
        band = slice(done, done + len(pixels))
        clean, _, colourful, good = read_pixels(pixels, valid[some], white, config.dark_level)
        rgb[band], saturation[band], usable[band] = clean, colourful, good
        done += len(pixels)
    rgb /= white.astype(np.float32)
    return View(sight, rgb, saturation, usable, px_per_mm(camera) / step)


def find_gloss(
    scene: Scene, grids: list[View], config: RefineConfig, progress: ProgressCallback = quiet
) -> list[Solved]:
    """Find gloss, bounced light and scattering from grids of the views' pixels.

    Args:
        scene: changed in place.
        grids: the views.
        config: see there.
        progress: of rounds.

    Returns:
        Each grid's pixels as solved.
    """
    surface = scene.surface
    interface = skin_interface()
    between, entered = None, np.zeros(0)
    if config.bounce_rays:
        rays = max(16, min(config.bounce_rays, config.bounce_rays_all // surface.coarse))
        between = other_skin(surface, rays)
        entered = vertex_irradiance(surface, scene.lights, interface, config.roughness)
    solved = [solve_grid(scene, grid, None, config) for grid in grids]
    for done in range(config.gloss_rounds):
        if done:
            solved = [solve_grid(scene, g, b, config) for g, b in zip(grids, solved, strict=True)]
        if between is not None:
            albedo = vertex_albedo(surface, grids, solved)
            bounced = bounced_light(surface, between, entered, albedo)
            if done == 0:
                scene.bounces = best_bounces(scene, bounced, grids[0], solved[0], config)
            scene.bounced = np.float32(scene.bounces) * bounced
        if done == 0:
            scene.scattering = best_scattering(scene, grids[0], solved[0], config)
        sums = np.zeros((len(surface.vertices), 5))
        for grid, found in zip(grids, solved, strict=True):
            evidence = grid_evidence(scene, grid, found, config)
            corners, weights = grid.sight.shadows.corners, grid.sight.shadows.weights
            sums += sum_at_vertices(evidence, corners, weights, len(surface.vertices))
        scene.gloss = better_gloss(
            scene.gloss,
            sums,
            surface,
            roughness_pool_mm=config.roughness_pool_mm,
            specular_pool_mm=config.specular_pool_mm,
            prior=config.gloss_prior,
        )
        progress(done + 1, config.gloss_rounds)
    return solved


def solve_grid(scene: Scene, view: View, before: Solved | None, config: RefineConfig) -> Solved:
    """One step with what the scene knows so far, from the step before or the mesh's normals."""
    sight = view.sight
    if before is None:
        start = np.where(view.usable[:, None], sight.normals, 0)
        around = unscattered(len(start), len(scene.lights.patterns))
    else:
        start, around = before.normal, around_of(scene, view, before)
    return solve_jointly(
        view.rgb,
        scene.lights,
        place_of(scene, sight),
        start,
        *gloss_of(scene, sight),
        skin_interface(),
        around,
        config.noise,
        rounds=1,
    )


def around_of(scene: Scene, view: View, solved: Solved) -> Scattered:
    """Light that wanders to each pixel of a view from its neighbours."""
    # A slope is shorter in the picture than it is.
    shrunk = float(np.sqrt(np.einsum("nk,nk->n", view.sight.normals, view.sight.views).mean()))
    px_per_mm = view.px_per_mm * shrunk
    return scattered(solved.irradiance, view.sight.mask, px_per_mm, scene.scattering)


def grid_evidence(scene: Scene, view: View, solved: Solved, config: RefineConfig) -> np.ndarray:
    """(n, 5) what the pixels say of the gloss; those at steep angles and edges say nothing."""
    sight = view.sight
    evidence = gloss_evidence(
        view.rgb,
        scene.lights,
        place_of(scene, sight),
        solved.normal,
        *gloss_of(scene, sight),
        skin_interface(),
        around_of(scene, view, solved),
        config.gloss_noise,
    )
    return np.asarray(evidence * steady(view, config)[:, None])


def steady(view: View, config: RefineConfig) -> np.ndarray:
    """(n,) 0..1: how far a pixel is from edges and from being seen edge on."""
    sight = view.sight
    facing = (np.maximum(np.einsum("nk,nk->n", sight.normals, sight.views), 0) / 0.8) ** 0.7
    edges = depth_edges(sight.depth_mm, config.depth_step_mm)
    inside = edge_distance_px(sight.mask & ~edges)[sight.mask] * sight.step
    return np.asarray(np.clip(facing, 0, 1) * np.clip(inside / config.edge_px, 0, 1))


def best_bounces(
    scene: Scene, bounced: np.ndarray, view: View, solved: Solved, config: RefineConfig
) -> float:
    """1 where light from other skin explains one view's pixels better than its absence, else 0.

    A stage is never without it, but renderings may be; the pixels that it lights most are asked.
    """
    sight = view.sight
    share = at_vertices_to(bounced.mean(axis=(1, 2)), sight.shadows.corners, sight.shadows.weights)
    good = (solved.misfit > 0) & (steady(view, config) > 0.5)
    if not good.any():
        return 0.0
    good &= share >= np.median(share[good])
    misfits = []
    for light in (0.0, 1.0):
        tried = dataclasses.replace(scene, bounced=np.float32(light) * bounced)
        again = solve_grid(tried, view, solved, config)
        misfits.append(float(np.median(again.misfit[good])))
    return float(misfits[1] < misfits[0])


def best_scattering(scene: Scene, view: View, solved: Solved, config: RefineConfig) -> float:
    """The share of wandering light that explains one view's pixels best.

    Relief that is calmer in red than in blue is light that wandered: another share leaves more of
    the readings unexplained.
    """
    misfits: list[float] = []
    for amount in config.scattering if len(config.scattering) > 1 else ():
        tried = dataclasses.replace(scene, scattering=amount)
        again = solve_grid(tried, view, solve_grid(tried, view, solved, config), config)
        good = (again.misfit > 0) & (steady(view, config) > 0.5)
        misfits.append(float(np.median(again.misfit[good])) if good.any() else 0.0)
    return config.scattering[int(np.argmin(misfits)) if misfits else 0]


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


def place_of(scene: Scene, sight: Sight, band: slice = ALL) -> Place:
    """Where a view's pixels lie."""
    return Place(
        sight.points_mm[band],
        sight.views[band],
        Shadows(sight.shadows.corners[band], sight.shadows.weights[band], sight.shadows.visible),
        scene.bounced,
    )


def joined(parts: list[Solved]) -> Solved:
    """The pixels of several bands as one."""
    names = [field.name for field in dataclasses.fields(Solved)]
    return Solved(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def gloss_of(scene: Scene, sight: Sight) -> tuple[np.ndarray, np.ndarray]:
    """(n,) roughness and (n,) specular albedo of a view's pixels, from the mesh."""
    corners, weights = sight.shadows.corners, sight.shadows.weights
    both = np.stack([scene.gloss.roughness, scene.gloss.specular], axis=1).astype(np.float32)
    roughness, specular = at_vertices_to(both, corners, weights).T
    return np.ascontiguousarray(roughness), np.ascontiguousarray(specular)


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
    specular = local_specular(
        evidence,
        specular,
        grid.sight.mask,
        config.specular_detail_mm * grid.px_per_mm,
        config.specular_detail_spread,
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
            place_of(scene, sight, band),
            begin,
            roughness[band],
            specular[band],
            skin_interface(),
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
    good = view.usable & (agreement > 0)
    trust = steady(view, config) * np.clip(2 * agreement, 0, 1)
    trust *= np.clip(view.saturation / config.grey_saturation - 1, 0, 1)
    power = solved.power.mean(axis=1)
    trust *= power / (power + config.dark_power)
    trust /= 1 + solved.misfit / config.doubtful_misfit
    turn2 = 1 / np.maximum(solved.certainty, 1e-12)
    trust /= 1 + turn2 / np.radians(config.doubtful_turn_deg) ** 2
    confidence = np.where(good, trust, 0).astype(np.float32)
    # A pixel that is hardly trusted takes its neighbours' albedo.
    weight = confidence[:, None] ** 2
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


def with_coarse(
    folder: ProcessedFolder, camera_id: str, mask: np.ndarray, maps: PixelMaps, share: float
) -> tuple[np.ndarray, PixelMaps]:
    """A view's maps with those of `separate` where the mesh has a hole, if there are any.

    Args:
        folder: holds the coarse maps.
        camera_id: the view.
        mask: (h, w) bool with n true pixels.
        maps: of these.
        share: of their confidence that coarse maps keep.

    Returns:
        The (h, w) mask of all, and their maps.
    """
    if not all(folder.view_path(camera_id, name).is_file() for name in MAP_NAMES.values()):
        return mask, maps
    every = mask | folder.read_mask(camera_id)
    values = {}
    for field, name in MAP_NAMES.items():
        whole = folder.read_view(camera_id, name)
        if field == "confidence":
            whole = whole * np.float32(share)
        whole[mask] = getattr(maps, field)
        values[field] = whole[every]
    return every, PixelMaps(**values)


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
