"""A camera between the light that meets it and the 8-bit file: it meters, balances, curves, stores.

Heads that are photographed linearly show their albedo times their light. A camera's file does not:
exposure follows what is metered, white balance is off, a curve makes the contrast, and what was
too bright is white. All of it is drawn from one seed. Distance follows the focal length, so that
faces keep their size in the picture and change their perspective.
"""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np

from benchmarks.networks_people import Head
from benchmarks.photo_studio import HEIGHT_PX, WIDTH_PX, Sitter
from lightstage.formats.environment import LightSet
from lightstage.formats.srgb import linear_from_srgb
from processing.colour import srgb_from_linear

FILM_MM = 36.0
"""The longer side of 35 mm film."""
FOCAL_MM = (28.0, 200.0)
METERS = ("face", "centre", "scene", "key")
GREY, GREY_STOPS = 0.18, 0.3
"""Value that a metered mean gets, and the deviation of that in stops."""
KEY, KEY_CODE = 95.0, (0.6, 0.9)
"""Percentile of the face's luminance that `key` meters, and the display value it becomes."""
BALANCE = 0.1
"""Standard deviation of the logarithm of red's and blue's gain."""
CENTRE = 0.2
"""Deviation of the weight of a centre-weighted meter, of the picture's sides."""
LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)
LEAST = 1e-4
LENS_PX = 0.6
"""Standard deviation of the lens's blur."""


@dataclasses.dataclass(frozen=True)
class Shooting:
    """Settings of a photograph.

    Attributes:
        focal_mm: as on 35 mm film.
        told: the file states the focal length.
        meter: of `METERS`: the mean of the face, of the centre, of the scene, or the face's lit
            side.
        logarithmic: the mean is of logarithms.
        level: what the metered value becomes, linear.
        balance: gains of red, green and blue beside the right ones.
        contrast: share of a smooth S in the tone curve.
        toe: display value of black, below zero where the shadows are cut off.
        shoulder: display value at which highlights begin to be compressed.
        saturation: factor of the distance from grey.
        sharpening: share of the detail that is added.
        sharpening_px: its standard deviation.
        noise: deviation of a linear value of 1, by photons; that of black is a fiftieth.
        quality: of the JPEG.
        seed: of noise and background.
    """

    focal_mm: float
    told: bool
    meter: str
    logarithmic: bool
    level: float
    balance: tuple[float, float, float]
    contrast: float
    toe: float
    shoulder: float
    saturation: float
    sharpening: float
    sharpening_px: float
    noise: float
    quality: int
    seed: int

    @property
    def focal_px(self) -> float:
        """Focal length in the studio's pixels."""
        return self.focal_mm / FILM_MM * max(WIDTH_PX, HEIGHT_PX)


def drawn(rng: np.random.Generator) -> Shooting:
    """A way to take a photograph.

    Args:
        rng: of all of it.
    """
    meter = METERS[int(rng.integers(len(METERS)))]
    grey = GREY * 2 ** rng.normal(0, GREY_STOPS)
    key = float(linear_from_srgb(np.array(rng.uniform(*KEY_CODE))))
    red, blue = np.exp(rng.normal(0, BALANCE, 2))
    return Shooting(
        focal_mm=float(np.exp(rng.uniform(*np.log(FOCAL_MM)))),
        told=bool(rng.random() < 0.5),
        meter=meter,
        logarithmic=bool(rng.random() < 0.5),
        level=key if meter == "key" else float(grey),
        balance=(float(red), 1.0, float(blue)),
        contrast=float(np.clip(rng.normal(0.3, 0.2), -0.1, 0.8)),
        toe=float(rng.uniform(-0.03, 0.03)),
        shoulder=float(rng.uniform(0.7, 0.95)),
        saturation=float(rng.uniform(0.9, 1.3)),
        sharpening=float(rng.uniform(0, 0.8)),
        sharpening_px=float(rng.uniform(0.7, 1.5)),
        noise=float(np.exp(rng.uniform(*np.log((0.003, 0.03))))),
        quality=int(rng.integers(75, 96)),
        seed=int(rng.integers(2**31)),
    )


def exposure(linear: np.ndarray, face: np.ndarray, shooting: Shooting) -> float:
    """Gain that brings what is metered to its level.

    Args:
        linear: (h, w, 3) scene.
        face: (h, w) bool, its face; the centre is metered where there is none.
        shooting: says what is metered.
    """
    luminance = np.maximum(linear @ LUMINANCE, LEAST)
    if shooting.meter == "key" and face.any():
        return shooting.level / float(np.percentile(luminance[face], KEY))
    if shooting.meter == "scene":
        weight = np.ones(luminance.shape)
    elif shooting.meter == "face" and face.any():
        weight = face.astype(float)
    else:
        height, width = luminance.shape
        down, across = (
            (np.arange(height) + 0.5) / height - 0.5,
            (np.arange(width) + 0.5) / width - 0.5,
        )
        weight = np.exp(-(down[:, None] ** 2 + across**2) / (2 * CENTRE**2))
    if shooting.logarithmic:
        mean = float(np.exp(np.average(np.log(luminance), weights=weight)))
    else:
        mean = float(np.average(luminance, weights=weight))
    return shooting.level / mean


