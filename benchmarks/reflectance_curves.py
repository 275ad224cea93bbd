"""Errors of reflectance against what goes wrong: noise, sway, room light, lamps, place, gloss.

Run `python -m benchmarks.reflectance_curves` for all, written into RESULTS.md and
docs/reflectance_curves.png, or with `--curves noise,sway` for some, which are printed alone. One
light and one dark person, two views of 602 x 402, direct light. Photographs go through the stages
`decode`, `separate` and `refine` (with the true mesh, where the person was at the first shot), with
no record of what was done to the light.
"""

from __future__ import annotations

import argparse
import copy
import dataclasses
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.plots import Line, Panel, draw
from benchmarks.record import record, table
from benchmarks.reflectance_people import NOISE, benchmark_rig, noisy, person
from benchmarks.reflectance_scores import (
    TrueView,
    joined,
    read_maps,
    scores,
    true_view,
    view_samples,
)
from lightstage.commands import quiet
from lightstage.formats.config import make_config
from lightstage.formats.exr import read_exr, write_exr
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.session import Session, load_session
from processing.coarse_maps import write_as_views
from processing.decode.config import DecodeConfig, PrepareConfig
from processing.decode.stage import decode
from processing.refinement.config import RefineConfig
from processing.refinement.stage import refine
from processing.separation.config import SeparateConfig
from processing.separation.stage import separate
from sim.camera.flaws import CaptureFlaws, RoomConfig, SwayConfig
from sim.camera.sway import moved
from sim.light.lamps import LampConfig, lamps_of
from sim.light.world import World
from sim.people.subject import Subject
from sim.people.subjects import load_subject
from sim.session import SessionConfig, write_direct
from sim.truth import write_truth

SCALE = 0.1
VIEWS = 2
TEXTURE_ROWS = 1536
PEOPLE = ("tone3", "tone6")
PICTURE = Path(__file__).parents[1] / "docs" / "reflectance_curves.png"
PUBLISHED = {"method": "kampouris", "kampouris": {"combine": "weighted", "field": "lights"}}
METHODS = ("refine", "coarse", "kampouris")
REFINE = RefineConfig(
    bounce_rays=0, scattering=(0.0,), gloss_pixels=15_000, occlusion_directions=32
)
"""Direct light has no bounces and no scattering: they are not looked for."""
ERRORS = {
    "albedo_rmse": "diffuse albedo RMSE",
    "diffuse_normal_deg": "diffuse normal, mean deg",
    "specular_2mm_share": "specular over 2 mm, share of constant",
}


@dataclasses.dataclass(frozen=True)
class Setting:
    """One way in which photographs are taken."""

    noise: float = NOISE
    sway_mm: float = 0.0
    ambient: float = 0.0
    gain_spread: float = 0.0
    missing: int = 0
    off_centre_mm: float = 0.0
    roughness: float = 1.0


@dataclasses.dataclass(frozen=True)
class Curve:
    """A field of `Setting`, its words, and the values that are tried."""

    field: str
    title: str
    values: tuple[float, ...]


CURVES = (
    Curve("noise", "noise, share of sqrt(.25 + I)", (0.0003, 0.001, 0.003, 0.01)),
    Curve("sway_mm", "sway, mm (and a third of it in deg)", (0, 0.3, 1)),
    Curve("ambient", "room light, share of full", (0, 0.01, 0.05)),
    Curve("gain_spread", "unknown spread of lamps' gains", (0, 0.05, 0.15)),
    Curve("missing", "dead lamps of 168, unknown", (0, 4, 24)),
    Curve("off_centre_mm", "head above the centre, mm", (0, 30, 70)),
    Curve("roughness", "roughness against the person's own", (0.7, 1, 1.3)),
)

Errors = dict[tuple[str, Setting, str], dict[str, float]]
"""By person, setting and method."""


class Stage:
    """A person in the benchmark's stage; rays are cast anew only where the person changes."""

    def __init__(self, name: str, folder: Path) -> None:
        """Load the person; `folder` is where truth is kept."""
        self.known = person(name)
        rig = benchmark_rig(SCALE)
        self.rig = dataclasses.replace(rig, cameras=rig.cameras[:VIEWS])
        known = self.known
        self.subject = load_subject(known.name, known.seed, None, TEXTURE_ROWS, known.traits)
        self._folder = folder
        self._who: tuple[float, float] | None = None
        self._world: World | None = None
        self._true: dict[str, TrueView] = {}

    def world(self, setting: Setting) -> World:
        """The person where the setting has it, under the setting's lamps."""
        who = setting.off_centre_mm, setting.roughness
        if self._world is None or who != self._who:
            self._who, self._world = who, World(changed(self.subject, *who), self.rig)
            truth = ProcessedFolder(write_truth(self._world, self._folder / f"truth-{who}"))
            self._true = {camera.id: true_view(truth, camera) for camera in self.rig.cameras}
            self.base_mesh = truth.base_mesh
        world = copy.copy(self._world)
        config = LampConfig(gain_spread=setting.gain_spread)
        lamps = lamps_of(self.rig, config, self.known.seed)
        dead = np.random.default_rng(self.known.seed).permutation(len(lamps.weights))
        weights = lamps.weights.copy()
        weights[dead[: setting.missing]] = 0
        world.lamps = dataclasses.replace(lamps, weights=weights)
        return world

    def errors(self, out: Path) -> dict[str, float]:
        """Of the maps in a processed folder, against the truth of the last `world`."""
        folder = ProcessedFolder(out)
        return scores(
            joined([view_samples(read_maps(folder, name), t) for name, t in self._true.items()])
        )


