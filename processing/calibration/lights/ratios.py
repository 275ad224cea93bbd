"""Normals of a ball by ratios of binary gradients, plain and corrected, beside those by lamps.

What a stage without known lamps can do: the ratio vector (I_a - I_abar) / (I_a + I_abar) is the
normal in an even field of light; in a real one it is brought to the normal by an affine or
quadratic map, fitted on a ball whose normals are known.
"""

from __future__ import annotations

import numpy as np

from processing.calibration.lights.grey_ball import Readings
from processing.lighting.lights import PatternLights, irradiance_vectors, no_shadows
from processing.normals import solve_normals
from processing.vectors import unit

AXES = ("x", "y", "z")
NEAR_SOLVES = 6


def ratio_vectors(readings: Readings) -> np.ndarray:
    """(n, 3) ratios of the three axes, channels averaged.

    Source: [Wilson2010].

    Raises:
        ValueError: a binary gradient is missing.
    """
    rgb = readings.rgb.mean(axis=2)
    pairs = [[readings.patterns.index(a + sign) for sign in "+-"] for a in AXES]
    plus, minus = (rgb[:, [pair[k] for pair in pairs]] for k in range(2))
    total = plus + minus
    return np.asarray((plus - minus) / np.where(np.abs(total) > 0, total, np.nan))


def ratio_terms(ratios: np.ndarray, degree: int) -> np.ndarray:
    """(n, 4) affine or (n, 10) quadratic terms of ratio vectors, for degree 1 or 2."""
    x, y, z = ratios.T
    terms = [np.ones(len(ratios)), x, y, z]
    if degree == 2:
        terms += [x * x, y * y, z * z, x * y, y * z, z * x]
    return np.stack(terms, axis=1)


def fit_ratios(ratios: np.ndarray, normals: np.ndarray, degree: int) -> np.ndarray:
    """(terms, 3) least squares from `ratio_terms` to known normals."""
    return np.asarray(np.linalg.lstsq(ratio_terms(ratios, degree), normals, rcond=None)[0])


def corrected(ratios: np.ndarray, fitted: np.ndarray) -> np.ndarray:
    """(n, 3) unit normals by ratios and what `fit_ratios` gave."""
    return unit(ratio_terms(ratios, 1 if len(fitted) == 4 else 2) @ fitted, shortest=0)


def lamp_normals(readings: Readings, lights: PatternLights) -> np.ndarray:
    """(n, 3) unit normals by the lamps' irradiance at each place; zero where there is none."""
    signal = readings.rgb.mean(axis=2)
    normals = unit(ratio_vectors(readings), shortest=0)
    open_sky = no_shadows(len(signal), lights)
    for _ in range(NEAR_SOLVES):
        vectors = irradiance_vectors(lights, readings.points_mm, normals, open_sky)
        normals = solve_normals(signal, vectors.astype(float))
    return normals


def errors_deg(found: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(n,) angle between unit normals, degrees."""
    return np.asarray(np.degrees(np.arccos(np.clip(np.sum(found * normals, axis=1), -1, 1))))
