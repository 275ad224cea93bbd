"""What other cameras do to pictures: stray light in the lens, and a sensor of another kind."""

from __future__ import annotations

import dataclasses
import zlib

import cv2
import numpy as np


@dataclasses.dataclass(frozen=True)
class Glare:
    """Light that a lens scatters over the picture, and its ghost on the other side of the axis.

    Attributes:
        veil: share of the picture's mean light that is on every pixel.
        haze: share that is smeared around each place over `haze_share` of the picture's height.
        ghost: share that comes again turned by half a turn around the picture's middle.
    """

    veil: float = 0.01
    haze: float = 0.01
    haze_share: float = 0.05
    ghost: float = 0.003

    def __call__(self, _: str, pictures: np.ndarray) -> np.ndarray:
        """Pictures (s, h, w, 3) with it; light is spread and none is made."""
        out = np.empty_like(pictures)
        for k, picture in enumerate(pictures):
            sigma = self.haze_share * len(picture)
            kept = picture * (1 - self.veil - self.haze - self.ghost)
            around = cv2.GaussianBlur(picture, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT)
            ghost = cv2.GaussianBlur(picture[::-1, ::-1], (0, 0), 0.3 * sigma)
            mean = picture.mean(axis=(0, 1))
            out[k] = kept + self.haze * around + self.ghost * ghost + self.veil * mean
        return out


@dataclasses.dataclass(frozen=True)
class Grain:
    """A small sensor: few electrons, rows that differ, pixels of unlike gain, coarse steps.

    Attributes:
        full_well_e: electrons at the brightest place, which are the largest count, too.
        read_e, row_e: standard deviations of what reading adds to a pixel and to a row, electrons.
        unlike: standard deviation of the pixels' gains, the same in all of a camera's pictures.
        bits: of its steps.
        seed: of all that.
    """

    full_well_e: float = 15_000.0
    read_e: float = 5.0
    row_e: float = 2.0
    unlike: float = 0.01
    bits: int = 12
    seed: int = 0

    def __call__(self, camera_id: str, pictures: np.ndarray) -> np.ndarray:
        """Pictures (s, h, w, 3) as it reads them, black taken off, on the same scale."""
        rng = np.random.default_rng([self.seed, zlib.crc32(camera_id.encode())])
        gain = 1 + self.unlike * rng.standard_normal(pictures.shape[1:])
        whole = max(float(np.quantile(pictures, 0.9999)) * 1.1, 1e-9)
        electrons = rng.poisson(np.maximum(pictures * gain, 0) * self.full_well_e / whole)
        rows = rng.standard_normal((*pictures.shape[:2], 1, 1)) * self.row_e
        read = electrons + rows + self.read_e * rng.standard_normal(pictures.shape)
        step = self.full_well_e / 2**self.bits
        counted = np.round(np.minimum(read, self.full_well_e) / step) * step
        return np.asarray(counted * whole / self.full_well_e, np.float32)
