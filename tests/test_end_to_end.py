"""The demo's commands on a tiny rig, from lighting the stage to the report, judged by truth."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from demo.measure import Measured, run_measured, tree_rss_kb
from demo.run import run
from demo.steps import ABOUT, Layout
from demo.tiny import CAMERAS, tiny_config
from lightstage.formats.exr import read_exr
from lightstage.formats.files import read_json
from lightstage.formats.mesh import read_obj
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.session import load_session
from lightstage.formats.template import default_template_path, load_template
from tests.documents import PACKAGES, ROOT, commands, options, run_as_written
from tests.programs import run_program
from tests.waiting import until

DONE_BY_THE_DEMO = ("lightstage-sim session", "lightstage-sim dataset", "lightstage-processing run")
DONE_BY_THE_DEMO += ("lightstage-processing evaluate", "lightstage-learning ")
"""Commands that take long: the demo has run them with the same options, and sizes besides."""
JAW = 17
"""iBUG's first landmarks are the jaw's."""
PATTERNS = ("full", "x+", "x-", "y+", "y-", "z+", "z-")


def in_this_process(command: Sequence[str]) -> Measured:
    """Stands for run_measured: the three large programs need not import their modules again.

    All others stay processes, as `make demo` has all steps; of the simulator's the session, whose
    devices write to the terminal.
    """
    program, *words = command[2:]
    if program not in ("sim", "processing", "learning") or words[0] == "session":
        return run_measured(command)
    begun = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("default")  # as in a process of its own, a warning is no error
        ended = run_program(program, *words)
    print(ended.out, ended.err)  # what pytest shows where the test fails
    seconds = time.perf_counter() - begun
    return Measured(ended.code, seconds, tree_rss_kb(os.getpid()) / 1024)


def test_the_demo_runs_end_to_end_on_a_tiny_rig(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("demo.run.run_measured", in_this_process)
    at = Layout(tmp_path / "demo")
    config = tiny_config()
    assert run(config, at.root) == 0
    session_is_whole(at)
    maps_are_near_the_truth(at)
    published_patches_are_there(at)
    report_shows_everything(at)
    nothing_is_half_written(at.root)
    a_second_run_skips_what_is_done(at)
    an_interrupt_leaves_whole_files(at, tmp_path / "interrupted")
    the_readmes_commands_run_as_written(at, tmp_path / "readme")


def session_is_whole(at: Layout) -> None:
    session = load_session(at.session)
    assert tuple(session.file.sequence) == PATTERNS
    assert {(f.pattern, f.camera) for f in session.file.frames} == {
        (p, c) for p in PATTERNS for c in CAMERAS
    }
    assert {f.encoding for f in session.file.frames} == {"raw"}
    assert (at.session / "journal.jsonl").stat().st_size > 0


def maps_are_near_the_truth(at: Layout) -> None:
    """Bounds a third beyond what so few pixels give."""
    found = ProcessedFolder(at.processed)
    for camera in CAMERAS:
        for name in ("diffuse_albedo", "specular_albedo", "diffuse_normal", "specular_normal"):
            assert np.isfinite(found.read_view(camera, name)).all()
    facts = read_json(at.processed / "evaluation.json")
    views = facts["views"]
    assert views["coverage_share"] > 0.85
    assert views["diffuse_albedo_rmse"] < 0.028
    assert views["diffuse_normal_median_deg"] < 1.65
    assert read_json(at.coarse / "evaluation.json")["views"]["diffuse_normal_median_deg"] < 3.8
    assert facts["base_mesh"]["skin_median_mm"] < 0.145
    assert facts["registered_mesh"]["skin_median_mm"] < 0.155
    # Six landmarks of the jaw beside the ears, where skin has no clear point and this texture has
    # texels of 1.5 mm, are up to 16 mm off each; brows, eyes, nose and mouth are not.
    assert facts["registered_mesh"]["landmark_mean_mm"] < 2.5
    marks = load_template(default_template_path()).landmarks[JAW:]
    true = read_obj(at.truth / "registered_mesh.obj").vertices[marks]
    apart = np.linalg.norm(read_obj(found.registered_mesh).vertices[marks] - true, axis=1)
    assert apart.mean() < 0.75
    assert apart.max() < 2.6
    assert facts["atlas"]["coverage_share"] > 0.8
    assert facts["atlas"]["diffuse_albedo_srgb_psnr_db"] > 36
    assert found.read_atlas("diffuse_albedo").shape == (384, 256, 3)


def published_patches_are_there(at: Layout) -> None:
    facts = read_json(at.published / "dataset.json")
    assert facts["counts"]["subjects"] == 2
    # There are about 20: a quarter of those that fit is left out by chance.
    assert 14 <= facts["counts"]["patches"] <= 26
    for name in facts["channels"]:
        shape = read_json(at.published / name / "zarr.json")["shape"]
        assert shape[0] == facts["counts"]["patches"]
    assert "person-" not in (at.published / "dataset.json").read_text()


def report_shows_everything(at: Layout) -> None:
    page = at.report.read_text()
    # One of the whole way, 3 of the stage, 6 of views, 2 of the shape, 4 of the atlas, 2 of the
    # data set, 1 of learning, 3 of other light.
    assert page.count("<figure>") == 22
    assert "<script" not in page
    figures = read_json(at.root / "figures.json")
    names = [step["name"] for step in figures["steps"]]
    for name in ("session", "check", "processing", "train", "infer"):
        assert name in names
    assert all(s["seconds"] > 0 and s["peak_mb"] > 10 for s in figures["steps"])
    assert all(np.isfinite(row["value"]) for row in figures["errors"])
    # As it is seen: under the rim light a few pixels that graze the crown are many times white, and
    # decide a linear error, which was .24 on one machine and below .185 on others.
    psnr_db = {name: errors["srgb_psnr_db"] for name, errors in figures["relit"].items()}
    bounds_db = {"key": 34.0, "split": 33.0, "rim": 29.0}
    assert {name: found > bounds_db[name] for name, found in psnr_db.items()} == dict.fromkeys(
        bounds_db, True
    )
    assert (at.root / "readme.jpg").stat().st_size < 300_000
    assert read_exr(at.inferred / "diffuse_albedo.exr", finite=True).shape == (384, 256, 3)


def nothing_is_half_written(root: Path) -> None:
    left = [p for p in root.rglob("*") if p.name.startswith(".") or p.suffix in (".tmp", ".part")]
    assert left == []


def process(at: Layout, out: Path) -> list[str]:
    """What follows the program's name."""
    return ["run", str(at.session), "--out", str(out), "--atlas-rows", "384", "--json"]


