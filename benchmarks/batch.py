"""Many sessions: batch on two workers against `run` in a row, workers killed; a store, its readers.

    python -m benchmarks.batch [run] [batch] [kills] [store] [readers]

All of it takes about eight minutes on two cores that do nothing else. Parts keep their figures, so
that they can be called one after the other, `run` before `kills`. As soon as all are there, the
tables are recorded, or printed alone where other sizes than the default were asked for: `--sessions
4 --kills 3 --scans 100 --seconds 1` takes a few minutes. The sessions are one simulated session
under as many ids.
"""

from __future__ import annotations

import argparse
import dataclasses
import heapq
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.batch_readers import READ_COLUMNS, READ_ROWS, READERS, SIDE, patches_a_second
from benchmarks.folders import differences, holder
from benchmarks.record import record, table
from benchmarks.reflectance_people import folder as kept_folder
from lightstage.counting import counted
from lightstage.formats.files import read_json, write_json
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.template import default_template_path
from lightstage.rig import default_rig, save_rig
from processing.batch import work
from processing.batch.needs import SECONDS
from processing.dataset import (
    add_scan,
    build_store,
    open_store,
    verify_store,
)
from processing.pipeline_config import PipelineConfig
from processing.records import RUN_LOCK, code_version, hash_template

UNTIL = "separate"
CAMERAS = ("cam0", "cam1", "cam2")
ROWS_PX = 240
SCANS = 1400
"""Sessions of the year."""
PARTS = ("run", "batch", "kills", "store", "readers")


@dataclasses.dataclass(frozen=True)
class Sizes:
    """How large the benchmark is.

    Attributes:
        sessions: of the batch.
        kills: workers that are killed.
        scans: of the store.
        seconds: that readers read.
    """

    sessions: int = 20
    kills: int = 10
    scans: int = SCANS
    seconds: float = 10.0


MACHINES = (1, 8, 64)
WORKERS = 2
"""Of a machine of 24 GiB and two cores, at 24 megapixels."""
PROCESSOR_TO_WALL = 759 / 531
"""Of RESULTS.md's session of nine views of 24 megapixels on two cores: with one core a worker, a
stage takes its processor seconds."""
VIEWS, RAW_GB, FRAMES_GB, COARSE_GB, MAPS_GB = 9, 0.34, 0.59, 0.22, 0.30
"""A view's photographs, decoded frames, coarse maps and exact maps."""
DISK_GB: dict[str, float] = {
    "decode": VIEWS * (2 * RAW_GB + FRAMES_GB),
    "separate": VIEWS * (FRAMES_GB + COARSE_GB),
    "reconstruct": VIEWS * FRAMES_GB,
    "refine": VIEWS * (FRAMES_GB + COARSE_GB + MAPS_GB),
    "register": 0.2,
    "atlas": VIEWS * MAPS_GB + 0.6,
}
"""What a stage reads and writes; photographs are read twice, for their hashes and decoded."""
DISKS_GB_S = (1.0, 5.0)


