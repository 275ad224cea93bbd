"""What our maps are held against: the published formulas and plain normals, each with its grid.

Two kinds. Far away: `separate` with another method, a field without mesh as it was published or
with the stage's own lights. On the true mesh: normals from one channel, or from the mean of all,
with the same positions, shadows and interface that `refine` has; a constant replaces the mirror
reflection.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from benchmarks.reflectance_case import Case
from benchmarks.reflectance_scores import Maps
from lightstage.formats.mesh import read_ply
from processing.albedo import diffuse_albedo, diffuse_light
from processing.frames.read import read_foreground, read_frames
from processing.lighting.interface import skin_interface
from processing.lighting.lights import PatternLights, irradiance_vectors, pattern_lights
from processing.lighting.lobe import transport
from processing.normals import solve_normals
from processing.readings import px_per_mm
from processing.surface import Sight, lit_surface, see

SOLVES = 2
MOST_FACES = 120_000
SHADOW_OFFSET_MM = 0.3
SMOOTHING_MM = 1.0
ALBEDO_PRIOR_POWER = 0.005
CHANNELS = {"red": [0], "blue": [2], "mean": [0, 1, 2]}

Settings = Mapping[str, Any]


@dataclasses.dataclass(frozen=True)
class Peer:
    """A method and the settings that it is tried with.

    Attributes:
        name: of the method.
        grid: settings, each as it is printed.
        maps: of a case and settings.
    """

    name: str
    grid: tuple[Settings, ...]
    maps: Callable[[Case, Settings], dict[str, Maps]]


def product(**values: tuple[Any, ...]) -> tuple[dict[str, Any], ...]:
    """All combinations of values."""
    return tuple(
        dict(zip(values, chosen, strict=True)) for chosen in itertools.product(*values.values())
    )


def far_kampouris(case: Case, settings: Settings) -> dict[str, Maps]:
    """The published separation."""
    options = {key: value for key, value in settings.items() if key != "normals"}
    return case.separated(
        {"method": "kampouris", "normals": settings["normals"], "kampouris": options}
    )


def far_ratios(case: Case, settings: Settings) -> dict[str, Maps]:
    """Ratios of complements as photographed, of all channels or of one."""
    options = {key: value for key, value in settings.items() if key != "normals"}
    return case.separated({"method": "ratios", "normals": settings["normals"], "ratios": options})


def on_mesh(case: Case, settings: Settings) -> dict[str, Maps]:
    """Normals from some channels with the true mesh, a constant for the mirror reflection."""
    return dict(_on_mesh(case, settings))


def _on_mesh(case: Case, settings: Settings) -> Iterator[tuple[str, Maps]]:
    lights, sights = true_sights(case)
    constant, roughness = float(settings["specular"]), float(settings["roughness"])
    for camera_id, sight in sights.items():
        rgb = read_frames(case.out, camera_id).pixels(sight.mask)
        rgb /= lights.colour.astype(np.float32)
        signal = rgb[:, :, CHANNELS[settings["channel"]]].mean(axis=2)
        normal = matte_normals(signal, sight, lights, constant, roughness)
        e, lobe = lit(sight, lights, normal, roughness)
        mirror = np.full(len(normal), constant, np.float32)
        found, power = diffuse_light(rgb, e, lobe, mirror)
        per_mm = px_per_mm(case.session.rig.camera(camera_id))
        yield camera_id, placed(sight.mask, normal, found, power, mirror, roughness, per_mm)


@functools.lru_cache(maxsize=1)
def true_sights(case: Case) -> tuple[PatternLights, dict[str, Sight]]:
    """A case's lights, and camera id to what it sees of the true mesh."""
    cameras = case.session.camera_ids()
    lights = pattern_lights(case.session, read_frames(case.out, cameras[0]).patterns)
    surface = lit_surface(
        read_ply(case.truth.base_mesh),
        lights,
        offset_mm=SHADOW_OFFSET_MM,
        smoothing_mm=SMOOTHING_MM,
        directions=1,
        most_faces=MOST_FACES,
    )
    rig, out = case.session.rig, case.out
    return lights, {c: see(surface, rig.camera(c), read_foreground(out, c)) for c in cameras}


