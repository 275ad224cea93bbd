"""What skips of the matcher save, and how far apart the surfaces are with and without them.

`python -m benchmarks.geometry_skips --person plain`, `--rows 1600 --only converged` for one skip at
full size. Each is matched twice: with the skip as the stage has it, and without. Depths apart: the
share of pixels, within the eroded foreground, that differ by more than a twentieth of a pixel's
disparity. Surfaces apart: along the true skin's normals, where both have a surface. `--twice` asks
what a second call with unchanged inputs takes, through the pipeline.
"""

from __future__ import annotations

import argparse
import dataclasses
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from benchmarks import reflectance_people
from benchmarks.geometry_case import Case
from benchmarks.geometry_people import PEOPLE
from benchmarks.geometry_scores import Surface
from benchmarks.record import record
from lightstage.formats.template import default_template_path
from processing import pipeline, pipeline_config
from processing.frames.read import read_frames
from processing.lighting.lights import PatternLights
from processing.reconstruction.config import ReconstructConfig
from processing.reconstruction.small_views import matched_times, small_view
from processing.reconstruction.stereo import make_stereo, match_views, pick_sources
from processing.reconstruction.two_passes import reconstruct_in_two_rounds
from processing.reconstruction.views import (
    Level,
    View,
    common_basis,
    finest_level,
    make_view,
    pictures_of,
)

SAME_PX = 0.05
FAR_MM = 0.1
TWICE = "tone3-old"
SKIPS = ("converged", "background", "behind", "blind")

Found = tuple[Level, list[np.ndarray], list[np.ndarray]]


def timed(views: Sequence[View], config: ReconstructConfig) -> tuple[Found, float]:
    """Depths and processor seconds."""
    start = time.process_time()
    found = match_views(views, config)
    return found, time.process_time() - start


def apart(one: Found, two: Found, views: Sequence[View], config: ReconstructConfig) -> float:
    """Share of foreground pixels on which two runs differ."""
    cameras = [view.camera for view in views]
    sources = pick_sources(cameras, [True] * len(views), config)
    differ, count = 0, 0
    for index, chosen in enumerate(sources):
        step = float(make_stereo(one[0], index, chosen, config).step)
        inside = cv2.erode(one[0].masks[index].astype(np.uint8), np.ones((7, 7))) > 0
        off = np.abs(one[1][index] - two[1][index]) > SAME_PX * step
        differ += int((off & inside).sum())
        count += int(inside.sum())
    return differ / count


class Surfaces:
    """Surfaces of one person, compared along the true skin's normals."""

    def __init__(self, case: Case, config: ReconstructConfig, lights: PatternLights) -> None:
        """Take what all have in common."""
        self.case, self.config, self.lights = case, config, lights

    def offsets(self, found: Found, views: Sequence[View]) -> tuple[np.ndarray, float]:
        """(n,) mm that true skin is above the surface, NaN where there is none; its share within
        half a millimetre of it.

        Background that was matched is left out: the question is the skin. Second looks are alike.
        """
        level, depths, costs = found
        masks = finest_masks(views, level)
        seen = dataclasses.replace(level, masks=masks)
        kept = [np.where(mask, depth, 0) for mask, depth in zip(masks, depths, strict=True)]
        mesh = self.case.mesh_placed(
            reconstruct_in_two_rounds(views, (seen, kept, costs), self.config, self.lights)[2]
        )
        surface, skin = Surface(mesh), self.case.skin
        within = float((surface.nearest(skin.places)[0] < 0.5).mean())
        return surface.signed(skin.places, skin.normals), within


def finest_masks(views: Sequence[View], level: Level) -> np.ndarray:
    """(views, h, w) bool, the foreground of views at a level's size."""
    return pictures_of(views, level.masks.shape[1]).masks[: len(level.masks)]


def called_twice(name: str) -> list[tuple[object, ...]]:
    """Seconds of `run --until reconstruct` on three views of a person, first and again."""
    path = reflectance_people.session(reflectance_people.person(name))
    rows: list[tuple[object, ...]] = []
    with tempfile.TemporaryDirectory() as place:
        for what in ("first", "second, nothing changed", "third, [reconstruct] trim_mm changed"):
            config = pipeline_config.read_config(None)
            if "third" in what:
                changed = dataclasses.replace(config.reconstruct, trim_mm=2.5)
                config = dataclasses.replace(config, reconstruct=changed)
            start, spent = time.perf_counter(), time.process_time()
            report = pipeline.run(
                path, Path(place), default_template_path(), config, until="reconstruct"
            )
            took = time.process_time() - spent, time.perf_counter() - start
            ran = " ".join(report["ran"]) or "nothing"
            rows.append((what, ran, *(f"{each:.1f}" for each in took)))
            print(*rows[-1], flush=True)
    return rows


