"""Training of the network of template points: faces drawn first, then steps on them."""

from __future__ import annotations

import copy
import dataclasses
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from learning.average import follow
from learning.checkpoint import AVERAGE, save_checkpoint
from learning.encoding import shrink
from learning.errors import TrainingError
from learning.limits import configured
from learning.maps import to_batch
from learning.photo.config import FitConfig
from learning.photo.shape_fit import Places, detector_places
from learning.points.config import PointsConfig
from learning.points.faces import Drawn, Faces
from learning.points.layout import SIDE_PX, Layout, layout_of
from learning.points.network import FAMILY, PointNetwork
from learning.points.trunk import fill_from_wheel
from learning.run import require_new
from lightstage.commands import ProgressCallback, quiet
from lightstage.faces import face_mesh
from lightstage.formats.template import Template, load_template
from processing.dataset import Store, open_store

SKIN_ROWS = 384
"""Rows of the skins' textures."""
LEAST_PRESENCE = 0.5
"""Of the detector; faces of which it is less sure are left out."""
LEAST_FACING = 0.1
"""Cosine to the camera below which a point is not learned from."""


@dataclasses.dataclass(frozen=True)
class Examples:
    """Faces as the network sees them.

    Attributes:
        pictures: (n, 128, 128, 3) uint8.
        beside_mm: (n, c, 2) float16.
        residual_mm: (n, p, 2) float16.
        facing: (n, p) float16 0..1, how much a point counts.
    """

    pictures: np.ndarray
    beside_mm: np.ndarray
    residual_mm: np.ndarray
    facing: np.ndarray

    def batch(self, chosen: np.ndarray) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """The network's inputs, targets and weights of some faces."""
        pictures = self.pictures[chosen].transpose(0, 3, 1, 2).astype(np.float32) / 255
        rest = (self.beside_mm[chosen], self.residual_mm[chosen], self.facing[chosen])
        beside, residual, facing = (torch.from_numpy(x.astype(np.float32)) for x in rest)
        return torch.from_numpy(pictures), beside, residual, facing


def examples_of(
    faces: Faces,
    layout: Layout,
    detected: Places,
    mirror: np.ndarray,
    count: int,
    rng: np.random.Generator,
    progress: ProgressCallback = quiet,
) -> Examples:
    """Draw `count` faces, and have the detector see each, and its mirror image.

    Args:
        faces: to draw from.
        layout: of the template.
        detected: the detector's points on it.
        mirror: (n,) each vertex's number on the other side.
        count: of faces.
        rng: of all chance.
        progress: of faces.
    """
    parts: list[tuple[np.ndarray, ...]] = []
    for done in range(count):
        drawn = faces.drawn(rng)
        width = drawn.picture.shape[1]
        other = Drawn(
            np.ascontiguousarray(drawn.picture[:, ::-1]),
            (drawn.points_px * [-1, 1] + [width, 0])[mirror],
            drawn.facing[mirror],
        )
        for one in (drawn, other):
            found = _example(one, layout, detected, rng)
            if found is not None:
                parts.append(found)
        progress(done + 1, count)
    if not parts:
        raise TrainingError("faces", found="none that the detector sees", expected="some")
    return Examples(*(np.stack(each) for each in zip(*parts, strict=True)))


def _example(
    drawn: Drawn, layout: Layout, detected: Places, rng: np.random.Generator
) -> tuple[np.ndarray, ...] | None:
    true = drawn.points_px[layout.vertices]
    # The crop to which the detector's own settles, nearly: it is seen once in place of thrice.
    crop = face_mesh.crop_of_points(_seen_through(drawn, layout, detected))
    centre = crop.centre_px + rng.normal(0, 0.02 * crop.size_px, 2)
    size_px, angle = crop.size_px * rng.uniform(0.95, 1.05), crop.angle + rng.normal(0, 0.03)
    seen = face_mesh.see(drawn.picture, face_mesh.Crop(centre, size_px, angle))
    if not seen.presence > LEAST_PRESENCE:
        return None
    facing = np.clip((drawn.facing[layout.vertices] - LEAST_FACING) / 0.3, 0, 1)
    return (
        layout.warped(drawn.picture, seen.points_px),
        layout.beside_mm(seen.points_px).astype(np.float16),
        layout.residual_mm(true, seen.points_px).astype(np.float16),
        facing.astype(np.float16),
    )


