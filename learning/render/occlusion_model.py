"""Cast shadows of a known topology without rays: a few pictures, mixed by the light's direction.

Visibility of every texel is baked from many directions on the mean shape. Its principal pictures
are kept, and what each weighs is known at the baked directions; in between, a kernel on the sphere
interpolates, so that a shadow moves with its light and has a gradient.
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import load_file, save_file
from torch import Tensor

from learning.errors import CheckpointError
from learning.render.light_dome import even_directions
from learning.render.occlusion import bake_visibility
from learning.render.uv import rasterise
from lightstage.commands import ProgressCallback, quiet
from lightstage.formats.files import atomic_path
from lightstage.formats.mesh import Mesh

SCHEMA = "lightstage.occlusion/1"
SHARPNESS = (8.0, 16.0, 32.0, 64.0, 128.0)
"""Kernel sharpnesses that are tried; a kernel of 32 is 10 degrees wide."""
NOISE = (1e-3, 1e-2, 1e-1)
"""Smoothings that are tried."""


@dataclasses.dataclass(frozen=True)
class OcclusionConfig:
    """How shadows are learned.

    Attributes:
        rows: of the texture that they are baked in; columns follow the template's 3 : 2.
        directions: that are baked.
        rank: pictures that are kept.
    """

    rows: int = 144
    directions: int = 1024
    rank: int = 64


class LowRankOcclusion:
    """The mixture of pictures; see the module."""

    def __init__(self, tensors: dict[str, Tensor]) -> None:
        """From `fit`'s or a file's tensors.

        Args:
            tensors: mean (t,), pictures (k, t), weights (d, k), directions (d, 3), sharpness (),
                covered (rows, columns).
        """
        self.tensors = tensors
        self.covered = tensors["covered"].bool()

    def predict(self, directions: Tensor) -> Tensor:
        """Visibility of distant lights.

        Args:
            directions: (n, 3) from the head to each light, of any length but 0; differentiable.

        Returns:
            (n, rows, columns), 0..1: the share of the light that is not blocked by another part of
            the head; 1 where there is no surface.
        """
        t = {k: v.to(directions) for k, v in self.tensors.items() if k != "covered"}
        unit = directions / directions.norm(dim=-1, keepdim=True).clamp_min(1e-6)
        near = torch.exp(t["sharpness"] * (unit @ t["directions"].T - 1))
        flat = (t["mean"] + near @ t["weights"] @ t["pictures"]).clamp(0, 1)
        out = flat.new_ones((len(flat), *self.covered.shape))
        return out.masked_scatter(self.covered.to(flat.device).expand_as(out), flat)

    def for_lights(self, position_mm: Tensor, size: tuple[int, int]) -> Tensor:
        """Visibility of (L, 3) lights around the head's origin, for maps of a size: (L, h, w)."""
        seen = self.predict(position_mm)
        return torch.nn.functional.interpolate(
            seen[None], size=size, mode="bilinear", align_corners=False
        )[0]

    def save(self, path: Path) -> Path:
        """Write as safetensors, pictures in half precision; returns `path`."""
        halves = {
            k: (v.half() if k in ("pictures", "mean") else v).contiguous()
            for k, v in self.tensors.items()
        }
        with atomic_path(path) as beside:
            save_file(halves, str(beside), metadata={"format": json.dumps({"schema": SCHEMA})})
        return path


def load_occlusion(path: Path) -> LowRankOcclusion:
    """Read what `LowRankOcclusion.save` wrote.

    Raises:
        CheckpointError: missing, damaged, or another kind of file.
    """
    if not path.is_file():
        raise CheckpointError(path, found="no such file", expected="an occlusion model")
    try:
        tensors = load_file(path)
    except Exception as error:
        raise CheckpointError(path, found=str(error), expected="a safetensors file") from None
    names = {"mean", "pictures", "weights", "directions", "sharpness", "covered"}
    if set(tensors) != names:
        raise CheckpointError(
            path, found=", ".join(sorted(tensors)), expected=", ".join(sorted(names))
        )
    return LowRankOcclusion({k: v if k == "covered" else v.float() for k, v in tensors.items()})


def default_occlusion_path() -> Path:
    """The model of our own template, committed as data."""
    return Path(__file__).parents[1] / "data" / "occlusion.safetensors"


def bake_dome(
    mesh: Mesh, rows: int, directions: np.ndarray, progress: ProgressCallback = quiet
) -> tuple[np.ndarray, np.ndarray]:
    """Bake cast shadows of distant lights in the texture.

    Args:
        mesh: with UV.
        rows: of the texture; two thirds as many columns.
        directions: (d, 3).
        progress: of the rays.

    Returns:
        (d, t) float32 visibility of the covered texels, and (rows, columns) bool, which those are.
    """
    raster = rasterise(mesh, rows, rows * 2 // 3)
    distant = np.ones(len(directions), bool)
    seen = bake_visibility(mesh, raster, directions, distant, progress, cast_only=True)
    return seen[:, raster.covered], raster.covered


def fit(visibility: np.ndarray, covered: np.ndarray, rank: int) -> LowRankOcclusion:
    """Learn from (d, t) visibility under `even_directions(d)`."""
    directions = even_directions(len(visibility))
    mean = visibility.mean(axis=0)
    rest = (visibility - mean).astype(np.float32)
    # By the small side: as many directions as rows, more texels than that.
    values, vectors = np.linalg.eigh(rest @ rest.T)
    kept = vectors[:, ::-1][:, :rank] * np.sqrt(np.maximum(values[::-1][:rank], 1e-12))
    pictures = np.linalg.lstsq(kept, rest, rcond=None)[0]
    sharpness, weights = _weigh(directions, kept)
    tensors = {
        "mean": torch.from_numpy(mean.astype(np.float32)),
        "pictures": torch.from_numpy(pictures.astype(np.float32)),
        "weights": torch.from_numpy(weights.astype(np.float32)),
        "directions": torch.from_numpy(directions.astype(np.float32)),
        "sharpness": torch.tensor(sharpness, dtype=torch.float32),
        "covered": torch.from_numpy(covered.astype(np.uint8)),
    }
    return LowRankOcclusion(tensors)


def _weigh(directions: np.ndarray, scores: np.ndarray) -> tuple[float, np.ndarray]:
    """Kernel regression of the scores; its width is what predicts a left-out direction best.

    Left out one at a time, a direction's residual is weight / diagonal of the inverse
    [Rasmussen2006].
    """
    best = (np.inf, 0.0, scores)
    cosines = directions @ directions.T - 1
    for sharpness in SHARPNESS:
        for noise in NOISE:
            kernel = np.exp(sharpness * cosines) + noise * np.eye(len(directions))
            inverse = np.linalg.inv(kernel)
            weights = inverse @ scores
            left_out = float(np.square(weights / np.diag(inverse)[:, None]).sum())
            if left_out < best[0]:
                best = (left_out, sharpness, weights)
    return best[1], best[2]
