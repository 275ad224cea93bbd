"""What the views show of the mesh, and what all of them share."""

from __future__ import annotations

import dataclasses

import numpy as np

from lightstage.formats.mesh import Mesh
from lightstage.rig import Camera
from processing.errors import ProcessingError
from processing.frames.read import Frames
from processing.lighting.facets import BECKMANN, Facets
from processing.lighting.interface import Interface, skin_interface
from processing.lighting.lights import PatternLights, Shadows
from processing.lighting.polarisers import diffuse_of_normals, mirrored_of_lamps
from processing.masks import edge_distance_px
from processing.readings import px_per_mm, read_pixels
from processing.refinement.config import RefineConfig
from processing.refinement.finish import facing
from processing.refinement.gloss import Gloss, skin_gloss
from processing.refinement.joint import Given, Noise, Place, Scattered
from processing.surface import (
    LitSurface,
    Sight,
    at_vertices_to,
    depth_edges,
    lit_surface,
    see,
)

ALL = slice(None)
BAND_PIXELS = 1_000_000
"""Pixels that are solved at a time: what they need besides their maps is held no longer."""


@dataclasses.dataclass(frozen=True)
class View:
    """One view's readings and what the mesh gives of its n pixels.

    Attributes:
        sight: what the camera sees of the mesh.
        rgb: (n, P, 3) float32 readings in the lights' own colour, 0 where not usable.
        saturation: (n,) of the sum over patterns.
        usable: (n,) bool: not clipped, not dark, finite, and not turned from the camera.
        px_per_mm: pixels a millimetre.
        mirrored: (4, L) see `joint.Place`.
        diffuse: (cells, P) see there.
    """

    sight: Sight
    rgb: np.ndarray
    saturation: np.ndarray
    usable: np.ndarray
    px_per_mm: float
    mirrored: np.ndarray
    diffuse: np.ndarray


@dataclasses.dataclass(frozen=True)
class Scene:
    """What all views share, and what has been found of it so far.

    Attributes:
        lights: of P patterns.
        surface: the mesh under them.
        gloss: of its vertices.
        bounced: (V, P, 3) float32 irradiance of its vertices by light from other skin.
        bounces: 1 where `bounced` explains the readings better than nothing does, else 0.
        scattering: share of light that wanders inside the skin.
        doubt: by what factor the residuals' variance is above what is expected, at least 1.
        noisier: by what factor the variance of the readings' noise is above what is configured.
        facets: the family of the face's mirror lobes.
    """

    lights: PatternLights
    surface: LitSurface
    gloss: Gloss
    bounced: np.ndarray
    bounces: float
    scattering: float
    doubt: float = 1.0
    noisier: float = 1.0
    facets: Facets = BECKMANN

    @property
    def from_skin(self) -> np.ndarray:
        """`bounced`, or (0, P, 3) where no light goes from skin to skin."""
        return self.bounced if self.bounces else self.bounced[:0]

    @property
    def interface(self) -> Interface:
        """What the skin's surface mirrors and lets through."""
        return skin_interface(self.facets)


