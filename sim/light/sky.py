"""Skies: a clear sky of our own, and Mitsuba's sun and sky.

The sky of our own has the luminance of the CIE's standard clear sky (type 12) [Darula2002] and a
colour that turns from blue overhead to what the air mass leaves of white near the horizon; the sun
is reddened by Rayleigh's and the haze's extinction along Kasten and Young's air mass [Kasten1989].
It resembles a sky and has a sky's contrasts; Mitsuba's (Hosek and Wilkie [Hosek2012]) is the one
to measure with.
"""

from __future__ import annotations

import dataclasses
import importlib.util
from typing import Any

import numpy as np

from lightstage.formats.srgb import LUMINANCE
from sim.errors import SimError
from sim.light.environments import Panorama, add_sun, directions, solid_angles

RGB_UM = np.array([0.615, 0.545, 0.465])
"""Wavelengths that stand for the three channels, micrometres."""
SUN_RADIUS_DEG = 0.2669
DISC_SAMPLES = 256


@dataclasses.dataclass(frozen=True)
class SkyConfig:
    """The sun's place, and the air.

    Attributes:
        elevation_deg: of the sun, above 0 and up to 90.
        azimuth_deg: of the sun, from +z toward +x.
        haze: Angstrom's turbidity coefficient: extinction of the haze at 1 micrometre. Our sky.
        turbidity: Linke-like turbidity of Mitsuba's sky, 1 to 10.
        ground_albedo: of the ground below the horizon.
        rows: of the picture.
    """

    elevation_deg: float = 60.0
    azimuth_deg: float = 35.0
    haze: float = 0.06
    turbidity: float = 3.0
    ground_albedo: float = 0.25
    rows: int = 256

    def __post_init__(self) -> None:
        """SimError when a value is outside its range."""
        limits = {
            "elevation_deg": (0.5, 90.0),
            "azimuth_deg": (-360.0, 360.0),
            "haze": (0.0, 1.0),
            "turbidity": (1.0, 10.0),
            "ground_albedo": (0.0, 1.0),
            "rows": (4, 4096),
        }
        for name, (least, most) in limits.items():
            value = getattr(self, name)
            if not least <= value <= most:
                raise SimError(
                    "sky", field=name, found=str(value), expected=f"between {least} and {most}"
                )


def sun_direction(config: SkyConfig) -> np.ndarray:
    """(3,) unit, to the sun."""
    high, round_ = np.radians(config.elevation_deg), np.radians(config.azimuth_deg)
    flat = np.cos(high)
    return np.array([flat * np.sin(round_), np.sin(high), flat * np.cos(round_)])


def air_mass(elevation_deg: float) -> float:
    """How many zenith atmospheres a ray crosses [Kasten1989]."""
    high = max(elevation_deg, 0.0)
    return float(1.0 / (np.sin(np.radians(high)) + 0.50572 * (high + 6.07995) ** -1.6364))


def sun_irradiance(config: SkyConfig) -> np.ndarray:
    """(3,) of a surface that faces the sun; 1 of each channel above the air."""
    rayleigh = 0.00864 * RGB_UM**-4.08
    haze = config.haze * RGB_UM**-1.3
    return np.exp(-air_mass(config.elevation_deg) * (rayleigh + haze))


