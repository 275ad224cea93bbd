"""Configuration of the `avatarme` training."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

from learning.patch_config import PatchConfig


@dataclasses.dataclass(frozen=True)
class FourTrainConfig(PatchConfig):
    """A training of four networks of one size; the defaults are the published ones [Lattas2020].

    Every step trains all four on the same patches, each on the truth of what it is given: none
    waits for another.
    """

    family: ClassVar[str] = "four_networks"
