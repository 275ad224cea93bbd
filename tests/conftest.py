"""What all tests share: optional head data, a small disk, commands in this process, maps."""

from __future__ import annotations

import copy
import functools
import gc
import os
import signal
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import hypothesis
import numpy as np
import pytest

from lightstage.formats import template
from lightstage.formats.files import write_json
from lightstage.formats.mesh import Mesh
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.template import default_template_path
from lightstage.interrupts import handlers_kept, interrupted, raise_on_signals
from tests.forked import quickly
from tests.memory import MEMORY, TEMPORARY, has_room
from tests.programs import Ended, run_program
from tests.slow import slow_files

# How long an example takes says more about the machine's other work than about the code.
hypothesis.settings.register_profile("project", deadline=None)
hypothesis.settings.load_profile("project")


def pytest_configure() -> None:
    """Temporary files are in memory where it has room; signals do what they usually do.

    A shell's background jobs and nohup ignore signals, and so do all processes begun by them.
    """
    if TEMPORARY not in os.environ and has_room(MEMORY):
        os.environ[TEMPORARY] = str(MEMORY)
    usual = {signal.SIGINT: signal.default_int_handler, signal.SIGHUP: signal.SIG_DFL}
    for number, handler in usual.items():
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, handler)


def read_shipped_mesh_once(read: Callable[[Path], Mesh]) -> Callable[[Path], Mesh]:
    """`read_obj` for templates: hundreds of tests read the shipped one, for a fifth of a second."""
    shipped, once = default_template_path() / "mesh.obj", functools.cache(read)
    return lambda path: copy.deepcopy(once(path)) if path == shipped else read(path)


template.read_obj = read_shipped_mesh_once(template.read_obj)

LAST = ("tests/test_end_to_end.py", "tests/sim/", "tests/lightstage/test_")
"""What goes last, in this order."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Slow files are marked; the longest test goes before the simulator's, what is quick last.

    Most of what the longest one runs is compiled by then, and the other workers are left enough to
    do beside it. Workers take what is left from each other by halves: where that happens most
    often, at the end, no test is long and none shares what takes long to make with those beside it.
    """
    slow = slow_files()
    for item in items:
        if item.nodeid.partition("::")[0] in slow:
            item.add_marker(pytest.mark.slow)
    places = {start: place for place, start in enumerate(LAST, 1)}
    items.sort(key=lambda i: next((places[s] for s in LAST if i.nodeid.startswith(s)), 0))


def pytest_collection_finish() -> None:
    """What collection imported stays: the collector need not inspect it again and again.

    Numba allocates millions of objects where it compiles; by Python's own thresholds an eighth of
    that time went to searches for garbage among all modules.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 20, 20)


def head_data_path() -> Path | None:
    """The folder with scanned heads, from LIGHTSTAGE_DATA or beside the checkout."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    path = Path(os.environ.get("LIGHTSTAGE_DATA", beside))
    return path if (path / "lps_head").is_dir() else None


@pytest.fixture(scope="session")
def head_data() -> Path:
    """The folder with scanned heads; skips where it is absent."""
    path = head_data_path()
    if path is None:
        pytest.skip("no head data: set LIGHTSTAGE_DATA or put it at ../shared/data")
    return path


@pytest.fixture
def small_disk(tmp_path) -> Iterator[Path]:
    """An empty folder on a disk of 64 kB of its own."""
    folder = tmp_path / "disk"
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(folder)]
    try:
        mounted = subprocess.run(command, capture_output=True).returncode == 0
    except FileNotFoundError:
        mounted = False
    if not mounted:
        pytest.skip("this user may not mount a disk")
    yield folder
    subprocess.run(["umount", "-l", str(folder)], check=True)


@pytest.fixture(autouse=True)
def signals_forgotten() -> Iterator[None]:
    """A signal that one test sent does not stop the commands of the tests that come after it.

    A process keeps that a signal came, for it ends soon; the tests' process goes on.
    """
    yield
    if interrupted():
        with handlers_kept():
            raise_on_signals()


@pytest.fixture
def run_command() -> Callable[..., Ended]:
    """tests.programs.run_program."""
    return run_program


@pytest.fixture(scope="session")
def make_processed() -> Callable[..., Path]:
    """A function that writes a small processed folder with known atlas maps.

    `make_processed(path, rows=96, columns=64, subject=.., seed=.., head_from_world=..)`: random
    maps on a half cylinder; the outer eighth of the texture is not covered.
    """
    return _write_processed


def _write_processed(
    path: Path,
    rows: int = 96,
    columns: int = 64,
    subject: str = "person-0000",
    expression: str = "neutral",
    seed: int = 0,
    head_from_world: np.ndarray | None = None,
    consent: str | None = "C-0001",
) -> Path:
    rng = np.random.default_rng(seed)
    folder = ProcessedFolder(path)
    v, u = np.meshgrid(
        (np.arange(rows) + 0.5) / rows, (np.arange(columns) + 0.5) / columns, indexing="ij"
    )
    angle = (u - 0.5) * np.pi
    normal = np.stack([np.sin(angle), np.zeros_like(u), np.cos(angle)], axis=2)
    covered = (abs(u - 0.5) < 0.375) & (abs(v - 0.5) < 0.375)
    tone = rng.uniform(0.2, 0.6, 3)
    pores = 0.02 * rng.standard_normal((rows, columns))
    albedo = tone * (1 + 0.2 * np.sin(20 * (u + 2 * v) + seed) + pores)[:, :, None]
    position = normal * 80 + np.stack([0 * u, (0.5 - v) * 240, 0 * u], axis=2)
    maps = {
        "diffuse_albedo": albedo,
        "specular_albedo": 0.028 + 0.004 * np.cos(30 * v),
        "ambient_occlusion": 0.8 + 0.2 * np.cos(10 * u),
        "diffuse_normal": normal,
        "specular_normal": normal,
        "position": position,
        "confidence": np.ones((rows, columns)),
        "skin": np.ones((rows, columns)),
    }
    for name, image in maps.items():
        mask = covered if image.ndim == 2 else covered[:, :, None]
        folder.write_atlas(name, image * mask)
    pose = np.eye(3, 4) if head_from_world is None else head_from_world
    write_json(folder.head_pose, {"head_from_world": pose.tolist()})
    write_json(
        path / "report.json", {"subject": subject, "expression": expression, "consent": consent}
    )
    return path


@pytest.fixture
def forked() -> Iterator[None]:
    """`python -m lightstage` is forked from a process that has imported it (tests.forked)."""
    with quickly():
        yield
