"""What a stage needs, as measured: memory for the number of workers, seconds for the rest."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from lightstage.errors import MemoryLimitError
from lightstage.formats.session import Session
from processing.parallel import cores

GIB = 2**30
SMALL_MP, LARGE_MP = 0.0864, 24.2
"""Megapixels of a photograph at which the two columns of `PEAK_GIB` were measured."""
SMALL_ROWS, MEASURED_ROWS = 96, 6144
"""Rows of the atlas in these measurements: the large one is the default."""
PEAK_GIB: Mapping[str, tuple[float, float]] = {
    "decode": (0.37, 0.76),
    "separate": (0.47, 3.78),
    "reconstruct": (0.82, 5.24),
    "refine": (1.73, 4.86),
    "register": (0.95, 1.39),
    "atlas": (0.98, 6.55),
}
"""Peak memory of a stage. The second column is benchmarks/RESULTS.md's session of nine views of 24
megapixels with an atlas of `MEASURED_ROWS`; the first a session of three views of 240 x 360 with
one of `SMALL_ROWS`, whose peak is the compiler's and the libraries'."""
TEXELS_GIB = 3.6
"""Of the difference between the atlas's two measurements, what its texels take, whatever the
photographs: of small ones 1536 rows take .17 GiB more than 768 do (benchmarks/RESULTS.md), .144 a
million texels. The rest grows with the photographs."""
SECONDS: Mapping[str, tuple[float, float]] = {
    "decode": (1.0, 25.0),
    "separate": (1.0, 34.0),
    "reconstruct": (10.0, 115.0),
    "refine": (10.0, 197.0),
    "register": (5.0, 9.0),
    "atlas": (2.0, 64.0),
}
"""Likewise, until the batch has measured its own."""


def megapixels(session: Session) -> float:
    """Of the largest photograph of a session."""
    used = set(session.camera_ids())
    sizes = [c.width_px * c.height_px for c in session.rig.cameras if c.id in used]
    return max(sizes, default=0) / 1e6


def between(table: Mapping[str, tuple[float, float]], stage: str, size_mp: float) -> float:
    """A table's value at a number of megapixels, on the line through its two measurements."""
    small, large = table[stage]
    share = (size_mp - SMALL_MP) / (LARGE_MP - SMALL_MP)
    return max(small, small + share * (large - small))


def peak_bytes(size_mp: float, rows: int, last: str) -> int:
    """Most memory that any stage takes.

    Args:
        size_mp: megapixels of a photograph.
        rows: of the atlas.
        last: the last stage that is run.
    """
    stages = list(PEAK_GIB)
    needed = {name: between(PEAK_GIB, name, size_mp) for name in stages[: stages.index(last) + 1]}
    if "atlas" in needed:
        small, large = PEAK_GIB["atlas"]
        of_photographs = between({"atlas": (small, large - TEXELS_GIB)}, "atlas", size_mp)
        share = (rows**2 - SMALL_ROWS**2) / (MEASURED_ROWS**2 - SMALL_ROWS**2)
        needed["atlas"] = of_photographs + max(0.0, share) * TEXELS_GIB
    return int(GIB * max(needed.values()))


def free_bytes() -> int:
    """Memory that programs can have now, in this process's control group too."""
    lines = Path("/proc/meminfo").read_text().splitlines()
    free = next(int(line.split()[1]) for line in lines if line.startswith("MemAvailable:")) * 1024
    limit, used = Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory.current")
    if limit.is_file() and used.is_file():
        most = limit.read_text().strip()
        if most.isdecimal():
            free = min(free, int(most) - int(used.read_text()))
    return max(0, free)


def worker_count(needed: int, sessions: int, memory_share: float, free: int) -> int:
    """Workers of this machine: as many as memory holds, at most one a core and a session.

    Args:
        needed: bytes, of `peak_bytes` for the largest photograph of all sessions.
        sessions: how many there are.
        memory_share: of the free memory, the share to be used.
        free: bytes.

    Raises:
        MemoryLimitError: not enough for one.
    """
    count = int(free * memory_share // needed)
    if count < 1:
        raise MemoryLimitError(
            "batch",
            field="--workers",
            found=f"{free / GIB:.1f} GiB of free memory",
            expected=f"{needed / memory_share / GIB:.1f} GiB for one session",
            hint="Close other programs, make a smaller atlas (--atlas-rows), or name a number of "
            "workers yourself.",
        )
    return max(1, min(count, cores(), sessions))
