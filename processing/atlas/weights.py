"""How well a view shows each texel: angle, resolution, occlusion, edges, and its own confidence."""

from __future__ import annotations

import dataclasses

import numba
import numpy as np

from lightstage.rig import Camera
from processing.atlas.sampling import readable
from processing.atlas.tiles import TileBounds, bound
from processing.atlas.visibility import depth_buffer, silhouette_distance

LEAST_WEIGHT = 1e-6
"""Texels of less weight count as not seen."""


@dataclasses.dataclass(frozen=True)
class WeightConfig:
    """How views are weighted."""

    feather_mm: float = 6.0
    """A view's weight rises from 0 at its silhouettes to full at this distance from them."""
    erode_px: float = 1.5
    """So many pixels along silhouettes hold some background and are not read at all."""
    jump_mm: float = 4.0
    """Neighbouring depths farther apart (and than eight pixels' width) are a silhouette."""
    bias_mm: float = 0.4
    """A texel this far behind the z-buffer still counts as seen ..."""
    bias_px: float = 1.5
    """... and so many pixels' worth of the surface's own slope more."""
    least_cos: float = 0.15
    """Views from flatter than this show nothing usable."""
    doubt_deg: float = 25.0
    """Where a view's normal is farther than this from the mesh's, its maps count less ..."""
    disbelief_deg: float = 50.0
    """... and not at all from here on: it was solved on a wrong surface."""


@dataclasses.dataclass(frozen=True)
class Texels:
    """The atlas's covered texels on the mesh.

    Attributes:
        positions: (k, 3) float32 mm.
        normals: (k, 3) float32 unit, the mesh's.
        trust: (k,) float32 in 0..1, how far the mesh may be believed there.
        start: (t + 1,) int64, where each tile's texels begin and the last one's end.
        bounds: of the tiles.
    """

    positions: np.ndarray
    normals: np.ndarray
    trust: np.ndarray
    start: np.ndarray
    bounds: TileBounds

    @classmethod
    def of(
        cls, positions: np.ndarray, normals: np.ndarray, trust: np.ndarray, start: np.ndarray
    ) -> Texels:
        """With the bounds that follow."""
        return cls(positions, normals, trust, start, bound(start, positions, normals, trust))


@dataclasses.dataclass(frozen=True)
class ViewSamples:
    """What one view sees of the atlas; one entry a seen texel.

    Attributes:
        slot: (k,) int32, position in the list of covered texels.
        pixel: (k, 2) float32 where the texel lies in the picture (first pixel's centre at 0.5).
        weight: (k,) float32 in 0..1.
        usable: (h, w) uint8 of `sampling.readable`, pixels that may be read.
        footprint_mm: width of a pixel on the surface.
        tiles: how many tiles were looked at; the others cannot face the view.
    """

    slot: np.ndarray
    pixel: np.ndarray
    weight: np.ndarray
    usable: np.ndarray
    footprint_mm: float
    tiles: int = 0


def view_samples(
    camera: Camera,
    vertices: np.ndarray,
    triangles: np.ndarray,
    texels: Texels,
    confidence: np.ndarray,
    mask: np.ndarray,
    measured: np.ndarray,
    finest_mm: float,
    config: WeightConfig,
) -> ViewSamples:
    """Which texels a view sees and with what weight.

    The weight is cos^2 of the viewing angle x resolution (the pixel's area on a facing surface
    against the finest view's) x the view's own confidence x the distance to its silhouettes x the
    trust in the surface there x the agreement of measured and mesh normal.

    Args:
        camera: the view.
        vertices: (n, 3) mm, the mesh that occludes.
        triangles: (t, 3).
        texels: where the atlas's texels are.
        confidence: (h, w) the view's.
        mask: (h, w) bool, the face.
        measured: (h, w, 3) the view's normals.
        finest_mm: width of a pixel at the head's middle in the finest view.
        config: settings.

    Returns:
        ViewSamples.
    """
    usable = mask & (confidence > 0)
    tiles = texels.bounds.seen_from(camera.centre_mm, config.least_cos)
    if not len(tiles) or not usable.any():
        none = np.zeros((0, 2), np.float32)
        return ViewSamples(none[:, 0].astype(np.int32), none, none[:, 0], readable(usable), 1.0, 0)
    depth = depth_buffer(camera, vertices, triangles)
    seen = usable & np.isfinite(depth)
    distance_mm = float(np.median(depth[seen])) if seen.any() else 1.0
    footprint = distance_mm / camera.fx_px
    edge = silhouette_distance(depth, usable, max(config.jump_mm, 8 * footprint))
    quality = np.zeros_like(edge)
    _feather(edge, confidence, config.erode_px, footprint / config.feather_mm, quality)
    doubt, disbelief = np.cos(np.deg2rad([config.doubt_deg, config.disbelief_deg]))
    weight = np.zeros(len(texels.positions), np.float32)
    pixel = np.empty((len(weight), 2), np.float32)
    counts = np.zeros(len(tiles), np.int64)
    lens = np.array(
        [camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px, *camera.dist], np.float64
    )
    _weigh(
        tiles,
        texels.start,
        np.asarray(camera.cam_from_world, np.float64),
        np.asarray(camera.centre_mm, np.float64),
        lens,
        texels.positions,
        texels.normals,
        texels.trust,
        depth,
        quality,
        np.ascontiguousarray(measured, np.float32),
        np.array([config.least_cos, config.bias_mm, config.bias_px, doubt, disbelief, finest_mm]),
        weight,
        pixel,
        counts,
    )
    ends = np.cumsum(counts)
    total = int(ends[-1])
    samples = ViewSamples(
        np.empty(total, np.int32),
        np.empty((total, 2), np.float32),
        np.empty(total, np.float32),
        # What is not read sharply must not be read through the blur either.
        readable(usable & (edge > 0)),
        footprint,
        len(tiles),
    )
    _gather(
        tiles,
        texels.start,
        ends - counts,
        weight,
        pixel,
        samples.slot,
        samples.pixel,
        samples.weight,
    )
    return samples