def a_second_run_skips_what_is_done(at: Layout) -> None:
    before = (at.processed / "base_mesh.ply").stat().st_mtime_ns
    done = run_program("processing", *process(at, at.processed))
    assert done.code == 0, done.err
    facts: dict[str, Any] = json.loads(done.out.splitlines()[-1])
    assert facts["ran"] == []
    assert (at.processed / "base_mesh.ply").stat().st_mtime_ns == before


def is_done(out: Path, stage: str) -> bool:
    path = out / "stages.json"
    return path.exists() and stage in read_json(path)["stages"]


def an_interrupt_leaves_whole_files(at: Layout, out: Path) -> None:
    command = [sys.executable, "-m", "processing", *process(at, out)]
    running = subprocess.Popen(command, stderr=subprocess.DEVNULL, process_group=0)
    until(lambda: is_done(out, "decode"), 60)
    assert running.poll() is None
    os.killpg(running.pid, signal.SIGINT)
    assert running.wait(60) != 0
    nothing_is_half_written(out)
    for path in out.rglob("*.exr"):
        read_exr(path, finite=True)
    assert "atlas" not in read_json(out / "stages.json")["stages"]


def the_readmes_commands_run_as_written(at: Layout, folder: Path) -> None:
    """Those of the steps, on what the demo made; the slow ones are the demo's own steps."""
    text = (ROOT / "README.md").read_text().split("## What the demo does")[1].split("\nA lab")[0]
    folder.mkdir()
    named = {
        "S": at.session,
        "S.truth": at.truth,
        "OUT": at.processed,
        "P": at.people,
        "RUN": at.training,
        "ABOUT.toml": ABOUT,
    }
    for name, path in named.items():
        (folder / name).symlink_to(path)
    steps = [step["command"] for step in read_json(at.steps)["steps"]]
    written = commands(text)
    assert len(written) >= 9
    for command in written:
        if command.startswith(DONE_BY_THE_DEMO):
            program, name = command.split(" ")[:2]
            start = f"python -m {PACKAGES[program]} {name} "
            same = [s for s in steps if s.startswith(start) and options(command) <= options(s)]
            assert same, command
        else:
            done = run_as_written(command, folder)
            assert done.code == 0, f"{command}\n{done.err}"
