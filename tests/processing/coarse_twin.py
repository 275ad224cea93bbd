"""The coarse method in plain float64: every light summed for every pixel, nothing tabulated."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np

from processing.lighting.interface import skin_interface
from processing.lighting.lights import PatternLights
from processing.lighting.lobe import SKIN_F0
from processing.separation.colour import SETTLED
from processing.separation.config import SeparateConfig
from processing.separation.far_tables import CELLS, ROWS, FarTables
from processing.separation.view_readings import Pixels
from tests.processing.lit_ball import exact_fresnel, smith


@dataclasses.dataclass(frozen=True)
class Twin:
    """(n, ...) maps of the pixels, float64."""

    normal: np.ndarray
    albedo: np.ndarray
    specular: np.ndarray
    solved: np.ndarray


def let_through(roughness: float, cosine: np.ndarray) -> np.ndarray:
    """T of the interface at Beckmann's m between two rows of its table."""
    table = skin_interface().table.astype(float)
    rows = np.linspace(0.15, 0.35, len(table))
    line = np.array([np.interp(roughness, rows, column) for column in table.T])
    return np.interp(cosine, np.linspace(0, 1, len(line)), line)


def mean_let(roughness: float) -> float:
    """Mean of T."""
    rows = np.linspace(0.15, 0.35, len(skin_interface().mean))
    return float(np.interp(roughness, rows, skin_interface().mean.astype(float)))


def light(
    lights: PatternLights,
    points: np.ndarray,
    normals: np.ndarray,
    views: np.ndarray,
    roughness: float,
    solve: bool = False,
) -> tuple[np.ndarray, np.ndarray]:
    """(n, P) irradiance and lobe of specular albedo 1; with `solve` (n, P, 3) vectors first."""
    strength = lights.strength
    irradiance = np.zeros((len(points), len(strength), 3))
    mirror = np.zeros((len(points), len(strength)))
    nv = np.maximum((normals * views).sum(axis=1), 0.05)
    for j, place in enumerate(lights.position_mm):
        toward = place - points
        distance = np.linalg.norm(toward, axis=1)
        toward /= distance[:, None]
        fall = (lights.radius_mm[j] / distance) ** 2
        nl = (normals * toward).sum(axis=1)
        enters = np.where(nl > 0, let_through(roughness, np.maximum(nl, 0)) * fall, 0)
        irradiance += (enters[:, None] * toward)[:, None, :] * strength[None, :, j, None]
        if solve:
            continue
        half = toward + views
        half /= np.linalg.norm(half, axis=1, keepdims=True)
        nh = np.maximum((normals * half).sum(axis=1), 1e-9)
        tan2 = (1 - nh**2) / nh**2
        spread = np.where(tan2 < 9 * roughness**2, np.exp(-tan2 / roughness**2), 0)
        spread = spread / (4 * roughness**2 * nh**4 * nv)
        f = exact_fresnel(SKIN_F0, (views * half).sum(axis=1)) / SKIN_F0
        shadows = smith(nv, roughness) * smith(np.maximum(nl, 1e-9), roughness)
        value = np.where(nl > 0, fall * spread * f * shadows, 0)
        mirror += value[:, None] * strength[None, :, j]
    if solve:
        return irradiance, mirror
    leaving = let_through(roughness, nv) / mean_let(roughness)
    return np.einsum("npk,nk->np", irradiance, normals) * leaving[:, None], mirror


