"""What developed pictures cost as photographs of light, and one exposure for those of a camera."""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from pathlib import Path

from lightstage.counting import counted
from lightstage.developed import Developed
from lightstage.errors import FormatError
from lightstage.exif import MOST_STOPS
from lightstage.findings import Finding

ALIKE = 1e-4
CLIPPED = 0.001
"""Share of clipped pixels from which a picture is named."""


@dataclasses.dataclass
class Exposures:
    """What is learned of developed pictures one after the other.

    Attributes:
        first: camera to the exposure that its pictures are brought to, and whose it is.
        factors: picture to what its light was multiplied by, where not 1.
        kinds: kind, bits and profile of each, counted.
        clipped: picture to its share of clipped pixels.
    """

    first: dict[str, tuple[float | None, Path]] = dataclasses.field(default_factory=dict)
    factors: dict[str, float] = dataclasses.field(default_factory=dict)
    kinds: Counter[str] = dataclasses.field(default_factory=Counter)
    clipped: dict[str, float] = dataclasses.field(default_factory=dict)

    def factor(self, pattern: str, camera: str, path: Path, picture: Developed) -> float:
        """Take a picture in; what brings its light to that of the camera's first one.

        Raises:
            FormatError: it has its exposure in its file and the first one does not, or they are too
                far apart.
        """
        profile = picture.profile if picture.has_profile else "no profile, taken for sRGB"
        self.kinds[f"{picture.kind} of {picture.bits} bits, {profile}"] += 1
        name = f"{pattern}/{camera}"
        if picture.clipped > CLIPPED:
            self.clipped[name] = picture.clipped
        wanted, whose = self.first.setdefault(camera, (picture.exposure, path))
        if (wanted is None) != (picture.exposure is None):
            raise FormatError(
                path,
                field="exposure",
                found="none in the file" if picture.exposure is None else "one in the file",
                expected=f"the same as in {whose}: photographs of unknown exposure do not belong "
                "together",
                hint="Export all in one way, with their EXIF fields or without.",
            )
        if wanted is None or picture.exposure is None:
            return 1.0
        times = wanted / picture.exposure
        if abs(math.log2(times)) > MOST_STOPS:
            raise FormatError(
                path,
                field="exposure",
                found=f"{times:.3g} times less than {whose}",
                expected=f"at most {2**MOST_STOPS:g} times",
                hint="Were these photographs taken for this session?",
            )
        if abs(times - 1) <= ALIKE:
            return 1.0
        self.factors[name] = times
        return times


def developed_findings(seen: Exposures) -> list[Finding]:
    """What an operator should know of a session of developed pictures; nothing of RAW and OpenEXR.

    Args:
        seen: all of a session's.
    """
    if not seen.kinds:
        return []
    kinds = ", ".join(f"{number} {kind}" for kind, number in sorted(seen.kinds.items()))
    found = [
        Finding(
            "warn",
            "developed",
            counted(seen.kinds.total(), "developed picture"),
            kinds,
            "camera RAW",
            "Their light is computed back from display values. The camera's tone curve, sharpening "
            "and denoising stay in it, each picture's white is 1, so that albedo has no scale, "
            "and clipped pixels carry no mark. Where RAW files exist, import those.",
        )
    ]
    if seen.clipped:
        worst = max(seen.clipped, key=lambda name: seen.clipped[name])
        found.append(
            Finding(
                "warn",
                "clipped",
                worst,
                f"{100 * seen.clipped[worst]:.2g} % of the pixels at white, the most of "
                f"{counted(len(seen.clipped), 'picture')}",
                f"at most {100 * CLIPPED:g} %",
                "What is brighter is lost there, and later stages cannot know.",
            )
        )
    if seen.factors:
        factors = ", ".join(f"{name} times {factor:.4g}" for name, factor in seen.factors.items())
        found.append(
            Finding(
                "warn",
                "exposure",
                "unlike exposures in the files",
                f"{factors}, to bring each camera's to one",
                "one exposure for all",
                "A tone curve makes this inexact.",
            )
        )
    return found
