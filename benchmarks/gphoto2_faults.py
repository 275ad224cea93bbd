"""The gphoto2 command line under faults: what it reports as done, and what is there.

Debian's `gphoto2` drives libgphoto2's virtual camera when it is given the libraries of
python-gphoto2's wheel, which carry it. One call a camera and shot, nine at once, as a script does.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from lightstage.rig import Rig
from sim.devices.camera_device import SEED, CameraFolders
from sim.devices.coded_photographer import CodedPhotographer, read_code
from sim.devices.faults import Fault, FaultLog, Story

DEADLINE_S = 5.0
FILE_FAULTS = ("fail", "hang", "stale", "truncated")
DISK_FAULTS = ("rename",)
"""Something of the photograph's name is there already and cannot be replaced."""
SHARE = 0.05


def wheel_environment(links: Path) -> dict[str, str]:
    """Variables with which `gphoto2` finds the virtual camera in python-gphoto2's wheel.

    Args:
        links: a folder for the libraries under the names that the program asks for.
    """
    spec = importlib.util.find_spec("gphoto2")
    assert spec is not None
    assert spec.origin is not None
    package = Path(spec.origin).parent
    libraries = package.parent / "gphoto2.libs"
    links.mkdir(parents=True, exist_ok=True)
    for name, link in (
        ("libgphoto2-", "libgphoto2.so.6"),
        ("libgphoto2_port-", "libgphoto2_port.so.12"),
    ):
        found = next(path for path in libraries.iterdir() if path.name.startswith(name))
        (links / link).symlink_to(found)
    return {
        **os.environ,
        "LD_LIBRARY_PATH": f"{links}:{libraries}",
        "CAMLIBS": str(package / "libgphoto2" / "camlibs"),
        "IOLIBS": str(package / "libgphoto2" / "vusb"),
    }


def require_cli() -> None:
    """Exit where the program is not there, before anything long is begun."""
    if shutil.which("gphoto2") is None:
        raise SystemExit("The gphoto2 command line is not there: apt-get install gphoto2")


def cli_rows(desk: Path, rig: Rig, shots: int, seed: int) -> list[list[object]]:
    """The table's line for the command line as it is."""
    return [_row(desk, rig, shots, seed)]


def _row(desk: Path, rig: Rig, shots: int, seed: int) -> list[object]:
    environment = wheel_environment(desk / "lib")
    share = SHARE / (len(FILE_FAULTS) + len(DISK_FAULTS))
    story = Story([Fault(name, probability=share) for name in FILE_FAULTS], seed)
    log = FaultLog()
    photographer = CodedPhotographer(rig, seed)
    folders = CameraFolders(desk / "cameras", [c.id for c in rig.cameras], story, log)
    rng = np.random.default_rng(seed)
    took, counts = [], dict.fromkeys(("faults", "done", "lost", "deleted", "other", "cut"), 0)
    with ThreadPoolExecutor(len(rig.cameras)) as pool:
        for shot in range(shots + 1):
            levels = rng.uniform(0, 1, len(rig.lights))
            light = photographer.lit(levels)
            seen = {c.id: photographer.photograph(c, light) for c in rig.cameras}
            for camera_id, data in seen.items():
                folders.put(camera_id, data)
            if shot == 0:
                continue  # a camera's first file counts as none
            disks = rng.choice(
                ["", *DISK_FAULTS], len(rig.cameras), p=[1 - share, *[share] * len(DISK_FAULTS)]
            )
            begun = time.perf_counter()
            jobs = [
                pool.submit(
                    _shoot, desk, folders, environment, camera.id, seen[camera.id], str(disk)
                )
                for camera, disk in zip(rig.cameras, disks, strict=True)
            ]
            results = [job.result() for job in jobs]
            took.append(time.perf_counter() - begun)
            counts["faults"] += int((disks != "").sum())
            for index, (said_done, said_deleted, path) in enumerate(results):
                counts["done"] += said_done
                code = read_code(path) if path.is_file() else None
                if code is not None and (code.camera, code.light) == (index, light):
                    continue
                if code is not None:
                    counts["other"] += 1
                elif path.is_file() and path.stat().st_size:
                    counts["cut"] += 1
                else:
                    counts["lost"] += 1
                    counts["deleted"] += said_deleted
    counts["faults"] += len(log.happened)
    version = subprocess.run(["gphoto2", "--version"], capture_output=True, text=True, check=True)
    return [
        f"{version.stdout.splitlines()[0]} --capture-image-and-download",
        shots * len(rig.cameras),
        counts["faults"],
        counts["done"],
        counts["lost"],
        counts["deleted"],
        counts["other"],
        counts["cut"],
        f"{np.mean(took):.3f}",
    ]


def _shoot(
    desk: Path,
    folders: CameraFolders,
    environment: dict[str, str],
    camera: str,
    data: bytes,
    disk: str,
) -> tuple[bool, bool, Path]:
    """One photograph as a script takes it; whether it was reported as done, and deleted there."""
    folder = Path(tempfile.mkdtemp(prefix=f"{camera}-", dir=desk))
    path = folder / "photograph.dng"
    with tempfile.TemporaryDirectory() as cwd:
        if disk == "rename":
            path.mkdir()  # something of that name is there already
        printed = ""
        for _ in range(2):
            done, printed = _call(
                environment | {"VCAMERADIR": str(folders.folder(camera))}, path, cwd
            )
            if done:
                break
            seed = folders.folder(camera) / "DCIM" / "100TEST" / SEED
            if seed.is_fifo():
                # The operator pulls the stuck camera's plug, and it works again.
                seed.unlink()
                seed.write_bytes(data)
        if path.is_dir():
            path = folder / "nothing"
    return done, "Deleting file" in printed, path


def _call(environment: dict[str, str], path: Path, cwd: str) -> tuple[bool, str]:
    command = ["gphoto2", "--capture-image-and-download", "--force-overwrite"]
    command += ["--filename", str(path)]
    try:
        ran = subprocess.run(
            command,
            env=environment,
            cwd=cwd,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=DEADLINE_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return False, ""
    return ran.returncode == 0, ran.stdout
