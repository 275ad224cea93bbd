"""A person under any set of lights: environments, studios, the stage's own patterns."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from lightstage.commands import ProgressCallback, quiet
from lightstage.formats.environment import LightSet, read_lights
from lightstage.formats.exr import write_exr
from lightstage.formats.png import write_png
from lightstage.formats.srgb import LUMINANCE
from lightstage.rig import Camera
from sim.errors import SimError
from sim.light.environments import Panorama, load_panorama, panorama_lights, rotated
from sim.light.lamps import point_lamps
from sim.light.olat import states
from sim.light.scene import Scene
from sim.light.sky import SkyConfig, mitsuba_sky
from sim.light.street import street
from sim.light.studio import STUDIOS, studio

SKIES = {
    "noon": SkyConfig(elevation_deg=60.0, azimuth_deg=35.0, turbidity=3.0),
    "sunset": SkyConfig(elevation_deg=4.0, azimuth_deg=50.0, turbidity=4.0),
}
LIGHTS_AT_ONCE = 256
SAMPLES = 3
"""Rays a pixel and side at silhouettes."""


@dataclasses.dataclass(frozen=True)
class RelightConfig:
    """How an environment becomes lights.

    Attributes:
        lights: that stand for it, at most (studios: about).
        rotate_deg: turns it about +y, from +z toward +x.
    """

    lights: int = 256
    rotate_deg: float = 0.0

    def __post_init__(self) -> None:
        """SimError for no light or too many, or an angle that is none."""
        if not 1 <= self.lights <= 65536:
            raise SimError(
                "environment", field="lights", found=str(self.lights), expected="1 to 65536"
            )
        if not np.isfinite(self.rotate_deg):
            raise SimError(
                "environment", field="rotate_deg", found=str(self.rotate_deg), expected="degrees"
            )


def environment_names() -> tuple[str, ...]:
    """Names that `environment_lights` knows besides files."""
    return ("street", "uniform", *SKIES, *STUDIOS)


def is_environment(name: str) -> bool:
    """Whether a name is an environment's or a file's, and so no pattern."""
    return name in environment_names() or Path(name).suffix.lower() in (".exr", ".hdr", ".json")


def environment_lights(name: str, config: RelightConfig | None = None, seed: int = 0) -> LightSet:
    """The lights of an environment.

    Args:
        name: one of `environment_names`, a latitude-longitude picture (.exr, .hdr) or a light set
            (.json, formats.environment).
        config: how many, and turned how.
        seed: of the street's houses.

    Raises:
        SimError, FormatError: no such name, or a file that cannot be used.
    """
    config = config or RelightConfig()
    path = Path(name)
    if name in STUDIOS:
        lights = studio(name, config.lights)
    elif path.suffix.lower() == ".json":
        lights = _with_ambient(read_lights(path), config.lights)
    else:
        lights = panorama_lights(_panorama(name, seed), config.lights)
    return rotated(lights, config.rotate_deg)


def _panorama(name: str, seed: int) -> Panorama:
    if name == "street":
        return street(seed)
    if name == "uniform":
        return Panorama("uniform", np.ones((64, 128, 3)))
    if name in SKIES:
        return mitsuba_sky(SKIES[name], name)
    if Path(name).suffix.lower() in (".exr", ".hdr"):
        return load_panorama(Path(name))
    raise SimError(
        f"environment {name!r}",
        found="an unknown name",
        expected=f"{', '.join(environment_names())}, a pattern, or a file .exr, .hdr, .json",
    )


def _with_ambient(lights: LightSet, count: int) -> LightSet:
    """A light set whose ambient term comes from lights all around, so that it casts shadows."""
    if not lights.ambient_rgb.any():
        return lights
    around = panorama_lights(
        Panorama("ambient", np.broadcast_to(lights.ambient_rgb, (64, 128, 3))), count
    )
    return LightSet(
        lights.name,
        np.concatenate([lights.position_mm, around.position_mm]),
        np.concatenate([lights.rgb, around.rgb]),
        np.zeros(3),
    )


def relit(
    scene: Scene,
    camera: Camera,
    lights: LightSet,
    progress: ProgressCallback = quiet,
    *,
    samples: int = SAMPLES,
) -> np.ndarray:
    """A person's picture under points of light, with cast shadows.

    Args:
        scene: the person.
        camera: the view.
        lights: points; an ambient term is not theirs (`environment_lights` has none).
        progress: of lights.
        samples: rays a pixel and side at silhouettes.

    Returns:
        (h, w, 3) float32, linear; the background is black.
    """
    surface = scene.surface(camera)
    views = [(surface, np.ones(len(surface.pixel), bool), np.float32(1))]
    if samples > 1:
        edge, fine = scene.edge_samples(surface, samples)
        inner = ~np.isin(surface.pixel, edge)
        views = [
            (surface, inner, np.float32(1)),
            (fine, np.ones(len(fine.pixel), bool), np.float32(1 / samples**2)),
        ]
    out = np.zeros((camera.height_px * camera.width_px, 3), np.float32)
    count = len(lights.position_mm)
    for first in range(0, count, LIGHTS_AT_ONCE):
        part = slice(first, first + LIGHTS_AT_ONCE)
        lamps = point_lamps(lights.position_mm[part])
        weights = lights.rgb[None, part]
        for seen, used, share in views:
            coarse = {} if seen is surface else {"coarse_px": 1}
            bits = scene.visible_lights(seen, lamps.positions_mm, **coarse)
            fields = (seen.position, seen.geometric, seen.normal, seen.view)
            skin = (seen.albedo, seen.specular, seen.roughness)
            for tile, body, mirror in states(*fields, *skin, bits, lamps, weights, seen.lobe):
                light = (body + mirror)[0] * (share * used[tile, None])
                np.add.at(out, seen.pixel[tile], light)
        progress(min(first + LIGHTS_AT_ONCE, count), count)
    return out.reshape(camera.height_px, camera.width_px, 3)


def auto_exposure(picture: np.ndarray, white: float = 0.75) -> float:
    """The factor that brings the bright end (97 %) of a (h, w, 3) picture's subject to `white`."""
    bright = picture @ LUMINANCE
    seen = bright[bright > 0]
    level = float(np.quantile(seen, 0.97)) if len(seen) else 0.0
    return white / level if level > 0 else 1.0


def write_picture(picture: np.ndarray, path: Path, exposure: float) -> Path:
    """Write a linear picture (h, w, 3): .exr as it is, .png exposed and encoded as sRGB.

    Raises:
        SimError: another suffix.
    """
    suffix = path.suffix.lower()
    if suffix == ".exr":
        return write_exr(path, picture, half=False)
    require_picture(path)
    linear = np.clip(picture * exposure, 0, 1)
    # IEC 61966-2-1 [IEC61966].
    low = linear * 12.92
    encoded = np.where(linear <= 0.0031308, low, 1.055 * linear ** (1 / 2.4) - 0.055)
    return write_png(path, np.round(encoded * 255).astype(np.uint8))


def require_picture(path: Path) -> None:
    """SimError unless a path ends as a picture that `write_picture` makes."""
    if path.suffix.lower() not in (".png", ".exr"):
        raise SimError(path, found=path.suffix or "no suffix", expected=".png or .exr")
