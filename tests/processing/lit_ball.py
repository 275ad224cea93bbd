"""A ball lit by the default rig, in plain float64: the known answer of the reflectance tests."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import pickle
from pathlib import Path

import numpy as np

from lightstage.formats.exr import write_exr
from lightstage.formats.session import Frame, SessionFile, save_session
from lightstage.patterns import SEQUENCES, pattern_levels
from lightstage.rig import Camera, Rig, default_rig, save_rig
from processing.lighting.lamps import nominal_lamps
from processing.lighting.lights import PatternLights, lights_of

PATTERNS = SEQUENCES["binary"]


@dataclasses.dataclass(frozen=True)
class Ball:
    """A ball of one skin. Lengths in mm."""

    radius_mm: float = 95.0
    albedo: tuple[float, float, float] = (0.55, 0.33, 0.22)
    specular: float = 0.028
    roughness: float = 0.25
    centre_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    coated: bool = False
    """Whether the diffuse layer lies below the interface that mirrors, as skin's does."""


@dataclasses.dataclass(frozen=True)
class Sight:
    """What a camera sees of a ball: all of (n, ...) in the mask's row order, mask (h, w)."""

    mask: np.ndarray
    points_mm: np.ndarray
    normals: np.ndarray
    views: np.ndarray


def small_rig(cameras: int = 1, factor: float = 0.028) -> Rig:
    """The default rig with fewer and smaller cameras."""
    rig = default_rig().scaled(factor)
    return dataclasses.replace(rig, cameras=rig.cameras[:cameras])


def lights_of_rig(rig: Rig, patterns: tuple[str, ...] = PATTERNS) -> PatternLights:
    """A rig's nominal lights as processing reckons with them."""
    levels = np.stack([pattern_levels(name, rig) for name in patterns])
    return lights_of(nominal_lamps(rig), patterns, levels)


def see(ball: Ball, camera: Camera) -> Sight:
    """First hits of a camera's pixels, by the quadratic."""
    origin, directions = camera.pixel_rays()
    offset = origin - np.array(ball.centre_mm)
    along = directions @ offset
    inside = along**2 - (offset @ offset - ball.radius_mm**2)
    mask = inside > 0
    distance = -along[mask] - np.sqrt(inside[mask])
    points = origin + directions[mask] * distance[:, None]
    normals = (points - ball.centre_mm) / ball.radius_mm
    return Sight(mask, points, normals, -directions[mask])


def exact_fresnel(f0: float, cosine: np.ndarray) -> np.ndarray:
    """By Snell's law and the two polarisations."""
    index = (1 + np.sqrt(f0)) / (1 - np.sqrt(f0))
    inside = np.sqrt(1 - (1 - cosine**2) / index**2)
    s = (cosine - index * inside) / (cosine + index * inside)
    p = (inside - index * cosine) / (inside + index * cosine)
    return (s**2 + p**2) / 2


def smith(cosine: np.ndarray, roughness: float) -> np.ndarray:
    """Smith's G1 for Beckmann as the rational fit of Walter 2007 has it."""
    a = cosine / (roughness * np.sqrt(np.maximum(1 - cosine**2, 1e-30)))
    fitted = (3.535 * a + 2.181 * a**2) / (1 + 2.276 * a + 2.577 * a**2)
    return np.where(a < 1.6, fitted, 1.0)


def let_through(ball: Ball, cosine: np.ndarray) -> np.ndarray:
    """Share of light that enters the ball's skin, 1 without a coat."""
    if not ball.coated:
        return np.ones_like(cosine)
    grid, shares = entering(ball.roughness)
    return np.interp(cosine, grid, shares)


def kept_mean(ball: Ball) -> float:
    """Mean over the hemisphere, weighted by the cosine, of the share that enters."""
    grid, shares = entering(ball.roughness)
    return float(np.trapezoid(2 * grid * shares, grid))


@functools.cache
def entering(roughness: float) -> tuple[np.ndarray, np.ndarray]:
    """Cosines, and 1 - the sum over visible half vectors of what the facets of n = 1.4 mirror.

    The integral runs over the facets' normals, drawn evenly in Beckmann's cumulative share.
    """
    u, phi = np.meshgrid((np.arange(200) + 0.5) / 200, np.pi * (np.arange(64) + 0.5) / 64)
    hz = 1 / np.sqrt(1 - roughness**2 * np.log(1 - u))
    hx = np.sqrt(1 - hz**2) * np.cos(phi)
    grid = np.linspace(0, 1, 41)
    shares = []
    for cosine in np.maximum(grid, 0.01):
        vh = hz * cosine + hx * np.sqrt(1 - cosine**2)
        nl = 2 * vh * hz - cosine
        seen = (vh > 0) & (nl > 0)
        g1, g2 = smith(np.array(cosine), roughness), smith(np.maximum(nl, 1e-9), roughness)
        masked = 1 / (1 / g1 + 1 / g2 - 1)  # height-correlated
        f = exact_fresnel((0.4 / 2.4) ** 2, np.maximum(vh, 0))
        shares.append(1 - np.where(seen, f * masked * vh / (hz * cosine), 0).mean())
    return grid, np.array(shares)


