"""Places on the face, as soft masks in UV: what the skin's painter paints by."""

from __future__ import annotations

import dataclasses
import functools

import cv2
import numpy as np

from sim.head_grid import (
    EYE_AZIMUTH_DEG,
    EYE_HALF_DEG,
    MOUTH_HALF_DEG,
    ROW_LID_LOW,
    ROW_LID_UP,
    ROW_MOUTH,
    face_azimuth_deg,
    smoothstep,
)
from sim.head_maps import region_map, tile_rows_columns, to_tile
from sim.head_mesh import hairline_mm, neutral_mesh
from sim.head_noise import cell_noise, octaves
from sim.head_shape import EYE_CENTRE_MM, EYE_RADIUS_MM

TILE_HEIGHT_MM = 310.0
"""About the height of the face's part of the tile, were all of it as dense."""

# Brow: along the arch for x >= 0, mm; and half its height there.
_BROW_MM = np.array([[12, 14.5], [20, 16.5], [30, 19.0], [40, 19.5], [48, 17.0], [56, 12.5]])
_BROW_HALF_MM = np.array([4.2, 4.4, 4.2, 3.6, 2.6, 1.2])


@dataclasses.dataclass(frozen=True)
class Face:
    """Soft masks 0..1 in UV, (rows, columns) float32, and noise on the neutral surface.

    Attributes:
        position: (rows, columns, 3) of the neutral head, mm.
        seed: of all its noise.
    """

    position: np.ndarray
    seed: int
    skin: np.ndarray
    lips: np.ndarray
    eyes: np.ndarray
    ears: np.ndarray
    cheeks: np.ndarray
    nose: np.ndarray
    chin: np.ndarray
    forehead: np.ndarray
    below_eyes: np.ndarray
    lid_rims: np.ndarray
    freckled: np.ndarray
    beard: np.ndarray
    oily: np.ndarray
    crow: np.ndarray
    eye_angle: np.ndarray
    mouth_inside: np.ndarray
    margin_rows: np.ndarray

    def noise(self, cell_mm: float, count: int, salt: int) -> np.ndarray:
        """(rows, columns) smooth noise of unit deviation; `salt` tells fields apart."""
        return self.noise_of(self.position, cell_mm, count, salt)

    def noise_of(self, points: np.ndarray, cell_mm: float, count: int, salt: int) -> np.ndarray:
        """The same at other points (rows, columns, 3)."""
        rows, columns = points.shape[:2]
        finest_texels = cell_mm / 2 ** (count - 1) / TILE_HEIGHT_MM * rows
        step = 4 if finest_texels > 11 else 2 if finest_texels > 5.5 else 1
        # Smooth noise is evaluated on fewer texels and enlarged.
        size = (-(-columns // step), -(-rows // step))
        if step > 1:
            points = cv2.resize(points, size, interpolation=cv2.INTER_AREA)
        found = octaves(points, cell_mm, count, self.seed + 1009 * salt)
        if step > 1:
            found = cv2.resize(found, (columns, rows), interpolation=cv2.INTER_CUBIC)
        return np.asarray(found, np.float32)

    def cells(self, cell_mm: float, salt: int) -> tuple[np.ndarray, np.ndarray]:
        """(rows, columns) distance in mm to scattered points, and a number 0..1 of each point."""
        flat = np.ascontiguousarray(self.position.reshape(-1, 3))
        distance, label = cell_noise(flat, cell_mm, self.seed + 1009 * salt)
        shape = self.position.shape[:2]
        return distance.reshape(shape), label.reshape(shape)

    def spot(self, rng: np.random.Generator, least_mm: float, most_mm: float) -> np.ndarray:
        """One round spot of random place and size on the face: (rows, columns) 0..1."""
        rows, columns = self.skin.shape
        while True:
            row = int(rng.uniform(0.12, 0.85) * rows)
            column = int(rng.uniform(0.2, 0.8) * columns)
            if self.skin[row, column] > 0.99:
                break
        radius = rng.uniform(least_mm, most_mm)
        out = np.zeros((rows, columns), np.float32)
        reach = max(4, rows // 40)
        part = np.s_[max(0, row - reach) : row + reach, max(0, column - reach) : column + reach]
        distance = np.linalg.norm(self.position[part] - self.position[row, column], axis=-1)
        out[part] = smoothstep(1.25 * radius, 0.6 * radius, distance)
        return out


def face_of(rows: int, columns: int, seed: int) -> Face:
    """The face's places on a tile of this size; `seed` chooses the noise."""
    return dataclasses.replace(_places(rows, columns), seed=seed)


@functools.lru_cache(maxsize=2)
def _places(rows: int, columns: int) -> Face:
    p = to_tile(neutral_mesh().vertices, rows, columns)
    folded = p.copy()
    folded[..., 0] = np.abs(p[..., 0])
    x, y, z = folded[..., 0], p[..., 1], p[..., 2]

    def at(centre: tuple[float, float, float], spread: tuple[float, float, float]) -> np.ndarray:
        away = (folded - np.array(centre, np.float32)) / np.array(spread, np.float32)
        return np.asarray(np.exp(-0.5 * (away**2).sum(axis=-1)))

    lips, eyes = region_map("lips", rows, columns), region_map("eyes", rows, columns)
    row, column = tile_rows_columns(rows, columns)
    azimuth = np.abs(np.interp(column, np.arange(len(face_azimuth_deg())), face_azimuth_deg()))
    beside = smoothstep(1.25, 0.95, np.abs(azimuth - EYE_AZIMUTH_DEG) / EYE_HALF_DEG)[None]
    nearest = np.minimum(np.abs(row - ROW_LID_UP), np.abs(row - ROW_LID_LOW))[:, None]
    nose = np.maximum(at((0, -42, 108), (14, 11, 14)), 0.8 * at((13, -46, 97), (7, 8, 10)))
    forehead = at((0, 45, 85), (42, 17, 45))
    freckled = np.maximum(at((24, -28, 82), (22, 13, 30)), at((0, -25, 100), (12, 16, 20)))
    mouth = np.maximum(at((0, -62, 96), (30, 6, 25)), at((0, -98, 84), (40, 20, 40)))
    jaw = (
        smoothstep(-50, -72, y - 0.25 * (60 - z))
        * smoothstep(-150, -118, y)
        * smoothstep(-8, 14, z)
    )
    inside = np.maximum(smoothstep(24, 8, x) * smoothstep(-88, -84, y), 0)
    beard = np.clip(np.maximum(mouth, jaw * (1 - 0.2 * inside)), 0, 1)
    beard = beard * (1 - lips) * (1 - at((0, -50, 100), (16, 5, 20)))
    dx, dy = x - 47, y + 9
    values = {
        "skin": region_map("skin", rows, columns),
        "lips": lips,
        "eyes": eyes,
        "ears": region_map("ears", rows, columns),
        "cheeks": at((42, -38, 70), (16, 14, 28)),
        "nose": nose,
        "chin": at((0, -106, 84), (15, 11, 25)),
        "forehead": forehead,
        "below_eyes": at((30, -20, 80), (12, 5, 20)) + 0.7 * at((20, -5, 80), (5, 8, 20)),
        "lid_rims": smoothstep(2.5, 0.0, nearest) * beside,
        "freckled": freckled,
        "beard": beard,
        "oily": np.clip(nose + forehead + 0.5 * at((0, -106, 84), (15, 11, 25)), 0, 1),
        "crow": at((57, -9, 62), (8, 10, 16)),
        "eye_angle": np.arctan2(dy, dx + 8),
        "mouth_inside": smoothstep(0.95, 0.3, np.abs(row - ROW_MOUTH))[:, None]
        * smoothstep(0.96, 0.86, azimuth / MOUTH_HALF_DEG),
        "margin_rows": nearest + 0 * beside + 9 * (1 - beside),
    }
    return Face(position=p, seed=0, **{k: np.asarray(v, np.float32) for k, v in values.items()})


def brow_share(face: Face) -> np.ndarray:
    """How much of each texel is brow hair, 0..1."""
    x, y = np.abs(face.position[..., 0]), face.position[..., 1]
    middle = np.interp(x, _BROW_MM[:, 0], _BROW_MM[:, 1])
    half = np.interp(x, _BROW_MM[:, 0], _BROW_HALF_MM)
    front = (face.position[..., 2] > 30) * smoothstep(9, 14, x) * smoothstep(60, 53, x)
    band = smoothstep(1.25, 0.35, np.abs(y - middle + 0.5 * face.noise(4.0, 2, 50)) / half) * front
    # Hairs rise near the nose and fall at the temple: noise stretched along that direction field,
    # which is the level lines of y - middle - lean integrated over x.
    inner = x - 12.0
    across = y - middle - (inner - 0.016 * inner**2)
    streaks = np.stack([0.16 * x, across, 0 * x], axis=-1).astype(np.float32)
    hairs = smoothstep(-0.9, 0.7, face.noise_of(streaks, 0.75, 2, 51))
    return np.asarray(band * (0.35 + 0.6 * hairs), np.float32)


def lash_share(face: Face) -> np.ndarray:
    """How much of each texel is eyelash, 0..1: a line along both lid margins."""
    return np.asarray(smoothstep(0.55, 0.15, face.margin_rows) * (1 - face.lips), np.float32)


def hair_share(face: Face) -> np.ndarray:
    """How much of each texel is short-cropped hair, 0..1, with a soft uneven hairline."""
    behind = hairline_mm(face.position) + 2.5 * face.noise(9.0, 3, 52)
    cover = smoothstep(-3.0, 9.0, behind) * (1 - face.ears)
    grain = face.noise_of(face.position * np.array([1.0, 0.4, 0.4], np.float32), 0.8, 2, 53)
    return np.asarray(cover * np.clip(0.72 + 0.16 * grain, 0, 1), np.float32)


def add_eyes(albedo: np.ndarray, face: Face, iris: tuple[float, float, float]) -> None:
    """Paint sclera, iris and pupil into (rows, columns, 3) linear albedo, in place."""
    here = face.eyes > 0
    p = face.position[here]
    p[:, 0] = np.abs(p[:, 0])
    front = EYE_CENTRE_MM + np.array([0.0, -0.3, EYE_RADIUS_MM])
    radius = np.hypot(p[:, 0] - front[0], p[:, 1] - front[1])
    turn = np.arctan2(p[:, 1] - front[1], p[:, 0] - front[0])
    fibres = 0.85 + 0.25 * np.sin(31 * turn + 1.5 * np.sin(7 * turn)) * smoothstep(2, 4, radius)
    shade = fibres * (1 - 0.65 * smoothstep(4.6, 5.7, radius))
    colour = shade[:, None] * np.array(iris)
    corner = smoothstep(8.0, 15.0, radius)
    red = np.maximum(octaves(p, 1.4, 2, face.seed + 54), 0) * smoothstep(6, 11, radius)
    white = np.array([0.62, 0.57, 0.53]) * (1 - 0.18 * corner - 0.04 * red)[:, None]
    white = white - (corner + 0.08 * red)[:, None] * np.array([0.0, 0.12, 0.12])
    out = white + smoothstep(6.1, 5.5, radius)[:, None] * (colour - white)
    out = out * smoothstep(1.8, 2.2, radius)[:, None] + 0.004
    albedo[here] += face.eyes[here][:, None] * (out - albedo[here])