def clear_sky(config: SkyConfig, toward: np.ndarray) -> np.ndarray:
    """Radiance of our clear sky, without the sun's disc.

    Args:
        config: see there.
        toward: (..., 3) unit; below the horizon the sky's rim is returned.

    Returns:
        (..., 3), on the scale where the sun above the air gives an irradiance of 1: scaled so that
        the sky gives the ground what a clear sky of this sun does, about a sixth of a high sun.
    """
    sun = sun_direction(config)
    rows = 32
    whole = directions(rows)[: rows // 2]
    given = _relative_sky(config, sun, whole)
    share = solid_angles(rows)[: rows // 2, None] * whole[..., 1]
    luminous = float(np.sum(share * (given @ LUMINANCE)))
    # Of what the air takes from the sun about half comes down again.
    lost = float((1.0 - sun_irradiance(config)) @ LUMINANCE) * 0.5 * max(sun[1], 0.05)
    return _relative_sky(config, sun, toward) * (lost / luminous)


def _relative_sky(config: SkyConfig, sun: np.ndarray, toward: np.ndarray) -> np.ndarray:
    """CIE type 12: gradation a = -1, b = -0.32; indicatrix c = 10, d = -3, e = 0.45."""
    up = np.maximum(toward[..., 1], 0.01)
    angle = np.arccos(np.clip(toward @ sun, -1, 1))
    gradation = 1.0 - np.exp(-0.32 / up)
    scatter = 1.0 + 10.0 * (np.exp(-3.0 * angle) - np.exp(-1.5 * np.pi))
    scatter += 0.45 * np.cos(angle) ** 2
    bright = gradation * scatter
    # Rayleigh's blue, washed out where the path is long, reddened as the sun is.
    path = (1.0 / (up + 0.08))[..., None]
    blue = RGB_UM**-4.0 / float((RGB_UM**-4.0) @ LUMINANCE)
    tint = blue * np.exp(-0.00864 * RGB_UM**-4.08 * (path + 0.25 * air_mass(config.elevation_deg)))
    haze = sun_irradiance(config) ** 0.6
    # Haze scatters forward, the colour of the sun, and hides the blue near the horizon.
    near = (0.12 + 0.6 * np.exp(-2.5 * angle) + 0.35 * np.exp(-6.0 * up))[..., None]
    near = np.minimum(near, 0.95)
    colour = (1 - near) * tint / (tint @ LUMINANCE)[..., None] + near * haze / float(
        haze @ LUMINANCE
    )
    return bright[..., None] * colour


def mitsuba_sky(config: SkyConfig, name: str) -> Panorama:
    """Mitsuba's sun and sky over a grey ground as a picture; needs the extra `reference`.

    The sun's disc, smaller than a texel, is integrated and put into one; the ground is a diffuser
    lit by all of it. Channels that the model leaves negative (a deep red sun outside sRGB) are 0.

    Raises:
        SimError: Mitsuba is not installed.
    """
    if importlib.util.find_spec("mitsuba") is None:
        raise SimError(
            f"environment {name}",
            found="no Mitsuba",
            expected="the extra `reference`",
            hint="Install lightstage[reference], or take the street, which needs nothing.",
        )
    import mitsuba as mi

    before = mi.variant()
    mi.set_variant("scalar_rgb")
    try:
        sun = sun_direction(config)
        # Mitsuba's sky has +z up; ours (x, y, z) is its (z, x, y).
        shared = {
            "type": "sunsky",
            "sun_direction": [float(sun[2]), float(sun[0]), float(sun[1])],
            "turbidity": config.turbidity,
            "albedo": {"type": "rgb", "value": config.ground_albedo},
        }
        sky = mi.load_dict({**shared, "sun_scale": 0.0})
        disc = mi.load_dict({**shared, "sky_scale": 0.0})

        def light(emitter: Any, toward: np.ndarray) -> np.ndarray:
            place = mi.SurfaceInteraction3f()
            out = np.empty_like(toward)
            for i, (x, y, z) in enumerate(toward.tolist()):
                place.wi = mi.Vector3f(-z, -x, -y)
                out[i] = np.array(emitter.eval(place, True)).ravel()
            return np.maximum(out, 0.0)

        rows = config.rows
        toward = directions(rows)
        above = toward[..., 1] > 0
        radiance = np.zeros_like(toward)
        radiance[above] = light(sky, toward[above])
        rays, each = _disc(sun)
        add_sun(radiance, sun, light(disc, rays).sum(axis=0) * each)
    finally:
        if before is not None:
            mi.set_variant(before)
    level = np.sum(
        radiance * (solid_angles(rows)[:, None] * toward[..., 1])[..., None], axis=(0, 1)
    )
    radiance[~above] = config.ground_albedo * level / np.pi
    return Panorama(name, radiance)


def _disc(sun: np.ndarray) -> tuple[np.ndarray, float]:
    """Rays (n, 3) spread evenly over the sun's disc, and the steradians of each."""
    k = np.arange(DISC_SAMPLES) + 0.5
    edge = np.cos(np.radians(0.999 * SUN_RADIUS_DEG))
    cosine = 1 - (1 - edge) * k / DISC_SAMPLES
    turn = np.pi * (3 - np.sqrt(5)) * k
    sine = np.sqrt(1 - cosine**2)
    side = np.cross(sun, [0.0, 0.0, 1.0] if abs(sun[2]) < 0.9 else [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    other = np.cross(sun, side)
    rays = cosine[:, None] * sun + sine[:, None] * (
        np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * other
    )
    solid = 2 * np.pi * (1 - np.cos(np.radians(SUN_RADIUS_DEG)))
    return rays, float(solid / DISC_SAMPLES)