@numba.njit(cache=True, parallel=True)
def _feather(
    edge: np.ndarray, confidence: np.ndarray, erode: float, per_px: float, out: np.ndarray
) -> None:
    """Confidence, rising smoothly from 0 at silhouettes."""
    for row in numba.prange(edge.shape[0]):
        for column in range(edge.shape[1]):
            share = min((edge[row, column] - erode) * per_px, 1.0)
            if share > 0:
                out[row, column] = share * share * (3 - 2 * share) * confidence[row, column]


@numba.njit(cache=True, parallel=True)
def _gather(
    tiles: np.ndarray,
    start: np.ndarray,
    first: np.ndarray,
    weight: np.ndarray,
    pixel: np.ndarray,
    slot: np.ndarray,
    found_pixel: np.ndarray,
    found_weight: np.ndarray,
) -> None:
    """The texels of some weight, one after the other."""
    for i in numba.prange(len(tiles)):
        at = first[i]
        for k in range(start[tiles[i]], start[tiles[i] + 1]):
            if weight[k] > LEAST_WEIGHT:
                slot[at] = k
                found_pixel[at, 0] = pixel[k, 0]
                found_pixel[at, 1] = pixel[k, 1]
                found_weight[at] = weight[k]
                at += 1


@numba.njit(cache=True, parallel=True)
def _weigh(
    tiles: np.ndarray,
    start: np.ndarray,
    pose: np.ndarray,
    centre: np.ndarray,
    lens: np.ndarray,
    positions: np.ndarray,
    normals: np.ndarray,
    trust: np.ndarray,
    depth: np.ndarray,
    quality: np.ndarray,
    measured: np.ndarray,
    limits: np.ndarray,
    weight: np.ndarray,
    pixel: np.ndarray,
    counts: np.ndarray,
) -> None:
    """Fill weight and pixel of some tiles' texels, and how many of them have any weight."""
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = lens
    least_cos, bias_mm, bias_px, doubt, disbelief, finest = limits
    height, width = depth.shape
    for i in numba.prange(len(tiles)):
        for k in range(start[tiles[i]], start[tiles[i] + 1]):
            if not trust[k] > 0:
                continue
            px, py, pz = positions[k, 0], positions[k, 1], positions[k, 2]
            vx, vy, vz = centre[0] - px, centre[1] - py, centre[2] - pz
            far = np.sqrt(vx * vx + vy * vy + vz * vz)
            if not far > 0:
                continue
            cosine = (vx * normals[k, 0] + vy * normals[k, 1] + vz * normals[k, 2]) / far
            if not cosine > least_cos:
                continue
            z = pose[2, 0] * px + pose[2, 1] * py + pose[2, 2] * pz + pose[2, 3]
            if not z > 0:
                continue
            x = (pose[0, 0] * px + pose[0, 1] * py + pose[0, 2] * pz + pose[0, 3]) / z
            y = (pose[1, 0] * px + pose[1, 1] * py + pose[1, 2] * pz + pose[1, 3]) / z
            r2 = x * x + y * y
            radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
            u = fx * (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)) + cx
            v = fy * (y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y) + cy
            if not (0 <= u < width and 0 <= v < height):
                continue
            row, column = int(v), int(u)
            good = quality[row, column]
            if not good > 0:
                continue
            footprint = z / fx
            slope = np.sqrt(1 - min(cosine * cosine, 1.0)) / cosine
            if z > depth[row, column] + bias_mm + bias_px * footprint * slope:
                continue
            agreement = (
                measured[row, column, 0] * normals[k, 0]
                + measured[row, column, 1] * normals[k, 1]
                + measured[row, column, 2] * normals[k, 2]
            )
            believed = min(max((agreement - disbelief) / (doubt - disbelief), 0.0), 1.0)
            sharp = min(1.0, (finest / footprint) ** 2)
            weight[k] = cosine * cosine * sharp * good * trust[k] * believed
            pixel[k, 0] = u
            pixel[k, 1] = v
            counts[i] += weight[k] > LEAST_WEIGHT
