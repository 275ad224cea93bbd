"""What the search of a domain's light is configured by."""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass(frozen=True)
class DomainConfig:
    """The only defaults of `domain-light`; `learning.limits` has their bounds.

    Attributes:
        textures: largest number that are used, evenly among those that are given.
        seconds: for the search of the lamps in closed form, at most.
        rounds: of light and skin in turns, in that search.
        steps: of the descent through the renderer after it; 0 for none.
        rate: Adam's first learning rate: of directions in radians, of strengths in natural
            logarithms.
        shadow_steps: the descent casts the shadows anew after so many steps.
    """

    textures: int = 24
    seconds: float = 120.0
    rounds: int = 4
    steps: int = 200
    rate: float = 0.02
    shadow_steps: int = 20
