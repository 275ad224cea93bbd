"""Positions and normals together on a surface known exactly, beside Nehab's own program.

Run `python -m benchmarks.geometry_relief`. A round surface with waves of 3 to 15 mm is seen by a
camera with depth noise of .08 mm; its normals have noise of 2 degrees, and in a second case are
tipped by 3 degrees besides, slowly changing. The peer is PyPI's `normal-position-combination` (the
paper's C++ program), no dependency of ours: where it is not installed its rows state that. It is
run with several weights, with and without its own mending of normals; its best row by normals
counts.
"""

from __future__ import annotations

import importlib
import importlib.util
import itertools
import time

import numpy as np

from benchmarks.record import record
from lightstage.formats.mesh import vertex_normals
from processing.reconstruction.config import ReconstructConfig
from processing.reconstruction.relief import with_relief
from processing.reconstruction.slopes import plane_slopes

PEER = "normal_position_combination"
SHAPE = (150, 200)
LENS = np.array([1500.0, 1500.0, 100.0, 75.0])
POSE = np.hstack([np.diag([1.0, -1.0, -1.0]), [[0.0], [0.0], [1000.0]]])
WAVES = ((3.0, 0.02), (6.0, 0.06), (15.0, 0.2))
"""Length and height of each, mm."""
NOISE_MM, NOISE_DEG, TIPPED_DEG = 0.08, 2.0, 3.0
EDGE_PX = 10


def surface() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(h, w, 3) points, normals and directions of sight."""
    fx, fy, cx, cy = LENS
    u, v = np.meshgrid(np.arange(SHAPE[1]) + 0.5, np.arange(SHAPE[0]) + 0.5)
    across = np.stack([(u - cx) / fx, -(v - cy) / fy], axis=-1)
    z = np.zeros(SHAPE)
    for _ in range(40):
        x, y = across[..., 0] * (1000 - z), across[..., 1] * (1000 - z)
        z, dx, dy = -(x * x + y * y) / 160, -x / 80, -y / 80
        for length, height in WAVES:
            k = 2 * np.pi / length
            z = z + height * np.sin(k * x) * np.cos(k * y)
            dx = dx + height * k * np.cos(k * x) * np.cos(k * y)
            dy = dy - height * k * np.sin(k * x) * np.sin(k * y)
    points = np.stack([x, y, z], axis=-1)
    sight = points - [0, 0, 1000]
    return points, _unit(np.stack([-dx, -dy, np.ones(SHAPE)], axis=-1)), _unit(sight)


def given_normals(true: np.ndarray, tipped_deg: float) -> np.ndarray:
    """Normals with noise, tipped by a slowly changing angle."""
    rng = np.random.default_rng(1)
    rows, columns = np.indices(SHAPE) / 60.0
    slow = np.stack([np.cos(columns + rows), np.sin(columns - rows), 0 * rows], axis=-1)
    fast = rng.normal(0, np.radians(NOISE_DEG) / np.sqrt(2), true.shape)
    return _unit(true + np.radians(tipped_deg) * slow + fast)


def errors(
    found: np.ndarray, points: np.ndarray, normals: np.ndarray, sight: np.ndarray
) -> tuple[float, float]:
    """Mean error along the line of sight in mm, and of the surface's own normals in degrees."""
    inner = np.s_[EDGE_PX:-EDGE_PX, EDGE_PX:-EDGE_PX]
    off = np.abs(((found - points) * sight).sum(axis=-1))[inner].mean()
    own = vertex_normals(found.reshape(-1, 3), _faces()).reshape(points.shape)
    cosine = np.clip((own * normals).sum(axis=-1), -1, 1)
    return float(off), float(np.degrees(np.arccos(cosine))[inner].mean())


