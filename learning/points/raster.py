"""A depth buffer of small triangles, and the light on what it shows, compiled."""

from __future__ import annotations

import numba
import numpy as np

FAR = np.float32(1e9)
"""Depth where nothing is."""
BIAS_MM = np.float32(3.0)
"""Distance by which what shadows a place is nearer to the lamp."""


@numba.njit(cache=True, error_model="numpy")
def draw(
    points: np.ndarray,
    triangles: np.ndarray,
    opacity: np.ndarray,
    depth: np.ndarray,
    face: np.ndarray,
    share: np.ndarray,
) -> None:
    """Draw triangles into a depth buffer: the nearest at each pixel's centre.

    Args:
        points: (n, 3) float32: x and y in pixels, and the distance.
        triangles: (t, 3) int32.
        opacity: (n,) float32: pixels of less than a half are not drawn.
        depth: (h, w) float32, begun with `FAR`; changed.
        face: (h, w) int32, begun with -1; changed to the triangle's number.
        share: (h, w, 2) float32, changed to the weights of the second and third corner.
    """
    height, width = depth.shape
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        x0, y0, z0 = points[a, 0], points[a, 1], points[a, 2]
        x1, y1, z1 = points[b, 0], points[b, 1], points[b, 2]
        x2, y2, z2 = points[c, 0], points[c, 1], points[c, 2]
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        if not (abs(area) > 1e-9 and z0 > 0 and z1 > 0 and z2 > 0):
            continue
        if not (abs(x0) < 1e6 and abs(x1) < 1e6 and abs(x2) < 1e6):
            continue
        if not (abs(y0) < 1e6 and abs(y1) < 1e6 and abs(y2) < 1e6):
            continue
        left = max(0, int(np.ceil(min(x0, x1, x2) - 0.5)))
        right = min(width - 1, int(np.floor(max(x0, x1, x2) - 0.5)))
        top = max(0, int(np.ceil(min(y0, y1, y2) - 0.5)))
        low = min(height - 1, int(np.floor(max(y0, y1, y2) - 0.5)))
        for row in range(top, low + 1):
            y = np.float32(row + 0.5)
            for column in range(left, right + 1):
                x = np.float32(column + 0.5)
                v = ((x - x0) * (y2 - y0) - (x2 - x0) * (y - y0)) / area
                w = ((x1 - x0) * (y - y0) - (x - x0) * (y1 - y0)) / area
                u = 1 - v - w
                if u < 0 or v < 0 or w < 0:
                    continue
                z = u * z0 + v * z1 + w * z2
                if not z < depth[row, column]:
                    continue
                if u * opacity[a] + v * opacity[b] + w * opacity[c] < 0.5:
                    continue
                depth[row, column] = z
                face[row, column] = t
                share[row, column, 0] = v
                share[row, column, 1] = w


