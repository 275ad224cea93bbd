"""A camera's sensor: colour mosaic, photon and read noise, black level, clipping at 14 bits."""

from __future__ import annotations

import dataclasses

import numpy as np

# Reflectance of the classic 24-patch chart as 8-bit sRGB under D65, as its maker publishes it.
CHART_SRGB = np.array(
    [
        [115, 82, 68], [194, 150, 130], [98, 122, 157], [87, 108, 67], [133, 128, 177],
        [103, 189, 170], [214, 126, 44], [80, 91, 166], [193, 90, 99], [94, 60, 108],
        [157, 188, 64], [224, 163, 46], [56, 61, 150], [70, 148, 73], [175, 54, 60],
        [231, 199, 31], [187, 86, 149], [8, 133, 161], [243, 243, 242], [200, 200, 200],
        [160, 160, 160], [122, 122, 121], [85, 85, 85], [52, 52, 52],
    ]
)  # fmt: skip
GREY_CARD = 0.18
PATCH_PX = 64


@dataclasses.dataclass(frozen=True)
class SensorConfig:
    """A 14-bit sensor of the D750's kind.

    Attributes:
        black_dn: counts without light.
        white_dn: counts at which it clips.
        electrons_per_dn: electrons for one count at the session's ISO.
        read_noise_e: standard deviation of what reading adds, electrons.
        sensitivity_rgb: of red, green and blue pixels to the LEDs' white.
        crosstalk: how much of linear R G B each of the three kinds of pixel sees; rows sum to 1.
        camera_spread: standard deviation of one camera's sensitivities against the others'.
        headroom: share of the white level at which the brightest skin under `full` lies.
        iso: as the files tell.
        unit_exposure_s: exposure at which linear 1.0 in a channel of sensitivity 1 just clips.
    """

    black_dn: int = 600
    white_dn: int = 16383
    electrons_per_dn: float = 5.0
    read_noise_e: float = 8.0
    sensitivity_rgb: tuple[float, float, float] = (0.52, 1.0, 0.68)
    crosstalk: tuple[tuple[float, float, float], ...] = (
        (0.88, 0.10, 0.02),
        (0.06, 0.87, 0.07),
        (0.01, 0.13, 0.86),
    )
    camera_spread: float = 0.01
    headroom: float = 0.85
    iso: int = 100
    unit_exposure_s: float = 1 / 30


@dataclasses.dataclass(frozen=True)
class Sensor:
    """One camera's sensor at the session's exposure.

    Attributes:
        config: of its kind.
        raw_from_linear: (3, 3) counts above black as a share of white, from linear rgb at
            `exposure_s`.
        exposure_s: the session's.
    """

    config: SensorConfig
    raw_from_linear: np.ndarray
    exposure_s: float

    @property
    def neutral(self) -> np.ndarray:
        """(3,) what a grey object gives, the largest channel 1 (DNG's AsShotNeutral)."""
        grey = self.raw_from_linear.sum(axis=1)
        return grey / grey.max()

    def expose(self, rgb_linear: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Counts of one exposure.

        Args:
            rgb_linear: (h, w, 3), h and w even; not negative.
            rng: of the noise.

        Returns:
            (h, w) uint16 RGGB mosaic.
        """
        config = self.config
        share = np.empty(rgb_linear.shape[:2], np.float32)
        matrix = self.raw_from_linear.astype(np.float32)
        for row, column, channel in ((0, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 2)):
            share[row::2, column::2] = rgb_linear[row::2, column::2] @ matrix[channel]
        span_dn = config.white_dn - config.black_dn
        # Twice the full well is clipped whatever the noise; it also keeps Poisson in range.
        electrons = rng.poisson(np.clip(share, 0.0, 2.0) * (span_dn * config.electrons_per_dn))
        noisy = electrons + rng.normal(0.0, config.read_noise_e, share.shape)
        counts = np.rint(config.black_dn + noisy / config.electrons_per_dn)
        return np.clip(counts, 0, config.white_dn).astype(np.uint16)


def make_sensor(config: SensorConfig, peak_rgb: np.ndarray, rng: np.random.Generator) -> Sensor:
    """A camera's sensor, exposed so that the brightest skin stays below white.

    Args:
        config: see there.
        peak_rgb: (3,) linear, the brightest skin under `full` in each channel.
        rng: of this camera's spread.
    """
    spread = 1.0 + config.camera_spread * rng.standard_normal(3)
    sensitivity = np.array(config.sensitivity_rgb) * spread
    matrix = sensitivity[:, None] * np.array(config.crosstalk)
    # One exposure for the whole stage: the spread of this camera must not change it.
    nominal = np.array(config.sensitivity_rgb)[:, None] * np.array(config.crosstalk)
    gain = config.headroom / float((nominal @ peak_rgb).max())
    return Sensor(config, gain * matrix, gain * config.unit_exposure_s)


def calibrate_colour(sensor: Sensor, rng: np.random.Generator) -> np.ndarray:
    """Colour calibration as a user makes it: from a noisy photograph of a chart and a grey card.

    The chart lies at the sphere's centre facing the frontal camera, lit by `full`, so that a
    perfect white would read 1. Patches that clip are left out. The grey card, photographed large,
    holds the scale.

    Args:
        sensor: the camera.
        rng: of the noise.

    Returns:
        (3, 3) linear_from_raw: rgb_linear = M @ (raw - black) / (white - black).
    """
    encoded = CHART_SRGB / 255.0
    chart = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    known = np.concatenate([chart, np.full((1, 3), GREY_CARD)])
    config = sensor.config
    raw, kept, weight = [], [], []
    for index, colour in enumerate(known):
        side = PATCH_PX * (4 if index == len(chart) else 1)
        counts = sensor.expose(np.broadcast_to(colour, (side, side, 3)).astype(np.float32), rng)
        if counts.max() >= config.white_dn:
            continue
        green = (counts[0::2, 1::2].mean() + counts[1::2, 0::2].mean()) / 2
        mean = np.array([counts[0::2, 0::2].mean(), green, counts[1::2, 1::2].mean()])
        raw.append((mean - config.black_dn) / (config.white_dn - config.black_dn))
        kept.append(colour)
        weight.append(float(side) / PATCH_PX)
    scale = np.array(weight)[:, None]
    solution, *_ = np.linalg.lstsq(scale * np.array(raw), scale * np.array(kept), rcond=None)
    return solution.T