def separate(
    pixels: Pixels, lights: PatternLights, config: SeparateConfig, camera_mm: np.ndarray
) -> Twin:
    """What `colour.separate_window` claims to do for a camera at some place."""
    rgb, valid, views = pixels.rgb.astype(float), pixels.valid, pixels.views
    mask, px_per_mm = pixels.mask, pixels.px_per_mm
    with np.errstate(all="ignore"):
        total = rgb.sum(axis=1)
        bright = rgb.mean(axis=2).max(axis=1)
        solved = valid & np.isfinite(total).all(axis=1) & (total > 0).all(axis=1)
        solved &= bright > config.dark_level
        unit = lights.colour / np.linalg.norm(lights.colour)
        across = total - (total @ unit)[:, None] * unit
        length = np.linalg.norm(across, axis=1)
        solved &= length / total.mean(axis=1) > config.grey_saturation
    rgb = np.where(solved[:, None, None], rgb, 0)
    across = np.where(solved[:, None], across / np.where(solved, length, 1)[:, None], 0)
    signal = np.einsum("npc,nc->np", rgb, across)
    points = camera_mm - (views @ camera_mm)[:, None] * views
    normals = views.copy()
    for _ in range(8):
        vectors, _ = light(lights, points, normals, views, config.roughness, solve=True)
        system = np.einsum("npi,npj->nij", vectors, vectors)[solved]
        right = np.einsum("npi,np->ni", vectors, signal)[solved]
        found = np.linalg.solve(system, right[..., None])[..., 0]
        normals[solved] = found / np.linalg.norm(found, axis=1, keepdims=True)
    e, mirror = light(lights, points, normals, views, config.roughness)
    rgb = rgb / lights.colour
    power = (e * e).sum(axis=1)
    own = mirror - e * ((e * mirror).sum(axis=1) / power)[:, None]
    weighed = np.where(solved, (own * rgb.mean(axis=2)).sum(axis=1), 0)
    weight = np.where(solved, (own * own).sum(axis=1), 0)
    typical = np.median(weight[solved]) if solved.any() else 0.0
    prior = config.specular_prior_share * typical
    sigma = config.specular_pool_mm * px_per_mm
    top = pooled(weighed, mask, sigma) + prior * config.specular_prior
    bottom = pooled(weight, mask, sigma) + prior
    specular = np.clip(top / np.where(bottom > 0, bottom, 1), 0, 0.2)
    lit = np.einsum("np,npc->nc", e, rgb) - (specular * (e * mirror).sum(axis=1))[:, None]
    lit, power = np.where(solved[:, None], lit, 0), np.where(solved, power, 0)
    near = np.stack([pooled(lit[:, c], mask, px_per_mm) for c in range(3)], axis=1)
    around = pooled(power, mask, px_per_mm)[:, None]
    near = np.where(around > 0, near / np.where(around > 0, around, 1), 0)
    own_weight = config.albedo_prior_power
    albedo = np.maximum((lit + own_weight * near) / (power[:, None] + own_weight), 0)
    none = ~solved
    albedo[none], normals[none], specular[none] = 0, 0, 0
    return Twin(normals, albedo, specular, solved)


def tiled(
    rgb: np.ndarray,
    mask: np.ndarray,
    view: np.ndarray,
    point: np.ndarray,
    lights: PatternLights,
    tables: FarTables,
    config: SeparateConfig,
) -> tuple[np.ndarray, np.ndarray]:
    """One tile's normals and lit over power by the same tables as the compiled loop, float64.

    Args:
        rgb: (4, 8, P, 3) readings.
        mask: (4, 8) bool, pixels that can be used.
        view, point: (3,) of the tile's middle.

    Returns:
        (n, 3) normals, (n, 3) diffuse albedo with all mirror reflection left in.
    """
    diffuse = tables.diffuse.astype(float).swapaxes(1, 2).reshape(len(tables.diffuse), ROWS, -1)
    count = len(lights.patterns)
    pixels = rgb[mask].astype(float)
    mean = pixels.mean(axis=0)
    unit = lights.colour / np.linalg.norm(lights.colour)
    total = mean.sum(axis=0)
    across = total - (total @ unit) * unit
    across /= np.linalg.norm(across)
    normal, b, cell = view, np.zeros(3), -1
    for _ in range(config.iterations):
        cell = cells(normal[None])[0]
        rows = diffuse[cell, :, :count]
        b = rows[:3] @ (mean @ across - _moved(rows[None], b[None], point[None])[0])
        normal = b / np.linalg.norm(b)
    xx, yy, zz, xy, xz, yz = diffuse[cell, 6:12, :count]
    moved = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    change = np.einsum("abk,b->ak", moved, point)
    solver = diffuse[cell, :3, :count]
    # Signals s = (G + J p) b with S G = 1, so that (1 + S J p) b = S s.
    found = np.linalg.solve(np.eye(3) + solver @ change.T, solver @ (pixels @ across).T).T
    normals = found / np.linalg.norm(found, axis=1, keepdims=True)
    e = np.maximum(normals @ (diffuse[cell, 3:6, :count] + change), 0)
    line = tables.leaving.astype(float)
    e *= np.interp(normals @ view, np.linspace(0, 1, len(line)), line)[:, None]
    lit = np.einsum("np,npc->nc", e, pixels / lights.colour)
    return normals, lit / (e * e).sum(axis=1)[:, None]


