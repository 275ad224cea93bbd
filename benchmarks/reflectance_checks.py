"""The gain by the checks of motion, room light and flicker: errors of maps with and without.

Run `python -m benchmarks.reflectance_checks`. One person, two views of 602 x 402, direct light,
noise as in the other benchmarks; photographs go through `decode`, `separate` and `refine` (with the
true mesh, where the person was at the first shot). Nothing shows what was done to the light.
"""

from __future__ import annotations

import argparse
import dataclasses
import shutil
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.record import record, table
from benchmarks.reflectance_curves import REFINE, Setting, Stage, photographed
from lightstage.formats.exr import read_exr, write_exr
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.session import Session
from processing.coarse_maps import write_as_views
from processing.decode.config import DecodeConfig, PrepareConfig
from processing.decode.stage import decode
from processing.refinement.stage import refine
from processing.separation.config import SeparateConfig
from processing.separation.stage import separate

OFF = PrepareConfig(forced=True, still_px=1e9, least_flicker=1e9, least_ambient=1e9)
ON = PrepareConfig(forced=True)
HEADER = (
    "what was done",
    "found: displacement px, room light %, flicker",
    "albedo RMSE, coarse: without, with",
    "normal deg, coarse: without, with",
    "albedo RMSE, refined: without, with",
    "normal deg, refined: without, with",
)


@dataclasses.dataclass(frozen=True)
class Trouble:
    """One way in which a session goes wrong."""

    title: str
    setting: Setting = dataclasses.field(default_factory=Setting)
    flicker: float = 1.0


TROUBLES = (
    Trouble("nothing"),
    Trouble("sway .3 mm, .1 deg", Setting(sway_mm=0.3)),
    Trouble("sway 1 mm, .33 deg", Setting(sway_mm=1.0)),
    Trouble("sway 3 mm, 1 deg", Setting(sway_mm=3.0)),
    Trouble("room light 1 % of full", Setting(ambient=0.01)),
    Trouble("room light 5 % of full", Setting(ambient=0.05)),
    Trouble("y+ 3 % brighter", flicker=1.03),
    Trouble("y+ 10 % brighter", flicker=1.10),
)


def flickered(session: Session, factor: float) -> None:
    """One photograph of every camera brighter, in place; only `decode` reads it after this."""
    for frame in session.file.frames:
        if frame.pattern == "y+" and factor != 1:
            path = session.frame_path(frame)
            write_exr(path, read_exr(path) * np.float32(factor), half=False)


def errors(
    stage: Stage, session: Session, out: Path, config: PrepareConfig
) -> tuple[str, list[dict[str, float]]]:
    """What was found, and errors of the coarse and the refined maps."""
    facts = decode(session, out, DecodeConfig(prepare=config))["sums"]
    separate(session, out, SeparateConfig(forced=True))
    write_as_views(out, session.camera_ids())
    coarse = stage.errors(out)
    shutil.copy(stage.base_mesh, ProcessedFolder(out).base_mesh)
    refine(session, out, REFINE)
    moved = max(max(own["displaced_px"].values(), default=0.0) for own in facts.values())
    room = 100 * float(np.mean([np.mean(own["ambient"]) for own in facts.values()]))
    gains = sorted({name for own in facts.values() for name in own["flicker"]})
    mean = {
        name: np.mean([own["flicker"].get(name, 1.0) for own in facts.values()]) for name in gains
    }
    flicker = ", ".join(f"{name} {gain:.3f}" for name, gain in mean.items()) or "none"
    return f"{moved:.2f}, {room:.2f}, {flicker}", [coarse, stage.errors(out)]


def row(stage: Stage, trouble: Trouble) -> list[str]:
    """One trouble's cells."""
    with tempfile.TemporaryDirectory() as name:
        session = photographed(stage, trouble.setting, Path(name))
        flickered(session, trouble.flicker)
        _, without = errors(stage, session, Path(name) / "off", OFF)
        found, mended = errors(stage, session, Path(name) / "on", ON)
    cells = [trouble.title, found]
    for maps in range(2):
        for key, digits in (("albedo_rmse", 4), ("diffuse_normal_deg", 2)):
            pair = without[maps][key], mended[maps][key]
            cells.append(", ".join(f"{value:.{digits}f}" for value in pair))
    return cells


def main() -> None:
    """All troubles, or the first few."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--person", default="tone3")
    parser.add_argument("--only", default="", help="words of the troubles to run, printed alone")
    arguments = parser.parse_args()
    chosen = [trouble for trouble in TROUBLES if arguments.only in trouble.title]
    with tempfile.TemporaryDirectory() as name:
        stage = Stage(arguments.person, Path(name))
        rows = [row(stage, trouble) for trouble in chosen]
    if len(chosen) < len(TROUBLES):
        print(table(HEADER, rows))
        return
    note = f"Errors of all visible skin of {arguments.person}, decoded with and without the checks."
    record("Checks of motion and light", HEADER, rows, note)


if __name__ == "__main__":
    main()
