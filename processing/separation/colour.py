"""Method `colour`: chroma's normals, specular albedo by least squares on skin's lobe.

Coarse: no mesh, no shadows. A pixel is taken to be where its ray passes the sphere's centre, so
that most of what the lights' finite distance does is known without a mesh.
"""

from __future__ import annotations

import dataclasses
import math

import cv2
import numpy as np

from lightstage.rig import Camera
from processing.albedo import NARROWEST_PX, shrunk
from processing.lanes import LANES
from processing.lighting.interface import skin_interface
from processing.lighting.lights import PatternLights
from processing.readings import px_per_mm
from processing.separation.coarse_given import Maps, Model, Window
from processing.separation.coarse_kernels import COUNT, SUMS, finish_window, solve_window
from processing.separation.coarse_tile import TILE_ROWS
from processing.separation.coarse_tiles import solve_tiles
from processing.separation.config import Relief, SeparateConfig, relief_of
from processing.separation.far_tables import far_tables
from processing.separation.linear import maps_by_chroma
from processing.separation.view_readings import Pixels
from processing.view_maps import PixelMaps

RELIEF: Relief = "diffuse"
"""What its specular normals are by itself."""
RAY_STEP_RAD = 1e-3
"""The camera's rays are found at steps of this angle and interpolated."""
SETTLED = 4e-6
"""A normal is found when a solve moves rho n by less than .002 of its length (squared here): what
is left is a tenth of that, since the next solve would move it ten times less."""


@dataclasses.dataclass(frozen=True)
class Readings:
    """What a window of a picture reads, and from where it is seen.

    Attributes:
        values: (P, h, w, 3) float16, times `scale`.
        scale: of the readings.
        mask: (h, w) bool, which to solve.
        valid: (h, w) bool, false where clipped.
        origin: row and column of the window's first pixel in the picture of the rays.
        rays: (gh, gw, 3) float32 unit directions from the camera, at every `step_px` pixels.
        step_px: see there.
        camera_mm: (3,) where the camera is; the origin itself takes every pixel to be there.
        px_per_mm: pixels a millimetre at the sphere's centre.
    """

    values: np.ndarray
    scale: float
    mask: np.ndarray
    valid: np.ndarray
    origin: tuple[int, int]
    rays: np.ndarray
    step_px: int
    camera_mm: np.ndarray
    px_per_mm: float


def in_one_pass(config: SeparateConfig) -> bool:
    """Whether `separate_window` does what `config` asks of the method `colour`."""
    plain = config.specular_normals in ("auto", "diffuse")
    return plain and config.normals in ("auto", "chroma")


def separate_pixels(pixels: Pixels, lights: PatternLights, config: SeparateConfig) -> PixelMaps:
    """Separation where `config` asks for more than the one pass of `separate_window`.

    Arguments as of `maps_by_chroma`, which does it.
    """
    return maps_by_chroma(pixels, lights, config, relief_of(RELIEF, config))


def tile_mm(readings: Readings) -> float:
    """The longer side of a tile of pixels at the sphere's centre."""
    return max(LANES, TILE_ROWS) / readings.px_per_mm


