"""A camera's sensor: colour mosaic, photon and read noise at an ISO, black level, clipping."""

from __future__ import annotations

import dataclasses

import numpy as np

from lightstage.counting import counted
from sim.camera.noise import count_kernel
from sim.errors import SimError

BASE_ISO = 100


@dataclasses.dataclass(frozen=True)
class SensorConfig:
    """A 14-bit sensor of the D750's kind.

    Attributes:
        black_dn: counts without light.
        white_dn: counts at which it clips.
        electrons_per_dn: electrons for one count at ISO 100; the amplifier divides it as ISO rises.
        read_noise_e: standard deviation of what reading adds before the amplifier, electrons.
        converter_noise_dn: the same behind the amplifier, counts, whatever the ISO.
        full_well_e: electrons that a pixel holds.
        sensitivity_rgb: of red, green and blue pixels to the LEDs' white.
        crosstalk: how much of linear R G B each of the three kinds of pixel sees; rows sum to 1.
        camera_spread: standard deviation of one camera's sensitivities against the others'.
        headroom: share of the white level at which the brightest skin under `full` is.
        iso: of the session.
        unit_exposure_s: exposure at which linear 1.0 in a channel of sensitivity 1 just clips at
            ISO 100.
    """

    black_dn: int = 600
    white_dn: int = 16383
    electrons_per_dn: float = 5.0
    read_noise_e: float = 2.5
    converter_noise_dn: float = 1.52
    full_well_e: float = 82_000.0
    sensitivity_rgb: tuple[float, float, float] = (0.52, 1.0, 0.68)
    crosstalk: tuple[tuple[float, float, float], ...] = (
        (0.88, 0.10, 0.02),
        (0.06, 0.87, 0.07),
        (0.01, 0.13, 0.86),
    )
    camera_spread: float = 0.01
    headroom: float = 0.85
    iso: int = BASE_ISO
    unit_exposure_s: float = 1 / 30

    @property
    def gain_e_per_dn(self) -> float:
        """Electrons for one count at this ISO."""
        return self.electrons_per_dn * BASE_ISO / self.iso

    @property
    def noise_e(self) -> float:
        """Standard deviation of what reading adds at this ISO, electrons."""
        return float(np.hypot(self.read_noise_e, self.converter_noise_dn * self.gain_e_per_dn))


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

    def exposed(self, factor: float) -> Sensor:
        """The same sensor, its shutter open `factor` times as long."""
        return dataclasses.replace(
            self,
            raw_from_linear=self.raw_from_linear * factor,
            exposure_s=self.exposure_s * factor,
        )

    def expose(self, rgb_linear: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Counts of one exposure.

        Args:
            rgb_linear: (h, w, 3). Below zero is no light; infinite light clips.
            rng: of the noise.

        Returns:
            (h, w) uint16 RGGB mosaic.

        Raises:
            SimError: NaN, or another shape.
        """
        config = self.config
        if rgb_linear.ndim != 3 or rgb_linear.shape[2] != 3 or 0 in rgb_linear.shape:
            raise SimError("light", found=f"shape {rgb_linear.shape}", expected="(h, w, 3)")
        light = np.ascontiguousarray(rgb_linear, np.float32)
        span_e = (config.white_dn - config.black_dn) * config.gain_e_per_dn
        counts = np.empty(light.shape[:2], np.uint16)
        unusable = np.zeros(len(light), np.int64)
        count_kernel(
            light,
            self.raw_from_linear * span_e,
            config.full_well_e,
            config.noise_e,
            config.gain_e_per_dn,
            float(config.black_dn),
            float(config.white_dn),
            np.uint64(rng.integers(0, 2**63)),
            counts,
            unusable,
        )
        if unusable.any():
            raise SimError(
                "light",
                field=f"row {int(np.flatnonzero(unusable)[0])}",
                found=counted(int(unusable.sum()), "NaN pixel"),
                expected="numbers",
            )
        return counts


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
    return Sensor(config, gain * matrix, gain * config.unit_exposure_s * BASE_ISO / config.iso)
