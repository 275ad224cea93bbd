"""What the reference computes, and how finely."""

from __future__ import annotations

import dataclasses

from sim.errors import SimError


@dataclasses.dataclass(frozen=True)
class ReferenceConfig:
    """How the reference lights a subject.

    Attributes:
        bounces: how often light may go from skin to skin; 0 is direct light alone.
        subsurface: whether light wanders inside the skin.
        samples: places of a pixel that are averaged, a square number; 1 is its centre.
        variant: Mitsuba's: ``scalar_rgb``, ``llvm_ad_rgb``, or ``auto`` for the fastest that works.
        texel_mm: spacing of the surface points on which light wanders.
        bounce_rays: rays from each coarse point that gather light from other skin.
        seed: of places on lamps and of bounce rays; other seeds give independent repeats.
    """

    bounces: int = 3
    subsurface: bool = True
    samples: int = 4
    variant: str = "auto"
    texel_mm: float = 0.35
    bounce_rays: int = 128
    seed: int = 0

    def __post_init__(self) -> None:
        """Refuse what cannot be computed."""
        side = round(self.samples**0.5)
        wrong = [
            ("bounces", self.bounces, "0 or more", self.bounces >= 0),
            (
                "samples",
                self.samples,
                "1, 4, 9, 16 ..",
                self.samples > 0 and side**2 == self.samples,
            ),
            ("texel_mm", self.texel_mm, "0.05 to 5", 0.05 <= self.texel_mm <= 5),
            ("bounce_rays", self.bounce_rays, "1 or more", self.bounce_rays >= 1),
            ("seed", self.seed, "0 or more", self.seed >= 0),
        ]
        for field, found, expected, fine in wrong:
            if not fine:
                raise SimError("reference", field=field, found=str(found), expected=expected)
