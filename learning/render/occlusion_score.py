"""How wrong shadows without rays are under lights that were not baked, and how long each takes."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch

from learning.render.occlusion_model import OcclusionTable, bake_dome
from learning.render.occlusion_network import OcclusionNetwork
from learning.render.occlusion_training import random_shares
from lightstage.commands import ProgressCallback, quiet
from lightstage.counting import counted
from lightstage.formats.mesh import Mesh

REPEATS = 3


@dataclasses.dataclass(frozen=True)
class UnseenLights:
    """Light sets from anywhere, whose directions were not baked, and the truth under them.

    Attributes:
        toward: (n, lights, 3) float64 unit.
        share: (n, lights), summing to 1.
        truth: (heads, n, t) what each head's covered texels see of a set, by rays.
        covered: (rows, columns) bool.
        rays_ms: processor milliseconds that a set of them took on one head.
    """

    toward: np.ndarray
    share: np.ndarray
    truth: np.ndarray
    covered: np.ndarray
    rays_ms: float

    def errors(self, seen: np.ndarray) -> np.ndarray:
        """(heads,) mean absolute error of (n, rows, columns)."""
        found: np.ndarray = np.abs(seen[:, self.covered] - self.truth).mean(axis=(1, 2))
        return found

    def rms(self, seen: np.ndarray) -> np.ndarray:
        """(heads,) root of the mean square error of (n, rows, columns)."""
        square = np.square(seen[:, self.covered] - self.truth).mean(axis=(1, 2))
        return np.sqrt(square)

    def by_table(self, table: OcclusionTable) -> np.ndarray:
        """(n, rows, columns) from the pictures of single lights."""
        count, lights = self.share.shape
        toward = torch.from_numpy(self.toward).float().flatten(0, 1)
        seen = table.for_lights(toward, (self.covered.shape[0], self.covered.shape[1]))
        pictures = seen.numpy().reshape(count, lights, *self.covered.shape)
        return np.einsum("nl,nlhw->nhw", self.share, pictures)

    def by_network(self, network: OcclusionNetwork) -> np.ndarray:
        """(n, rows, columns): of whole sets, or of single lights where the network takes one."""
        count, lights = self.share.shape
        toward = torch.from_numpy(self.toward).float()
        share = torch.from_numpy(self.share).float()
        with torch.inference_mode():
            if network.config.lights == lights:
                return network.occlusion(toward, share).numpy()
            single = toward.flatten(0, 1)[:, None]
            seen = network.occlusion(single, single.new_ones(len(single), 1))
            pictures = seen.unflatten(0, (count, lights))
            return torch.einsum("nl,nlhw->nhw", share, pictures).numpy()


def unseen_lights(
    heads: Sequence[Mesh],
    rows: int,
    lights: int,
    count: int,
    rng: np.random.Generator,
    progress: ProgressCallback = quiet,
) -> UnseenLights:
    """`count` random sets of `lights`, and rays from heads of one UV to them."""
    toward = rng.normal(size=(count, lights, 3))
    toward /= np.linalg.norm(toward, axis=2, keepdims=True)
    share = random_shares(rng, count, lights)
    bake_dome(heads[0], rows, toward[0])  # compiles what has never run
    began = time.process_time()
    baked = [bake_dome(head, rows, toward.reshape(-1, 3), progress) for head in heads]
    rays_ms = 1e3 * (time.process_time() - began) / (count * len(heads))
    seen = np.array([seen.reshape(count, lights, -1) for seen, _ in baked])
    return UnseenLights(toward, share, np.einsum("nl,hnlt->hnt", share, seen), baked[0][1], rays_ms)


def least_ms(function: Callable[[], object]) -> float:
    """Processor milliseconds of all threads, the least of some runs after one."""
    function()
    times = []
    for _ in range(REPEATS):
        began = time.process_time()
        function()
        times.append(time.process_time() - began)
    return 1e3 * min(times)


@dataclasses.dataclass(frozen=True)
class OcclusionScore:
    """Errors of occlusion, 0..1, under unseen lights, and processor ms of a set.

    Attributes:
        no_shadows, table, network: mean absolute errors.
        fitted: the network's, before decoder and regressor were trained together.
        no_shadows_rms, table_rms, network_rms: roots of mean square errors.
        rays_ms, table_ms, network_ms: at the pictures' size.
        sets: of lights.
    """

    no_shadows: float
    table: float
    fitted: float
    network: float
    no_shadows_rms: float
    table_rms: float
    network_rms: float
    rays_ms: float
    table_ms: float
    network_ms: float
    sets: int

    def figures(self) -> dict[str, Any]:
        """By name."""
        return dataclasses.asdict(self)

    def sentence(self) -> str:
        """For the command's last line."""
        better = "network" if self.network < self.table else "table"
        return (
            f"mean error (rms) under {counted(self.sets, 'unseen light set')}: "
            f"table {self.table:.4f} ({self.table_rms:.3f}) in {self.table_ms:.2f} ms, "
            f"network {self.network:.4f} ({self.network_rms:.3f}) in {self.network_ms:.2f} ms, "
            f"{self.fitted:.4f} before its joint steps, "
            f"no shadows {self.no_shadows:.4f} ({self.no_shadows_rms:.3f}), "
            f"rays {self.rays_ms:.2f} ms; the {better} is nearer to the rays"
        )


def score_occlusion(
    unseen: UnseenLights, table: OcclusionTable, network: OcclusionNetwork, fitted: float
) -> OcclusionScore:
    """Table and network beside each other; `fitted` as in `OcclusionScore`."""
    sets = len(unseen.share)
    seen = {
        "no_shadows": np.ones((sets, *unseen.covered.shape)),
        "table": unseen.by_table(table),
        "network": unseen.by_network(network),
    }
    errors = {name: float(unseen.errors(pictures).mean()) for name, pictures in seen.items()}
    roots = {f"{name}_rms": float(unseen.rms(x).mean()) for name, x in seen.items()}
    return OcclusionScore(
        **errors,
        **roots,
        fitted=fitted,
        rays_ms=unseen.rays_ms,
        table_ms=least_ms(lambda: unseen.by_table(table)) / sets,
        network_ms=least_ms(lambda: unseen.by_network(network)) / sets,
        sets=sets,
    )
