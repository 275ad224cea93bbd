"""Error maps of a foreign scene with clothes, neck included, with and without what casts shadows.

``python -m benchmarks.foreign_pictures`` makes docs/reflectance_foreign.jpg: two views of a scene,
each without the clothes in the scene (upper row) and with what `reconstruct` finds of them (lower).
"""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path

import cv2
import numpy as np

from benchmarks.foreign import ROWS
from benchmarks.foreign_cases import CASES
from benchmarks.foreign_session import session_of
from benchmarks.reflectance_people import folder
from lightstage.formats.exr import read_exr
from lightstage.formats.files import atomic_path
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.session import load_session
from lightstage.formats.template import default_template_path
from processing.colour import srgb_from_linear
from processing.evaluation.maps import angle_deg
from processing.pipeline import run
from processing.pipeline_config import PipelineConfig
from sim.session import truth_path

PICTURE = Path(__file__).parents[1] / "docs" / "reflectance_foreign.jpg"
CASE = "grey-collar"
VIEWS = ("cam0", "cam1")
ANGLE_ERROR_DEG, ALBEDO_ERROR = 10.0, 0.08
"""Errors that are drawn white."""
COLUMNS = 230
MARGIN_PX = 6


def main() -> None:
    """Make the maps and the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--case", default=CASE, choices=CASES)
    parser.add_argument("--rows", type=int, default=ROWS, help=f"of a picture [{ROWS}]")
    parser.add_argument("--keep", type=Path, default=folder() / "foreign", help="folder")
    parser.add_argument("--out", type=Path, default=PICTURE)
    arguments = parser.parse_args()
    session = session_of(CASES[arguments.case], arguments.case, arguments.rows, arguments.keep)
    strips = []
    for looked in (False, True):
        out = arguments.keep / "pictures" / f"{arguments.case}-{arguments.rows}-{looked}"
        how = dataclasses.replace(PipelineConfig().reconstruct, find_occluders=looked)
        config = dataclasses.replace(PipelineConfig(), reconstruct=how)
        run(session, out, default_template_path(), config, until="refine")
        caption = "with what was found of it" if looked else "clothes not in the scene"
        strips.append(strip(session, ProcessedFolder(out), caption))
    ok, data = cv2.imencode(
        arguments.out.suffix, np.concatenate(strips), [cv2.IMWRITE_JPEG_QUALITY, 85]
    )
    if not ok:
        raise OSError(f"{arguments.out}: cannot be encoded")
    with atomic_path(arguments.out) as beside:
        beside.write_bytes(data.tobytes())
    print(arguments.out)


def strip(session_path: Path, found: ProcessedFolder, caption: str) -> np.ndarray:
    """A titled row of pictures, BGR: of each view photograph, normal error, albedo error, trust."""
    true, session = ProcessedFolder(truth_path(session_path)), load_session(session_path)
    pictures, titles = [], []
    for camera in VIEWS:
        photograph = read_exr(session.frame_path(session.frame("full", camera)))
        skin = true.read_mask(camera)
        normal, albedo = (true.read_view(camera, f"diffuse_{x}") for x in ("normal", "albedo"))
        turned = np.zeros(skin.shape)
        turned[skin] = angle_deg(found.read_view(camera, "diffuse_normal")[skin], normal[skin])
        off = np.abs(found.read_view(camera, "diffuse_albedo") - albedo).mean(axis=2)
        lit = srgb_from_linear(np.clip(photograph / np.quantile(photograph, 0.998), 0, 1))
        grey = (turned / ANGLE_ERROR_DEG, off / ALBEDO_ERROR, found.read_view(camera, "confidence"))
        shown = [lit, *(np.repeat(np.where(skin, x, 0.15)[..., None], 3, axis=2) for x in grey)]
        rows, columns = (np.flatnonzero(skin.any(axis=axis)) for axis in (1, 0))
        part = tuple(
            slice(max(x[0] - MARGIN_PX, 0), x[-1] + 4 * MARGIN_PX) for x in (rows, columns)
        )
        pictures += [_sized(picture[part]) for picture in shown]
        titles += [
            f"{camera}, {caption}",
            f"normals off, white {ANGLE_ERROR_DEG:g} deg",
            f"albedo off, white {ALBEDO_ERROR:g}",
            "confidence",
        ]
    height = max(len(picture) for picture in pictures)
    padded = [np.pad(p, ((0, height - len(p)), (0, 0), (0, 0))) for p in pictures]
    band = np.zeros((20, COLUMNS * len(padded), 3), np.uint8)
    for k, title in enumerate(titles):
        place = (k * COLUMNS + 4, 14)
        cv2.putText(band, title, place, cv2.FONT_HERSHEY_SIMPLEX, 0.37, (255,) * 3, 1, cv2.LINE_AA)
    return np.concatenate([band, np.concatenate(padded, axis=1)])


def _sized(picture: np.ndarray) -> np.ndarray:
    size = (COLUMNS, round(picture.shape[0] * COLUMNS / picture.shape[1]))
    small = cv2.resize(
        np.clip(picture, 0, 1).astype(np.float32), size, interpolation=cv2.INTER_AREA
    )
    return np.asarray((small[..., ::-1] * 255).round().astype(np.uint8))


if __name__ == "__main__":
    main()
