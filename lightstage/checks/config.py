"""Limits of all checks, with their units."""

from __future__ import annotations

import dataclasses

from lightstage.formats.config import require_bounds


@dataclasses.dataclass(frozen=True)
class ChecksConfig:
    """What a photograph and a shot must keep.

    A share of white is of the sensor's span from black to white (1 in an OpenEXR picture); a share
    of full is of what the same place reads under `full`.

    Attributes:
        thumbnail_px: longer side of what is kept of a photograph, at most.
        kept_photographs: photographs that no sum needs and that are kept all the same, for each
            camera; the oldest go first.
        max_clipped_share: of the lit pixels of a colour, above which a photograph is taken again.
        warn_clipped_share: the same, above which it is reported.
        min_signal_share: of white, least level of the brightest percent of a photograph that is
            to show the subject under `full`.
        warn_signal_share: the same, below which it is reported.
        min_snr: least signal to noise of a pixel in the lit region under `full`.
        max_expected_ratio: brighter or darker than the light model expects by this factor.
        max_unlike_ratio: under `full`, brighter or darker than the middle of the cameras by this
            factor.
        warn_ambient_share: of full, light that is there without a lamp.
        max_ambient_share: the same, above which the shot is taken again.
        max_gain_error: share by which a photograph's exposure may leave that of `full`.
        max_misfit_share: of full, mean absolute residual of a sum after its gains are fitted.
        max_excess_share: of full, by which a pattern may be brighter than `full` somewhere.
        warn_motion_mm: at the sphere's centre, between the photographs of one sum.
        max_motion_mm: the same, above which the shot is taken again.
        min_sharpness: fine detail against the same camera's other photographs, above which it is
            in focus; 1 is alike.
        warn_sharpness: the same, below which it is reported.
        min_highlight_ratio: whiteness of a parallel photograph against the cross one, less one;
            below minus this the banks are held to be swapped.
        max_baseline_change: share by which a camera's light of a pattern against `full` may leave
            an earlier session's.
    """

    thumbnail_px: int = 192
    kept_photographs: int = 12
    max_clipped_share: float = 0.02
    warn_clipped_share: float = 0.004
    min_signal_share: float = 0.02
    warn_signal_share: float = 0.05
    min_snr: float = 5.0
    max_expected_ratio: float = 2.5
    max_unlike_ratio: float = 1.8
    warn_ambient_share: float = 0.01
    max_ambient_share: float = 0.05
    max_gain_error: float = 0.03
    max_misfit_share: float = 0.03
    max_excess_share: float = 0.05
    warn_motion_mm: float = 1.5
    max_motion_mm: float = 4.0
    min_sharpness: float = 0.5
    warn_sharpness: float = 0.65
    min_highlight_ratio: float = 0.01
    max_baseline_change: float = 0.1

    def __post_init__(self) -> None:
        """ConfigError on limits by which nothing could be checked: before a light goes on."""
        require_bounds(self, "checks", BOUNDS)


BOUNDS = {"thumbnail_px": (8, 4096), "kept_photographs": (0, 10_000)}
"""Least and largest; every other number is 0 or more."""
