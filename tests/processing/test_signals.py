"""Libraries of processing leave the signals to the command."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

PROGRAM = """
import os, signal
from lightstage.interrupts import raise_on_signals
raise_on_signals()
import processing.colmap
try:
    os.kill(os.getpid(), signal.SIGTERM)
    signal.pause()
except KeyboardInterrupt:
    print("ended in order")
"""


def test_sigterm_ends_a_command_in_order_after_pycolmap_was_imported() -> None:
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=False, timeout=60
    )
    assert (done.stdout, done.stderr, done.returncode) == ("ended in order\n", "", 0)


def test_no_module_imports_pycolmap_past_its_gate() -> None:
    root = Path(__file__).parents[2]
    named = [
        path.name
        for path in (root / "processing").rglob("*.py")
        if "import pycolmap\n" in path.read_text().replace("colmap import pycolmap", "")
    ]
    assert named == ["colmap.py"]