def _seen_through(drawn: Drawn, layout: Layout, detected: Places) -> np.ndarray:
    """(468, 2) px of the detector's points; in the middle where the template has none."""
    corners = drawn.points_px[detected.triangles]
    known = np.einsum("pck,pc->pk", corners, detected.weights)
    out = np.tile(known.mean(axis=0), (len(layout.there), 1))
    out[layout.there] = known
    return out


def mirrored(template: Template) -> np.ndarray:
    """(n,) the vertex on the other side of each."""
    from scipy.spatial import cKDTree

    vertices = template.mesh.vertices
    return np.asarray(cKDTree(vertices).query(vertices * [-1, 1, 1])[1])


def likelihood(network: PointNetwork, batch: tuple[Tensor, ...]) -> Tensor:
    """Mean negative logarithm of the likelihood of the true points, without its constant."""
    pictures, beside, residual, facing = batch
    off, log_deviation = network(pictures, beside)
    squared = (off - residual).square().sum(dim=2)
    each = 0.5 * squared * torch.exp(-2 * log_deviation) + 2 * log_deviation
    return (facing * each).sum() / facing.sum().clamp_min(1)


def varied(pictures: Tensor, rng: np.random.Generator) -> Tensor:
    """Pictures with other exposures and colours, some with a part that shows nothing."""
    count = len(pictures)
    power = np.exp(rng.normal(0, 0.15, (count, 1, 1, 1)))
    gain = np.exp(rng.normal(0, 0.1, (count, 1, 1, 1)) + rng.normal(0, 0.05, (count, 3, 1, 1)))
    out = pictures.pow(torch.from_numpy(power).float()) * torch.from_numpy(gain).float()
    for index in np.flatnonzero(rng.random(count) < 0.2):
        size = rng.integers(12, 48, 2)
        row, column = rng.integers(0, SIDE_PX - size)
        value = torch.from_numpy(rng.random(3)).float()[:, None, None]
        out[index, :, row : row + size[0], column : column + size[1]] = value
    return out.clamp(0, 1)


def trained(
    network: PointNetwork,
    examples: Examples,
    config: PointsConfig,
    progress: ProgressCallback = quiet,
) -> PointNetwork:
    """Train a network on faces; the average of its weights."""
    average = copy.deepcopy(network)
    trunk = set(network.trunk.parameters())
    rest = [each for each in network.parameters() if each not in trunk]
    rate = config.learning_rate
    adam = torch.optim.Adam(
        [{"params": rest, "lr": rate}, {"params": list(trunk), "lr": config.trunk_share * rate}]
    )
    count = len(examples.pictures)
    steps = max(1, config.epochs * count // config.batch)
    schedule = torch.optim.lr_scheduler.LambdaLR(
        adam, lambda s: min(1, (s + 1) / 200) * 0.5 * (1 + float(np.cos(np.pi * s / steps)))
    )
    order = np.random.default_rng([config.seed, 1])
    queue = np.zeros(0, int)
    network.train()
    for step in range(steps):
        if len(queue) < config.batch:
            queue = np.concatenate([queue, order.permutation(count)])
        chosen, queue = queue[: config.batch], queue[config.batch :]
        pictures, *others = examples.batch(chosen)
        rng = np.random.default_rng([config.seed, 2, step])
        loss = likelihood(network, (varied(pictures, rng), *others))
        adam.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 5.0)
        adam.step()
        schedule.step()
        follow(average, network, config.average, step)
        progress(step + 1, steps)
    return average.eval()