def changed(subject: Subject, off_centre_mm: float, roughness: float) -> Subject:
    """The subject higher up, its roughness scaled."""
    shift = np.eye(4)[:3]
    shift[1, 3] = off_centre_mm
    rough = (subject.roughness * np.float32(roughness)).astype(np.float32)
    return moved(dataclasses.replace(subject, roughness=rough), shift)


def photographed(stage: Stage, setting: Setting, folder: Path) -> Session:
    """A session under a setting, pixel noise added."""
    world = stage.world(setting)
    sway = SwayConfig(sway_mm=setting.sway_mm, sway_deg=setting.sway_mm / 3)
    flaws = CaptureFlaws(room=RoomConfig(ambient=setting.ambient), sway=sway)
    root = folder / "session"
    write_direct(world, root, SessionConfig(), stage.known.seed, quiet, flaws)
    session = load_session(root)
    rng = np.random.default_rng(stage.known.seed)
    for frame in session.file.frames:
        path = session.frame_path(frame)
        write_exr(path, noisy(read_exr(path), rng, setting.noise), half=False)
    return session


def measured(stage: Stage, setting: Setting) -> Iterator[tuple[str, dict[str, float]]]:
    """Method and errors under a setting."""
    with tempfile.TemporaryDirectory() as name:
        session, out = photographed(stage, setting, Path(name)), Path(name) / "out"
        decode(session, out, DecodeConfig(prepare=PrepareConfig(forced=True)))
        published = {**PUBLISHED, "forced": True}
        separate(session, out, make_config(SeparateConfig, published, "benchmark"))
        write_as_views(out, session.camera_ids())
        yield "kampouris", stage.errors(out)
        separate(session, out, SeparateConfig(forced=True))
        write_as_views(out, session.camera_ids())
        yield "coarse", stage.errors(out)
        shutil.copy(stage.base_mesh, ProcessedFolder(out).base_mesh)
        refine(session, out, REFINE)
        yield "refine", stage.errors(out)


def settings_of(curve: Curve) -> list[Setting]:
    """The settings that a curve goes through."""
    kind = type(getattr(Setting(), curve.field))
    return [Setting(**{curve.field: kind(value)}) for value in curve.values]


def panels(curves: tuple[Curve, ...], errors: Errors) -> list[list[Panel]]:
    """A row of panels for each error, a column for each curve."""
    rows = []
    for key, title in ERRORS.items():
        row = []
        for curve in curves:
            lines = [
                Line(
                    f"{method}, {person(name).skin} skin",
                    list(curve.values),
                    [errors[name, setting, method][key] for setting in settings_of(curve)],
                    METHODS.index(method),
                    person(name).skin == "dark",
                )
                for method in METHODS
                for name in PEOPLE
            ]
            # The published formulas' specular errors are many times a constant's.
            row.append(Panel(title, curve.title, lines, curve.field == "noise", log_y=True))
        rows.append(row)
    return rows


def table_rows(curves: tuple[Curve, ...], errors: Errors) -> list[list[str]]:
    """Curve, value, method; errors of the light and the dark person."""
    return [
        [
            curve.title,
            f"{value:g}",
            method,
            *(
                " / ".join(f"{errors[name, setting, method][key]:.4g}" for name in PEOPLE)
                for key in ERRORS
            ),
        ]
        for curve in curves
        for value, setting in zip(curve.values, settings_of(curve), strict=True)
        for method in METHODS
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    fields = [curve.field for curve in CURVES]
    parser.add_argument("--curves", default=",".join(fields), help=", ".join(fields))
    parser.add_argument("--picture", type=Path, help="where to draw some curves")
    arguments = parser.parse_args()
    wanted = arguments.curves.split(",")
    if unknown := sorted({*wanted} - {*fields}):
        parser.error(f"{', '.join(unknown)}: expected {', '.join(fields)}")
    curves = tuple(curve for curve in CURVES if curve.field in wanted)
    errors: Errors = {}
    start = time.process_time()
    for name in PEOPLE:
        with tempfile.TemporaryDirectory() as folder:
            stage = Stage(name, Path(folder))
            settings = dict.fromkeys(s for curve in curves for s in settings_of(curve))
            # People of one place and gloss one after another: their rays are cast once.
            for setting in sorted(settings, key=lambda s: (s.off_centre_mm, s.roughness)):
                for method, found in measured(stage, setting):
                    errors[name, setting, method] = found
                seconds = time.process_time() - start
                print(f"  {seconds:.0f} s of processor time: {name} {setting}", flush=True)
    header = ("curve", "value", "method", *(f"{title}, light / dark" for title in ERRORS.values()))
    rows = table_rows(curves, errors)
    whole = curves == CURVES
    if whole or arguments.picture:
        draw(panels(curves, errors), arguments.picture or PICTURE)
    if whole:
        note = "People tone3 and tone6, two views of 602 x 402; docs/reflectance_curves.png."
        record("Reflectance: curves", header, rows, note)
    else:
        print(table(header, rows))


if __name__ == "__main__":
    main()
