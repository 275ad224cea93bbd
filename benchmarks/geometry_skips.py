"""What skips of the matcher save, and that they change nothing that counts.

`python -m benchmarks.geometry_skips --person plain`. Each is matched twice, coarsely: with the skip
as the stage has it, and without. Results apart: the share of pixels, within the eroded foreground,
whose depth differs by more than a twentieth of a pixel's disparity.
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from collections.abc import Sequence

import cv2
import numpy as np

from benchmarks.geometry_case import Case
from benchmarks.geometry_people import PEOPLE
from benchmarks.record import record
from processing.frames.read import read_frames
from processing.reconstruction.config import ReconstructConfig
from processing.reconstruction.small_views import matched_times, small_view
from processing.reconstruction.stereo import make_stereo, match_views, pick_sources
from processing.reconstruction.views import Level, View, common_basis, finest_level, make_view

CONFIG = dataclasses.replace(ReconstructConfig(), finest_rows=200)
SAME_PX = 0.05

Found = tuple[Level, list[np.ndarray], list[np.ndarray]]


def timed(views: Sequence[View], config: ReconstructConfig) -> tuple[Found, float]:
    """Depths and processor seconds."""
    start = time.process_time()
    found = match_views(views, config)
    return found, time.process_time() - start


def apart(one: Found, two: Found, views: Sequence[View]) -> float:
    """Share of foreground pixels on which two runs differ."""
    cameras = [view.camera for view in views]
    sources = pick_sources(cameras, [True] * len(views), CONFIG)
    differ, count = 0, 0
    for index, chosen in enumerate(sources):
        step = float(make_stereo(one[0], index, chosen, CONFIG).step)
        inside = cv2.erode(one[0].masks[index].astype(np.uint8), np.ones((7, 7))) > 0
        off = np.abs(one[1][index] - two[1][index]) > SAME_PX * step
        differ += int((off & inside).sum())
        count += int(inside.sum())
    return differ / count


def unmasked(case: Case, views: Sequence[View]) -> list[View]:
    """Views in which every pixel is foreground."""
    small = []
    times = matched_times(case.session.rig.cameras[0].height_px, CONFIG.finest_rows)
    for name in case.session.camera_ids():
        frames = read_frames(case.out, name)
        normals = np.zeros((*frames.shape, 3), np.float32)
        every = np.ones(frames.shape, bool)
        small.append(small_view(case.session.rig.camera(name), frames, every, normals, times))
    basis = common_basis([s.images for s in small], [v.mask for v in views])
    return [
        make_view(s.camera, s.images, s.valid, s.mask, v.normals, basis)
        for s, v in zip(small, views, strict=True)
    ]


def main() -> None:
    """Measure, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--person", default="plain", choices=[known.name for known in PEOPLE])
    name = parser.parse_args().person
    case = Case(name)
    views, _ = case.views(CONFIG)
    timed(views, CONFIG)  # compiled before the clock starts
    usual, usual_s = timed(views, CONFIG)
    rows: list[tuple[object, ...]] = []

    def add(what: str, other: Found, without_s: float, ours: Found, with_s: float) -> None:
        share = 100 * apart(ours, other, views[: len(ours[1])])
        saved = f"{100 * (1 - with_s / without_s):.0f}"
        rows.append((what, f"{without_s:.1f}", f"{with_s:.1f}", saved, f"{share:.2f}"))
        print(*rows[-1], flush=True)

    add("pixels outside the foreground", *timed(unmasked(case, views), CONFIG), usual, usual_s)
    grazing = dataclasses.replace(CONFIG, min_cosine=-1.0)
    add("views that see a patch from behind", *timed(views, grazing), usual, usual_s)
    blind = [
        dataclasses.replace(v, textures=np.full_like(v.textures, np.nan)) if k > 6 else v
        for k, v in enumerate(views)
    ]
    without = timed(views[:7], CONFIG)
    with_blind = timed(blind, CONFIG)
    level, depths, costs = with_blind[0]
    cut = level, depths[:7], costs[:7]
    add("views that show nothing (2 of 9, beside 7 alone)", *without, cut, with_blind[1])
    height, width = finest_level(views).masks.shape[1:]
    record(
        "Geometry: what each skip saves",
        (
            "skipped",
            "processor s without",
            "processor s with",
            "saved, %",
            f"pixels more than {SAME_PX} px of disparity apart, %",
        ),
        rows,
        f"{name}, matching alone, nine views of {width} x {height} at {CONFIG.finest_rows} rows at "
        "most. That unchanged inputs are not worked on again is the pipeline's doing.",
    )


if __name__ == "__main__":
    main()
