"""The shipped whole-face network on people held out, refined and alone, beside plain guesses.

Ten simulated people whose seed the training did not use, each under four lights (in front, one hard
lamp, coloured, from behind), lit by rays at the texture's own size. Raw errors, and those after the
best gain for each channel, which nobody knows of a real person. `--checkpoint RUN` measures another
network; `--people FOLDER` measures other heads: those of `lightstage-sim dataset`, or the folder
that `lightstage-processing run` made of a real one, whose atlas then is the truth.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections import defaultdict
from pathlib import Path

import numpy as np

from benchmarks.record import record
from lightstage.formats.environment import LightSet
from lightstage.formats.mesh import Mesh
from lightstage.formats.processed import ProcessedFolder

SUBJECTS, SEED, ROWS = 10, 900, 768
CAMERA_MM = np.array([0.0, 0.0, 1100.0])
PATCH_PX = 64
LIGHTS = {
    "in front": LightSet(
        "front",
        np.array([[400.0, 300.0, 1000.0], [-700.0, 200.0, 700.0]]),
        np.array([[0.45, 0.45, 0.45], [0.25, 0.25, 0.25]]),
        np.full(3, 0.2),
    ),
    "one hard lamp": LightSet(
        "hard", np.array([[800.0, 600.0, 600.0]]), np.full((1, 3), 1.1), np.full(3, 0.03)
    ),
    "coloured": LightSet(
        "coloured",
        np.array([[700.0, 100.0, 700.0], [-700.0, 100.0, 700.0]]),
        np.array([[0.6, 0.45, 0.35], [0.25, 0.35, 0.5]]),
        np.full(3, 0.15),
    ),
    "from behind": LightSet(
        "behind", np.array([[900.0, 300.0, -250.0]]), np.full((1, 3), 1.2), np.full(3, 0.3)
    ),
}
"""In the head frame, mm. `one hard lamp`, `coloured` and `from behind` go beyond the training's
ambient light, tint and brightness of a lamp at the side."""


def squared(found: np.ndarray, true: np.ndarray, skin: np.ndarray) -> float:
    """Mean square error of sRGB-encoded colours over skin."""
    from processing.colour import srgb_from_linear

    return float(np.square(srgb_from_linear(found) - srgb_from_linear(true))[skin].mean())


def gained(found: np.ndarray, true: np.ndarray, skin: np.ndarray) -> np.ndarray:
    """After the best gain a channel."""
    return found * ((found * true)[skin].sum(0) / np.maximum((found**2)[skin].sum(0), 1e-12))


def detail(found: np.ndarray, true: np.ndarray, skin: np.ndarray) -> tuple[float, float]:
    """Product and norms of what patches show beyond their mean, for a correlation."""
    from processing.colour import srgb_from_linear

    product = norms = 0.0
    squares = np.zeros(2)
    for row in range(0, skin.shape[0] - PATCH_PX + 1, PATCH_PX):
        for column in range(0, skin.shape[1] - PATCH_PX + 1, PATCH_PX):
            here = (slice(row, row + PATCH_PX), slice(column, column + PATCH_PX))
            known = skin[here]
            if known.mean() < 0.9:
                continue
            both = [srgb_from_linear(image[here][known]) for image in (found, true)]
            both = [values - values.mean(axis=0) for values in both]
            product += float((both[0] * both[1]).sum())
            squares += [float((values**2).sum()) for values in both]
    norms = float(np.sqrt(squares.prod()))
    return product, norms


def people(folder: Path) -> list[Path]:
    """Processed folders of people held out, made where they are missing."""
    from sim.people.dataset import make_plan, write_people
    from sim.people.table import load_table

    plan = make_plan(folder, load_table("balanced"), SUBJECTS, 1, SEED, ROWS)
    write_people(plan)
    return sorted(path.parent for path in folder.glob("*/report.json"))


def main() -> None:
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--people", type=Path, help="processed folders; made where not given")
    parser.add_argument("--checkpoint", type=Path, help="a run; the shipped weights else")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as made:
        folders = (
            sorted(path.parent for path in asked.people.glob("*/report.json"))
            if asked.people
            else people(Path(made))
        )
        title = "Learning, shipped whole-face network"
        if asked.checkpoint:
            title = f"Learning, whole-face network of {asked.checkpoint.name}"
        if asked.people:
            title += f", heads of {asked.people.name}"
        measure(title, folders, asked.checkpoint)


def measure(title: str, folders: list[Path], checkpoint: Path | None) -> None:
    """Print and record the table."""
    from learning.checkpoint import load_whole_face, shipped_weights
    from learning.commands import REFINE_SECONDS
    from learning.maps import load_head
    from learning.networks.whole_face import BANDS
    from learning.relight import lit_texture, shadows_of
    from learning.whole.detail import enlarged
    from learning.whole.infer import in_mesh_axes, infer_whole_face
    from lightstage.formats.mesh import read_mesh
    from lightstage.formats.template import default_template_path, load_template
    from processing.dataset import read_head_pose

    network, about = load_whole_face(checkpoint or shipped_weights())
    template = load_template(default_template_path())
    mean = np.exp(network.mean_log_albedo[0].permute(1, 2, 0).numpy())
    errors: dict[tuple[str, str], list[float]] = defaultdict(list)
    details: dict[str, list[tuple[float, float]]] = defaultdict(list)
    specular: list[np.ndarray] = []
    trust: list[np.ndarray] = []
    turned: list[float] = []
    seconds: dict[str, list[float]] = defaultdict(list)
    for root in folders:
        folder = ProcessedFolder(root)
        mesh: Mesh = read_mesh(folder.registered_mesh)
        pose = read_head_pose(folder.head_pose)
        head = load_head(root / "atlas", mesh, template)
        true = folder.read_atlas("diffuse_albedo")
        skin = folder.read_atlas("confidence") > 0
        rows, columns = skin.shape
        camera_mm = np.linalg.solve(pose[:, :3], CAMERA_MM - pose[:, 3])
        for kind, in_head in LIGHTS.items():
            lights = in_mesh_axes(in_head, pose)
            seen = shadows_of(head, lights)
            texture = lit_texture(head, lights, camera_mm, seen=seen)
            began = time.perf_counter()
            alone = infer_whole_face(network, texture, mesh, pose)
            between = time.perf_counter()
            found = infer_whole_face(network, texture, mesh, pose, refine_seconds=REFINE_SECONDS)
            seconds["network"].append(between - began)
            seconds["refined"].append(time.perf_counter() - between)
            albedo = found.maps["diffuse_albedo"]
            turned.append(_off_deg(found.light, lights))
            blurred = infer_whole_face(network, texture, mesh, pose, shares=[0.0] * BANDS)
            guesses = {
                "refined": albedo,
                "network": alone.maps["diffuse_albedo"],
                "network, without the texture's detail": blurred.maps["diffuse_albedo"],
                "texture as albedo": texture,
                "mean person": enlarged(mean, rows, columns),
                "the person's true tone": np.broadcast_to(true[skin].mean(axis=0), true.shape),
            }
            for name, guess in guesses.items():
                errors[name, "raw"].append(squared(guess, true, skin))
                errors[name, "gain"].append(squared(gained(guess, true, skin), true, skin))
                if name in ("refined", "network"):
                    errors[name, kind].append(errors[name, "raw"][-1])
                details[name].append(detail(guess, true, skin))
            shine = folder.read_atlas("specular_albedo")[skin]
            specular.append(np.stack([found.maps["specular_albedo"][skin] - shine, shine]))
            error = np.abs(albedo - true).mean(axis=2)[skin]
            trust.append(np.stack([found.maps["confidence"][skin], error]))
    names = list(dict.fromkeys(name for name, _ in errors))
    table = [
        [
            name,
            f"{_db(errors[name, 'raw']):.2f}",
            f"{_db(errors[name, 'gain']):.2f}",
            f"{_correlation(details[name]):.2f}",
        ]
        for name in names
    ]
    by_light = ", ".join(
        f"{kind} {_db(errors['refined', kind]):.1f} ({_db(errors['network', kind]):.1f}) dB"
        for kind in LIGHTS
    )
    misses, shines = np.concatenate(specular, axis=1)
    deciles = _by_decile(*np.concatenate(trust, axis=1))
    record(
        title,
        ["diffuse albedo", "PSNR dB", "after the best gain a channel", "detail in patches"],
        table,
        f"Heads that were not trained on: {len(folders)}, under {len(LIGHTS)} lights at {rows} "
        f"rows; refined (network alone) by light: {by_light}. The strongest lamp is found to "
        f"{np.median(turned):.1f} degrees in the median, {np.percentile(turned, 90):.0f} at the "
        "90th percentile. "
        f"Specular albedo RMSE {np.sqrt((misses**2).mean()):.4f}, "
        f"{np.sqrt((misses**2).mean()) / shines.std():.2f} of the best constant's. Mean error by "
        f"decile of confidence, least first: {deciles}. Seconds a texture: network "
        f"{np.median(seconds['network']):.1f}, refined {np.median(seconds['refined']):.1f} (at "
        f"most {max(seconds['refined']):.1f}). "
        f"Network of {about.step} steps.",
    )


def _off_deg(found: LightSet | None, true: LightSet) -> float:
    """Angle at the origin between the strongest lamp that was found and the strongest there is."""
    if found is None or not len(found.rgb):
        return 180.0
    places = [s.position_mm[s.rgb.sum(axis=1).argmax()] for s in (found, true)]
    one, other = (place / np.linalg.norm(place) for place in places)
    return float(np.degrees(np.arccos(np.clip(one @ other, -1, 1))))


def _db(squares: list[float]) -> float:
    return -10 * float(np.log10(np.mean(squares)))


def _correlation(parts: list[tuple[float, float]]) -> float:
    product, norms = np.sum(parts, axis=0)
    return float(product / max(norms, 1e-12))


def _by_decile(confidence: np.ndarray, error: np.ndarray) -> str:
    order = np.argsort(confidence)
    return ", ".join(f"{part.mean():.4f}" for part in np.array_split(error[order], 10))


if __name__ == "__main__":
    main()
