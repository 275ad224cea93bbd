"""A photograph brought into the texture of the mesh that it shows."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import open3d

from learning.photo.sampling import averaged, sampled
from learning.render.uv import UvRaster
from learning.render.view import cast_from, scene_of
from lightstage.formats.mesh import Mesh
from lightstage.rig import Camera

SAME_MM = 1.0
"""A texel is seen where a ray toward it meets the surface no farther from it than that."""
STEP_MM = 8.0
"""A change of depth within `EDGE_MM` that is an edge: a texel behind it may show what is before
it, as the shape is never quite that of the photograph."""
EDGE_MM = 1.5
EDGE_PX = 4
"""That many pixels of the picture of depth where it is fine enough, and never less than one."""
GRAZING = 0.2
"""Cosine to the camera below which a texel is not taken from the photograph."""
LARGEST_DEPTH_PX = 1024
"""Edges of depth are searched for in a picture of the head of so many pixels a side at most."""
BESIDE_MM = 10.0
"""Of the scene around what is seen, in that picture."""
LEAST_ISLAND = 0.02
"""Of the largest island of seen texels: smaller ones are slivers."""


@dataclasses.dataclass(frozen=True)
class Unwrapped:
    """A photograph in texels.

    Attributes:
        texture: (rows, columns, 3) float32 linear; zero where nothing is seen.
        seen: (rows, columns) bool.
        facing: (rows, columns) float32, cosine between the surface and the direction to the camera.
    """

    texture: np.ndarray
    seen: np.ndarray
    facing: np.ndarray


def unwrap(
    rgb_linear: np.ndarray,
    mesh: Mesh,
    raster: UvRaster,
    camera: Camera,
    person: np.ndarray | None = None,
) -> Unwrapped:
    """Sample a photograph at each texel of a mesh that it shows.

    Args:
        rgb_linear: (h, w, 3).
        mesh: in the camera's world, mm.
        raster: of the texture.
        camera: the photograph's; its size is that of `rgb_linear`.
        person: (h, w) bool, pixels that show the person; all where None.
    """
    covered = raster.covered
    position = raster.interpolate(mesh.vertices)[covered].astype(float)
    normal = raster.normals(mesh)[covered]
    toward = camera.centre_mm - position
    distance = np.linalg.norm(toward, axis=1)
    cosine = (normal * toward).sum(axis=1) / np.maximum(distance, 1e-9)
    place, depth = camera.project(position)
    inside = (depth > 0) & (place > 0.5).all(axis=1)
    inside &= (place < [camera.width_px - 0.5, camera.height_px - 0.5]).all(axis=1)
    seen = inside & (cosine > GRAZING)
    scene = scene_of(mesh)
    met = cast_from(scene, camera.centre_mm, -toward[seen] / distance[seen, None])["t_hit"]
    seen[seen] = met > distance[seen] - SAME_MM / np.maximum(cosine[seen], GRAZING)
    if seen.any():
        seen[seen] = ~_edges(scene, camera, place[seen], float(np.median(distance[seen])))
    if person is not None:
        column, row = place[seen].astype(int).T
        seen[seen] = person[row, column]
    texture = np.zeros((*covered.shape, 3), np.float32)
    texture[covered] = _sampled(rgb_linear, place, seen, covered)
    return Unwrapped(texture, _spread(seen, covered), _spread(cosine.astype(np.float32), covered))


def without_slivers(unwrapped: Unwrapped, keep: np.ndarray) -> Unwrapped:
    """A photograph in texels without its small islands apart from the rest.

    Such an island is a sliver of an ear or of the scalp at the head's outline, where the fitted
    shape is least the person's: it mostly shows what is beside it.

    Args:
        unwrapped: of `unwrap`.
        keep: (rows, columns) bool; an island that reaches into it stays, such as an eye.
    """
    seen = unwrapped.seen
    count, label, about, _ = cv2.connectedComponentsWithStats(seen.astype(np.uint8), connectivity=4)
    area = np.where(np.arange(count) > 0, about[:, cv2.CC_STAT_AREA], 0)
    stays = area >= LEAST_ISLAND * area.max()
    stays[np.unique(label[keep & seen])] = True
    seen = seen & stays[label]
    return Unwrapped(unwrapped.texture * seen[..., None], seen, unwrapped.facing)


def smaller(camera: Camera, largest_px: int) -> Camera:
    """The camera with a picture of so many pixels a side, where its own has more."""
    longer = max(camera.width_px, camera.height_px)
    return camera if longer <= largest_px else camera.scaled(largest_px / longer)


def depth_camera(
    camera: Camera, away_mm: float, place_px: np.ndarray
) -> tuple[Camera, int, np.ndarray]:
    """The camera of the picture in which edges of depth are searched for, and how far, in pixels.

    In a photograph of few pixels the cheek's slope would be a step of depth from pixel to pixel,
    so that the picture of depth has pixels of its own: as large as `EDGE_MM` asks, of at most
    `LARGEST_DEPTH_PX` a side. It shows the head alone, which may be small in its photograph.

    Args:
        camera: of the photograph.
        away_mm: distance of what it shows.
        place_px: (n, 2) where that is in the photograph.

    Returns:
        The camera, the pixels, and the (2,) corner of its picture in the photograph.
    """
    beside = BESIDE_MM * camera.fx_px / away_mm
    size = np.array([camera.width_px, camera.height_px])
    low = np.clip(np.floor(place_px.min(axis=0) - beside), 0, size - 1)
    high = np.clip(np.ceil(place_px.max(axis=0) + beside), low + 1, size)
    width, height = (high - low).astype(int).tolist()
    part = dataclasses.replace(
        camera,
        width_px=width,
        height_px=height,
        cx_px=camera.cx_px - low[0],
        cy_px=camera.cy_px - low[1],
    )
    finest = EDGE_PX * away_mm / (EDGE_MM * camera.fx_px)
    scale = min(finest, LARGEST_DEPTH_PX / max(width, height))
    return part.scaled(scale), max(1, round(EDGE_PX * scale / finest)), low


def _edges(
    scene: open3d.t.geometry.RaycastingScene,
    camera: Camera,
    place_px: np.ndarray,
    away_mm: float,
) -> np.ndarray:
    """(n,) bool, whether (n, 2) places, so far away, are beside a step of depth."""
    small, reach, corner = depth_camera(camera, away_mm, place_px)
    met = cast_from(scene, *small.pixel_rays())["t_hit"]
    depth = np.where(np.isfinite(met), met, 1e6).reshape(small.height_px, small.width_px)
    kernel = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
    step = cv2.dilate(depth, kernel) - cv2.erode(depth, kernel) > STEP_MM
    # Only what is behind the step is in doubt.
    behind = step & (depth > cv2.erode(depth, kernel) + STEP_MM / 2)
    doubtful = behind | (step & (cv2.dilate(depth, kernel) >= 1e5))
    at = (place_px - corner) * (small.fx_px / camera.fx_px)
    columns = np.clip(at[:, 0].astype(int), 0, small.width_px - 1)
    rows = np.clip(at[:, 1].astype(int), 0, small.height_px - 1)
    found: np.ndarray = doubtful[rows, columns]
    return found


def _sampled(
    rgb: np.ndarray, place_px: np.ndarray, seen: np.ndarray, covered: np.ndarray
) -> np.ndarray:
    """(n, 3) colours; a photograph finer than the texels is averaged before."""
    factor = _pixels_of_texel(place_px, seen, covered)
    rgb, scale = averaged(rgb, factor)
    out = np.zeros((len(place_px), 3), np.float32)
    out[seen] = sampled(rgb, place_px[seen] * scale)
    return out


def _pixels_of_texel(place_px: np.ndarray, seen: np.ndarray, covered: np.ndarray) -> int:
    """Whole pixels of the photograph on the side of the median seen texel, 1 at least."""
    image = np.full((*covered.shape, 2), np.nan)
    image[covered] = np.where(seen[:, None], place_px, np.nan)
    step = np.linalg.norm(np.diff(image, axis=1), axis=2)
    known = step[np.isfinite(step)]
    return max(1, int(np.median(known))) if known.size else 1


def _spread(values: np.ndarray, covered: np.ndarray) -> np.ndarray:
    """(n,) values of the texels with a surface as (rows, columns); zero elsewhere."""
    out = np.zeros(covered.shape, values.dtype)
    out[covered] = values
    return out
