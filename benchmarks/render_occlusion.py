"""Cast shadows without rays: how wrong each way is under three lights, and what it costs.

On the template's mean shape and on people it was not made from, under light sets whose directions
were not baked, beside the rays that are the truth. `--network RUN`, any number of times, is what
`lightstage-learning occlusion --network RUN` trained, of one light or of three; without it one is
trained as that command does (some minutes). The second table is of a render's maps, which are
larger than what is baked.
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from benchmarks.record import record
from learning.occlusion_run import load_occlusion_network
from learning.render.light_dome import even_directions, harmonics
from learning.render.occlusion_model import OcclusionTable, bake_dome, default_occlusion
from learning.render.occlusion_network import OcclusionNetwork
from learning.render.occlusion_score import UnseenLights, least_ms, unseen_lights
from learning.render.occlusion_training import BakedHeads, OcclusionTrainConfig, OcclusionTrainer
from learning.render.uv import rasterise
from lightstage.formats.mesh import Mesh
from lightstage.formats.template import default_template_path, load_template

PEOPLE, SETS, LIGHTS = 4, 60, 3
FITTED_DIRECTIONS = 512
"""That harmonics and principal pictures are fitted to; their count is their cost here."""
LARGE_ROWS, LARGE_LIGHTS = 768, 12


def heads_of() -> list[Mesh]:
    """The mean shape, then people."""
    template = load_template(default_template_path())
    if template.modes is None:
        raise SystemExit("the template has no modes")
    rng = np.random.default_rng(1)
    modes = template.modes.identity
    weights = [np.zeros(len(modes)), *rng.normal(size=(PEOPLE, len(modes)))]
    moved = [template.mesh.vertices + np.tensordot(weight, modes, 1) for weight in weights]
    return [template.mesh.with_vertices(vertices) for vertices in moved]


def full(unseen: UnseenLights, flat: np.ndarray) -> np.ndarray:
    """(n, rows, columns) of (n, t) covered texels."""
    pictures = np.ones((len(flat), *unseen.covered.shape), np.float32)
    pictures[:, unseen.covered] = flat
    return pictures


def mixed(unseen: UnseenLights, seen: np.ndarray) -> np.ndarray:
    """(n, rows, columns) of the sets, from (n lights, t) of single lights."""
    single = seen.reshape(*unseen.share.shape, -1)
    return full(unseen, np.einsum("nl,nlt->nt", unseen.share, single))


def nearest(unseen: UnseenLights, table: OcclusionTable) -> np.ndarray:
    found = np.argmax(unseen.toward.reshape(-1, 3) @ table.directions.T, axis=1)
    return mixed(unseen, table.pictures(found))


def by_harmonics(unseen: UnseenLights, seen: np.ndarray, order: int) -> Callable[[], np.ndarray]:
    baked = harmonics(torch.from_numpy(even_directions(len(seen))), order).numpy()
    known = np.linalg.lstsq(baked, seen, rcond=None)[0].astype(np.float32)
    toward = torch.from_numpy(unseen.toward.reshape(-1, 3))
    here = harmonics(toward, order).numpy().astype(np.float32)
    return lambda: mixed(unseen, np.clip(here @ known, 0, 1))


def by_pictures(unseen: UnseenLights, seen: np.ndarray, rank: int) -> Callable[[], np.ndarray]:
    """Principal pictures, their weights interpolated by a kernel on the sphere."""
    directions = even_directions(len(seen))
    mean = seen.mean(axis=0)
    values, vectors = np.linalg.eigh((seen - mean) @ (seen - mean).T)
    scores = vectors[:, ::-1][:, :rank] * np.sqrt(np.maximum(values[::-1][:rank], 1e-12))
    pictures = np.linalg.lstsq(scores, seen - mean, rcond=None)[0].astype(np.float32)
    kernel = np.exp(32 * (directions @ directions.T - 1)) + 0.01 * np.eye(len(directions))
    weights = np.linalg.solve(kernel, scores)
    near = np.exp(32 * (unseen.toward.reshape(-1, 3) @ directions.T - 1)) @ weights
    return lambda: mixed(unseen, np.clip(mean + near.astype(np.float32) @ pictures, 0, 1))


def trained(mesh: Mesh, table: OcclusionTable) -> tuple[str, OcclusionNetwork]:
    """A network as the command trains it, on the table's own pictures."""
    rows, columns = table.covered.shape
    every = table.pictures(np.arange(len(table.bits))) > 0.5
    baked = BakedHeads(rasterise(mesh, rows, columns), table.directions, every[None])
    config = OcclusionTrainConfig()
    config = dataclasses.replace(config, occlusion=dataclasses.replace(config.occlusion, rows=rows))
    trainer = OcclusionTrainer(baked, config)
    trainer.train_autoencoder()
    trainer.fit_regressor()
    trainer.train_jointly()
    return named(trainer.network, config.steps, config.joint_steps), trainer.network


def read(run: Path) -> tuple[str, OcclusionNetwork]:
    network, about = load_occlusion_network(run)
    return named(network, about.config["steps"], about.config["joint_steps"]), network


