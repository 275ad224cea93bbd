"""What do the checks of a shot cost, and which faults of a session do they find?"""

from __future__ import annotations

import argparse
import collections
import tempfile
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import cv2
import numpy as np
import rawpy

from benchmarks.check_cases import DARK_FIRST, cases
from benchmarks.check_faults import BINARY, POLARISED, Stage, simulate
from benchmarks.record import record
from lightstage.checks import ShotChecks
from lightstage.patterns import pattern_levels
from lightstage.rig import Rig, default_rig
from lightstage.sequence import Shot
from sim.camera.dng import Exif, dng_bytes
from sim.camera.sensor import SensorConfig, make_sensor

SIZES = {"1.5 MP": 0.25, "24 MP": 1.0}
EXIF = Exif("Nikon DSC D750", "6012345", 16.0, 105.0)
PATTERNS = ("full", "x+", "x-")
PEOPLE = 20
"""With --all; a quick run takes `FEW_PEOPLE`."""
FEW_PEOPLE = 3
EVERY = 3
"""Each person has every third case, the next one begins with another: the figures of all people
together cost a third."""
SMALL = 0.06


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--all", action="store_true", help=f"{PEOPLE} people, not {FEW_PEOPLE}")
    parser.add_argument("--cost", action="store_true", help="the table of costs alone")
    given = parser.parse_args()
    people = PEOPLE if given.all else FEW_PEOPLE
    record(
        "Capture checks: cost",
        (
            "size",
            "one photograph, s",
            "(processor s)",
            "shot of nine, s",
            "compared, s",
            "peer, one photograph, s",
            "(processor s)",
            "ratio of processor s",
            "memory, MB",
        ),
        [cost(name, scale) for name, scale in SIZES.items()],
        "A synthetic DNG for each of nine cameras, read from the disk's cache. Shot of nine: two "
        "threads measure, then the third pattern of a session is compared with the two before. "
        "Peer: rawpy's half-size postprocess and OpenCV's Laplacian, which see neither noise nor "
        "pattern nor motion. Memory: growth of a fresh process's "
        "peak over three shots of nine, files being read included.",
    )
    if given.cost:
        return
    stages = (simulate(seed, default_rig().scaled(SMALL)) for seed in range(people))
    record(
        "Capture checks: faults found",
        ("session", "size", "sessions", "found", "named rightly", "to be retaken", "others named"),
        faults(stages),
        f"{people} parametric people of several tones and expressions, nine cameras of 240 x 360 "
        "pixels, laboratory flaws (sway of 0.3 mm and 0.1 degrees, room light of 0.2 %, lamps 2 % "
        "apart, vignetting, defocus, noise at ISO 200), every other one lit by solid angle. Clean "
        "sessions beside sessions with one fault. Named rightly: a finding names the photograph's "
        "camera and pattern, or the pattern where it is the light; others named: also another one.",
    )


def cost(name: str, scale: float) -> tuple[object, ...]:
    """One photograph, a shot of nine, and the peer."""
    rig = default_rig().scaled(scale)
    sensor = make_sensor(SensorConfig(iso=200), np.ones(3), np.random.default_rng(1))
    with tempfile.TemporaryDirectory() as folder:
        paths = {}
        for pattern in PATTERNS:
            counts = sensor.expose(picture(rig, pattern), np.random.default_rng(1))
            for index, camera in enumerate(rig.cameras):
                # Each camera sees it a little higher: no two photographs are the same.
                own_counts = np.roll(counts, 2 * index, axis=0)
                paths[pattern, camera.id] = Path(folder) / f"{pattern}{camera.id}.dng"
                paths[pattern, camera.id].write_bytes(dng_bytes(own_counts, sensor, EXIF))
        checks = ShotChecks(rig, [Shot(p, pattern_levels(p, rig)) for p in PATTERNS])
        first = paths["full", "cam0"]
        checks.photograph("full", "cam0", first)  # compile
        one, own = timed(lambda: checks.photograph("full", "cam0", first))
        nine, compared = [], []
        for pattern in PATTERNS:
            nine.append(timed(partial(shoot, checks, rig, paths, pattern))[0])
            compared.append(timed(partial(checks.shot, pattern))[0])
        with ProcessPoolExecutor(1, get_context("spawn")) as pool:
            grown = pool.submit(grown_mb, scale, paths).result()
        peer, peer_own = timed(lambda: look(first))
    return (
        name,
        f"{one:.2f}",
        f"{own:.2f}",
        f"{nine[-1] + compared[-1]:.2f}",
        f"{compared[-1]:.2f}",
        f"{peer:.2f}",
        f"{peer_own:.2f}",
        f"{peer_own / own:.1f}",
        f"{grown:.0f}",
    )