@numba.njit(cache=True, error_model="numpy")
def normals_of(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(n, 3) float32 vertex normals, area-weighted; zero where all triangles are degenerate."""
    out = np.zeros(vertices.shape, np.float32)
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        p0 = vertices[b, 0] - vertices[a, 0]
        p1 = vertices[b, 1] - vertices[a, 1]
        p2 = vertices[b, 2] - vertices[a, 2]
        q0 = vertices[c, 0] - vertices[a, 0]
        q1 = vertices[c, 1] - vertices[a, 1]
        q2 = vertices[c, 2] - vertices[a, 2]
        x, y, z = p1 * q2 - p2 * q1, p2 * q0 - p0 * q2, p0 * q1 - p1 * q0
        for i in (a, b, c):
            out[i, 0] += x
            out[i, 1] += y
            out[i, 2] += z
    for i in range(len(out)):
        length = np.sqrt(out[i, 0] ** 2 + out[i, 1] ** 2 + out[i, 2] ** 2)
        if length > 0:
            out[i, 0] /= length
            out[i, 1] /= length
            out[i, 2] /= length
    return out


@numba.njit(cache=True, error_model="numpy")
def lit(
    face: np.ndarray,
    share: np.ndarray,
    triangles: np.ndarray,
    places: np.ndarray,
    normals: np.ndarray,
    openness: np.ndarray,
    gloss: np.ndarray,
    around: np.ndarray,
    lamps: np.ndarray,
    colours: np.ndarray,
    frames: np.ndarray,
    shadows: np.ndarray,
    power: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Irradiance at each pixel's place, and the light that it mirrors.

    Args:
        face: (h, w) int32 of `draw`; nothing is computed where it is -1.
        share: (h, w, 2) float32 of `draw`.
        triangles: (t, 3) int32.
        places: (n, 3) float32 mm, the camera at the origin.
        normals: (n, 3) float32.
        openness: (n,) float32, share of the surroundings that a vertex sees.
        gloss: (n,) float32, strength of what is mirrored.
        around: (4, 3) float32: light from everywhere, and its slopes along x, y and z.
        lamps: (l, 3) float32 unit, toward far lamps.
        colours: (l, 3) float32.
        frames: (l, 3, 4) float32: from a place to its texel and depth in the lamp's buffer.
        shadows: (l, s, s) float32 depths.
        power: of the highlight.

    Returns:
        (h, w, 3) float32 both.
    """
    height, width = face.shape
    matt = np.zeros((height, width, 3), np.float32)
    shine = np.zeros((height, width, 3), np.float32)
    size = shadows.shape[1]
    place, normal = np.empty(3, np.float32), np.empty(3, np.float32)
    half = np.empty(3, np.float32)
    for row in range(height):
        for column in range(width):
            t = face[row, column]
            if t < 0:
                continue
            v, w = share[row, column, 0], share[row, column, 1]
            u = 1 - v - w
            a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
            for k in range(3):
                place[k] = u * places[a, k] + v * places[b, k] + w * places[c, k]
                normal[k] = u * normals[a, k] + v * normals[b, k] + w * normals[c, k]
            length = np.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
            away = np.sqrt(place[0] ** 2 + place[1] ** 2 + place[2] ** 2)
            if not (length > 1e-6 and away > 1e-6):
                continue
            for k in range(3):
                normal[k] /= length
            open_ = u * openness[a] + v * openness[b] + w * openness[c]
            mirrors = u * gloss[a] + v * gloss[b] + w * gloss[c]
            for k in range(3):
                soft = around[0, k]
                for j in range(3):
                    soft += around[j + 1, k] * normal[j]
                matt[row, column, k] = max(soft, 0.05 * around[0, k]) * open_
            for i in range(len(lamps)):
                cosine = normal[0] * lamps[i, 0] + normal[1] * lamps[i, 1] + normal[2] * lamps[i, 2]
                if cosine <= 0:
                    continue
                x, y, z = np.float32(0), np.float32(0), np.float32(0)
                for k in range(3):
                    x += frames[i, 0, k] * place[k]
                    y += frames[i, 1, k] * place[k]
                    z += frames[i, 2, k] * place[k]
                x += frames[i, 0, 3] - 0.5
                y += frames[i, 1, 3] - 0.5
                z += frames[i, 2, 3] - BIAS_MM
                # The mean of four texels, weighed by how near they are.
                seen = np.float32(0)
                x0, y0 = int(np.floor(x)), int(np.floor(y))
                for dy in range(2):
                    for dx in range(2):
                        xs, ys = x0 + dx, y0 + dy
                        near = (1 - abs(x - xs)) * (1 - abs(y - ys))
                        inside = 0 <= xs < size and 0 <= ys < size
                        if not inside or shadows[i, ys, xs] > z:
                            seen += near
                for k in range(3):
                    half[k] = lamps[i, k] - place[k] / away
                norm = np.sqrt(half[0] ** 2 + half[1] ** 2 + half[2] ** 2)
                peak = np.float32(0)
                if norm > 1e-6:
                    peak = (normal[0] * half[0] + normal[1] * half[1] + normal[2] * half[2]) / norm
                bright = mirrors * max(peak, np.float32(0)) ** power
                for k in range(3):
                    matt[row, column, k] += seen * cosine * colours[i, k]
                    shine[row, column, k] += seen * cosine * bright * colours[i, k]
    return matt, shine
