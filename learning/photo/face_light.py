"""The light of one photograph on a face whose shape is nearly known, and how normals change it."""

from __future__ import annotations

import dataclasses

import numpy as np

HARMONICS = 8
"""Of orders 1 and 2."""


@dataclasses.dataclass(frozen=True)
class Lit:
    """What one photograph's light gives each place, for a shape that is near the true one.

    Attributes:
        lamps_mm: (l, 3).
        seen: (l, s) share of each lamp that each place sees, soft at the shadows' borders.
        openness: (s,) share of light from everywhere.
        strength: (l + 1,) luminance of the lamps and of the light from everywhere.
        shine: (s,) mirrored light.
        weight: (s,) 0..1, how much each place counts.
    """

    lamps_mm: np.ndarray
    seen: np.ndarray
    openness: np.ndarray
    strength: np.ndarray
    shine: np.ndarray
    weight: np.ndarray

    def kept(self, chosen: np.ndarray) -> Lit:
        """The light of some of the places, by their (c,) indices."""
        return dataclasses.replace(
            self,
            seen=self.seen[:, chosen],
            openness=self.openness[chosen],
            shine=self.shine[chosen],
            weight=self.weight[chosen],
        )


def harmonics(normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(s, 8) of (s, 3) unit normals, orders 1 and 2 without scale [Ramamoorthi2001]; slopes.

    Returns:
        The values, and (s, 8, 3) how they change with the normal.
    """
    x, y, z = normal.T
    zero, one = np.zeros_like(x), np.ones_like(x)
    values = [x, y, z, x * y, y * z, x * z, x * x - y * y, z * z - 1 / 3]
    slopes = [
        (one, zero, zero),
        (zero, one, zero),
        (zero, zero, one),
        (y, x, zero),
        (zero, z, y),
        (z, zero, x),
        (2 * x, -2 * y, zero),
        (zero, zero, 2 * z),
    ]
    return np.stack(values, axis=1), np.stack([np.stack(s, axis=1) for s in slopes], axis=1)


def irradiance(position: np.ndarray, normal: np.ndarray, lit: Lit) -> tuple[np.ndarray, np.ndarray]:
    """(s, l + 1 + 8) each light's share, and (s, l + 1 + 8, 3) its slope by the normal.

    The lamps', that of light from everywhere, and small corrections of it by harmonics.
    """
    toward = lit.lamps_mm[:, None] - position  # (l, s, 3)
    distance2 = (toward**2).sum(axis=2)
    falloff = (lit.lamps_mm**2).sum(axis=1)[:, None] / np.maximum(distance2, 1.0)
    toward = toward / np.sqrt(np.maximum(distance2, 1.0))[..., None]
    cosine = (toward * normal).sum(axis=2)
    there = lit.seen * falloff
    lamps = (there * np.maximum(cosine, 0)).T
    slopes = np.moveaxis((there * (cosine > 0))[..., None] * toward, 0, 1)
    values, turned = harmonics(normal)
    around = lit.openness[:, None]
    each = np.concatenate([lamps, around, around * values], axis=1)
    none = np.zeros((len(normal), 1, 3))
    by_normal = np.concatenate([slopes, none, around[..., None] * turned], axis=1)
    return each, by_normal