def tabulated(
    rgb: np.ndarray,
    views: np.ndarray,
    mask: np.ndarray,
    lights: PatternLights,
    tables: FarTables,
    config: SeparateConfig,
    camera_mm: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Normals and lit over power of good pixels by the same tables as the compiled loop, float64.

    Returns:
        (n, 3) normals, (n, 3) diffuse albedo with all mirror reflection left in.
    """
    diffuse = tables.diffuse.astype(float).swapaxes(1, 2).reshape(len(tables.diffuse), ROWS, -1)
    count = len(lights.patterns)
    rgb = rgb.astype(float)
    unit = lights.colour / np.linalg.norm(lights.colour)
    total = rgb.sum(axis=1)
    across = total - (total @ unit)[:, None] * unit
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    # Relative to what the pixel reads in all, as in the loop: neighbours begin from its length.
    signal = np.einsum("npc,nc->np", rgb, across) * (3 / total.sum(axis=1))[:, None]
    points = camera_mm - (views @ camera_mm)[:, None] * views
    n = np.zeros_like(views)
    cell = np.zeros(len(n), int)
    before, length = None, 0.0
    for i, (y, x) in enumerate(np.argwhere(mask)):
        # A run of neighbours of a row is searched one after the other, each from the last's end.
        if before is None or before[0] != y or before[1] != x - 1 or length == 0:
            n[i], length = views[i], 0.0
        else:
            n[i] = n[i - 1]
        before = (y, x)
        older, last, cell[i] = -1, -1, -1
        for _ in range(config.iterations):
            older, last, cell[i] = last, cell[i], cells(n[i : i + 1])[0]
            rows = diffuse[cell[i], :, :count]
            b = n[i] * length
            found = rows[:3] @ (signal[i] - _moved(rows[None], b[None], points[i : i + 1])[0])
            step = found - b
            length = float(np.linalg.norm(found))
            n[i] = found / length
            settled = cell[i] == last and step @ step < SETTLED * length**2
            if settled or (cell[i] == older and cell[i] != last):
                break
    rows = diffuse[cell][:, :, :count]
    e = np.einsum("njk,nj->nk", rows[:, 3:6], n) + _moved(rows, n, points)
    nv = np.clip((n * views).sum(axis=1), 0.05, 1)
    line = tables.leaving.astype(float)
    e = np.maximum(e, 0) * np.interp(nv, np.linspace(0, 1, len(line)), line)[:, None]
    power = (e * e).sum(axis=1)
    return n, np.einsum("np,npc->nc", e, rgb / lights.colour) / power[:, None]


def cells(n: np.ndarray) -> np.ndarray:
    """Cells of the octahedral grid."""
    u, v = (n[:, :2] / np.abs(n).sum(axis=1, keepdims=True)).T
    below = n[:, 2] < 0
    folded = (1 - np.abs(v)) * np.where(u >= 0, 1, -1), (1 - np.abs(u)) * np.where(v >= 0, 1, -1)
    u, v = np.where(below, folded[0], u), np.where(below, folded[1], v)
    i, j = (np.minimum(CELLS - 1, ((w + 1) / 2 * CELLS).astype(int)) for w in (u, v))
    return np.asarray(i * CELLS + j)


def _moved(rows: np.ndarray, n: np.ndarray, p: np.ndarray) -> np.ndarray:
    form = [n[:, i] * p[:, i] for i in range(3)]
    form += [n[:, i] * p[:, j] + n[:, j] * p[:, i] for i, j in ((0, 1), (0, 2), (1, 2))]
    return np.einsum("njk,jn->nk", rows[:, 6:], np.array(form))


def pooled(values: np.ndarray, mask: np.ndarray, sigma_px: float) -> np.ndarray:
    """Gaussian sums over the mask, at every pixel."""
    image = np.zeros(mask.shape)
    image[mask] = values
    return np.asarray(
        cv2.GaussianBlur(image, (0, 0), sigma_px, borderType=cv2.BORDER_CONSTANT)[mask]
    )
