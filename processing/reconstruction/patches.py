"""Numba kernels: how well a slanted patch of one view agrees with other views.

A pixel x = (u, v, 1) of the reference view at inverse depth w (1/mm, along the optical axis) is
in another view at the homogeneous pixel M x + m w, with M = K_s R K_r^-1 and m = K_s t. On a plane
the inverse depth is affine in the pixel, w (1 + a du + b dv). Normals show how a patch is bent,
too: from its centre to a sample the slopes' mean of both counts, so the inverse depth of a patch is
w (1 + bend) with a bend of each sample that no depth changes. Pictures are (h, w, TEXTURES)
float32, textures of the same surface under different lights, NaN where a pixel may not be used.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

TEXTURES = 4
"""Channels of a matching picture. A matte surface under any number of lights has four at most (its
albedo times 1, n_x, n_y, n_z), as far as the lights are spread evenly."""

NO_MATCH = np.float32(2.0)
"""Cost of a patch that no other view can judge. Real costs are in 0..2; uncorrelated is 1."""

# Without `nnan` and `ninf`: NaN marks pixels that may not be used.
FAST = {"nsz", "arcp", "contract", "reassoc"}

ZERO = np.float32(0.0)
HALF = np.float32(0.5)
ONE = np.float32(1.0)
MIN_SHARE = np.float32(0.6)
"""Share of a patch that must fall on valid pixels of the other view."""
ALONE = np.float32(0.05)
"""Added to the cost of a patch that a single view judges."""

Plane = tuple[np.float32, np.float32, np.float32]


class Stereo(NamedTuple):
    """One reference view and the views that it is matched with; arrays are float32.

    Attributes:
        pictures: (views, h, w, TEXTURES), all views of the rig.
        reference: index of the view whose depth is sought.
        sources: (s,) int64 indices of the views it is matched with.
        matrices: (s, 3, 3) M.
        shifts: (s, 3) m.
        lens: (4,) fx, fy, cx, cy of the reference.
        centres: (s, 3) the sources' centres in the reference camera's axes, mm.
        slopes: (h, w, 2) a, b of every pixel's plane.
        offsets: (k, 2) int64 du, dv of the patch's samples.
        min_cosine: a view that sees the plane at a smaller cosine does not judge,
        graze_cosine: unless all do, and it sees it at more than this.
        contrast_floor: share of the radiance below which contrast is noise.
        step: inverse depth of one pixel's disparity.
    """

    pictures: np.ndarray
    reference: int
    sources: np.ndarray
    matrices: np.ndarray
    shifts: np.ndarray
    lens: np.ndarray
    centres: np.ndarray
    slopes: np.ndarray
    offsets: np.ndarray
    min_cosine: np.float32
    graze_cosine: np.float32
    contrast_floor: np.float32
    step: np.float32


class Patch(NamedTuple):
    """Buffers of one thread: the valid samples of the reference patch.

    Attributes:
        offsets: (k, 2) float32 du, dv.
        values: (k, TEXTURES) relative to the centre, which keeps sums of squares from cancelling.
        seen: (s,) bool, the sources that the plane faces.
        bends: (k,) float32, relative change of inverse depth from the centre.
    """

    offsets: np.ndarray
    values: np.ndarray
    seen: np.ndarray
    bends: np.ndarray


@njit(cache=True)
def new_patch(stereo: Stereo) -> Patch:
    """Buffers for one thread."""
    count = stereo.offsets.shape[0]
    return Patch(
        np.zeros((count, 2), np.float32),
        np.zeros((count, TEXTURES), np.float32),
        np.zeros(stereo.sources.shape[0], np.bool_),
        np.zeros(count, np.float32),
    )


@njit(cache=True, fastmath=FAST)
def gather_patch(stereo: Stereo, row: int, column: int, patch: Patch) -> tuple[int, np.float32]:
    """Fill `patch` around a valid pixel of the reference.

    Returns:
        Number of samples, and the variance below which contrast is noise here.
    """
    picture = stereo.pictures[stereo.reference]
    height, width = picture.shape[0], picture.shape[1]
    a, b = stereo.slopes[row, column, 0], stereo.slopes[row, column, 1]
    energy, count = ZERO, 0
    for channel in range(TEXTURES):
        energy += picture[row, column, channel] * picture[row, column, channel]
    for k in range(stereo.offsets.shape[0]):
        x, y = column + stereo.offsets[k, 0], row + stereo.offsets[k, 1]
        if 0 <= x < width and 0 <= y < height and not math.isnan(picture[y, x, 0]):
            patch.offsets[count, 0] = np.float32(stereo.offsets[k, 0])
            patch.offsets[count, 1] = np.float32(stereo.offsets[k, 1])
            patch.bends[count] = HALF * (
                (a + stereo.slopes[y, x, 0]) * patch.offsets[count, 0]
                + (b + stereo.slopes[y, x, 1]) * patch.offsets[count, 1]
            )
            for channel in range(TEXTURES):
                patch.values[count, channel] = (
                    picture[y, x, channel] - picture[row, column, channel]
                )
            count += 1
    return count, energy * stereo.contrast_floor * stereo.contrast_floor


@njit(cache=True, fastmath=FAST)
def source_cost(
    stereo: Stereo,
    index: int,
    row: int,
    column: int,
    plane: Plane,
    patch: Patch,
    count: int,
    floor: np.float32,
) -> np.float32:
    """One minus the pooled normalised cross-correlation of a patch with one other view.

    The textures' covariances are summed before the division, so each counts by the contrast that
    it shows: rho = sum_c cov_c / sqrt((sum_c var_c + floor) (sum_c var'_c + floor')), where floor'
    is no less than the same share of the two views' difference in radiance.

    Args:
        stereo: the views.
        index: which of the sources.
        row, column: the patch's centre in the reference.
        plane: w, a, b.
        patch: filled by `gather_patch`.
        count, floor: what `gather_patch` returned.

    Returns:
        Cost in 0..2, NO_MATCH where too little of the patch falls on valid pixels.
    """
    picture = stereo.pictures[stereo.sources[index]]
    m, t = stereo.matrices[index], stereo.shifts[index]
    w = plane[0]
    u, v = np.float32(column) + HALF, np.float32(row) + HALF
    tx, ty, tz = t[0] * w, t[1] * w, t[2] * w
    x0 = m[0, 0] * u + m[0, 1] * v + m[0, 2] + tx
    y0 = m[1, 0] * u + m[1, 1] * v + m[1, 2] + ty
    z0 = m[2, 0] * u + m[2, 1] * v + m[2, 2] + tz
    xu, xv, yu, yv, zu, zv = m[0, 0], m[0, 1], m[1, 0], m[1, 1], m[2, 0], m[2, 1]
    height, width = picture.shape[0], picture.shape[1]
    right, bottom = np.float32(width - 1), np.float32(height - 1)
    # One flat index without a sign spares numba's checks for negative indices; the four textures
    # are written out so that the sums stay in registers: together 2.7 times as fast as arrays.
    flat = picture.reshape(height * width * TEXTURES)
    line = np.uint64(width * TEXTURES)
    c = stereo.pictures[stereo.reference, row, column]
    c0, c1, c2, c3 = c[0], c[1], c[2], c[3]
    used = 0
    r_0 = r_1 = r_2 = r_3 = s_0 = s_1 = s_2 = s_3 = rr = ss = rs = ZERO
    for k in range(count):
        du, dv = patch.offsets[k, 0], patch.offsets[k, 1]
        bend = patch.bends[k]
        z = z0 + zu * du + zv * dv + tz * bend
        scale = ONE / z if z > ZERO else ZERO
        x = (x0 + xu * du + xv * dv + tx * bend) * scale - HALF
        y = (y0 + yu * du + yv * dv + ty * bend) * scale - HALF
        if not (x >= ZERO and y >= ZERO and x < right and y < bottom):
            continue
        left, top = int(x), int(y)
        fx, fy = x - np.float32(left), y - np.float32(top)
        w11 = fx * fy
        w01, w10, w00 = fx - w11, fy - w11, ONE - fx - fy + w11
        i = np.uint64((top * width + left) * TEXTURES)
        j = i + line
        s0 = _blend(flat, i, j, w00, w01, w10, w11, 0) - c0
        if math.isnan(s0):
            continue
        s1 = _blend(flat, i, j, w00, w01, w10, w11, 1) - c1
        s2 = _blend(flat, i, j, w00, w01, w10, w11, 2) - c2
        s3 = _blend(flat, i, j, w00, w01, w10, w11, 3) - c3
        r0, r1 = patch.values[k, 0], patch.values[k, 1]
        r2, r3 = patch.values[k, 2], patch.values[k, 3]
        used += 1
        r_0, r_1, r_2, r_3 = r_0 + r0, r_1 + r1, r_2 + r2, r_3 + r3
        s_0, s_1, s_2, s_3 = s_0 + s0, s_1 + s1, s_2 + s2, s_3 + s3
        rr += r0 * r0 + r1 * r1 + r2 * r2 + r3 * r3
        ss += s0 * s0 + s1 * s1 + s2 * s2 + s3 * s3
        rs += r0 * s0 + r1 * s1 + r2 * s2 + r3 * s3
    if not np.float32(used) > MIN_SHARE * np.float32(count):
        return NO_MATCH
    n = ONE / np.float32(used)
    variance_r = n * (rr - n * (r_0 * r_0 + r_1 * r_1 + r_2 * r_2 + r_3 * r_3))
    variance_s = n * (ss - n * (s_0 * s_0 + s_1 * s_1 + s_2 * s_2 + s_3 * s_3))
    covariance = n * (rs - n * (r_0 * s_0 + r_1 * s_1 + r_2 * s_2 + r_3 * s_3))
    # Much brighter than the reference, the other view has coarser noise (and rounding).
    offset = n * n * (s_0 * s_0 + s_1 * s_1 + s_2 * s_2 + s_3 * s_3)
    floor_s = max(floor, stereo.contrast_floor * stereo.contrast_floor * offset)
    under = math.sqrt(max(variance_r, ZERO) + floor) * math.sqrt(max(variance_s, ZERO) + floor_s)
    if not under > ZERO:
        return ONE
    return ONE - min(max(covariance / np.float32(under), -ONE), ONE)


@njit(cache=True, fastmath=FAST, inline="always")
def _blend(
    flat: np.ndarray,
    i: np.uint64,
    j: np.uint64,
    w00: np.float32,
    w01: np.float32,
    w10: np.float32,
    w11: np.float32,
    channel: int,
) -> np.float32:
    """Bilinear value of one texture; i and j are the flat indices of the upper and lower pixel."""
    here, next_ = np.uint64(channel), np.uint64(TEXTURES + channel)
    upper = w00 * flat[i + here] + w01 * flat[i + next_]
    return upper + w10 * flat[j + here] + w11 * flat[j + next_]


@njit(cache=True, fastmath=FAST)
def plane_cost(
    stereo: Stereo,
    row: int,
    column: int,
    plane: Plane,
    patch: Patch,
    count: int,
    floor: np.float32,
) -> np.float32:
    """Mean of the two best costs among the views that the plane faces: the others may be occluded.

    Returns:
        Cost, NO_MATCH where no view can judge.
    """
    facing = facing_views(stereo, row, column, plane, stereo.min_cosine, patch.seen)
    if facing == 0:
        # Better one that sees it from the side than none.
        facing = facing_views(stereo, row, column, plane, stereo.graze_cosine, patch.seen)
    if facing == 0:
        return NO_MATCH
    best, second = NO_MATCH, NO_MATCH
    for index in range(stereo.sources.shape[0]):
        if not patch.seen[index]:
            continue
        cost = source_cost(stereo, index, row, column, plane, patch, count, floor)
        if cost < best:
            best, second = cost, best
        elif cost < second:
            second = cost
    if not best < NO_MATCH:
        return NO_MATCH
    if not second < NO_MATCH:
        return best + ALONE
    return HALF * (best + second)


@njit(cache=True, fastmath=FAST)
def facing_views(
    stereo: Stereo, row: int, column: int, plane: Plane, least: np.float32, seen: np.ndarray
) -> int:
    """Mark the sources that see a plane at more than some cosine.

    Args:
        stereo: the views.
        row, column: the reference's pixel.
        plane: w, a, b there.
        least: the cosine.
        seen: (s,) bool, filled.

    Returns:
        How many there are.
    """
    w, a, b = plane
    fx, fy, cx, cy = stereo.lens
    u, v = np.float32(column) + HALF, np.float32(row) + HALF
    # The plane's normal away from the camera, scaled so that normal . point = depth.
    nx, ny, nz = fx * a, fy * b, ONE + (cx - u) * a + (cy - v) * b
    depth = ONE / w
    px, py = (u - cx) / fx * depth, (v - cy) / fy * depth
    length = np.float32(math.sqrt(nx * nx + ny * ny + nz * nz))
    count = 0
    for k in range(stereo.centres.shape[0]):
        dx, dy = px - stereo.centres[k, 0], py - stereo.centres[k, 1]
        dz = depth - stereo.centres[k, 2]
        distance = np.float32(math.sqrt(dx * dx + dy * dy + dz * dz))
        seen[k] = dx * nx + dy * ny + dz * nz > least * length * distance
        count += seen[k]
    return count