def picture(rig: Rig, pattern: str) -> np.ndarray:
    """(h, w, 3) a textured ball, lit from the side that the pattern names."""
    camera = rig.cameras[0]
    height, width = camera.height_px, camera.width_px
    y, x = np.mgrid[:height, :width].astype(np.float32)
    x, y = (x / width - 0.5) * 2.6, (y / height - 0.5) * 2.6
    ball = np.sqrt(np.maximum(1 - x * x - y * y, 0))
    side = {"full": 1.0, "x+": (1 + x) / 2, "x-": (1 - x) / 2}[pattern]
    rng = np.random.default_rng(0)
    skin = 1 + 0.05 * cv2.resize(
        rng.normal(size=(height // 4, width // 4)).astype(np.float32), (width, height)
    )
    return np.repeat((0.6 * ball * side * skin)[..., None], 3, axis=2).astype(np.float32)


def shoot(checks: ShotChecks, rig: Rig, paths: dict[tuple[str, str], Path], pattern: str) -> None:
    with ThreadPoolExecutor(2) as pool:
        jobs = [
            pool.submit(checks.photograph, pattern, camera.id, paths[pattern, camera.id])
            for camera in rig.cameras
        ]
        for job in jobs:
            job.result()


def grown_mb(scale: float, paths: dict[tuple[str, str], Path]) -> float:
    """Growth of a fresh process's peak memory over three shots of nine."""
    rig = default_rig().scaled(scale)
    checks = ShotChecks(rig, [Shot(p, pattern_levels(p, rig)) for p in PATTERNS])
    small = default_rig().scaled(0.02)
    sensor = make_sensor(SensorConfig(), np.ones(3), np.random.default_rng(1))
    counts = sensor.expose(picture(small, "full"), np.random.default_rng(1))
    with tempfile.TemporaryDirectory() as folder:
        first = Path(folder) / "small.dng"
        first.write_bytes(dng_bytes(counts, sensor, EXIF))
        checks.photograph("full", "cam0", first)  # compile, load libraries
    before = peak_mb()
    for pattern in PATTERNS:
        shoot(checks, rig, paths, pattern)
        checks.shot(pattern)
    return peak_mb() - before


def look(path: Path) -> float:
    """The peer: develop at half size, and take a figure of sharpness."""
    with rawpy.imread(str(path)) as raw:
        image = raw.postprocess(half_size=True, no_auto_bright=True, output_bps=16)
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    return float(cv2.Laplacian(grey, cv2.CV_32F).var())


def peak_mb() -> float:
    """Of this process alone: getrusage's figure is its parent's too."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(float(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM"))


def timed(work: Callable[[], object]) -> tuple[float, float]:
    """Seconds by the wall and of the processor."""
    begun, own = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - begun, time.process_time() - own


def faults(stages: Iterable[Stage]) -> list[tuple[object, ...]]:
    """Clean sessions and sessions with faults, counted over all people."""
    counts: dict[tuple[str, str], collections.Counter[str]] = {}
    for index, stage in enumerate(stages):
        for patterns in (BINARY, DARK_FIRST, POLARISED):
            if f"{stage.cameras[0]}|{patterns[0]}" in stage.light:
                own = counts.setdefault(("clean", ", ".join(patterns[:2])), collections.Counter())
                found = stage.found(patterns, stage.photo)
                own["sessions"] += 1
                own["found"] += bool(found)
                own["retake"] += any(f.severity == "retake" for f in found)
        rng = np.random.default_rng([stage.seed, 99])
        for number, case in enumerate(cases(stage, rng)):
            if number % EVERY != index % EVERY:
                continue
            found = stage.found(case.patterns, case.make)
            own = counts.setdefault((case.name, case.size), collections.Counter())
            named = [(f.pattern, f.camera) in case.culprits for f in found]
            own["sessions"] += 1
            own["found"] += bool(found)
            own["named"] += any(named)
            own["nameable"] += bool(case.culprits)
            own["retake"] += any(f.severity == "retake" for f in found)
            own["others"] += bool(case.culprits) and not all(named)
    return [
        (
            *key,
            own["sessions"],
            own["found"],
            own["named"] if own["nameable"] else "",
            own["retake"],
            own["others"] if own["nameable"] else "",
        )
        for key, own in counts.items()
    ]


if __name__ == "__main__":
    main()
