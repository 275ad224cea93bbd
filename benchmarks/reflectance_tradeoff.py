"""Run time against error of every method of reflectance and some of their settings.

Run `python -m benchmarks.reflectance_tradeoff`; it writes a picture for the documentation. With
people's names behind it only those are measured, printed and not recorded. Seconds are
processor seconds for a megapixel of face; errors are those of one light and one dark person at 1.5
megapixels under direct light with the benchmarks' noise, all visible skin up to 70 degrees.
"""

from __future__ import annotations

import dataclasses
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.record import RESULTS, record, table
from benchmarks.reflectance_people import CAMERAS, Known, noisy, person, session
from benchmarks.scatter import Panel, draw
from lightstage.formats.exr import read_exr
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.session import Session, load_session
from processing.frames.read import Frames, read_frames, write_foreground, write_frames
from processing.lighting.lights import pattern_lights
from processing.masks import foreground
from processing.refinement.config import RefineConfig
from processing.refinement.stage import refine
from processing.separation.config import KampourisConfig, RatiosConfig, SeparateConfig
from processing.separation.view import separate_view

WHO = ("tone3", "tone6")
PICTURE = RESULTS.parents[1] / "docs" / "reflectance_tradeoff.png"
STEEPEST_DEG = 70.0
MAPS = ("diffuse_normal", "diffuse_albedo", "specular_albedo")

Maps = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Normal, diffuse and specular albedo of a mask's pixels."""


@dataclasses.dataclass(frozen=True)
class Case:
    """A person's session, its decoded frames and masks in a processed folder, and the truth."""

    opened: Session
    out: Path
    masks: dict[str, np.ndarray]
    truth: ProcessedFolder


def prepared(known: Known, out: Path) -> Case:
    """Noisy frames of all cameras as `decode` would leave them."""
    opened = load_session(session(known))
    rng = np.random.default_rng(known.seed)
    masks = {}
    for camera in CAMERAS:
        frames = [opened.frame(name, camera) for name in opened.file.sequence]
        images = noisy(np.stack([read_exr(opened.frame_path(frame)) for frame in frames]), rng)
        masks[camera] = foreground(images.max(axis=(0, 3)), 0.03)
        valid = np.ones(masks[camera].shape, bool)
        write_frames(out, camera, Frames.of(opened.file.sequence, images, valid))
        write_foreground(out, camera, masks[camera])
    truth = ProcessedFolder(session(known).with_name("session.truth"))
    return Case(opened, out, masks, truth)


def coarse(method: str, config: SeparateConfig) -> Callable[[Case], tuple[Maps, np.ndarray, float]]:
    """The frontal view's maps, their mask and the processor seconds."""

    def run(case: Case) -> tuple[Maps, np.ndarray, float]:
        camera = CAMERAS[0]
        frames, mask = read_frames(case.out, camera), case.masks[camera]
        lights = pattern_lights(case.opened, frames.patterns)
        args = (method, frames, mask, case.opened.rig.camera(camera), lights, config)
        separate_view(*args)
        start = time.process_time()
        maps = separate_view(*args)
        seconds = time.process_time() - start
        return (maps.diffuse_normal, maps.albedo, maps.specular), mask, seconds

    return run


def with_mesh(case: Case) -> tuple[Maps, np.ndarray, float]:
    """The stage `refine` with the true mesh: a view's share of all three's seconds."""
    out = case.out
    shutil.copy(case.truth.base_mesh, ProcessedFolder(out).base_mesh)
    start = time.process_time()
    refine(case.opened, out, RefineConfig())
    seconds = (time.process_time() - start) / len(CAMERAS)
    folder = ProcessedFolder(out)
    mask = folder.read_mask(CAMERAS[0])
    normal, albedo, specular = (folder.read_view(CAMERAS[0], name)[mask] for name in MAPS)
    return (normal, albedo, specular), mask, seconds