def matte_normals(
    signal: np.ndarray, sight: Sight, lights: PatternLights, constant: float, roughness: float
) -> np.ndarray:
    """(n, 3) normals of readings (n, P) less the lobe of a constant specular albedo."""
    normal = sight.normals
    for _ in range(SOLVES):
        matte = signal
        if constant > 0:
            matte = signal - np.float32(constant) * lit(sight, lights, normal, roughness)[1]
        vectors = irradiance_vectors(
            lights, sight.points_mm, normal, sight.shadows, skin_interface(), roughness
        )
        found = solve_normals(np.ascontiguousarray(matte, np.float32), vectors)
        good = np.einsum("nk,nk->n", found, sight.normals) > 0
        normal = np.where(good[:, None], found, sight.normals)
    return normal


def lit(
    sight: Sight, lights: PatternLights, normal: np.ndarray, roughness: float
) -> tuple[np.ndarray, np.ndarray]:
    """E_k and B_k of a view's pixels."""
    return transport(
        lights,
        sight.points_mm,
        normal,
        sight.views,
        roughness,
        sight.shadows,
        skin_interface(),
    )


def placed(
    mask: np.ndarray,
    normal: np.ndarray,
    found: np.ndarray,
    power: np.ndarray,
    mirror: np.ndarray,
    roughness: float,
    sigma_px: float,
) -> Maps:
    """Maps of a mask's pixels in their picture; such a method knows no confidence but 1.

    Args:
        mask: (h, w) bool with n true pixels.
        normal: (n, 3).
        found, power: of `diffuse_light`.
        mirror: (n,) specular albedo.
        roughness: everywhere.
        sigma_px: over which creases that see hardly any light take their neighbours' albedo.
    """
    albedo = diffuse_albedo(found, power, mask, sigma_px, ALBEDO_PRIOR_POWER)

    def picture(values: np.ndarray) -> np.ndarray:
        image = np.zeros((*mask.shape, *values.shape[1:]), np.float32)
        image[mask] = values
        return image

    ones = np.ones(len(normal))
    normals, even = picture(normal), picture(ones)
    return Maps(normals, normals, picture(albedo), picture(mirror), even * roughness, even)


PEERS = (
    Peer(
        "kampouris",
        product(
            combine=("median", "maximum", "mean", "weighted"),
            field=("uniform", "lights"),
            least_saturation=(0.02,),
            most_specular=(0.05, 0.2),
            normals=("auto",),
        )
        + product(
            combine=("weighted",),
            field=("lights",),
            least_saturation=(0.02,),
            most_specular=(0.05,),
            normals=("red", "blue"),
        ),
        far_kampouris,
    ),
    Peer(
        "ratios",
        product(field=("uniform", "lights"), specular=(0.0, 0.014, 0.02, 0.026), normals=("mean",)),
        far_ratios,
    ),
    Peer(
        "red",
        product(field=("uniform", "lights"), specular=(0.0, 0.014, 0.02, 0.026), normals=("red",)),
        far_ratios,
    ),
    Peer(
        "blue",
        product(field=("uniform", "lights"), specular=(0.0, 0.014, 0.02, 0.026), normals=("blue",)),
        far_ratios,
    ),
    Peer(
        "red, true mesh",
        product(channel=("red",), specular=(0.0, 0.014, 0.02, 0.026), roughness=(0.2, 0.26)),
        on_mesh,
    ),
    Peer(
        "blue, true mesh",
        product(channel=("blue",), specular=(0.0, 0.014, 0.02, 0.026), roughness=(0.2, 0.26)),
        on_mesh,
    ),
)
