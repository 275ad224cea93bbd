"""What does a simulated sensor cost, and do its noise's statistics match the model?"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import TypeVar

import numpy as np
import scipy.stats

from benchmarks.record import record
from lightstage.rig import default_rig
from sim.camera.dng import Exif, dng_bytes
from sim.camera.flaws import PRESETS
from sim.camera.optics import make_lens
from sim.camera.sensor import Sensor, SensorConfig, make_sensor

T = TypeVar("T")
SIZES = {"1.5 MP": (1500, 1000), "24 MP": (6016, 4016)}
STEPS = 12
"""Grey levels of the wedge from which the photon transfer line is taken."""
EXIF = Exif("Nikon DSC D750", "6012345", 16.0, 105.0)


def main() -> None:
    rows: list[tuple[object, ...]] = []
    for size, shape in SIZES.items():
        rows += noise_rows(size, shape)
    for size, scale in (("1.5 MP", 0.25), ("24 MP", 1.0)):
        rows.append(lens_row(size, scale))
    record(
        "Simulated sensor",
        ("size", "step", "seconds", "plain twin, seconds", "ratio", "error against the model"),
        rows,
        f"A wedge of {STEPS} greys from dark to 0.8 of white. Counts: slope of variance against "
        "mean against 1 / gain, its intercept against read noise and rounding, and the skew of the "
        "brightest step in standard errors; behind the bar the same of the plain twin, which is "
        "numpy's Poisson and Gaussian generator. Lens: the set `lab` on a picture with depths of a "
        "head; error is the light lost or made inside the picture.",
    )


def noise_rows(size: str, shape: tuple[int, int]) -> list[tuple[object, ...]]:
    """Counts at three ISO values, and the DNG of the last."""
    out: list[tuple[object, ...]] = []
    light = wedge(shape)
    for iso in (100, 800, 6400):
        sensor = make_sensor(SensorConfig(iso=iso), np.ones(3), np.random.default_rng(1))
        sensor.expose(light[:2, :2], np.random.default_rng(0))  # compile
        seconds, counts = timed(partial(sensor.expose, light, np.random.default_rng(2)))
        seconds_twin, known = timed(partial(twin, sensor, light, np.random.default_rng(2)))
        out.append(
            (
                size,
                f"counts at ISO {iso}",
                f"{seconds:.3f}",
                f"{seconds_twin:.2f}",
                f"{seconds_twin / seconds:.1f}",
                f"{errors(sensor, counts)} / {errors(sensor, known)}",
            )
        )
    seconds, data = timed(lambda: dng_bytes(counts, sensor, EXIF))
    out.append((size, f"DNG, {len(data) / 1e6:.0f} MB", f"{seconds:.3f}", "", "", "exact"))
    return out


def lens_row(size: str, scale: float) -> tuple[object, ...]:
    """The lens of the set `lab`."""
    camera = default_rig().scaled(scale).cameras[0]
    lens = make_lens(camera, PRESETS["lab"].lens, 1)
    height, width = camera.height_px, camera.width_px
    rows, columns = np.mgrid[:height, :width].astype(np.float32)
    x, y = (columns / width - 0.5) * 1.5, (rows / height - 0.5) * 1.5
    bulge = np.sqrt(np.maximum(0.3 - x**2 - y**2, 0)).astype(np.float32)
    depth = np.where(bulge > 0, 1100 - 200 * bulge, 0)
    light = np.random.default_rng(3).random((height, width, 3), np.float32)
    light *= (bulge > 0)[..., None]
    seconds, formed = timed(lambda: lens.form(light, depth))
    bare = formed / lens.shading[..., None]
    lost = float(bare.sum(dtype=float) / light.sum(dtype=float) - 1)
    return (size, "lens, lab", f"{seconds:.2f}", "", "", f"{lost:.0e} of the light")


def wedge(shape: tuple[int, int]) -> np.ndarray:
    """(h, w, 3) grey steps side by side."""
    step = np.arange(shape[1]) * STEPS // shape[1]
    grey = np.linspace(0, 0.8 / 0.85, STEPS, dtype=np.float32)[step]
    return np.ascontiguousarray(np.broadcast_to(grey[None, :, None], (*shape, 3)))


def twin(sensor: Sensor, light: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The same sensor in plain numpy."""
    config = sensor.config
    share = np.empty(light.shape[:2])
    for row, column, kind in ((0, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 2)):
        share[row::2, column::2] = light[row::2, column::2] @ sensor.raw_from_linear[kind]
    span = (config.white_dn - config.black_dn) * config.gain_e_per_dn
    mean = np.clip(share * span, 0, 2 * config.full_well_e)
    held = np.minimum(rng.poisson(mean), config.full_well_e)
    noisy = held + rng.normal(0.0, config.noise_e, share.shape)
    counts = np.rint(config.black_dn + noisy / config.gain_e_per_dn)
    return np.clip(counts, 0, config.white_dn).astype(np.uint16)


def errors(sensor: Sensor, counts: np.ndarray) -> str:
    """Slope and intercept of the photon transfer line, and the brightest step's skew."""
    config = sensor.config
    green = counts[::2, 1::2].astype(float) - config.black_dn
    step = (2 * np.arange(green.shape[1]) + 1) * STEPS // counts.shape[1]
    parts = [green[:, step == k] for k in range(STEPS)]
    mean, variance = (np.array([f(part) for part in parts]) for f in (np.mean, np.var))
    slope, intercept = np.polyfit(mean, variance, 1, w=1 / variance)
    known = (config.noise_e / config.gain_e_per_dn) ** 2 + 1 / 12
    electrons = mean[-1] * config.gain_e_per_dn
    skew = electrons / (electrons + config.noise_e**2) ** 1.5
    apart = (scipy.stats.skew(parts[-1], axis=None) - skew) / np.sqrt(6 / parts[-1].size)
    return (
        f"{slope * config.gain_e_per_dn - 1:+.2%}, {intercept / known - 1:+.2%}, {apart:+.1f} s.e."
    )


def timed(work: Callable[[], T]) -> tuple[float, T]:
    begun = time.perf_counter()
    result = work()
    return time.perf_counter() - begun, result


if __name__ == "__main__":
    main()
