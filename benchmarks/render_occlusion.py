"""Cast shadows without rays: how wrong each way is under three lights, and what it costs.

On the template's mean shape and on people it was not made from, under light sets whose directions
were not baked. `--steps` is the published network's training (300 take a minute), 0 for none;
`--network` a file that its weights are kept in from run to run.
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import load_file, save_file

from benchmarks.record import record
from benchmarks.render_speed import best_ms
from learning.render.light_dome import even_directions, harmonics
from learning.render.occlusion_model import OcclusionTable, bake_dome, default_occlusion
from learning.render.occlusion_network import NetworkConfig, OcclusionNetwork, train_network
from lightstage.formats.template import default_template_path, load_template

PEOPLE, SETS, LIGHTS, REPEATS = 4, 60, 3, 3
TRAINING_DIRECTIONS = 512


@dataclasses.dataclass(frozen=True)
class Trial:
    """Light sets and the truth under them.

    Attributes:
        toward: (d, 3) directions.
        sets: (n, 3) indices.
        share: (n, 3) of each light, summing to 1.
        truth: (1 + people, n, t) occlusion; the first is the mean shape's.
    """

    toward: np.ndarray
    sets: np.ndarray
    share: np.ndarray
    truth: np.ndarray


def make_trial(rows: int) -> Trial:
    template = load_template(default_template_path())
    if template.modes is None:
        raise SystemExit("the template has no modes")
    rng = np.random.default_rng(1)
    toward = rng.normal(size=(3 * SETS, 3))
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    sets = np.arange(3 * SETS).reshape(SETS, LIGHTS)
    share = rng.uniform(0.2, 1.0, (SETS, LIGHTS))
    share /= share.sum(axis=1, keepdims=True)
    weights = [np.zeros(len(template.modes.identity))]
    weights += [rng.normal(size=len(template.modes.identity)) for _ in range(PEOPLE)]
    truth = []
    for weight in weights:
        moved = template.mesh.vertices + np.tensordot(weight, template.modes.identity, 1)
        mesh = dataclasses.replace(template.mesh, vertices=moved)
        seen = bake_dome(mesh, rows, toward)[0]
        truth.append(np.einsum("nl,nlt->nt", share, seen[sets]))
    return Trial(toward, sets, share, np.array(truth))


def mixed(trial: Trial, seen: np.ndarray) -> np.ndarray:
    """(n, t) of the sets, from (d, t) of single lights."""
    return np.einsum("nl,nlt->nt", trial.share, seen[trial.sets])


def from_table(trial: Trial, table: OcclusionTable) -> np.ndarray:
    rows, columns = table.covered.shape
    toward = torch.from_numpy(trial.toward).float()
    seen = table.for_lights(toward, (rows, columns)).numpy()
    return mixed(trial, seen[:, table.covered])


def nearest(trial: Trial, table: OcclusionTable) -> np.ndarray:
    found = np.argmax(trial.toward @ table.directions.T, axis=1)
    return mixed(trial, table.pictures(found))


def by_harmonics(trial: Trial, seen: np.ndarray, order: int) -> Callable[[], np.ndarray]:
    baked = harmonics(torch.from_numpy(even_directions(len(seen))), order).numpy()
    known = np.linalg.lstsq(baked, seen, rcond=None)[0].astype(np.float32)
    here = harmonics(torch.from_numpy(trial.toward), order).numpy().astype(np.float32)
    return lambda: mixed(trial, np.clip(here @ known, 0, 1))


def by_pictures(trial: Trial, seen: np.ndarray, rank: int) -> Callable[[], np.ndarray]:
    """Principal pictures, their weights interpolated by a kernel on the sphere."""
    directions = even_directions(len(seen))
    mean = seen.mean(axis=0)
    values, vectors = np.linalg.eigh((seen - mean) @ (seen - mean).T)
    scores = vectors[:, ::-1][:, :rank] * np.sqrt(np.maximum(values[::-1][:rank], 1e-12))
    pictures = np.linalg.lstsq(scores, seen - mean, rcond=None)[0].astype(np.float32)
    kernel = np.exp(32 * (directions @ directions.T - 1)) + 0.01 * np.eye(len(directions))
    weights = np.linalg.solve(kernel, scores)
    near = np.exp(32 * (trial.toward @ directions.T - 1)) @ weights
    return lambda: mixed(trial, np.clip(mean + near.astype(np.float32) @ pictures, 0, 1))


def trained(
    seen: np.ndarray, covered: np.ndarray, steps: int, kept: Path | None
) -> OcclusionNetwork:
    config = NetworkConfig(lights=LIGHTS, steps=steps, regressed=1000)
    if kept is not None and kept.exists():
        network = OcclusionNetwork(covered.shape[0], covered.shape[1], config)
        network.load_state_dict(load_file(kept))
        network.eval()
    else:
        network = train_network(seen, even_directions(len(seen)), covered, config)
        if kept is not None:
            save_file(network.state_dict(), kept)
    return network


def by_network(
    trial: Trial, network: OcclusionNetwork, covered: np.ndarray
) -> Callable[[], np.ndarray]:
    toward = torch.from_numpy(trial.toward[trial.sets]).float()
    share = torch.from_numpy(trial.share).float()

    def run() -> np.ndarray:
        with torch.inference_mode():
            return network.occlusion(toward, share).numpy()[:, covered]

    return run


def through_network(
    trial: Trial, network: OcclusionNetwork, covered: np.ndarray
) -> Callable[[], np.ndarray]:
    """The exact picture through encoder and decoder: what no regressor can be better than."""
    pictures = torch.ones(SETS, *covered.shape)
    pictures[:, torch.from_numpy(covered)] = torch.from_numpy(trial.truth[0]).float()

    def run() -> np.ndarray:
        with torch.inference_mode():
            return network(pictures).numpy()[:, covered]

    return run


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=300)
    parser.add_argument("--network", type=Path)
    chosen = parser.parse_args()
    steps = chosen.steps
    table = default_occlusion()
    rows = table.covered.shape[0]
    trial = make_trial(rows)
    mesh = load_template(default_template_path()).mesh
    seen, covered = bake_dome(mesh, rows, even_directions(TRAINING_DIRECTIONS))
    texels, kilobyte = seen.shape[1], 1e-3
    ways: list[tuple[str, float, Callable[[], np.ndarray]]] = [
        ("mean shape, exact (rays)", 0.0, lambda: trial.truth[0]),
        ("no shadows at all", 0.0, lambda: np.ones_like(trial.truth[0])),
        ("table of 2048, mixed (default)", table.bits.nbytes, lambda: from_table(trial, table)),
        ("table of 2048, nearest", table.bits.nbytes, lambda: nearest(trial, table)),
        ("harmonics of order 4", 25 * texels * 4, by_harmonics(trial, seen, 4)),
        (
            "harmonics of order 7, as large as the table",
            64 * texels * 4,
            by_harmonics(trial, seen, 7),
        ),
        ("harmonics of order 12", 169 * texels * 4, by_harmonics(trial, seen, 12)),
        ("64 principal pictures", 64 * texels * 4, by_pictures(trial, seen, 64)),
    ]
    if steps:
        network = trained(seen, covered, steps, chosen.network)
        size = 4.0 * sum(values.numel() for values in network.parameters())
        ways.append(
            (f"published network, {steps} steps", size, by_network(trial, network, covered))
        )
        way = through_network(trial, network, covered)
        ways.append(("its autoencoder, given the exact picture", size, way))
    lines = []
    for name, size, way in ways:
        found, ms = way(), best_ms(way, REPEATS) / SETS
        error = np.abs(found[None] - trial.truth).mean(axis=(1, 2))
        square = float(np.square(found - trial.truth[0]).mean())
        lines.append(
            [
                name,
                f"{error[0]:.4f}",
                f"{error[1:].mean():.4f}",
                f"{error[1:].mean() - np.abs(trial.truth[0] - trial.truth[1:]).mean():.4f}",
                f"{np.sqrt(square):.3f}",
                f"{size * kilobyte:.0f}",
                f"{ms:.2f}",
            ]
        )
    record(
        "Renderer: cast shadows without rays",
        [
            "way",
            "mean error, mean shape",
            "other people",
            "above the floor",
            "rms, mean shape",
            "kB",
            "ms a set",
        ],
        lines,
        f"{rows} x {covered.shape[1]} texels, {SETS} sets of {LIGHTS} lights from anywhere, "
        f"directions and {PEOPLE} people not seen before; cast shadows alone. The floor is the "
        "mean shape's exact shadows on the other people. Processor ms over "
        "2 cores, the best of 3.",
    )


if __name__ == "__main__":
    main()
