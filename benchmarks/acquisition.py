"""What capture costs: nine supervised cameras a shot.

Peer, in the same run: plain python-gphoto2, camera after camera, as a script without this project
would take a shot. (Acknowledged light over the wire: benchmarks/leds.py.)
"""

from __future__ import annotations

import os
import statistics
import struct
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from benchmarks.record import record
from lightstage.cameras.binding import close_cameras, try_cameras
from lightstage.cameras.process import CameraProcess
from lightstage.rig import default_rig
from lightstage.session import SessionPlan, SessionWriter

CAMERAS = 9
PORT = "usb:001,001"

PLAIN = """
import hashlib, os, sys
import gphoto2
camera = gphoto2.Camera()
camera.init()
print("ready", flush=True)
for line in sys.stdin:
    path = camera.capture(gphoto2.GP_CAPTURE_IMAGE)
    file = camera.file_get(path.folder, path.name, gphoto2.GP_FILE_TYPE_NORMAL)
    file.save(line.strip())
    if sys.argv[1] == "verified":
        with open(line.strip(), "rb") as saved:
            os.fsync(saved.fileno())
            os.posix_fadvise(saved.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
            hashlib.file_digest(saved, "sha256")
    print("done", flush=True)
"""


def photograph(size: int, seed: int) -> bytes:
    """A file of `size` bytes that begins as a DNG does."""
    head = b"II*\0\x08\0\0\0" + struct.pack("<HHHI4sI", 1, 50706, 1, 4, b"\x01\x04\0\0", 0)
    return head + np.random.default_rng(seed).bytes(size - len(head))


def shot_rows(size: int, shots: int, desk: Path) -> list[list[object]]:
    """Seconds a shot of nine virtual cameras: one after the other, and supervised."""
    folders, photographs = [], []
    for index in range(CAMERAS):
        seed = desk / f"{size}-{index}" / "DCIM" / "100TEST" / "seed.jpg"
        seed.parent.mkdir(parents=True)
        photographs.append(photograph(size, index))
        seed.write_bytes(photographs[-1])
        folders.append(seed.parents[2])
    plain_s, plain_wrong = _plain(folders, photographs, shots, desk / f"plain-{size}", "saved")
    safe_s, safe_wrong = _plain(folders, photographs, shots, desk / f"safe-{size}", "verified")
    ours_s, ours_wrong, skew_ms = _ours(folders, photographs, shots, desk / f"ours-{size}")
    rows: list[list[object]] = []
    for name, took, wrong, skew in (
        ("plain gphoto2, one after the other, saved", plain_s, plain_wrong, "-"),
        ("the same, flushed and read back", safe_s, safe_wrong, "-"),
        (
            "supervised, at once, flushed, read back, journaled",
            ours_s,
            ours_wrong,
            f"{skew_ms:.1f}",
        ),
    ):
        median = statistics.median(took)
        ratio = median / statistics.median(plain_s)
        rows.append([f"{size / 1e6:.1f} MB", name, f"{median:.3f}", wrong, skew, f"{ratio:.2f}"])
    return rows


def _plain(
    folders: list[Path], photographs: list[bytes], shots: int, out: Path, how: str
) -> tuple[list[float], int]:
    out.mkdir()
    children = []
    for folder in folders:
        child = subprocess.Popen(
            [sys.executable, "-c", PLAIN, how],
            env={**os.environ, "VCAMERADIR": str(folder)},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            bufsize=1,
        )
        children.append((child, child.stdin, child.stdout))
    took, wrong = [], 0
    try:
        for _, _, replies in children:
            assert replies is not None
            replies.readline()
        for shot in range(shots):
            begun = time.perf_counter()
            for index, (_, requests, replies) in enumerate(children):
                assert requests is not None
                assert replies is not None
                requests.write(f"{out}/{shot}-{index}\n")
                replies.readline()
            took.append(time.perf_counter() - begun)
            for index, expected in enumerate(photographs):
                wrong += (out / f"{shot}-{index}").read_bytes() != expected
    finally:
        for child, _, _ in children:
            child.kill()
            child.wait()
    return took, wrong


def _ours(
    folders: list[Path], photographs: list[bytes], shots: int, out: Path
) -> tuple[list[float], int, float]:
    rig = default_rig()
    cameras = [
        CameraProcess(camera.id, PORT, folder, 60.0)
        for camera, folder in zip(rig.cameras, folders, strict=True)
    ]
    plan = SessionPlan(tuple(f"olat-{shot:03d}" for shot in range(shots)))
    writer = SessionWriter.new(out, rig, plan)
    took, wrong, skews_ms = [], 0, []
    try:
        _, problems = try_cameras(cameras)
        assert not problems, problems
        with ThreadPoolExecutor(CAMERAS) as pool:
            for name in plan.sequence:
                begun = time.perf_counter()
                writer.lit(name, [0.0], acknowledged=False)
                writer.trigger(name, {camera.id: 1 for camera in cameras})
                at_s = time.monotonic() + 0.02

                def take(camera: CameraProcess, name: str = name, at_s: float = at_s) -> float:
                    exposure = camera.trigger(at_s, name)
                    file = exposure.files[0]
                    writer.exposed(name, 1, camera.id, file)
                    incoming = writer.incoming(name, camera.id, 1)
                    got = camera.download(file.name, incoming, name)
                    writer.keep(name, camera.id, 1, incoming, file, got.sha256)
                    return exposure.triggered_s

                triggers = list(pool.map(take, cameras))
                writer.shot(name)
                took.append(time.perf_counter() - begun)
                skews_ms.append(1e3 * (max(triggers) - min(triggers)))
                for camera, expected in zip(cameras, photographs, strict=True):
                    path = out / "frames" / name / f"{camera.id}.dng"
                    wrong += path.read_bytes() != expected
    finally:
        close_cameras(cameras)
        writer.close()
    return took, wrong, max(skews_ms)


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        rows = shot_rows(1_556_000, 12, Path(name)) + shot_rows(25_000_000, 4, Path(name))
    record(
        "Acquisition: a shot of nine cameras",
        ["photograph", "how", "s a shot (median)", "wrong files", "largest skew ms", "ratio"],
        rows,
        "libgphoto2's virtual camera in nine processes; every file compared byte by byte with "
        "what the camera had.",
    )


if __name__ == "__main__":
    main()