def shade(
    ball: Ball, sight: Sight, rig: Rig, levels: np.ndarray, seen_lights: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """(..., n) irradiance and mirror radiance under (..., L) levels: patterns share the geometry.

    A convex ball shadows only itself; `seen_lights`, (L, n) bool, says what something else hides.
    """
    lights = rig.positions_mm
    radii = np.linalg.norm(lights, axis=1)
    white = (np.maximum(lights[:, 2], 0) / radii).sum()  # all radii are equal in the default rig
    irradiance = np.zeros((*levels.shape[:-1], len(sight.points_mm)))
    mirror = np.zeros_like(irradiance)
    nv = np.maximum((sight.normals * sight.views).sum(axis=1), 0.05)
    m = ball.roughness
    leaving = let_through(ball, nv) / (kept_mean(ball) if ball.coated else 1)
    seen, skin = smith(nv, m), (0.4 / 2.4) ** 2
    for number, (light, radius, level) in enumerate(
        zip(lights, radii, np.moveaxis(levels, -1, 0), strict=True)
    ):
        if not level.any():
            continue
        to_light = light - sight.points_mm
        distance = np.linalg.norm(to_light, axis=1)
        to_light /= distance[:, None]
        nl = np.maximum((sight.normals * to_light).sum(axis=1), 0)
        weight = (level / white)[..., None] * (radius / distance) ** 2
        if seen_lights is not None:
            weight = weight * seen_lights[number]
        irradiance += weight * (nl * let_through(ball, nl) * leaving)
        half = to_light + sight.views
        half /= np.linalg.norm(half, axis=1, keepdims=True)
        nh = (sight.normals * half).sum(axis=1)
        tan2 = (1 - nh**2) / nh**2
        spread = np.exp(-tan2 / m**2) / (np.pi * m**2 * nh**4)
        f = ball.specular / skin * exact_fresnel(skin, (sight.views * half).sum(axis=1))
        brdf_nl = spread * f * seen * smith(np.maximum(nl, 1e-9), m) / (4 * nv)
        mirror += weight * np.where(nl > 0, np.pi * brdf_nl, 0)
    return irradiance, mirror


def photograph(
    ball: Ball, sight: Sight, rig: Rig, seen_lights: np.ndarray | None = None
) -> np.ndarray:
    """(n, P, 3) what the pixels read under the binary sequence; see `shade`."""
    levels = np.stack([pattern_levels(name, rig) for name in PATTERNS])
    irradiance, mirror = shade(ball, sight, rig, levels, seen_lights)
    return (irradiance[..., None] * np.array(ball.albedo) + mirror[..., None]).swapaxes(0, 1)


@functools.lru_cache(32)
def _photographed(given: bytes) -> tuple[np.ndarray, np.ndarray]:
    """(h, w) mask and (n, P, 3) readings of a pickled ball, camera and rig: many tests' session."""
    ball, camera, rig = pickle.loads(given)
    sight = see(ball, camera)
    return sight.mask, photograph(ball, sight, rig)


def write_session(ball: Ball, rig: Rig, root: Path) -> Path:
    """A session of linear frames; returns its folder."""
    save_rig(rig, root / "rig.json")
    frames = []
    for camera in rig.cameras:
        mask, rgb = _photographed(pickle.dumps((ball, camera, rig)))
        for index, name in enumerate(PATTERNS):
            image = np.zeros((*mask.shape, 3), np.float32)
            image[mask] = rgb[:, index]
            path = Path("frames") / name / f"{camera.id}.exr"
            write_exr(root / path, image, half=False)
            digest = hashlib.sha256((root / path).read_bytes()).hexdigest()
            frames.append(
                Frame(
                    pattern=name,
                    camera=camera.id,
                    path=str(path),
                    sha256=digest,
                    encoding="linear",
                )
            )
    save_session(
        root,
        SessionFile(
            id="ball",
            created_utc="2026-01-01T00:00:00Z",
            subject="ball",
            expression="neutral",
            sequence=list(PATTERNS),
            frames=frames,
        ),
    )
    return root


def angle_deg(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angles between unit vectors along the last axis, in degrees."""
    return np.degrees(np.arccos(np.clip((a * b).sum(axis=-1), -1, 1)))
