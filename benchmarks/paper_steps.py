"""First steps of the published networks: time, memory, losses, at full and at reduced width.

Each case trains in a process of its own, so that its peak memory is its own. At full width patches
have 512 texels, as published; at reduced width 128, with the published losses and rates.
`--full-presets` names those that are run at full width, which takes minutes a step on two cores,
and for `avatarme` the memory of four networks; `--store` takes a store that is there already.
`--device cuda` trains on a GPU: its seconds are those of the clock, its memory the GPU's.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.record import record

PEOPLE = 2
PRESETS = ("paper", "avatarme")
HEADER = (
    "preset",
    "device",
    "weights",
    "steps",
    "s a step",
    "peak GiB",
    "s a texture",
    "first losses",
    "last losses",
)
TEXTURE = (1536, 1024)
LAST = 20
"""Steps at the end whose mean is printed, where there are so many."""
FULL = {"data": {"shadow_sets": 8}}
"""Fewer shadows than published are baked before the first step; the steps are as published."""
REDUCED = {
    "generator": {"width": 16},
    "discriminator": {"width": 16},
    "data": {"patch_px": 128, "stride_px": 64, "patches_in_memory": 256, "shadow_sets": 8},
}


def store_of(root: Path) -> Path:
    """A store of simulated people."""
    from processing.dataset import build_store

    people = ("--subjects", str(PEOPLE), "--expressions", "1", "--seed", "7")
    words = ("sim", "dataset", *people, "--out", str(root / "people"), "--maps-only")
    subprocess.run([sys.executable, "-m", *words], check=True, stdout=subprocess.DEVNULL)
    processed = sorted(p.parent for p in (root / "people").glob("*/report.json"))
    return build_store(processed, root / "store")


def measured(
    store_path: Path, name: str, full: bool, steps: int, device_name: str
) -> dict[str, Any]:
    """Train some steps in this process; the facts."""
    import numpy as np
    import torch

    from learning.data import PatchData
    from learning.devices import choose_device, devices_here
    from learning.four.train import FourTrainer
    from learning.patch_config import PatchConfig, TrainConfig
    from learning.presets import preset
    from learning.run import split
    from learning.train import TRAINERS
    from learning.training import BatchLearner
    from processing.dataset import open_store

    config = preset(name, FULL if full else REDUCED, "benchmark")
    assert isinstance(config, PatchConfig)
    store = open_store(store_path)
    _, trained_on = split(store, config.held_out_subjects)
    # A step takes as long whoever is shown; reading more people does not belong to it.
    people = set(sorted(trained_on)[: PEOPLE - 1])
    how = (config.data, config.lights, config.augment, np.random.default_rng([config.seed, 1]))
    data = PatchData(store, people, *how, config.shading, draws=config.draws, seed=config.seed)
    device = choose_device(device_name)
    trainer: Any = TRAINERS[config.family][0](config, device)
    parts = trainer.trainers.values() if isinstance(trainer, FourTrainer) else [trainer]
    learner, networks = BatchLearner(trainer, data.draw), [part.generator for part in parts]
    seconds, lines = [], []
    on_gpu = device.type == "cuda"
    # On processors with other work the clock measures that work too.
    now = time.perf_counter if on_gpu else time.process_time
    with learner.ahead() if on_gpu else contextlib.nullcontext():
        for number in range(steps):
            # A step ends with its losses as numbers, so that the GPU has done it.
            began = now()
            lines.append(learner.step(number, 0.0))
            seconds.append(now() - began)
    peak_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    found: dict[str, Any] = {
        "steps": steps,
        "weights": sum(p.numel() for network in networks for p in network.parameters()),
        "seconds": statistics.median(seconds[1:] or seconds),
        "device": devices_here()[str(device)],
        "peak_gib": torch.cuda.max_memory_allocated() / 2**30 if on_gpu else peak_kib / 2**20,
        "first": lines[0],
        "last": {k: statistics.fmean(line[k] for line in lines[-LAST:]) for k in lines[0]},
    }
    if isinstance(config, TrainConfig):
        if on_gpu:
            found["texture_seconds"] = texture_seconds(trainer.generator, config.data.patch_px)
        else:
            found["shares"] = shares(config, data, lines[0])
    return found


def texture_seconds(generator: Any, patch_px: int) -> float:
    """Time of a network over one texture in tiles, after a first one."""
    import torch

    from learning.infer import run_tiles

    generator.eval()
    inputs, context = torch.rand(1, 6, *TEXTURE), torch.rand(1, 3, patch_px, patch_px)
    for _ in range(2):
        began = time.perf_counter()
        run_tiles(generator, inputs, context, patch_px)
    return time.perf_counter() - began


def shares(config: Any, data: Any, first: dict[str, float]) -> dict[str, float]:
    """Part of the generator's loss that the rendering loss is under each norm, untrained."""
    import numpy as np
    import torch

    from learning.losses import rendering_loss
    from learning.patch_train import PatchTrainer

    batch = data.draw(config.batch, np.random.default_rng([config.seed, 2, 0]))
    with torch.inference_mode():
        generated = PatchTrainer(config).generator(batch.inputs) * batch.covered_channels
        patch, texel = (float(rendering_loss(generated, batch, n)) for n in ("patch", "texel"))
    others = first["adversarial"] + first["features"] + first["maps"]
    texels = float(batch.covered.sum()) / len(batch.inputs)
    values = {"mean of texels": texel, "patch": patch, "sum of texels": texel * texels}
    weighted = {norm: config.render_weight * value for norm, value in values.items()}
    return {norm: value / (value + others) for norm, value in weighted.items()}