def prepare_scene(
    mesh: Mesh,
    lights: PatternLights,
    seen_by: list[tuple[Camera, np.ndarray]],
    config: RefineConfig,
    occluders: Mesh | None = None,
) -> Scene:
    """Cast the mesh's rays; gloss is a typical skin's, and no light goes from skin to skin yet.

    Args:
        mesh: the skin, mm, world.
        lights: of P patterns.
        seen_by: cameras and their (h, w) bool foregrounds.
        config: see there.
        occluders: what else hides lights and sky from the skin, such as clothes.
    """
    surface = lit_surface(
        mesh,
        lights,
        offset_mm=config.shadow_offset_mm,
        smoothing_mm=config.smoothing_mm,
        directions=config.occlusion_directions,
        most_faces=config.most_faces,
        finest_mm=config.finest_mm,
        seen_by=seen_by,
        occluders=occluders,
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
    view = read_sight(frames, camera, see(scene.surface, camera, foreground, step), scene, config)
    if not len(view.usable):
        raise ProcessingError(
            f"camera {camera.id}",
            found="no pixel that shows the mesh",
            expected="a face in front of the camera",
            hint="Do base_mesh.ply and the rig belong to this session?",
        )
    return view


def read_sight(
    frames: Frames, camera: Camera, sight: Sight, scene: Scene, config: RefineConfig
) -> View:
    """The readings of what a camera sees of the mesh."""
    step = sight.step
    chosen = np.zeros(frames.shape, bool)
    chosen[::step, ::step] = sight.mask
    white = scene.lights.colour
    count = int(sight.mask.sum())
    rgb = np.empty((count, len(frames.patterns), 3), np.float32)
    saturation, usable = np.empty(count, np.float32), np.empty(count, bool)
    valid = frames.valid
    until = np.cumsum(np.count_nonzero(chosen, axis=1))
    done = top = 0
    while done < count:
        # At least one row; rows with no pixel cost nothing.
        bottom = max(int(np.searchsorted(until, done + BAND_PIXELS, "right")), top + 1)
        some = np.zeros_like(chosen)
        some[top:bottom] = chosen[top:bottom]
        pixels = frames.pixels(some)
        band = slice(done, done + len(pixels))
        clean, _, colourful, good = read_pixels(pixels, valid[some], white, config.dark_level)
        rgb[band], saturation[band], usable[band] = clean, colourful, good
        done, top = done + len(pixels), bottom
    rgb /= white.astype(np.float32)
    usable &= faces_camera(sight)
    return View(
        sight,
        rgb,
        saturation,
        usable,
        px_per_mm(camera) / step,
        mirrored_of_lamps(scene.lights, camera),
        diffuse_of_normals(scene.lights, camera),
    )


def faces_camera(sight: Sight) -> np.ndarray:
    """(n,) bool: the mesh's averaged normal faces the camera. Elsewhere, at rims and in folds,
    no lobe can be reckoned with.
    """
    return np.asarray(np.einsum("nk,nk->n", sight.normals, sight.views) > 0)


def place_of(scene: Scene, view: View, some: slice | np.ndarray = ALL) -> Place:
    """Where a view's n pixels, or some of them by a slice or (k,) numbers, are."""
    sight = view.sight
    return Place(
        sight.points_mm[some],
        sight.views[some],
        Shadows(sight.shadows.corners[some], sight.shadows.weights[some], sight.shadows.visible),
        scene.from_skin,
        view.mirrored,
        view.diffuse,
    )


def gloss_of(
    scene: Scene, sight: Sight, some: slice | np.ndarray = ALL
) -> tuple[np.ndarray, np.ndarray]:
    """(n,) roughness and (n,) specular albedo of a view's pixels, or some of them, from the mesh.

    `some` is a slice or (n,) numbers.
    """
    corners, weights = sight.shadows.corners[some], sight.shadows.weights[some]
    both = np.stack([scene.gloss.roughness, scene.gloss.specular], axis=1).astype(np.float32)
    roughness, specular = at_vertices_to(both, corners, weights).T
    return np.ascontiguousarray(roughness), np.ascontiguousarray(specular)


def steady(view: View, config: RefineConfig) -> np.ndarray:
    """(n,) 0..1: how far a pixel is from edges and from being seen edge on."""
    sight = view.sight
    inside = from_edge(sight, config) * sight.step
    return np.asarray(facing(sight.normals, sight.views) * np.clip(inside / config.edge_px, 0, 1))


def from_edge(sight: Sight, config: RefineConfig) -> np.ndarray:
    """(n,) float32, how many of a sight's own pixels are between each and the nearest edge.

    An edge is one of its mask or a step of its depth; the pixels are `sight.step` apart.
    """
    steps = depth_edges(sight.depth_mm, config.depth_step_mm)
    return np.asarray(edge_distance_px(sight.mask & ~steps)[sight.mask])


def given_of(
    scene: Scene,
    view: View,
    some: slice | np.ndarray,
    normals: np.ndarray,
    around: Scattered,
    noise: Noise,
) -> Given:
    """Some of a view's pixels, a slice or (k,) numbers, with (k, 3) normals and known gloss."""
    roughness, specular = gloss_of(scene, view.sight, some)
    return Given(
        view.rgb[some],
        scene.lights,
        place_of(scene, view, some),
        normals,
        roughness,
        specular,
        scene.interface,
        around,
        noise,
    )