def errors(case: Case, maps: Maps, mask: np.ndarray) -> tuple[float, float, float]:
    """Mean normal error in deg, albedo RMSE, specular RMSE as a share of the best constant's."""
    camera = case.opened.rig.camera(CAMERAS[0])
    views = -camera.pixel_rays()[1][mask]
    known = [case.truth.read_view(CAMERAS[0], name)[mask] for name in MAPS]
    facing = np.einsum("nk,nk->n", known[0], views)
    scored = case.truth.read_mask(CAMERAS[0])[mask] & (facing > np.cos(np.radians(STEEPEST_DEG)))
    cosine = np.einsum("nk,nk->n", maps[0], known[0])[scored]
    angle = np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean()
    albedo = np.sqrt(((maps[1] - known[1])[scored] ** 2).mean())
    left = np.sqrt(((maps[2] - known[2])[scored] ** 2).mean()) / known[2][scored].std()
    return float(angle), float(albedo), float(left)


def settings() -> dict[str, Callable[[Case], tuple[Maps, np.ndarray, float]]]:
    """What is compared, by name."""
    base = SeparateConfig()
    weighted = KampourisConfig(combine="weighted", field="lights")
    return {
        "colour": coarse("colour", base),
        "colour, 1 solve": coarse("colour", SeparateConfig(iterations=1)),
        "colour, 3 solves": coarse("colour", SeparateConfig(iterations=3)),
        "colour, prior 10": coarse("colour", SeparateConfig(specular_prior_share=10.0)),
        "colour, m .3": coarse("colour", SeparateConfig(roughness=0.3)),
        "colour, red normals": coarse("colour", SeparateConfig(normals="red")),
        "colour, blue normals": coarse("colour", SeparateConfig(normals="blue")),
        "linear (arrays)": coarse("linear", base),
        "kampouris, printed": coarse("kampouris", base),
        "kampouris, weighted, lights": coarse("kampouris", SeparateConfig(kampouris=weighted)),
        "ratios, printed": coarse("ratios", base),
        "ratios, lights": coarse("ratios", SeparateConfig(ratios=RatiosConfig(field="lights"))),
        "refine, true mesh": with_mesh,
    }


def main() -> None:
    """Run all on both people, or on those named; write the table and the picture, or print."""
    who = tuple(sys.argv[1:]) or WHO
    found: dict[str, list[tuple[float, ...]]] = {}
    for name in who:
        with tempfile.TemporaryDirectory() as folder:
            case = prepared(person(name), Path(folder))
            for setting, call in settings().items():
                maps, mask, seconds = call(case)
                megapixels = mask.sum() / 1e6
                row = (seconds / megapixels, *errors(case, maps, mask))
                found.setdefault(setting, []).append(row)
                print(name, setting, " ".join(f"{value:.3f}" for value in row), flush=True)
    titles = ("normal, mean deg", "diffuse albedo RMSE", "specular, share of constant")
    labels = [person(name).skin if who == WHO else name for name in who]
    heads = ["method", "processor s a megapixel of face", "seconds, ratio to the first"]
    heads += [f"{label}: {title}" for label in labels for title in titles]
    heads.append("errors, mean ratio to the first")
    first = np.array(next(iter(found.values())))
    rows = []
    for setting, values in found.items():
        ratio = np.array(values) / first
        cells = [f"{value:.3f}" for row in values for value in row[1:]]
        seconds = float(np.mean([row[0] for row in values]))
        times = f"{ratio[:, 0].mean():.1f}"
        rows.append([setting, f"{seconds:.2f}", times, *cells, f"{ratio[:, 1:].mean():.2f}"])
    if who != WHO:
        print(table(heads, rows))
        return
    panels = [
        Panel(
            f"{person(name).skin} skin: {title}",
            [(values[k][0], values[k][1 + column]) for values in found.values()],
        )
        for k, name in enumerate(who)
        for column, title in enumerate(titles)
    ]
    draw(panels, list(found), "processor s a megapixel of face", PICTURE, columns=len(titles))
    record(
        "Reflectance: run time against error",
        heads,
        rows,
        f"{' and '.join(WHO)}, frontal view of 1004 x 1504, direct light, pixel noise .001 "
        f"sqrt(.25 + I); drawn in docs/{PICTURE.name}. `refine` is a third of the stage on three "
        "views.",
    )


if __name__ == "__main__":
    main()