def program(package: str, *words: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", package, *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def make_sessions(at: Path, count: int) -> list[Path]:
    """One simulated session of three small views, under several ids."""
    first = at / "sessions" / "s0"
    if not first.exists():
        rig = default_rig().scaled(ROWS_PX / 6016)
        cameras = tuple(c for c in rig.cameras if c.id in CAMERAS)
        rig = dataclasses.replace(rig, lights=rig.lights[::8], cameras=cameras)
        words = ["session", "--subject", "P0", "--direct", "--rows", 192, "--scale", 1.0]
        path = save_rig(rig, at / "rig.json")
        made = program("sim", *words, "--rig", path, "--out", first)
        assert made.returncode == 0, made.stderr
    sessions = [first]
    for index in range(1, count):
        copy = first.with_name(f"s{index}")
        if not copy.exists():
            shutil.copytree(first, copy)
            value = read_json(copy / "session.json")
            write_json(copy / "session.json", {**value, "id": f"s{index}", "subject": f"P{index}"})
        sessions.append(copy)
    return sessions


def id_of(session: Path) -> str:
    return str(read_json(session / "session.json")["id"])


def part_run(at: Path, sizes: Sizes) -> dict[str, Any]:
    """As many calls of `run` in a row."""
    out = at / "run"
    shutil.rmtree(out, ignore_errors=True)
    sessions = make_sessions(at, sizes.sessions)
    began, spent = time.perf_counter(), processor_s()
    for session in sessions:
        words = ("run", session, "--out", out / id_of(session), "--until", UNTIL)
        done = program("processing", *words)
        assert done.returncode == 0, done.stderr
    return {
        "sessions": sizes.sessions,
        "run_s": time.perf_counter() - began,
        "run_cpu_s": processor_s() - spent,
    }


def processor_s() -> float:
    """Processor seconds of all processes that this one started and that ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def batch(at: Path, out: Path, sizes: Sizes) -> tuple[float, dict[str, Any]]:
    words = (
        "batch",
        *make_sessions(at, sizes.sessions),
        "--out",
        out,
        "--until",
        UNTIL,
        "--workers",
        2,
        "--json",
    )
    began = time.perf_counter()
    done = program("processing", *words)
    seconds = time.perf_counter() - began
    assert done.returncode == 0, done.stderr
    return seconds, dict(json.loads(done.stdout.splitlines()[-1]))


def part_batch(at: Path, sizes: Sizes) -> dict[str, Any]:
    """The batch, the batch again with nothing to do, and a session that is up to date."""
    out = at / "batch"
    shutil.rmtree(out, ignore_errors=True)
    spent = processor_s()
    first, facts = batch(at, out, sizes)
    spent = processor_s() - spent
    again, nothing = batch(at, out, sizes)
    template = default_template_path()
    looks = []
    for _ in range(5):
        for session in make_sessions(at, sizes.sessions):
            order = work.Order(
                "b",
                str(session),
                str(out / id_of(session)),
                str(template),
                PipelineConfig(),
                UNTIL,
                2,
                code_version(),
                hash_template(template),
            )
            began = time.perf_counter()
            assert work.look(order).left == ()
            looks.append(time.perf_counter() - began)
    return {
        "batch_s": first,
        "batch_cpu_s": spent,
        "stages": facts["stages_run"],
        "again_s": again,
        "again_stages": nothing["stages_run"],
        "look_s": float(np.median(looks)),
    }


def part_kills(at: Path, sizes: Sizes) -> dict[str, Any]:
    """The batch while whoever works on a session drawn at random is killed again and again."""
    out = at / "kills"
    shutil.rmtree(out, ignore_errors=True)
    locks = [out / id_of(session) / RUN_LOCK for session in make_sessions(at, sizes.sessions)]
    ended = threading.Event()
    killed: list[int] = []

    def kill() -> None:
        rng = random.Random(0)
        struck: set[Path] = set()
        while len(killed) < sizes.kills and not ended.wait(rng.uniform(1, 6)):
            # A session twice at most: its third try must be let through.
            held = [(lock, pid) for lock in locks if (pid := holder(lock)) and lock not in struck]
            if held:
                lock, pid = rng.choice(held)
                struck.add(lock)
                os.kill(pid, signal.SIGKILL)
                killed.append(pid)

    thread = threading.Thread(target=kill, daemon=True)
    thread.start()
    seconds, facts = batch(at, out, sizes)
    ended.set()
    different = [
        f"{name}/{each}"
        for name in map(id_of, make_sessions(at, sizes.sessions))
        for each in differences(out / name, at / "run" / name)
    ]
    print("\n".join(different))
    return {
        "kills_s": seconds,
        "kills": len(killed),
        "lost": facts["sessions"] - facts["done"],
        "different": len(different),
    }


def part_store(at: Path, sizes: Sizes) -> dict[str, Any]:
    """A store of 1,400 small scans: opened, added to, verified."""
    shutil.rmtree(at / "store", ignore_errors=True)
    shutil.rmtree(at / "people", ignore_errors=True)
    folder = ProcessedFolder(at / "people" / "first")
    rng = np.random.default_rng(0)
    for name in ("diffuse_albedo", "diffuse_normal", "specular_normal", "position"):
        folder.write_atlas(name, rng.random((48, 32, 3)))
    for name in ("specular_albedo", "confidence", "skin"):
        folder.write_atlas(name, rng.random((48, 32)) + 0.5)
    write_json(folder.head_pose, {"head_from_world": np.eye(3, 4).tolist()})
    people = []
    for index in range(sizes.scans + 1):
        person = at / "people" / f"{index:04d}"
        person.mkdir()
        (person / "atlas").symlink_to(folder.root / "atlas")
        (person / folder.head_pose.name).symlink_to(folder.head_pose)
        report = {"subject": f"P{index // 7:04d}", "expression": f"e{index % 7}", "consent": "C-1"}
        write_json(person / "report.json", report)
        people.append(person)
    began = time.perf_counter()
    store = build_store(people[:-1], at / "store")
    build_s = time.perf_counter() - began
    began = time.perf_counter()
    opened = open_store(store)
    open_s = time.perf_counter() - began
    began = time.perf_counter()
    add_scan(store, people[-1])
    add_s = time.perf_counter() - began
    began = time.perf_counter()
    files, left = verify_store(store)
    return {
        "build_s": build_s,
        "open_s": open_s,
        "add_s": add_s,
        "verify_s": time.perf_counter() - began,
        "files": files,
        "left": len(left),
        "scans": len(opened.scans),
        "list_mb": (store / "dataset.json").stat().st_size / 1e6,
    }


def part_readers(at: Path, sizes: Sizes) -> dict[str, Any]:
    """Patches a second from the store, from tars and from whole EXR files, by so many readers."""
    return {"patches_a_second": patches_a_second(at / "readers", sizes.seconds)}


def simulate(machines: int, disk_gb_s: float, sessions: int = SCANS) -> float:
    """Hours until all sessions are done: stages compute on their own core, then share one disk.

    The disk gives each of n stages that use it the n-th part of its rate.
    """
    stages = [(PROCESSOR_TO_WALL * SECONDS[s][1], DISK_GB[s]) for s in SECONDS]
    waiting = sessions
    now, served = 0.0, 0.0  # `served`: GB that each stage at the disk has had since the beginning
    computing: list[tuple[float, int]] = []
    at_disk: list[tuple[float, int]] = []
    for _ in range(min(machines * WORKERS, sessions)):
        heapq.heappush(computing, (stages[0][0], 0))
        waiting -= 1
    while computing or at_disk:
        rate = disk_gb_s / max(1, len(at_disk))
        disk_at = now + (at_disk[0][0] - served) / rate if at_disk else float("inf")
        if computing and computing[0][0] <= disk_at:
            then, stage = heapq.heappop(computing)
            served += (then - now) * rate if at_disk else 0.0
            now = then
            heapq.heappush(at_disk, (served + stages[stage][1], stage))
            continue
        served, stage = heapq.heappop(at_disk)
        now = disk_at
        if stage + 1 < len(stages):
            heapq.heappush(computing, (now + stages[stage + 1][0], stage + 1))
        elif waiting:
            waiting -= 1
            heapq.heappush(computing, (now + stages[0][0], 0))
    return now / 3600


def printed(title: str, header: Sequence[str], rows: Sequence[Sequence[object]], note: str) -> None:
    """A table that is not recorded, since its sizes are not the default ones."""
    print(f"## {title}\n\n{note}\n\n{table(header, rows)}\n")


def tables(f: dict[str, Any], show: Callable[..., None]) -> None:
    """Show what was measured."""
    share = f["batch_s"] / f["run_s"]
    show(
        "Batch: many sessions on two workers",
        ("what", "measured", "target"),
        [
            (
                f"{f['sessions']} calls of `run` in a row",
                f"{f['run_s']:.0f} s, {f['run_cpu_s']:.0f} s of processor",
                "",
            ),
            (
                "batch on two workers",
                f"{f['batch_s']:.0f} s, {share:.2f} of it; {f['batch_cpu_s']:.0f} s of processor",
                ".60",
            ),
            (
                f"batch, {f['kills']} workers killed at random",
                f"{f['kills_s']:.0f} s, {f['lost']} lost, {f['different']} files different",
                "0 lost, 0 different",
            ),
            (
                "batch again, nothing to do",
                f"{f['again_s']:.1f} s, {f['again_stages']} stages run",
                "0 stages",
            ),
            ("a session that is up to date", f"{f['look_s']:.3f} s", ".2 s"),
        ],
        f"{f['sessions']} sessions of three views of 160 x {ROWS_PX}, `--until {UNTIL}`; one "
        "simulated session under as many ids. Load average at the end "
        f"{os.getloadavg()[0]:.1f}.",
    )
    show(
        f"Store: {f['scans']:,} small scans",
        ("what", "measured", "target"),
        [
            (f"build, {f['scans']} scans of 48 x 32", f"{f['build_s']:.0f} s", ""),
            (f"open ({f['list_mb']:.1f} MB of dataset.json)", f"{f['open_s']:.3f} s", "1 s"),
            ("add one", f"{f['add_s']:.2f} s", ""),
            (f"verify, {f['files']} files", f"{f['verify_s']:.1f} s", ""),
        ],
        "`open` reads the list alone; `add` writes its own scan and the list.",
    )
    rows = [
        (machines, f"{disk:g}", f"{hours:.1f}", f"{hours / 24:.1f}")
        for machines in MACHINES
        for disk in DISKS_GB_S
        for hours in [simulate(machines, disk)]
    ]
    show(
        "Batch: 1,400 sessions of 24 megapixels, simulated",
        ("machines of 2 cores and 24 GiB", "disk that they share, GB/s", "hours", "days"),
        rows,
        "Two workers a machine; a stage's processor seconds are those of the session of nine views "
        f"below, its share of {sum(DISK_GB.values()):.0f} GB a session goes through one disk that "
        "all share.",
    )
    show(
        "Patches a second",
        ("from", *(counted(count, "reader") for count in READERS)),
        [
            (form, *(f"{rate:.1f}" for rate in own.values()))
            for form, own in f["patches_a_second"].items()
        ],
        f"Patches of {SIDE} texels of two scans of {READ_ROWS} x {READ_COLUMNS}, five maps each, "
        "from the system's cache of files. Store: random places. Tars: in their order, by the "
        "standard library. EXR files: a random place, cut from five whole files.",
    )


def measure(name: str, sizes: Sizes) -> None:
    """Measure one of `PARTS`, and keep its figures beside those of the same code."""
    path = _figures(sizes)
    path.parent.mkdir(parents=True, exist_ok=True)
    known: dict[str, Any] = read_json(path) if path.exists() else {}
    if known.get("code") != code_version():
        # What older code wrote differs from what this writes, whoever is killed.
        known = {"code": code_version()}
    known[name] = globals()[f"part_{name}"](path.parent, sizes)
    print(name, known[name], flush=True)
    write_json(path, known)


def _figures(sizes: Sizes) -> Path:
    return kept_folder() / ("batch" if sizes == Sizes() else "batch-small") / "figures.json"


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("parts", nargs="*", help=f"of {', '.join(PARTS)}; all where none is named")
    for field in dataclasses.fields(Sizes):
        parser.add_argument("--" + field.name, type=type(field.default), default=field.default)
    arguments = parser.parse_args()
    sizes = Sizes(
        **{field.name: getattr(arguments, field.name) for field in dataclasses.fields(Sizes)}
    )
    for name in arguments.parts or PARTS:
        # Each in a process of its own: numba keeps the number of threads that it began with, and
        # a batch's workers have another.
        code = f"from benchmarks.batch import Sizes, measure; measure({name!r}, {sizes!r})"
        subprocess.run([sys.executable, "-c", code], check=True)
    known = read_json(_figures(sizes))
    if known.keys() >= set(PARTS):
        tables(
            {key: value for part in PARTS for key, value in known[part].items()},
            record if sizes == Sizes() else printed,
        )


if __name__ == "__main__":
    main()
