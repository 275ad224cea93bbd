"""Which method a session's patterns allow, and each method's function."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from processing.errors import ProcessingError
from processing.lights import PatternLights, rank
from processing.methods import colour, kampouris, ratios
from processing.methods.config import SeparateConfig
from processing.pixels import PixelMaps

Method = Callable[
    [np.ndarray, np.ndarray, np.ndarray, np.ndarray, PatternLights, float, SeparateConfig],
    PixelMaps,
]
"""Separates one view's pixels; arguments and result are those of `colour.separate_pixels`."""

METHODS: dict[str, Method] = {
    "colour": colour.separate_pixels,
    "kampouris": kampouris.separate_pixels,
    "ratios": ratios.separate_pixels,
}


def chosen_method(lights: PatternLights, config: SeparateConfig) -> str:
    """The method that separates a session's photographs.

    Args:
        lights: of the session's patterns, without dark ones.
        config: its `method`, where it is not ``auto``, is taken if the patterns allow it.

    Raises:
        ProcessingError: no method, or not the one named, can separate these patterns.
    """
    fitting = fitting_methods(lights)
    found = ", ".join(lights.patterns)
    if not fitting:
        raise ProcessingError(
            "session.json",
            field="sequence",
            found=found,
            expected="patterns that light a face from three directions, such as `binary`",
            hint="Capture with `--sequence binary`.",
        )
    if config.method == "auto":
        return fitting[0]
    if config.method not in fitting:
        raise ProcessingError(
            "configuration",
            field="separate.method",
            found=f"{config.method} for the patterns {found}",
            expected=f"auto, {', '.join(fitting)} for these patterns",
            hint="Leave the method to `auto`, or capture the sequence that it needs.",
        )
    return config.method


def fitting_methods(lights: PatternLights) -> list[str]:
    """Methods that can separate photographs under these lights, the best first."""
    if lights.polarised or rank(lights) < 3:
        return []
    pairs = all(f"{axis}{sign}" in lights.patterns for axis in "xyz" for sign in "+-")
    return ["colour", *(("kampouris", "ratios") if pairs else ())]