def in_a_child(store: Path, name: str, full: bool, steps: int, device: str) -> dict[str, Any]:
    """`measured` in a process of its own."""
    words = ["--store", str(store), "--case", name, "--steps", str(steps), "--device", device]
    words += ["--full"] if full else []
    ran = subprocess.run(
        [sys.executable, "-m", "benchmarks.paper_steps", *words],
        check=True,
        stdout=subprocess.PIPE,
        text=True,
    )
    found: dict[str, Any] = json.loads(ran.stdout.splitlines()[-1])
    return found


def losses(found: dict[str, float]) -> str:
    """Those of one network, or the sums over four."""
    parts = []
    for name in ("adversarial", "features", "rendering", "discriminators", "error"):
        of_parts = [value for key, value in found.items() if key.endswith(f".{name}")]
        if of_parts or name in found:
            parts.append(f"{name} {sum(of_parts) if of_parts else found[name]:.3g}")
    return ", ".join(parts)


def record_losses(cases: list[tuple[str, bool, dict[str, Any]]]) -> None:
    """Record presets, whether at full width, and what `measured` found of each."""
    rows, notes = [], []
    for name, full, found in cases:
        width = "full" if full else "reduced"
        rows.append(
            [
                f"{name}, {width}",
                found["device"],
                f"{found['weights']:,}",
                found["steps"],
                f"{found['seconds']:.2f}",
                f"{found['peak_gib']:.1f}",
                f"{found['texture_seconds']:.2f}" if "texture_seconds" in found else "-",
                losses(found["first"]),
                losses(found["last"]),
            ]
        )
        if "shares" in found:
            each = (f"{n} {100 * share:.3g} %" for n, share in found["shares"].items())
            notes.append(f"{width}: {', '.join(each)}")
    record(
        "Learning, first steps of the published networks"
        + ("" if cases[0][2]["device"] == "cpu" else ", on a GPU"),
        HEADER,
        rows,
        "Seconds of a processor over all cores, of a GPU by the clock. One patch a step, of 512 "
        "texels at full and 128 at reduced width; published losses and rates, weights counted in; "
        "`error` is the maps' L1, which is not trained on. Last losses are means of at most the "
        f"last {LAST} steps. Of four networks sums. A texture has {TEXTURE[0]} x {TEXTURE[1]} "
        "texels and goes through the network in tiles, each twice."
        + (
            " Share of the rendering loss in the untrained generator's, by its norm: "
            f"{'; '.join(notes)}."
            if notes
            else ""
        ),
    )


def main() -> None:
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=300, help="at reduced width")
    parser.add_argument("--full-steps", type=int, default=3)
    parser.add_argument("--full-presets", nargs="*", default=PRESETS, choices=PRESETS)
    parser.add_argument("--store", type=Path, help="made anew where not given")
    parser.add_argument("--device", default="cpu", help="cpu, or cuda")
    parser.add_argument("--case", help="print one case's facts as JSON")
    parser.add_argument("--full", action="store_true", help="of --case")
    chosen = parser.parse_args()
    if chosen.case:
        print(
            json.dumps(
                measured(chosen.store, chosen.case, chosen.full, chosen.steps, chosen.device)
            )
        )
        return
    cases = []
    with tempfile.TemporaryDirectory() as folder:
        store = chosen.store or store_of(Path(folder))
        for full, steps in ((False, chosen.steps), (True, chosen.full_steps)):
            for name in chosen.full_presets if full else PRESETS:
                cases.append((name, full, in_a_child(store, name, full, steps, chosen.device)))
    record_losses(cases)


if __name__ == "__main__":
    main()
