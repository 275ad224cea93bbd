"""Set-up says how much disk it needs, and stops before a download where there is too little."""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[1] / "scripts" / "disk-space"
DISKS = (Path("/dev/shm"), SCRIPT.parent)
"""One of them is on another disk than the tests' temporary files, wherever these are."""


def ask(
    tmp_path: Path, free_mb: dict[str, int], temporary: Path
) -> subprocess.CompletedProcess[str]:
    """The script's answer on disks with so much room; `df` is a stand-in that tells it."""
    tools = tmp_path / "tools"
    tools.mkdir(exist_ok=True)
    cases = "".join(f"{place}) echo {mb} ;; " for place, mb in free_mb.items())
    stand_in = tools / "df"
    stated = f'for last; do :; done\ncase "$last" in {cases}esac\n'
    stand_in.write_text(f"#!/bin/sh\necho Avail\n{stated}")
    stand_in.chmod(0o755)
    environment = os.environ | {
        "PATH": f"{tools}:{os.environ['PATH']}",
        "TMPDIR": str(temporary),
    }
    return subprocess.run(
        [SCRIPT, tmp_path / ".venv"], env=environment, capture_output=True, text=True
    )


def needed_mb(tmp_path: Path) -> int:
    """What the environment and its packages need on one disk, to 100 MB."""
    message = ask(tmp_path, {str(tmp_path): 10**6}, tmp_path).stdout
    found = re.search(r"([0-9.]+) GB needed", message)
    assert found is not None, message
    return round(1000 * float(found[1]))


def test_room_is_reported_in_one_line(tmp_path: Path) -> None:
    found = ask(tmp_path, {str(tmp_path): 80_000}, tmp_path)
    assert (found.returncode, found.stderr) == (0, "")
    assert found.stdout.count("\n") == 1
    assert f"GB needed in {tmp_path} and {tmp_path}, 80.0 GB free" in found.stdout
    assert 1000 < needed_mb(tmp_path) < 10_000


def test_too_little_room_on_one_disk_stops_the_set_up(tmp_path: Path) -> None:
    free_mb = needed_mb(tmp_path) - 100
    found = ask(tmp_path, {str(tmp_path): free_mb}, tmp_path)
    assert (found.returncode, found.stdout) == (2, "")
    assert f"{free_mb / 1000:.1f} GB free" in found.stderr
    assert "Make room, or set TMPDIR" in found.stderr
    assert ask(tmp_path, {str(tmp_path): free_mb + 200}, tmp_path).returncode == 0


def test_each_disk_is_asked_for_its_own_share(tmp_path: Path) -> None:
    own = tmp_path.stat().st_dev
    others = [disk for disk in DISKS if disk.is_dir() and disk.stat().st_dev != own]
    if not others:
        pytest.skip("no second disk")
    near, far, enough_mb = str(tmp_path), str(others[0]), needed_mb(tmp_path) - 100
    assert ask(tmp_path, {near: enough_mb, far: enough_mb}, others[0]).returncode == 0
    for free_mb in ({near: enough_mb, far: 100}, {near: 100, far: enough_mb}):
        found = ask(tmp_path, free_mb, others[0])
        assert found.returncode == 2
        assert "0.1 GB free" in found.stderr


@pytest.mark.parametrize(
    ("given", "more"),
    [
        ('{"requires_dist": ["filelock", "nvidia-cublas==13.1"]}', True),
        ('{"requires_dist": ["filelock"], "description": "on nvidia-smi\'s cards"}', False),
    ],
)
def test_a_torch_that_brings_cuda_needs_more(tmp_path: Path, given: str, more: bool) -> None:
    usual_mb = needed_mb(tmp_path)
    python = tmp_path / ".venv" / "bin" / "python"
    python.parent.mkdir(parents=True)
    python.write_text(f"#!/bin/sh\ncat <<'END'\n{given}\nEND\n")
    python.chmod(0o755)
    assert (needed_mb(tmp_path) > usual_mb + 2000) == more


def test_what_an_interrupted_set_up_left_is_not_needed_again(tmp_path: Path) -> None:
    free_mb = {str(tmp_path): needed_mb(tmp_path) - 100}
    assert ask(tmp_path, free_mb, tmp_path).returncode == 2
    venv = tmp_path / ".venv"
    venv.mkdir()
    with (venv / "unpacked").open("wb") as held:
        os.posix_fallocate(held.fileno(), 0, 200_000_000)
    assert ask(tmp_path, free_mb, tmp_path).returncode == 0
