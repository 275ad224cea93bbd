"""RAW to linear colour: error of demosaics on faces whose light is known, and seconds for 24 MP.

Run `python -m benchmarks.reflectance_raw`. A person's clean photographs are exposed by the
simulated sensor, in the pictures' own sharpness and blurred as a lens does; every method gets the
same counts and the same colour matrix. Error is of linear rgb on the face, where nothing is
clipped. Seconds are a process's own and wall, for one file of 24 MP from opening to linear colour.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import rawpy

from benchmarks.record import record
from benchmarks.reflectance_people import person, session
from lightstage.formats.exr import read_exr
from lightstage.formats.processed import ProcessedFolder
from processing.colour import ColourCorrection
from processing.frames.window import Window, whole
from processing.raw.develop import Settings, develop
from processing.raw.raw_file import open_raw
from processing.raw.region import find_window, preview
from sim.camera.dng import Exif, dng_bytes
from sim.camera.sensor import Sensor, SensorConfig, make_sensor

WHO = ("tone1", "tone6", "lps")
CAMERA = "cam0"
BLURS_PX = (0.0, 0.7)
EXIF = Exif("Made up", "1", 16.0, 85.0)
FAR_PX = 7
"""From clipped light, which no method can know."""
Method = Callable[[Path, Sensor, Window | None], np.ndarray]


def ours(path: Path, sensor: Sensor, window: Window | None) -> np.ndarray:
    """The compiled pass over a window, or over the whole picture."""
    raw = open_raw(path)
    window = window or whole(raw.shape)
    matrix = ColourCorrection(np.linalg.inv(sensor.raw_from_linear))
    out, marks = np.zeros((*window.shape, 3), np.float16), np.zeros(window.shape, np.uint8)
    develop(raw, window, Settings(matrix, 1.0, 0.99), None, out, marks)
    raw.close()
    return out


def opencv(path: Path, sensor: Sensor, window: Window | None, code: int) -> np.ndarray:
    """OpenCV's demosaic of balanced 16-bit counts, then the matrix."""
    del window
    config, raw = sensor.config, open_raw(path)
    balance = 1 / sensor.raw_from_linear.sum(axis=1)
    balance /= balance.max()
    level = np.float32(config.white_dn - config.black_dn)
    share = (raw.counts.astype(np.float32) - config.black_dn) / level
    raw.close()
    share[::2, ::2] *= np.float32(balance[0])
    share[::2, 1::2] *= np.float32(balance[1])
    share[1::2, ::2] *= np.float32(balance[1])
    share[1::2, 1::2] *= np.float32(balance[2])
    # A pedestal keeps the noise below black.
    counts = np.clip(np.rint(share * 60000 + 2000), 0, 65535).astype(np.uint16)
    rgb = (cv2.cvtColor(counts, code).astype(np.float32) - 2000) / 60000
    matrix = np.linalg.inv(sensor.raw_from_linear) / balance
    return np.asarray(rgb @ matrix.T.astype(np.float32))


def libraw(
    path: Path, sensor: Sensor, window: Window | None, algorithm: rawpy.DemosaicAlgorithm
) -> np.ndarray:
    """LibRaw's demosaic with the camera's own balance, which it needs to see edges; the matrix."""
    del window
    gains = 1 / sensor.raw_from_linear.sum(axis=1)
    with rawpy.imread(str(path)) as raw:
        picture = raw.postprocess(
            demosaic_algorithm=algorithm,
            output_color=rawpy.ColorSpace.raw,
            gamma=(1, 1),
            no_auto_bright=True,
            user_wb=[*gains, gains[1]],
            output_bps=16,
            user_flip=0,
            adjust_maximum_thr=0,
        )
    # LibRaw scales the weakest gain to 1 and clips the others there: what is bright is lost.
    share = picture.astype(np.float32) / 65535
    matrix = np.linalg.inv(sensor.raw_from_linear) / (gains / gains.min())
    return np.asarray(share @ matrix.T.astype(np.float32))


METHODS: dict[str, Method] = {
    "ours": ours,
    "OpenCV bilinear": partial(opencv, code=cv2.COLOR_BAYER_RGGB2RGB),
    "OpenCV edge-aware": partial(opencv, code=cv2.COLOR_BAYER_RGGB2RGB_EA),
    "LibRaw linear": partial(libraw, algorithm=rawpy.DemosaicAlgorithm.LINEAR),
    "LibRaw AHD": partial(libraw, algorithm=rawpy.DemosaicAlgorithm.AHD),
    "LibRaw DHT": partial(libraw, algorithm=rawpy.DemosaicAlgorithm.DHT),
}


