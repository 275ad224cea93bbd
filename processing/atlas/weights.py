"""How well a view shows each texel: angle, resolution, occlusion, edges, and its own confidence."""

from __future__ import annotations

import dataclasses

import numba
import numpy as np

from lightstage.formats.half import as_float
from lightstage.rig import Camera
from processing.atlas.config import WeightConfig
from processing.atlas.sampling import Reading, readable
from processing.atlas.visibility import depth_buffer, silhouette_distance

LEAST_WEIGHT = 1e-6
"""Texels of less weight count as not seen."""
APART_PX = 4
"""The view's distance is the median of every fourth pixel of every fourth row: a head needs no
more."""
FRAME_PX = 2
"""Around what may be read: one for neighbours, one that is surely outside."""


@dataclasses.dataclass(frozen=True)
class Texels:
    """The atlas's covered texels on the mesh.

    Attributes:
        positions: (k, 3) float32 mm.
        normals: (k, 3) float32 unit, the mesh's.
        trust: (k,) float32 in 0..1, how far the mesh may be believed there.
        start: (t + 1,) int64, where each tile's texels begin and the last one's end.
    """

    positions: np.ndarray
    normals: np.ndarray
    trust: np.ndarray
    start: np.ndarray


@dataclasses.dataclass(frozen=True)
class ViewSamples:
    """What one view sees of the atlas; one entry a seen texel.

    Attributes:
        window: rows and columns of the view's maps that are ever read.
        reading: where in that window.
        footprint_mm: width of a pixel on the surface.
    """

    window: tuple[slice, slice]
    reading: Reading
    footprint_mm: float


class Sampler:
    """Sees the atlas's texels through one view after the other."""

    def __init__(
        self,
        vertices: np.ndarray,
        triangles: np.ndarray,
        texels: Texels,
        finest_mm: float,
        config: WeightConfig,
    ) -> None:
        """Keep what all views share.

        Args:
            vertices: (n, 3) mm, the mesh that occludes.
            triangles: (t, 3).
            texels: where the atlas's texels are.
            finest_mm: width of a pixel at the head's middle in the finest view.
            config: settings.
        """
        self._vertices, self._triangles, self._texels = vertices, triangles, texels
        self._finest_mm, self._config = finest_mm, config
        # Filled anew for every view: one as long as needed would be cleared by the system first.
        count = len(texels.positions)
        self._slot = np.empty(count, np.int32)
        self._pixel = np.empty((count, 2), np.float32)
        self._weight = np.empty(count, np.float32)

    def look(
        self, camera: Camera, confidence: np.ndarray, mask: np.ndarray, measured: np.ndarray
    ) -> ViewSamples:
        """Which texels a view sees and with what weight.

        The weight is cos^2 of the viewing angle x resolution (the pixel's area on a facing surface
        against the finest view's) x the view's own confidence x the distance to its silhouettes x
        the trust in the surface there x the agreement of measured and mesh normal.

        Args:
            camera: the view.
            confidence: (h, w) float32, the view's.
            mask: (h, w) bool, the face.
            measured: (h, w, 3) float16, the view's normals.
        """
        config, texels = self._config, self._texels
        usable = mask & (confidence > 0)
        window = window_of(usable)
        usable = np.ascontiguousarray(usable[window])
        if not len(texels.positions) or not usable.any():
            none = np.zeros((0, 2), np.float32)
            nothing = Reading(usable.view(np.uint8), none[:, 0].astype(np.int32), none, none[:, 0])
            return ViewSamples(window, nothing, 1.0)
        camera = dataclasses.replace(
            camera,
            cx_px=camera.cx_px - window[1].start,
            cy_px=camera.cy_px - window[0].start,
            width_px=usable.shape[1],
            height_px=usable.shape[0],
        )
        depth = depth_buffer(camera, self._vertices, self._triangles)
        # Counted from the picture's corner, so that the window's place changes nothing.
        some = tuple(slice(-w.start % APART_PX, None, APART_PX) for w in window)
        seen = depth[some][usable[some] & np.isfinite(depth[some])]
        distance_mm = float(np.median(seen)) if len(seen) else 1.0
        footprint = distance_mm / camera.fx_px
        edge = silhouette_distance(depth, usable, max(config.jump_mm, 8 * footprint))
        quality = np.zeros_like(edge)
        _feather(
            edge,
            np.ascontiguousarray(confidence[window]),
            config.erode_px,
            footprint / config.feather_mm,
            quality,
        )
        doubt, disbelief = np.cos(np.deg2rad([config.doubt_deg, config.disbelief_deg]))
        counts = np.zeros(len(texels.start) - 1, np.int64)
        _weigh(
            texels.start,
            np.asarray(camera.cam_from_world, np.float64),
            np.asarray(camera.centre_mm, np.float64),
            np.array(
                [camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px, *camera.dist], np.float64
            ),
            texels.positions,
            texels.normals,
            texels.trust,
            depth,
            quality,
            np.ascontiguousarray(measured[window], np.float16).view(np.uint16),
            np.array(
                [
                    config.least_cos,
                    config.bias_mm,
                    config.bias_px,
                    doubt,
                    disbelief,
                    self._finest_mm,
                ]
            ),
            self._slot,
            self._pixel,
            self._weight,
            counts,
        )
        ends = np.cumsum(counts)
        total = int(ends[-1])
        reading = Reading(
            # What is not read sharply must not be read through the blur either.
            readable(usable & (edge > 0)),
            np.empty(total, np.int32),
            np.empty((total, 2), np.float32),
            np.empty(total, np.float32),
        )
        first = texels.start[:-1]
        _gather(first, counts, ends, self._slot, reading.slot)
        _gather(2 * first, 2 * counts, 2 * ends, self._pixel.ravel(), reading.pixel.ravel())
        _gather(first, counts, ends, self._weight, reading.weight)
        return ViewSamples(window, reading, footprint)