def scored(network: PointNetwork, examples: Examples) -> dict[str, float]:
    """Root mean squares in mm of the detector's points, with their mean taken off, and of ours."""
    squares: dict[str, float] = {"detector_mm": 0, "detector_mean_off_mm": 0, "points_mm": 0}
    total, mean = 0.0, examples.residual_mm.astype(float).mean(axis=0)
    for first in range(0, len(examples.pictures), 50):
        chosen = np.arange(first, min(first + 50, len(examples.pictures)))
        pictures, beside, residual, facing = examples.batch(chosen)
        with torch.no_grad():
            off, _ = network(pictures, beside)
        weight = facing.numpy()
        true = residual.numpy()
        for name, found in (
            ("detector_mm", np.zeros_like(true)),
            ("detector_mean_off_mm", mean),
            ("points_mm", off.numpy()),
        ):
            squares[name] += float((weight * ((true - found) ** 2).sum(axis=2)).sum())
        total += float(weight.sum())
    return {name: (value / max(total, 1e-9)) ** 0.5 for name, value in squares.items()}


def skins_of(store: Store) -> list[np.ndarray]:
    """(rows, columns, 3) linear albedos of a store's people."""
    everything = slice(None)
    out = []
    for scan in range(len(store.scans)):
        albedo = to_batch(store.read(scan, "diffuse_albedo", everything, everything))
        rows, columns = albedo.shape[2:]
        small = min(rows, SKIN_ROWS)
        out.append(shrink(albedo, (small, small * columns // rows))[0].permute(1, 2, 0).numpy())
    return out


def train_points(
    data: Path, template: Path, out: Path, file: Path | None, progress: ProgressCallback = quiet
) -> dict[str, Any]:
    """Draw faces in a store's skins, train on them, and write a checkpoint; the facts.

    Args:
        data: store of maps in the template's texture.
        template: whose mean head, modes and people are drawn.
        out: folder of the run.
        file: TOML over the defaults of `PointsConfig`, or None.
        progress: of faces, then of steps.

    Raises:
        LightstageError: no store, no template, or one without the detector's points or modes of
            expressions, a run that is there already.
    """
    began = time.monotonic()
    config = configured(PointsConfig, file, {}, "points")
    require_new(out, "Choose another --out, or remove that run first.")
    torch.manual_seed(config.seed)
    store, own = open_store(data), load_template(template)
    found = detector_places(own)
    if found is None or own.mesh.uvs is None:
        raise TrainingError(
            template,
            found="no points of the detector, or no UV",
            expected="a template that `fit` takes",
            hint="`lightstage-learning template-points --template TEMPLATE` finds the points.",
        )
    layout, mirror = layout_of(own, FitConfig()), mirrored(own)
    faces = Faces(own, FitConfig(), skins_of(store))
    rng = np.random.default_rng([config.seed, 0])
    examples = examples_of(faces, layout, found[0], mirror, config.faces, rng, progress)
    held_out = examples_of(faces, layout, found[0], mirror, config.held_out, rng)
    drawn_s = time.monotonic() - began
    network = PointNetwork(len(layout.control), len(layout.vertices))
    fill_from_wheel(network.trunk)
    network.set_layout(layout, own)
    average = trained(network, examples, config, progress)
    metrics = scored(average, held_out)
    halved = {name: value.half() for name, value in average.named_parameters()}
    out.mkdir(parents=True, exist_ok=True)
    save_checkpoint(
        out,
        config.epochs * len(examples.pictures) // config.batch,
        {AVERAGE: {**average.state_dict(), **halved}},
        {
            "family": FAMILY,
            "config": dataclasses.asdict(config),
            "data_fingerprint": store.fingerprint,
            "held_out": [],
            "texture_rows": store.scans[0].rows,
            "metrics": metrics,
            "step_seconds": time.monotonic() - began - drawn_s,
        },
    )
    seconds = time.monotonic() - began
    return {"out": str(out), "faces": len(examples.pictures), **metrics, "seconds": seconds}