def exposed(folder: Path, who: str, blur_px: float) -> tuple[Path, Sensor, np.ndarray, np.ndarray]:
    """A person's full light as a DNG: its path, sensor, clean light, and where it is compared."""
    root = session(person(who))
    light = np.maximum(read_exr(root / "frames" / "full" / f"{CAMERA}.exr"), 0)
    mask = ProcessedFolder(root.with_name("session.truth")).read_mask(CAMERA)
    peak = np.percentile(light[mask], 99, axis=0)
    if blur_px:
        light = cv2.GaussianBlur(light, (0, 0), blur_px)
    sensor = make_sensor(SensorConfig(), peak, np.random.default_rng(0))
    counts = sensor.expose(light, np.random.default_rng(1))
    path = folder / f"{who}.dng"
    path.write_bytes(dng_bytes(counts, sensor, EXIF))
    # From the balanced clip of LibRaw on, beside the sensor's own.
    raw = light @ sensor.raw_from_linear.T
    balanced = (raw / sensor.raw_from_linear.sum(axis=1)).max(axis=2)
    full = (raw.max(axis=2) > 0.95) | (balanced > 0.95 / sensor.raw_from_linear.sum(axis=1).max())
    near = cv2.dilate(full.astype(np.uint8), np.ones((2 * FAR_PX + 1, 2 * FAR_PX + 1))) > 0
    return path, sensor, light, mask & ~near


def errors(folder: Path) -> dict[str, list[float]]:
    """Method to RMS errors of linear rgb, one for each person and blur."""
    out: dict[str, list[float]] = {name: [] for name in METHODS}
    for blur in BLURS_PX:
        for who in WHO:
            path, sensor, light, where = exposed(folder, who, blur)
            for name, method in METHODS.items():
                off = method(path, sensor, None)[where].astype(float) - light[where]
                out[name].append(float(np.sqrt(np.mean(off**2))))
    return out


def seconds(folder: Path) -> dict[str, tuple[float, float]]:
    """Method to processor and wall seconds for 24 MP: ours on the window that it finds."""
    path, sensor, light, _ = exposed(folder, WHO[0], 0.0)
    large = cv2.resize(light, None, fx=4, fy=4, interpolation=cv2.INTER_LINEAR)
    path.write_bytes(dng_bytes(sensor.expose(large, np.random.default_rng(2)), sensor, EXIF))
    raw = open_raw(path)
    window = find_window(*preview(raw), raw.shape, 0.03)
    raw.close()
    calls: dict[str, tuple[Method, Window | None]] = {
        "ours, the face's window": (ours, window),
        **{name: (method, None) for name, method in METHODS.items()},
    }
    out = {}
    for name, (method, part) in calls.items():
        method(path, sensor, part)
        found = []
        for _ in range(3):
            wall, own = time.perf_counter(), time.process_time()
            method(path, sensor, part)
            found.append((time.process_time() - own, time.perf_counter() - wall))
        out[name] = min(found)
    share = window.height * window.width / large[..., 0].size
    out[f"ours, the face's window ({100 * share:.0f} %)"] = out.pop("ours, the face's window")
    return out


def main() -> None:
    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory() as name:
        wrong, cost = errors(Path(name)), seconds(Path(name))
    best = wrong["ours"]
    rows: list[tuple[str, ...]] = []
    for method, (own, wall) in cost.items():
        found = wrong.get(method, best if method.startswith("ours") else [])
        ratio = np.mean([x / y for x, y in zip(found, best, strict=True)])
        cells = [f"{1000 * value:.2f}" for value in found]
        ours_s = next(iter(v for k, v in cost.items() if k.startswith("ours, the")))[0]
        rows.append(
            (method, *cells, f"{ratio:.2f}", f"{own:.2f} / {wall:.2f}", f"{own / ours_s:.1f}")
        )
    header = [f"{who}, blur {blur:g} px" for blur in BLURS_PX for who in WHO]
    record(
        "Demosaic of faces",
        ("method", *header, "error, ratio to ours", "24 MP: own / wall s", "seconds, ratio"),
        rows,
        "RMS error of linear rgb in thousandths (white = 1) on the face at 1504 x 1004, the "
        "simulated sensor's noise at ISO 100. Ours and OpenCV in one thread, LibRaw in its own.",
    )


if __name__ == "__main__":
    main()
