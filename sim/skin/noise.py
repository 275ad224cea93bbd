"""Noise in space, so that what it draws on a skin keeps its size wherever the UV is stretched."""

from __future__ import annotations

import numba
import numpy as np

_MASK = 0xFFFFFFFF


@numba.njit(cache=True, inline="always")
def _hash(x: int, y: int, z: int, seed: int) -> int:
    """32 mixed bits of a lattice point."""
    h = (x * 374761393 + y * 668265263 + z * 2147483647 + seed * 1274126177) & _MASK
    h = ((h ^ (h >> 15)) * 2246822519) & _MASK
    h = ((h ^ (h >> 13)) * 3266489917) & _MASK
    return h ^ (h >> 16)


@numba.njit(cache=True, inline="always")
def _gradient(h: int, x: float, y: float, z: float) -> float:
    """Dot product with one of the twelve edge directions of a cube."""
    k = h % 12
    a = x if k < 8 else y
    b = y if k < 4 else z
    return (a if h & 4096 else -a) + (b if h & 8192 else -b)


@numba.njit(cache=True, parallel=True)
def gradient_noise(points: np.ndarray, cell_mm: float, seed: int) -> np.ndarray:
    """Perlin's gradient noise [Perlin2002].

    Args:
        points: (n, 3) mm.
        cell_mm: size of its features.
        seed: another seed, another field.

    Returns:
        (n,) float32 of mean 0 and standard deviation of about .28, within -1.1..1.1.
    """
    out = np.empty(len(points), np.float32)
    for i in numba.prange(len(points)):
        px, py, pz = points[i, 0] / cell_mm, points[i, 1] / cell_mm, points[i, 2] / cell_mm
        x0, y0, z0 = int(np.floor(px)), int(np.floor(py)), int(np.floor(pz))
        fx, fy, fz = px - x0, py - y0, pz - z0
        u = fx * fx * fx * (fx * (fx * 6 - 15) + 10)
        v = fy * fy * fy * (fy * (fy * 6 - 15) + 10)
        w = fz * fz * fz * (fz * (fz * 6 - 15) + 10)
        total = 0.0
        for dx in range(2):
            wx = u if dx else 1 - u
            for dy in range(2):
                wy = v if dy else 1 - v
                for dz in range(2):
                    wz = w if dz else 1 - w
                    h = _hash(x0 + dx, y0 + dy, z0 + dz, seed)
                    total += wx * wy * wz * _gradient(h, fx - dx, fy - dy, fz - dz)
        out[i] = total
    return out


@numba.njit(cache=True, inline="always")
def _two_nearest(point: np.ndarray, cell_mm: float, seed: int) -> tuple[float, float, int]:
    """Squared distances in cells to the two nearest scattered points, and the nearest one's hash.

    Infinite and -1 where there is none, as around a NaN.
    """
    px, py, pz = point[0] / cell_mm, point[1] / cell_mm, point[2] / cell_mm
    x0, y0, z0 = int(np.floor(px)), int(np.floor(py)), int(np.floor(pz))
    best, second, found = np.inf, np.inf, -1
    for dx in range(-1, 2):
        for dy in range(-1, 2):
            for dz in range(-1, 2):
                h = _hash(x0 + dx, y0 + dy, z0 + dz, seed)
                ex = x0 + dx + 0.1 + 0.8 * (h & 1023) / 1023 - px
                ey = y0 + dy + 0.1 + 0.8 * ((h >> 10) & 1023) / 1023 - py
                ez = z0 + dz + 0.1 + 0.8 * ((h >> 20) & 1023) / 1023 - pz
                d = ex * ex + ey * ey + ez * ez
                if d < best:
                    best, second, found = d, best, _hash(h, dx + x0, dy + y0, seed)
                elif d < second:
                    second = d
    return best, second, found


@numba.njit(cache=True, parallel=True)
def cell_noise(points: np.ndarray, cell_mm: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Distance to the nearest of scattered points, one a cell [Worley1996].

    Args:
        points: (n, 3) mm.
        cell_mm: size of the cells.
        seed: another seed, another scatter.

    Returns:
        (n,) float32 distance in mm and (n,) float32 a number 0..1 that belongs to the nearest
        point; infinite and NaN where the point is NaN.
    """
    distance = np.empty(len(points), np.float32)
    label = np.empty(len(points), np.float32)
    for i in numba.prange(len(points)):
        best, _, found = _two_nearest(points[i], cell_mm, seed)
        distance[i] = np.sqrt(best) * cell_mm
        label[i] = found / _MASK if found >= 0 else np.nan
    return distance, label


def octaves(points: np.ndarray, cell_mm: float, count: int, seed: int) -> np.ndarray:
    """Sum of gradient noises, each of half the size and strength of the one before.

    Args:
        points: (..., 3) mm.
        cell_mm: size of the largest features.
        count: number of noises.
        seed: as above.

    Returns:
        (...) float32 of mean 0 and standard deviation of about 1.
    """
    flat = np.ascontiguousarray(points.reshape(-1, 3), np.float32)
    total = np.zeros(len(flat), np.float32)
    power = 0.0
    for k in range(count):
        total += 0.5**k * gradient_noise(flat, cell_mm / 2.0**k, seed + 101 * k)
        power += 0.25**k
    return (total / np.float32(0.28 * np.sqrt(power))).reshape(points.shape[:-1])


@numba.njit(cache=True, parallel=True)
def cell_edges(points: np.ndarray, cell_mm: float, seed: int) -> np.ndarray:
    """How much farther the second nearest of scattered points is than the nearest [Worley1996].

    It is zero on the borders of a net of polygons.

    Args:
        points: (n, 3) mm.
        cell_mm: size of the cells.
        seed: another seed, another net.

    Returns:
        (n,) float32 mm; NaN where the point is NaN.
    """
    out = np.empty(len(points), np.float32)
    for i in numba.prange(len(points)):
        best, second, _ = _two_nearest(points[i], cell_mm, seed)
        out[i] = (np.sqrt(second) - np.sqrt(best)) * cell_mm if second < np.inf else np.nan
    return out


@numba.njit(cache=True, parallel=True)
def spots(
    points: np.ndarray, centres: np.ndarray, radii: np.ndarray, strengths: np.ndarray
) -> np.ndarray:
    """Sum of soft round spots.

    Args:
        points: (n, 3) mm.
        centres: (k, 3) mm.
        radii: (k,) mm, above zero: a spot is full within .6 and gone beyond 1.25 of it.
        strengths: (k,).

    Returns:
        (n,) float32; zero where the point is NaN.
    """
    out = np.zeros(len(points), np.float32)
    for i in numba.prange(len(points)):
        total = 0.0
        for k in range(len(centres)):
            reach = 1.25 * radii[k]
            dy = points[i, 1] - centres[k, 1]
            if not abs(dy) < reach:
                continue
            dx, dz = points[i, 0] - centres[k, 0], points[i, 2] - centres[k, 2]
            d2 = dx * dx + dy * dy + dz * dz
            if d2 < reach * reach:
                t = min((reach - np.sqrt(d2)) / (0.65 * radii[k]), 1.0)
                total += strengths[k] * t * t * (3 - 2 * t)
        out[i] = total
    return out