def named(network: OcclusionNetwork, steps: int, joint_steps: int) -> str:
    config = network.config
    what = "coordinates" if config.order == 1 else f"harmonics of order {config.order}"
    return f"network of {config.lights}, {what}, {steps} + {joint_steps} steps"


def size_of(network: OcclusionNetwork) -> float:
    """Bytes of what is needed in use: all but the encoder."""
    parts = (network.regressor, network.widen, network.decoder)
    return 4.0 * sum(p.numel() for part in parts for p in part.parameters())


def small(
    heads: list[Mesh], table: OcclusionTable, networks: list[tuple[str, OcclusionNetwork]]
) -> None:
    """Every way at the size that is baked."""
    rows, columns = table.covered.shape
    unseen = unseen_lights(heads, rows, LIGHTS, SETS, np.random.default_rng(1))
    seen = bake_dome(heads[0], rows, even_directions(FITTED_DIRECTIONS))[0]
    texels = seen.shape[1]
    exact = full(unseen, unseen.truth[0])
    bits = float(table.bits.nbytes)
    ways: list[tuple[str, float, Callable[[], np.ndarray]]] = [
        ("no shadows at all", 0.0, lambda: np.ones_like(exact)),
        ("table of 2048, mixed (default)", bits, lambda: unseen.by_table(table)),
        ("table of 2048, nearest", bits, lambda: nearest(unseen, table)),
        ("harmonics of order 4", 25 * texels * 4, by_harmonics(unseen, seen, 4)),
        ("harmonics of order 7", 64 * texels * 4, by_harmonics(unseen, seen, 7)),
        ("harmonics of order 12", 169 * texels * 4, by_harmonics(unseen, seen, 12)),
        ("64 principal pictures", 64 * texels * 4, by_pictures(unseen, seen, 64)),
    ]

    def way_of(network: OcclusionNetwork) -> Callable[[], np.ndarray]:
        return lambda: unseen.by_network(network)

    ways += [(name, size_of(network), way_of(network)) for name, network in networks]
    floor = unseen.errors(exact)[1:].mean()
    rays_ms = f"{unseen.rays_ms:.2f}"
    lines = [["rays, on the mean shape", "0.0000", f"{floor:.4f}", "0.0000", "0.000", "0", rays_ms]]
    for name, size, way in ways:
        pictures = way()
        errors = unseen.errors(pictures)
        others = errors[1:].mean()
        lines.append(
            [
                name,
                f"{errors[0]:.4f}",
                f"{others:.4f}",
                f"{others - floor:.4f}",
                f"{unseen.rms(pictures)[0]:.3f}",
                f"{size / 1e3:.0f}",
                f"{least_ms(way) / SETS:.2f}",
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
        f"{rows} x {columns} texels, {SETS} sets of {LIGHTS} lights from anywhere, directions and "
        f"{PEOPLE} people not seen before; cast shadows alone. The floor is the mean shape's exact "
        "shadows on the other people. Processor ms of all threads, the least of 3; rays once, "
        "their tree of triangles included.",
    )


def large(mesh: Mesh, table: OcclusionTable, networks: list[tuple[str, OcclusionNetwork]]) -> None:
    """What a render gets: each light's visibility of the maps' texels."""
    rng = np.random.default_rng(2)
    unseen = unseen_lights([mesh], LARGE_ROWS, 1, LARGE_LIGHTS, rng)
    toward = torch.from_numpy(unseen.toward[:, 0]).float()
    size = (unseen.covered.shape[0], unseen.covered.shape[1])

    def by_table() -> np.ndarray:
        return table.for_lights(toward, size).numpy()

    def way_of(network: OcclusionNetwork) -> Callable[[], np.ndarray]:
        def way() -> np.ndarray:
            with torch.inference_mode():
                return network.for_lights(toward, torch.ones(LARGE_LIGHTS, 3), size).numpy()

        return way

    ways = [("no shadows at all", lambda: np.ones((LARGE_LIGHTS, *size))), ("table", by_table)]
    ways += [(name, way_of(net)) for name, net in networks if net.config.lights == 1]
    lines = [["rays", "0.0000", "0.000", f"{unseen.rays_ms:.1f}"]]
    for name, way in ways:
        seen = way()
        error, root = unseen.errors(seen)[0], unseen.rms(seen)[0]
        ms = least_ms(way) / LARGE_LIGHTS
        lines.append([name, f"{error:.4f}", f"{root:.3f}", f"{ms:.1f}"])
    record(
        "Renderer: cast shadows of a render",
        ["way", "mean error", "rms", "ms a light"],
        lines,
        f"Maps of {size[0]} x {size[1]} texels of the mean shape, {LARGE_LIGHTS} lights from "
        f"anywhere; table and networks are baked at {table.covered.shape[0]} rows and enlarged. "
        "Processor ms of all threads, the least of 3; rays once, their tree of triangles included.",
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--network", type=Path, action="append", default=[])
    chosen = parser.parse_args()
    table, heads = default_occlusion(), heads_of()
    networks = [read(run) for run in chosen.network] or [trained(heads[0], table)]
    for name, network in networks:
        if network.config.lights not in (1, LIGHTS):
            raise SystemExit(f"{name}: of 1 light or of {LIGHTS}")
    small(heads, table, networks)
    large(heads[0], table, networks)


if __name__ == "__main__":
    main()