def window_of(usable: np.ndarray) -> tuple[slice, slice]:
    """Rows and columns around what is usable, with a frame of two that is not where there is one.

    Nothing outside it can be nearer to a usable pixel than the frame is.

    Args:
        usable: (h, w) bool.
    """
    rows, columns = np.flatnonzero(usable.any(axis=1)), np.flatnonzero(usable.any(axis=0))
    if not len(rows):
        return slice(0, 0), slice(0, 0)
    height, width = usable.shape
    return (
        slice(max(int(rows[0]) - FRAME_PX, 0), min(int(rows[-1]) + 1 + FRAME_PX, height)),
        slice(max(int(columns[0]) - FRAME_PX, 0), min(int(columns[-1]) + 1 + FRAME_PX, width)),
    )


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
    first: np.ndarray, counts: np.ndarray, ends: np.ndarray, tiled: np.ndarray, out: np.ndarray
) -> None:
    """What tiles hold from their first places on, one after the other."""
    for i in numba.prange(len(first)):
        count = counts[i]
        out[ends[i] - count : ends[i]] = tiled[first[i] : first[i] + count]


@numba.njit(cache=True, parallel=True)
def _weigh(
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
    slot: np.ndarray,
    pixel: np.ndarray,
    weight: np.ndarray,
    counts: np.ndarray,
) -> None:
    """Texels of some weight, each tile's from its first place on, and how many a tile has."""
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = lens
    least_cos, bias_mm, bias_px, doubt, disbelief, finest = limits
    height, width = depth.shape
    for i in numba.prange(len(start) - 1):
        at = start[i]
        for k in range(start[i], start[i + 1]):
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
                as_float(measured[row, column, 0]) * normals[k, 0]
                + as_float(measured[row, column, 1]) * normals[k, 1]
                + as_float(measured[row, column, 2]) * normals[k, 2]
            )
            believed = min(max((agreement - disbelief) / (doubt - disbelief), 0.0), 1.0)
            sharp = min(1.0, (finest / footprint) ** 2)
            here = np.float32(cosine * cosine * sharp * good * trust[k] * believed)
            if here > LEAST_WEIGHT:
                slot[at], weight[at] = k, here
                pixel[at, 0], pixel[at, 1] = u, v
                at += 1
        counts[i] = at - start[i]
