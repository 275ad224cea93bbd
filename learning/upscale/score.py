"""How good super-resolution is, and whether the detail that it adds is there in truth."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from typing import ClassVar

import cv2
import numpy as np
import torch

from learning.errors import TrainingError
from learning.upscale.data import Picture
from learning.upscale.infer import enlarge_encoded
from learning.upscale.network import Rcan

Method = Callable[[np.ndarray], np.ndarray]
BLOCK_PX = 64
"""Side of the blocks of skin in which detail is compared."""


@dataclasses.dataclass(frozen=True)
class Detail:
    """Sums over blocks of skin of detail beyond the input's band.

    A block is as good as the band that was not recorded: its discrete cosine transform, without
    the frequencies that the input has along both axes. Nothing of it follows from the input
    alone, so what a method shows there is guessed, well or badly.

    Attributes:
        found: squares, of the picture that was found.
        true: squares, of the truth.
        product: of both.
    """

    found: float = 0.0
    true: float = 0.0
    product: float = 0.0

    def __add__(self, other: Detail) -> Detail:
        return Detail(
            self.found + other.found, self.true + other.true, self.product + other.product
        )

    @property
    def energy(self) -> float:
        """Found over true: below 1 detail is missing, above it something was invented."""
        return self.found / max(self.true, 1e-12)

    @property
    def correlation(self) -> float:
        """1 where all detail is at its true place, 0 where it is anywhere."""
        return self.product / max((self.found * self.true) ** 0.5, 1e-12)


@dataclasses.dataclass(frozen=True)
class UpscaleScore:
    """Over captured skin of the people held out, lit textures and albedos, sRGB-encoded.

    Attributes:
        psnr_db: of the network.
        psnr_bicubic_db: of cubic interpolation of the sRGB-encoded input.
        psnr_lanczos_db: of Lanczos interpolation.
        energy: beyond the input's band over the truth's, of the network; see `Detail`.
        energy_lanczos: the same.
        correlation: of the network's detail with the truth's.
        correlation_lanczos: the same.
    """

    scored: ClassVar[str] = "textures"
    psnr_db: float
    psnr_bicubic_db: float
    psnr_lanczos_db: float
    energy: float
    energy_lanczos: float
    correlation: float
    correlation_lanczos: float

    def guesses(self) -> dict[str, float]:
        """See `Scored`."""
        return {
            "bicubic interpolation": self.psnr_bicubic_db,
            "Lanczos interpolation": self.psnr_lanczos_db,
        }

    def sentence(self) -> str:
        """See `Scored`."""
        return (
            f"PSNR {self.psnr_db:.2f} dB (bicubic {self.psnr_bicubic_db:.2f}, Lanczos "
            f"{self.psnr_lanczos_db:.2f}); beyond the input's band {self.energy:.3f} of the true "
            f"energy, correlation {self.correlation:.2f} (Lanczos {self.energy_lanczos:.3f}, "
            f"{self.correlation_lanczos:.2f})"
        )


@dataclasses.dataclass(frozen=True)
class Compared:
    """One method over skin of some pictures.

    Attributes:
        psnr_db: sRGB-encoded.
        detail: beyond the input's band.
        seconds: of the median picture.
    """

    psnr_db: float
    detail: Detail
    seconds: float


def methods_of(network: Rcan) -> dict[str, Method]:
    """The network and OpenCV's interpolations; each enlarges (h, w, 3) sRGB-encoded."""
    times = network.config.times
    return {
        "network": lambda low: enlarge_encoded(network, low),
        "bicubic": lambda low: interpolated(low, times, cv2.INTER_CUBIC),
        "lanczos": lambda low: interpolated(low, times, cv2.INTER_LANCZOS4),
    }


def compare(methods: dict[str, Method], pictures: list[Picture], times: int) -> dict[str, Compared]:
    """Compare methods that enlarge `times` with the truth.

    Raises:
        TrainingError: no captured skin to score on.
    """
    texels = sum(int(picture.skin.sum()) for picture in pictures)
    if not texels:
        raise TrainingError(
            "score",
            found="no captured skin on the people held out",
            expected="maps as they were when the training began",
            hint="Was the store written anew meanwhile?",
        )
    compared = {}
    for name, method in methods.items():
        squares, total, seconds = 0.0, Detail(), []
        for picture in pictures:
            low, true = (_image(tensor) for tensor in (picture.low, picture.high))
            began = time.perf_counter()
            found = np.clip(method(low), 0, 1)
            seconds.append(time.perf_counter() - began)
            squares += float(np.square(found - true)[picture.skin].mean(axis=1).sum())
            total += detail(found, true, picture.skin, times)
        psnr_db = -10 * float(np.log10(max(squares / texels, 1e-12)))
        compared[name] = Compared(psnr_db, total, float(np.median(seconds)))
    return compared


def score_upscaling(network: Rcan, pictures: list[Picture]) -> UpscaleScore:
    """Score a network in evaluation mode beside the two interpolations; errors as `compare`."""
    found = compare(methods_of(network), pictures, network.config.times)
    ours, lanczos = found["network"], found["lanczos"]
    return UpscaleScore(
        ours.psnr_db,
        found["bicubic"].psnr_db,
        lanczos.psnr_db,
        ours.detail.energy,
        lanczos.detail.energy,
        ours.detail.correlation,
        lanczos.detail.correlation,
    )


def interpolated(low: np.ndarray, times: int, how: int) -> np.ndarray:
    """(h, w, 3) enlarged by one of OpenCV's interpolations."""
    size = (times * low.shape[1], times * low.shape[0])
    return np.asarray(cv2.resize(low, size, interpolation=how))


def detail(found: np.ndarray, true: np.ndarray, where: np.ndarray, times: int) -> Detail:
    """Compare two (rows, columns, 3) pictures in blocks that are whole within `where` (bool)."""
    total = Detail()
    step = BLOCK_PX // 2
    # Cosine k of a block has k / (2 BLOCK_PX) cycles a texel; the input has up to 1 / (2 times).
    kept = BLOCK_PX // times
    for row in range(0, where.shape[0] - BLOCK_PX + 1, step):
        for column in range(0, where.shape[1] - BLOCK_PX + 1, step):
            here = (slice(row, row + BLOCK_PX), slice(column, column + BLOCK_PX))
            if where[here].all():
                total += _compared(found[here], true[here], kept)
    return total


def _compared(found: np.ndarray, true: np.ndarray, kept: int) -> Detail:
    bands = []
    for block in (found, true):
        spectrum = np.stack([cv2.dct(block[..., c].astype(np.float64)) for c in range(3)])
        spectrum[:, : kept + 1, : kept + 1] = 0
        bands.append(spectrum)
    return Detail(*(float((a * b).sum()) for a, b in ((bands[0],) * 2, (bands[1],) * 2, bands)))


def _image(planes: torch.Tensor) -> np.ndarray:
    return np.ascontiguousarray(planes.float().permute(1, 2, 0).numpy())