def unmasked(case: Case, views: Sequence[View], config: ReconstructConfig) -> list[View]:
    """Views in which every pixel is foreground."""
    small = []
    times = matched_times(case.session.rig.cameras[0].height_px, config.finest_rows)
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
    parser.add_argument("--rows", type=int, default=400, help="The pictures are halved to so many.")
    parser.add_argument("--only", choices=SKIPS, action="append")
    parser.add_argument("--twice", action="store_true")
    given = parser.parse_args()
    name, only = given.person, given.only or SKIPS
    if given.twice:
        record(
            "Geometry: unchanged inputs are not worked on again",
            ("call", "stages that ran", "processor s", "s"),
            called_twice(TWICE),
            f"{TWICE}, `run --until reconstruct` of three views of 1004 x 1504; every photograph's "
            "hash is checked each time.",
        )
        return
    case = Case(name)
    config = dataclasses.replace(ReconstructConfig(), finest_rows=given.rows)
    views, lights = case.views(config)
    surfaces = Surfaces(case, config, lights)
    timed(views, dataclasses.replace(config, finest_rows=100))  # compiled before the clock starts
    usual, usual_s = timed(views, config)
    usual_mm, usual_within = surfaces.offsets(usual, views)
    rows: list[tuple[object, ...]] = []

    def add(what: str, other: Found, without_s: float, ours: Found, with_s: float) -> None:
        some = views[: len(ours[1])]
        share = 100 * apart(ours, other, some, config)
        here, within = (usual_mm, usual_within) if ours is usual else surfaces.offsets(ours, some)
        there, without = surfaces.offsets(other, some)
        both = np.isfinite(here) & np.isfinite(there)
        off = np.abs(here - there)[both]
        rows.append(
            (
                what,
                f"{without_s:.1f}",
                f"{with_s:.1f}",
                f"{100 * (1 - with_s / without_s):.0f}",
                f"{share:.2f}",
                f"{np.median(off):.4f} / {np.percentile(off, 95):.3f}",
                f"{100 * (off > FAR_MM).mean():.2f}",
                f"{np.nanmedian(np.abs(there)):.4f} / {np.nanmedian(np.abs(here)):.4f}",
                f"{100 * without:.2f} / {100 * within:.2f}",
            )
        )
        print(*rows[-1], flush=True)

    if "converged" in only:
        all_try = dataclasses.replace(config, still_px=0.0)
        add("depths that have come to rest", *timed(views, all_try), usual, usual_s)
    if "background" in only:
        every = timed(unmasked(case, views, config), config)
        add("pixels outside the foreground", *every, usual, usual_s)
    if "behind" in only:
        grazing = dataclasses.replace(config, min_cosine=-1.0)
        add("views that see a patch from behind", *timed(views, grazing), usual, usual_s)
    if "blind" in only:
        blind = [
            dataclasses.replace(v, textures=np.full_like(v.textures, np.nan)) if k > 6 else v
            for k, v in enumerate(views)
        ]
        without = timed(views[:7], config)
        (level, depths, costs), with_s = timed(blind, config)
        fields = {f.name: getattr(level, f.name)[:7] for f in dataclasses.fields(level)}
        cut = Level(**fields), depths[:7], costs[:7]
        add("views that show nothing (2 of 9, beside 7 alone)", *without, cut, with_s)
    height, width = finest_level(views).masks.shape[1:]
    size = usual[0].masks.shape[1]
    record(
        f"Geometry: what each skip saves, {size} rows",
        (
            "skipped",
            "processor s without",
            "processor s with",
            "saved, %",
            f"pixels more than {SAME_PX} px of disparity apart, %",
            "surfaces apart, mm: median / p95",
            f"more than {FAR_MM} mm, %",
            "true skin to surface, mm, median: without / with",
            "skin within .5 mm, %: without / with",
        ),
        rows,
        f"{name}, matching alone is timed; nine views of {width} x {height} at {size} rows.",
    )


if __name__ == "__main__":
    main()