def curve(display: np.ndarray, shooting: Shooting) -> np.ndarray:
    """The camera's tone curve, increasing: display values, above 1 too, to 0..1."""
    knee = shooting.shoulder
    above = np.maximum(display - knee, 0) / (1 - knee)
    value = np.minimum(display, knee) + (1 - knee) * -np.expm1(-above)
    value = value + shooting.contrast * (value**2 * (3 - 2 * value) - value)
    return np.clip(shooting.toe + (1 - shooting.toe) * value, 0, 1)


def developed(linear: np.ndarray, face: np.ndarray, shooting: Shooting) -> np.ndarray:
    """(h, w, 3) uint8 sRGB codes, as the camera's JPEG holds them.

    Args:
        linear: (h, w, 3) light that meets the sensor.
        face: (h, w) bool, where the face is.
        shooting: what the camera does.
    """
    rng = np.random.default_rng([shooting.seed, 1])
    raw = exposure(linear, face, shooting) * np.asarray(linear, np.float32)
    deviation = shooting.noise * np.sqrt(np.maximum(raw, 0) + 0.02**2)
    raw = raw + deviation * rng.normal(size=raw.shape)
    raw = np.maximum(raw, 0) * np.array(shooting.balance)
    value = curve(_unclipped_srgb(raw), shooting)
    grey = (value @ LUMINANCE)[..., None]
    value = grey + shooting.saturation * (value - grey)
    grey = (value @ LUMINANCE).astype(np.float32)
    detail = grey - cv2.GaussianBlur(grey, (0, 0), shooting.sharpening_px)
    value = value + shooting.sharpening * detail[..., None]
    codes = np.round(255 * np.clip(value, 0, 1)).astype(np.uint8)
    _, file = cv2.imencode(".jpg", codes[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, shooting.quality])
    read = cv2.imdecode(file, cv2.IMREAD_COLOR)
    assert read is not None
    return np.ascontiguousarray(read[..., ::-1])


def _unclipped_srgb(linear: np.ndarray) -> np.ndarray:
    """The display values of sRGB's formula, above 1 too."""
    return np.where(
        linear > 1,
        1.055 * np.maximum(linear, 1) ** (1 / 2.4) - 0.055,
        srgb_from_linear(np.minimum(linear, 1)),
    )


def backdrop(shooting: Shooting, lights: LightSet) -> np.ndarray:
    """(h, w, 3) float32 linear: what is behind the person, as bright as the light makes a wall.

    A gradient between two colours with upright and level edges and soft blobs out of focus.
    """
    rng = np.random.default_rng([shooting.seed, 2])
    level = lights.rgb.sum(axis=0) + lights.ambient_rgb
    down, across = (
        np.mgrid[0:HEIGHT_PX, 0:WIDTH_PX] / np.array([HEIGHT_PX, WIDTH_PX])[:, None, None]
    )

    def colour() -> np.ndarray:
        grey = np.exp(rng.uniform(np.log(0.04), np.log(0.6)))
        return np.asarray(grey * np.exp(rng.normal(0, 0.15, 3)))

    turn = rng.uniform(0, 2 * np.pi)
    share = np.clip(0.5 + np.cos(turn) * (across - 0.5) + np.sin(turn) * (down - 0.5), 0, 1)
    picture = colour() + share[..., None] * (colour() - colour())
    picture = np.maximum(picture, 0.01)
    for _ in range(int(rng.integers(2, 9))):
        low, size = rng.uniform(-0.2, 1, 2), rng.uniform(0.05, 0.5, 2)
        inside = (across > low[0]) & (across < low[0] + size[0])
        inside &= (down > low[1]) & (down < low[1] + size[1])
        picture[inside] = colour()
    picture = cv2.GaussianBlur(picture, (0, 0), float(rng.uniform(2, 25)))
    return np.asarray(level * picture, np.float32)


def taken(
    head: Head, yaw_deg: float, lights: LightSet, shooting: Shooting
) -> tuple[np.ndarray, Sitter]:
    """(h, w, 3) uint8 photograph of a head, and the sitter with its camera.

    Args:
        head: who is seen.
        yaw_deg: of the camera, to the head's left.
        lights: in the world.
        shooting: how it is taken.
    """
    # One ray a pixel, a quarter of the time, and the blur of a lens instead of more.
    sitter = Sitter(head, yaw_deg, focal_px=shooting.focal_px, supersample=1)
    linear = cv2.GaussianBlur(sitter.under(lights, backdrop(shooting, lights)), (0, 0), LENS_PX)
    return developed(linear, sitter.skin(), shooting), sitter