def camera_rays(camera: Camera, step_px: int) -> np.ndarray:
    """(gh, gw, 3) float32 directions of a camera's rays through every `step_px`th pixel's centre,
    and beyond the picture's end by one step.
    """
    few = dataclasses.replace(
        camera,
        width_px=-(-camera.width_px // step_px) + 1,
        height_px=-(-camera.height_px // step_px) + 1,
        fx_px=camera.fx_px / step_px,
        fy_px=camera.fy_px / step_px,
        cx_px=(camera.cx_px - 0.5) / step_px + 0.5,
        cy_px=(camera.cy_px - 0.5) / step_px + 0.5,
    )
    return np.ascontiguousarray(few.pixel_rays()[1], np.float32)


def window_readings(
    values: np.ndarray,
    scale: float,
    mask: np.ndarray,
    valid: np.ndarray,
    origin: tuple[int, int],
    camera: Camera,
) -> Readings:
    """Readings of a window of one camera's picture: (P, h, w, 3) halves, (h, w) mask and valid."""
    step_px = max(1, int(RAY_STEP_RAD * camera.fx_px))
    rays = camera_rays(camera, step_px)
    where, fine = camera.centre_mm, px_per_mm(camera)
    return Readings(values, scale, mask, valid, origin, rays, step_px, where, fine)


def separate_window(readings: Readings, lights: PatternLights, config: SeparateConfig) -> PixelMaps:
    """Separate a window of one view's frames, which may be on the disk: it is read once, in rows.

    Normals come from chroma, which holds no mirror reflection; specular albedo from least squares
    on the lobe model, pooled over neighbours; diffuse albedo from what the lobe leaves.

    Args:
        readings: see there.
        lights: of the P patterns.
        config: see there.

    Returns:
        float32 PixelMaps; confidence 0 and zeros where a pixel is clipped, dark, grey or not
        finite.
    """
    mask = np.ascontiguousarray(readings.mask)
    per_row = mask.sum(axis=1)
    row_start = np.cumsum(per_row) - per_row
    count = int(per_row.sum())
    tiles = tile_mm(readings) <= config.tile_mm and mask.shape[1] >= LANES
    block = max(1, int(readings.px_per_mm / 2))
    if tiles:
        block = -(-block // LANES) * LANES
    view = readings.rays[len(readings.rays) // 2, readings.rays.shape[1] // 2].astype(float)
    if np.any(readings.camera_mm):
        view = -readings.camera_mm / np.linalg.norm(readings.camera_mm)
    elif count:
        view = _mean_ray(readings)
    tables = far_tables(lights, -view, config.roughness, skin_interface())
    sums = np.zeros((*(-(-side // block) for side in mask.shape), SUMS + 1), np.float32)
    # Never written to, whoever gave them: the loop is compiled once, as it is for mapped files.
    half = readings.values.view(np.uint16)
    half.flags.writeable = False
    window = Window(
        half=half,
        scale=np.float32(readings.scale),
        mask=mask,
        valid=np.ascontiguousarray(readings.valid),
        row_start=row_start,
        origin=np.array(readings.origin),
        rays=readings.rays,
        step=readings.step_px,
        camera=readings.camera_mm.astype(np.float32),
        block=block,
    )
    white = np.append(lights.colour, lights.colour / np.linalg.norm(lights.colour))
    model = Model(
        diffuse=tables.diffuse.ravel(),
        lobe=tables.lobe.ravel(),
        leaving=tables.leaving,
        groups=tables.lobe.shape[1],
        radius=np.float32(tables.radius_mm),
        white=white.astype(np.float32),
        part=_part(config.normals, lights.colour),
        limits=_limits(config),
    )
    normal, albedo = np.empty((count, 3), np.float32), np.empty((count, 3), np.float32)
    maps = Maps(normal, albedo, *(np.empty(count, np.float32) for _ in range(3)))
    (solve_tiles if tiles else solve_window)(window, model, sums, maps)
    gloss, prior = blocks_albedo(sums, block, readings.px_per_mm, config)
    power, width = np.float32(config.albedo_prior_power), np.float32(config.roughness)
    finish_window(window, gloss, prior, power, width, albedo, maps.specular, maps.roughness)
    return PixelMaps(normal, normal, albedo, maps.specular, maps.roughness, maps.confidence)


def blocks_albedo(
    sums: np.ndarray, block: int, px_per_mm: float, config: SeparateConfig
) -> tuple[np.ndarray, np.ndarray]:
    """Specular albedo of blocks of pixels, pooled, and the diffuse albedo of their neighbourhood.

    Args:
        sums: (bh, bw, SUMS + 1) of `solve_window`.
        block: pixels a side.
        px_per_mm: pixels a millimetre.
        config: see there.

    Returns:
        (bh, bw) and (bh, bw, 3) float32.
    """
    count = sums[..., COUNT]
    full = count > 0
    each = sums[..., 1][full] / count[full]
    typical = float(np.median(each)) if full.any() else 0.0
    share = 1 / (block * block)
    pooled = _blurred(sums[..., :2] * share, config.specular_pool_mm * px_per_mm, block)
    weight = config.specular_prior_share * typical
    gloss = shrunk(pooled[..., 0], pooled[..., 1], config.specular_prior, weight)
    lit = sums[..., 2:5] - gloss[..., None] * sums[..., 6:7]
    near = _blurred(np.concatenate([lit, sums[..., 5:6]], axis=2) * share, px_per_mm, block)
    power = near[..., 3:]
    prior = np.where(power > 0, near[..., :3] / np.where(power > 0, power, 1), 0)
    return gloss.astype(np.float32), prior.astype(np.float32)


def _blurred(image: np.ndarray, sigma_px: float, block: int) -> np.ndarray:
    """Gaussian means over blocks, of coarser blocks where that is enough.

    Sums over blocks and lines between them blur already, by a quarter of a block squared.
    """
    rows, columns = image.shape[:2]
    times = max(1, int(sigma_px / block / 4))
    small = (-(-columns // times), -(-rows // times))
    if times > 1:
        border = (0, small[1] * times - rows, 0, small[0] * times - columns)
        padded = cv2.copyMakeBorder(image, *border, cv2.BORDER_CONSTANT)
        image = cv2.resize(padded, small, interpolation=cv2.INTER_AREA)
    sigma = sigma_px / block / times
    if block * times > 1:
        sigma = math.sqrt(max(sigma * sigma - 0.25, 0.01))
    sigma = max(sigma, NARROWEST_PX)
    found = cv2.GaussianBlur(image, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT)
    if times > 1:
        size = (small[0] * times, small[1] * times)
        found = cv2.resize(found, size, interpolation=cv2.INTER_LINEAR)[:rows, :columns]
    return np.asarray(found).reshape(rows, columns, -1)


def _limits(config: SeparateConfig) -> np.ndarray:
    """`Model.limits`."""
    half_trust = math.radians(config.half_trust_deg)
    values = (3 * config.dark_level, config.grey_saturation, config.iterations, SETTLED)
    return np.array([*values, config.noise**2, half_trust**2], np.float32)


def _part(normals: str, white: np.ndarray) -> np.ndarray:
    """`Model.part`."""
    if normals in ("auto", "chroma"):
        return np.zeros(3, np.float32)
    if normals == "mean":
        return np.asarray(1 / (3 * white), np.float32)
    weights = np.zeros(3, np.float32)
    channel = ("red", "green", "blue").index(normals)
    weights[channel] = 1 / white[channel]
    return weights


def _mean_ray(readings: Readings) -> np.ndarray:
    """(3,) unit: the mean of the rays where they are given."""
    total = readings.rays.reshape(-1, 3).sum(axis=0, dtype=float)
    length = float(np.linalg.norm(total))
    return total / length if length > 0 else np.array([0.0, 0.0, -1.0])


def fit(signal: np.ndarray, irradiance: np.ndarray) -> np.ndarray:
    """(n,) 0..1: how well the chroma follows the irradiance; shadows and clutter do not."""
    power = np.einsum("np,np->n", irradiance, irradiance)
    total = np.einsum("np,np->n", signal, signal)
    both = np.einsum("np,np->n", signal, irradiance)
    safe = np.where((power > 0) & (total > 0), power * total, 1)
    share = np.where((power > 0) & (total > 0), 1 - both * both / safe, 1)
    residual = np.sqrt(np.clip(share, 0, 1))
    return np.clip((0.4 - residual) / 0.3, 0, 1)
