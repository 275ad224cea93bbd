"""Which of Mitsuba's variants works here.

`llvm_ad_rgb` needs a libLLVM that Dr.Jit can drive; a wrong one does not raise, it ends the
process. So each candidate is tried in a process of its own, newest first.
"""

from __future__ import annotations

import functools
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

from sim.errors import SimError

SCALAR, LLVM = "scalar_rgb", "llvm_ad_rgb"
OLDEST_LLVM = 15
PROBE_S = 60.0
FOLDERS = ("/usr/lib/*-linux-gnu", "/usr/lib64", "/usr/lib/llvm-*/lib", "/usr/local/lib")
PROBE = """
import mitsuba as mi
mi.set_variant("llvm_ad_rgb")
scene = mi.load_dict({
    "type": "scene",
    "integrator": {"type": "path", "max_depth": 3},
    "ball": {"type": "sphere", "bsdf": {"type": "roughplastic"}},
    "lamp": {"type": "point", "position": [0, 3, 3], "intensity": 9.0},
    "camera": {
        "type": "perspective",
        "to_world": mi.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0]),
        "film": {"type": "hdrfilm", "width": 16, "height": 16},
    },
})
import numpy as np
mean = float(np.asarray(mi.render(scene, spp=4)).mean())
assert 0.01 < mean < 10.0, mean
"""


def find_variant(wanted: str = "auto") -> str:
    """The variant to use.

    Args:
        wanted: ``auto``, ``llvm_ad_rgb`` or ``scalar_rgb``.

    Returns:
        The variant's name; where it is LLVM's, DRJIT_LIBLLVM_PATH names the library that works.

    Raises:
        SimError: Mitsuba is absent, the name is unknown, or LLVM was asked for and none works.
    """
    if wanted not in ("auto", SCALAR, LLVM):
        raise SimError(
            "reference", field="variant", found=wanted, expected=f"auto, {SCALAR} or {LLVM}"
        )
    _require_mitsuba()
    if wanted == SCALAR:
        return SCALAR
    library = working_llvm()
    if library is not None:
        os.environ["DRJIT_LIBLLVM_PATH"] = library
        return LLVM
    if wanted == LLVM:
        raise SimError(
            "reference",
            field="variant",
            found="no libLLVM that works",
            expected=f"libLLVM {OLDEST_LLVM} or newer that passes a trial",
            hint="Install libllvm19, set DRJIT_LIBLLVM_PATH, or take scalar_rgb.",
        )
    return SCALAR


@functools.cache
def working_llvm() -> str | None:
    """Path of the first libLLVM that renders a plain scene, None where none does; asked once."""
    named = os.environ.get("DRJIT_LIBLLVM_PATH")
    for path in [named] if named else candidates():
        if _works(path):
            return path
    return None


def candidates() -> list[str]:
    """Libraries called libLLVM in the usual folders, newest first, each file once."""
    found: dict[Path, int] = {}
    for pattern in FOLDERS:
        for path in Path("/").glob(f"{pattern[1:]}/libLLVM*.so*"):
            version = re.search(r"(?:libLLVM-|\.so\.)(\d+)", path.name)
            if version is not None and int(version[1]) >= OLDEST_LLVM:
                found[path.resolve()] = int(version[1])
    return [str(path) for path in sorted(found, key=lambda p: (-found[p], str(p)))]


def _works(library: str) -> bool:
    environment = {**os.environ, "DRJIT_LIBLLVM_PATH": library}
    try:
        done = subprocess.run(
            [sys.executable, "-c", PROBE],
            env=environment,
            capture_output=True,
            timeout=PROBE_S,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return done.returncode == 0


def _require_mitsuba() -> None:
    import importlib.util

    if importlib.util.find_spec("mitsuba") is None:
        raise SimError(
            "reference",
            found="no mitsuba",
            expected="the Python package mitsuba 3.9",
            hint="pip install 'lightstage[reference]'.",
        )


def mitsuba(variant: str) -> Any:
    """The module `mitsuba` with this variant chosen for the calling thread."""
    import mitsuba as mi

    mi.set_variant(variant)
    return mi
