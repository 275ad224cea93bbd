"""The firmware, compiled for this computer; tests skip where there is no compiler."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.firmware.bench import Bench

FIRMWARE = Path(__file__).resolve().parents[2] / "firmware"


def make(*words: str) -> subprocess.CompletedProcess[str]:
    """`make -C firmware`, or a skip."""
    for tool in ("gcc", "make"):
        if shutil.which(tool) is None:
            pytest.skip(f"the firmware is not tested: there is no {tool}")
    command = ["make", "-s", "-C", str(FIRMWARE), *words]
    return subprocess.run(command, capture_output=True, text=True)


@pytest.fixture(scope="session")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """A function that compiles a program of firmware/Makefile: `compiled("bench", lights=8)`."""
    done: dict[tuple[str, int], Path] = {}
    root = tmp_path_factory.mktemp("firmware")

    def program(name: str, lights: int) -> Path:
        if (name, lights) not in done:
            path = root / str(lights) / name
            made = make(str(path), f"OUT={path.parent}", f"DEFINES=-DLS_LIGHTS={lights}")
            assert made.returncode == 0, made.stdout + made.stderr
            done[name, lights] = path
        return done[name, lights]

    return program


@pytest.fixture
def bench(compiled: Callable[..., Path]) -> Iterator[Bench]:
    """Three lights, just switched on."""
    with Bench(compiled("bench", 3)) as bench:
        bench.reset()
        yield bench