def peer_best(
    noisy: np.ndarray, normals: np.ndarray, truth: tuple[np.ndarray, np.ndarray, np.ndarray]
) -> tuple[str, tuple[float, float], float]:
    """Settings, errors and seconds of the peer's best run by normals."""
    program = importlib.import_module(PEER)
    best = ("", (np.inf, np.inf), 0.0)
    for weight, (mend, scale) in itertools.product(
        (0.01, 0.03, 0.1, 0.3), ((False, 1.0), (True, 1.0), (True, 3.0))
    ):
        start = time.process_time()
        moved = program.process_ndarray(
            noisy.reshape(-1, 3).astype(np.float32),
            _faces(),
            normals.reshape(-1, 3).astype(np.float32),
            llambda=weight,
            fixnorm=mend,
            fixnorm_s=scale,
            fixnorm_n=5,
        )
        spent = time.process_time() - start
        vertices = moved[0] if isinstance(moved, tuple) else moved
        found = errors(np.asarray(vertices, float).reshape(noisy.shape), *truth)
        if found[1] < best[1][1]:
            settings = f"lambda {weight:g}, " + (f"mended over {scale:g}" if mend else "as given")
            best = (settings, found, spent)
    return best


def ours(noisy: np.ndarray, normals: np.ndarray, relief_mm: float) -> tuple[np.ndarray, float]:
    """Our points and processor seconds."""
    config = ReconstructConfig(relief_mm=relief_mm)
    start = time.process_time()
    slopes = plane_slopes(normals.astype(np.float32), LENS, POSE)
    known = np.ones(SHAPE, bool)
    moved, _ = with_relief(noisy.astype(np.float32), slopes, known, LENS, POSE, config)
    return moved.astype(float), time.process_time() - start


def main() -> None:
    """Measure, and write the table."""
    points, normals, sight = truth = surface()
    rng = np.random.default_rng(0)
    noisy = points + sight * rng.normal(0, NOISE_MM, (*SHAPE, 1))
    config = ReconstructConfig()
    ours(noisy, normals, config.relief_mm)  # compiles
    rows: list[tuple[object, ...]] = []
    before = errors(noisy, *truth)
    rows.append(("points alone", "", f"{before[0]:.4f}", f"{before[1]:.2f}", ""))
    for tipped in (0.0, TIPPED_DEG):
        seen = given_normals(normals, tipped)
        noise = f"tipped by {tipped:g} degrees" if tipped else "noise alone"
        for relief_mm in (2 * config.relief_mm, config.relief_mm):
            moved, spent = ours(noisy, seen, relief_mm)
            own = errors(moved, *truth)
            by = f"ours, relief below {relief_mm:g} mm"
            rows.append((by, noise, f"{own[0]:.4f}", f"{own[1]:.2f}", f"{spent:.2f}"))
        if importlib.util.find_spec(PEER) is None:
            rows.append(("Nehab's program", noise, "not installed", "", ""))
            continue
        setting, theirs, spent = peer_best(noisy, seen, truth)
        name = f"Nehab's program ({setting})"
        rows.append((name, noise, f"{theirs[0]:.4f}", f"{theirs[1]:.2f}", f"{spent:.2f}"))
        ratios = (f"{own[0] / theirs[0]:.2f}", f"{own[1] / theirs[1]:.2f}")
        rows.append((f"{by}, over peer", noise, *ratios, ""))
    record(
        "Geometry: positions and normals beside Nehab's program",
        ("points", "normals", "position, mean mm", "normals of the surface, mean deg", "s"),
        rows,
        f"{SHAPE[1]} x {SHAPE[0]} points of a pixel's {1000 / LENS[0]:.2f} mm, depth noise "
        f"{NOISE_MM} mm, normals' noise {NOISE_DEG:g} degrees; normals mended "
        f"above {config.bias_mm:g} mm.",
    )


def _faces() -> np.ndarray:
    index = np.arange(SHAPE[0] * SHAPE[1]).reshape(SHAPE)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    one = np.stack([a, c, b], axis=-1).reshape(-1, 3)
    two = np.stack([b, c, d], axis=-1).reshape(-1, 3)
    return np.concatenate([one, two]).astype(np.int32)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


if __name__ == "__main__":
    main()
