"""Made-up RAW files: DNGs of known colours with any mosaic, black levels, orientation, exposure."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lightstage.formats.files import sha256_file
from lightstage.rig import Rig, save_rig
from sim.camera.tiff import ASCII, BYTE, LONG, RATIONAL, SHORT, SRATIONAL, Tags, tiff_bytes

BLACK, WHITE = 600, 15520
RGGB = np.array([[0, 1], [1, 2]])
X_TRANS = np.array(
    [
        [1, 1, 0, 1, 1, 2],
        [1, 1, 2, 1, 1, 0],
        [2, 0, 1, 0, 2, 1],
        [1, 1, 2, 1, 1, 0],
        [1, 1, 0, 1, 1, 2],
        [0, 2, 1, 2, 0, 1],
    ]
)
CFA, LINEAR_RAW = 32803, 34892
NEUTRAL = (1 / 2, 1.0, 2 / 3)


def counts_of(rgb: np.ndarray, mosaic: np.ndarray | None = RGGB) -> np.ndarray:
    """(h, w) uint16 counts of (h, w, 3) shares of white, or (h, w, 3) where there is no mosaic."""
    counts = np.rint(BLACK + rgb * (WHITE - BLACK))
    if mosaic is not None:
        rows, columns = np.indices(rgb.shape[:2])
        colours = mosaic[rows % len(mosaic), columns % mosaic.shape[1]]
        counts = np.take_along_axis(counts, colours[..., None], axis=2)[..., 0]
    return np.clip(counts, 0, 65535).astype(np.uint16)


def write_dng(
    path: Path,
    counts: np.ndarray,
    mosaic: np.ndarray | None = RGGB,
    exposure: tuple[float, int, float] | None = (1 / 60, 100, 8.0),
    more: Tags | None = None,
) -> Path:
    """A DNG that LibRaw reads.

    Args:
        path: where to.
        counts: (h, w) or (h, w, 3) uint16.
        mosaic: colours of the counts; None for three colours a pixel.
        exposure: seconds, ISO, f-number; None leaves them out.
        more: further tags, or other values of these.
    """
    height, width = counts.shape[:2]
    samples = 1 if mosaic is not None else 3
    tags: dict[int, tuple[int, object]] = {
        254: (LONG, 0),
        256: (LONG, width),
        257: (LONG, height),
        258: (SHORT, (16,) * samples),
        259: (SHORT, 1),
        262: (SHORT, CFA if mosaic is not None else LINEAR_RAW),
        271: (ASCII, "Made"),
        272: (ASCII, "Made up"),
        274: (SHORT, 1),
        277: (SHORT, samples),
        278: (LONG, height),
        284: (SHORT, 1),
        50706: (BYTE, (1, 4, 0, 0)),
        50707: (BYTE, (1, 1, 0, 0)),
        50708: (ASCII, "Made up"),
        50714: (SHORT, BLACK),
        50717: (LONG, WHITE),
        50721: (SRATIONAL, np.eye(3).ravel()),
        50728: (RATIONAL, NEUTRAL),
        50778: (SHORT, 21),
    }
    if mosaic is not None:
        tags |= {
            33421: (SHORT, mosaic.shape),
            33422: (BYTE, tuple(mosaic.ravel())),
            50710: (BYTE, (0, 1, 2)),
            50711: (SHORT, 1),
        }
    exif: dict[int, tuple[int, object]] = {36864: (BYTE, (48, 50, 51, 48))}
    if exposure is not None:
        time, iso, stop = exposure
        exif |= {33434: (RATIONAL, time), 34855: (SHORT, iso), 33437: (RATIONAL, stop)}
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(tiff_bytes(counts, tags | dict(more or {}), exif))
    return path


def gradient(height: int = 48, width: int = 64) -> np.ndarray:
    """(h, w, 3) smooth shares of white that no demosaic gets wrong."""
    rows, columns = np.mgrid[:height, :width]
    return np.stack(
        [0.3 + 0.2 * columns / width, 0.2 + 0.1 * rows / height, 0.1 + 0 * rows], axis=-1
    )


def write_raw_session(
    root: Path,
    rig: Rig,
    photographs: Mapping[str, Mapping[str, np.ndarray]],
    colour: Mapping[str, Any] | None = None,
    exposures: Mapping[str, tuple[float, int, float]] | None = None,
) -> Path:
    """A session of DNGs.

    Args:
        root: its folder.
        rig: whose cameras photographed.
        photographs: pattern to camera to (h, w, 3) shares of white.
        colour: content of its colour calibration; None for no calibration.
        exposures: by pattern, where not the usual one.
    """
    frames = []
    for pattern, cameras in photographs.items():
        for camera, rgb in cameras.items():
            path = root / "frames" / pattern / f"{camera}.dng"
            stated = (exposures or {}).get(pattern, (1 / 60, 100, 8.0))
            write_dng(path, counts_of(rgb), exposure=stated)
            frames.append(
                {
                    "pattern": pattern,
                    "camera": camera,
                    "path": str(path.relative_to(root)),
                    "sha256": sha256_file(path),
                    "encoding": "raw",
                }
            )
    save_rig(rig, root / "rig.json")
    if colour is not None:
        (root / "colour.json").write_text(json.dumps(colour))
    value = {
        "schema": "lightstage.session/1",
        "id": "made",
        "created_utc": "2000-01-01T00:00:00Z",
        "subject": "made",
        "expression": "neutral",
        "sequence": list(photographs),
        "frames": frames,
        "calibration": {
            "colour": None if colour is None else "colour.json",
            "cameras": None,
            "lights": None,
        },
    }
    (root / "session.json").write_text(json.dumps(value))
    return root


def replace_photograph(root: Path, pattern: str, camera: str, rgb: np.ndarray) -> None:
    """Take one of a session's photographs again."""
    path = root / "frames" / pattern / f"{camera}.dng"
    old = sha256_file(path)
    write_dng(path, counts_of(rgb))
    text = (root / "session.json").read_text()
    (root / "session.json").write_text(text.replace(old, sha256_file(path)))
