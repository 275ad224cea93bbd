"""Super-resolution at 8 times: RCAN beside bicubic and Lanczos interpolation, in one run.

People of another seed than those of the training, their lit textures and their albedos apart, and
the face of a scanned head's texture. For each: PSNR over skin (sRGB-encoded), the energy beyond the
input's band over the true one (more than 1 was invented), the correlation of that band with the
true one, and the time of one picture. `--checkpoint RUN` measures another network, `--picture FILE`
leaves FILE_0 and on: input, Lanczos, RCAN and truth side by side.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from benchmarks.record import record

if TYPE_CHECKING:
    from torch import Tensor

    from learning.upscale.data import Picture

SUBJECTS, SEED, ROWS, LIGHTS = 6, 900, 768, 3
SCAN_FACE = (slice(176, 640), slice(336, 688))
"""Rows and columns of the scan's face in its texture of 1024: brows, eyes, mouth and stubble."""


def main() -> None:
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--checkpoint", type=Path, help="a run; the shipped weights else")
    parser.add_argument("--picture", type=Path, help="PNG to write, with _0 and on in its name")
    arguments = parser.parse_args()
    from learning.checkpoint import load_super_resolution, shipped_super_resolution
    from learning.upscale.score import compare, methods_of

    network, about = load_super_resolution(arguments.checkpoint or shipped_super_resolution())
    times, methods = network.config.times, methods_of(network)
    with tempfile.TemporaryDirectory() as folder:
        made = people(Path(folder), times)
    cases = {"people, lit": made[::2], "people, albedo": made[1::2]}
    scan = scanned(times)
    if scan:
        cases["scanned head's face"] = [scan]
    table = []
    for case, pictures in cases.items():
        for name, found in compare(methods, pictures, times).items():
            table.append(
                [
                    case,
                    {"network": "RCAN", "bicubic": "bicubic", "lanczos": "Lanczos"}[name],
                    f"{found.psnr_db:.2f}",
                    f"{found.detail.energy:.3f}",
                    f"{found.detail.correlation:.2f}",
                    f"{found.seconds:.3f}",
                ]
            )
    weights = sum(values.numel() for values in network.parameters())
    record(
        f"Learning, super-resolution at {times} times"
        + (f", network of {arguments.checkpoint.name}" if arguments.checkpoint else ""),
        ["textures", "method", "PSNR dB", "energy beyond the input's band", "correlation", "s"],
        table,
        f"{SUBJECTS} people that were not trained on, {ROWS // times} to {ROWS} rows, {LIGHTS} "
        f"lights each"
        + (
            "; the scan is Infinite, 3D Head Scan by Lee Perry-Smith, 128 to 1024 rows"
            if scan
            else "; no scan was there"
        )
        + f". Network of {weights:,} weights and {about.step} steps. Energy: found over true. "
        "Seconds of wall time on a machine that others use too.",
    )
    if arguments.picture:
        for index, picture in enumerate([cases["people, lit"][0], *([scan] if scan else [])]):
            low, true = planes(picture.low), planes(picture.high)
            both = [np.clip(methods[name](low), 0, 1) for name in ("lanczos", "network")]
            row = np.concatenate([as_squares(low, times), *both, true], axis=1)
            path = arguments.picture.with_stem(f"{arguments.picture.stem}_{index}")
            cv2.imwrite(str(path), np.rint(255 * row[..., ::-1]).astype(np.uint8))


def planes(tensor: Tensor) -> np.ndarray:
    """(3, h, w) to (h, w, 3)."""
    return np.ascontiguousarray(tensor.float().permute(1, 2, 0).numpy())


def as_squares(low: np.ndarray, times: int) -> np.ndarray:
    """The input's texels as squares."""
    return low.repeat(times, axis=0).repeat(times, axis=1)


def people(folder: Path, times: int) -> list[Picture]:
    """Lit texture and albedo in turn, of people as they are."""
    from learning.augment import AugmentConfig
    from learning.render.environments import RandomLightConfig
    from learning.upscale.config import PicturesConfig
    from learning.upscale.data import Pictures
    from processing.dataset import build_store, open_store
    from sim.people.dataset import make_plan, write_people
    from sim.people.table import load_table

    write_people(
        make_plan(folder / "people", load_table("balanced"), SUBJECTS, 1, SEED, ROWS), jobs=1
    )
    folders = sorted(path.parent for path in (folder / "people").glob("*/report.json"))
    store = open_store(build_store(folders, folder / "store"))
    own = dataclasses.replace(AugmentConfig(), melanin=0.0, haemoglobin=0.0)
    return Pictures(
        store,
        {scan.subject for scan in store.scans},
        times,
        2 * LIGHTS * SUBJECTS,
        PicturesConfig(),
        RandomLightConfig(),
        own,
        np.random.default_rng(0),
    ).pictures


def scanned(times: int) -> Picture | None:
    """The scanned head's texture, its face as skin; None where it is not at hand."""
    import torch

    from learning.upscale.data import Picture, downsampled

    data = Path(os.environ.get("LIGHTSTAGE_DATA", "../shared/data"))
    image = cv2.imread(str(data / "lps_head" / "Map-COL.jpg"))
    if image is None:
        return None
    rgb = np.ascontiguousarray(image[..., ::-1].transpose(2, 0, 1), np.float32) / 255
    high = torch.from_numpy(rgb)
    face = np.zeros(image.shape[:2], bool)
    face[SCAN_FACE] = True
    low = downsampled(high[None], times)[0]
    return Picture(high.half(), low, face, torch.empty((0, 2), dtype=torch.long))


if __name__ == "__main__":
    main()
