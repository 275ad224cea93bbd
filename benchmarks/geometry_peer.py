"""The peer of `reconstruct`: OpenCV's SGBM on rectified pairs, tuned, with our own fusion.

`python -m benchmarks.geometry_peer --person lps` tunes it: one parameter after the other, on one
pair of views from brows to chin, by the share of skin pixels whose point is within .5 mm of the
truth. `Sgbm` holds what came out; both then get the same photographs, masks, cameras, consistency
and fusion.
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.geometry_case import Case
from benchmarks.geometry_people import PEOPLE
from benchmarks.geometry_scores import Surface
from benchmarks.record import record
from lightstage.formats.session import Session
from lightstage.rig import Camera
from processing.frames.read import Frames, read_foreground, read_frames
from processing.reconstruction.config import ReconstructConfig
from processing.reconstruction.poses import tone_mapped
from processing.reconstruction.small_views import of_cells, smaller_picture
from processing.reconstruction.stereo import focus_point
from processing.reconstruction.views import Level, View, pyramid

# Neighbours whose epipolar lines cover the head from all sides, as PEERS' figure used.
PAIRS = ((0, 1), (0, 2), (1, 3), (2, 4), (0, 5), (0, 6), (5, 7), (5, 8))
REACH_MM = 130.0
NEAR_MM = 0.5
BAND = (0.35, 0.6)
"""Tuned on this part of the height: from the brows to the chin."""
MODES = {
    "HH": cv2.STEREO_SGBM_MODE_HH,
    "HH4": cv2.STEREO_SGBM_MODE_HH4,
    "3WAY": cv2.STEREO_SGBM_MODE_SGBM_3WAY,
}


@dataclasses.dataclass(frozen=True)
class Sgbm:
    """Parameters of OpenCV's matcher, as tuned; but for small components, which are dropped.

    Points were within .5 mm on most pixels with all of them kept, with 5 % of points more than
    11 mm off.

    Attributes:
        times: pictures are matched smaller by this factor.
        block: side of the block, px.
        smooth: P1 is this times block^2, P2 four times as much.
        unique: margin of the best disparity, %.
        mode: of MODES.
        prefilter: cap of the Sobel picture that is matched; 0 matches grey values.
        speckle: components smaller than this are dropped, px.
    """

    times: int = 1
    block: int = 3
    smooth: float = 8.0
    unique: int = 0
    mode: str = "HH"
    prefilter: int = 63
    speckle: int = 100


ASKED: dict[str, tuple[Any, ...]] = {
    "times": (1, 2),
    "block": (3, 5, 7, 11),
    "smooth": (2.0, 8.0, 24.0),
    "prefilter": (0, 15, 63),
    "unique": (0, 5, 10),
    "mode": ("HH", "HH4", "3WAY"),
    "speckle": (0, 100, 400),
}


@dataclasses.dataclass(frozen=True)
class Shown:
    """A view as SGBM takes it: straightened, grey, 8 bits."""

    camera: Camera
    picture: np.ndarray
    mask: np.ndarray


def shown(camera: Camera, frames: Frames, mask: np.ndarray, times: int) -> Shown:
    """The brightest photograph of a view, toned, without lens distortion."""
    picture = tone_mapped(frames.image(frames.patterns.index("full")), mask)
    lens, dist = camera.opencv_matrix, np.array(camera.dist)
    picture = cv2.undistort(picture, lens, dist)
    inside = cv2.undistort(mask.astype(np.uint8), lens, dist) > 0
    small, inside = smaller_picture(picture, inside, times)
    straight = dataclasses.replace(camera, dist=(0.0,) * 5)
    if times > 1:
        straight = of_cells(straight, times)
        height, width = inside.shape
        straight = dataclasses.replace(straight, width_px=width, height_px=height)
    return Shown(straight, small, inside)


def rectify(one: Camera, two: Camera, focus: np.ndarray) -> np.ndarray:
    """(3, 3) axes of the rectified pair from the world; picture rows run along the baseline."""
    baseline = two.centre_mm - one.centre_mm
    x = baseline / np.linalg.norm(baseline)
    forward = focus - 0.5 * (one.centre_mm + two.centre_mm)
    y = np.cross(forward, x)
    y /= np.linalg.norm(y)
    return np.stack([x, y, np.cross(x, y)])


def pair_points(
    one: Shown,
    two: Shown,
    focus: np.ndarray,
    sgbm: Sgbm,
    band: tuple[float, float] = (0.0, 1.0),
) -> tuple[np.ndarray, int]:
    """World points (n, 3) of the first view's mask, by SGBM with a left-right check.

    The virtual lenses are shifted so that the point the cameras look at has disparity 0.

    Args:
        one, two: the views.
        focus: (3,) the point.
        sgbm: parameters.
        band: the part of the rectified pictures' height that is matched.

    Returns:
        The points, and how many pixels of the mask were asked.
    """
    rotation = rectify(one.camera, two.camera, focus)
    size = (int(1.25 * one.camera.width_px), one.camera.height_px)
    lens, warped = one.camera.fx_px, []
    centres = [view.camera.centre_mm for view in (one, two)]
    local = [rotation @ (focus - centre) for centre in centres]
    middle = [(size[0] / 2 - lens * p[0] / p[2], size[1] / 2 - lens * p[1] / p[2]) for p in local]
    for view, (cx, cy) in zip((one, two), middle, strict=True):
        new = np.array([[lens, 0, cx], [0, lens, cy], [0, 0, 1]])
        turn = rotation @ view.camera.cam_from_world[:, :3].T
        homography = new @ turn @ np.linalg.inv(view.camera.matrix)
        half = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
        homography = np.linalg.inv(half) @ homography @ half
        warped.append(cv2.warpPerspective(view.picture, homography, size, flags=cv2.INTER_CUBIC))
        warped.append(cv2.warpPerspective(view.mask.astype(np.uint8), homography, size))
    baseline = float(np.linalg.norm(centres[1] - centres[0]))
    depth = float(local[0][2])
    near = lens * baseline * (1 / (depth - REACH_MM) - 1 / depth)
    far = lens * baseline * (1 / (depth + REACH_MM) - 1 / depth)
    count = 16 * int(np.ceil((near - far) / 16))
    matcher = cv2.StereoSGBM.create(
        minDisparity=int(np.floor(far)),
        numDisparities=count,
        blockSize=sgbm.block,
        P1=round(sgbm.smooth * sgbm.block**2),
        P2=round(4 * sgbm.smooth * sgbm.block**2),
        disp12MaxDiff=1,
        preFilterCap=sgbm.prefilter,
        uniquenessRatio=sgbm.unique,
        speckleWindowSize=sgbm.speckle,
        speckleRange=2,
        mode=MODES[sgbm.mode],
    )
    top, bottom = (round(share * size[1]) for share in band)
    rows = np.flatnonzero(warped[1][top:bottom].any(axis=1))
    if not len(rows):
        return np.zeros((0, 3)), 0
    top, bottom = top + int(rows[0]), top + int(rows[-1]) + 1
    warped = [layer[top:bottom] for layer in warped]
    # Disparities near the picture's edge need columns beyond it; they are around 0.
    pad = 16 + round(max(near, -far))
    left, right = (cv2.copyMakeBorder(w, 0, 0, pad, pad, cv2.BORDER_CONSTANT) for w in warped[::2])
    disparity = matcher.compute(left, right)[:, pad:-pad].astype(np.float32) / 16
    row, column = np.nonzero((disparity > far) & (warped[1] > 0))
    found = disparity[row, column]
    z = lens * baseline / (found + lens * baseline / depth)
    (cx, cy) = middle[0]
    x, y = (column + 0.5 - cx) / lens * z, (top + row + 0.5 - cy) / lens * z
    points = np.stack([x, y, z], axis=1) @ rotation + centres[0]
    return points, int(np.count_nonzero(warped[1]))


def splat(points: np.ndarray, level: Level, index: int) -> np.ndarray:
    """(h, w) inverse depth of points in one view at a level: the median of each pixel's.

    The nearest one would be too near by the points' noise.
    """
    pose, (fx, fy, cx, cy) = level.poses[index], level.lenses[index]
    local = points @ pose[:, :3].T + pose[:, 3]
    height, width = level.masks.shape[1:]
    column = np.floor(fx * local[:, 0] / local[:, 2] + cx).astype(int)
    row = np.floor(fy * local[:, 1] / local[:, 2] + cy).astype(int)
    inside = (row >= 0) & (column >= 0) & (row < height) & (column < width)
    pixel, near = (row * width + column)[inside], (1 / local[inside, 2]).astype(np.float32)
    order = np.lexsort((near, pixel))
    which, first, count = np.unique(pixel[order], return_index=True, return_counts=True)
    out = np.zeros(height * width, np.float32)
    out[which] = near[order][first + count // 2]
    out = out.reshape(height, width)
    out[~level.masks[index]] = 0
    return out


def shown_views(session: Session, out: Path, times: int) -> list[Shown]:
    """All views of a processed folder as SGBM takes them."""
    return [
        shown(session.rig.camera(name), read_frames(out, name), read_foreground(out, name), times)
        for name in session.camera_ids()
    ]


def peer_depths(
    session: Session, out: Path, views: list[View], config: ReconstructConfig, sgbm: Sgbm
) -> tuple[Level, list[np.ndarray], list[np.ndarray]]:
    """SGBM's depth maps of all views, on the level that ours end at."""
    level = pyramid(views, config.finest_rows, config.coarsest_rows)[-1]
    seen = shown_views(session, out, sgbm.times)
    focus = focus_point([view.camera for view in seen])
    clouds: list[list[np.ndarray]] = [[] for _ in views]
    for first, second in PAIRS:
        points = pair_points(seen[first], seen[second], focus, sgbm)[0]
        clouds[first].append(points)
        clouds[second].append(points)
    depths = [splat(np.concatenate(c), level, k) for k, c in enumerate(clouds)]
    costs = [np.where(depth > 0, 0.2, 2.0).astype(np.float32) for depth in depths]
    return level, depths, costs


def tune(case: Case) -> tuple[Sgbm, list[tuple[object, ...]]]:
    """The best parameters, sought one after the other, and a row for each that was tried."""
    surface = Surface(case.skin.mesh)
    best, best_share = Sgbm(block=5, unique=5, prefilter=0), -1.0
    rows: list[tuple[object, ...]] = []
    tried: set[Sgbm] = set()
    for name, values in ASKED.items():
        for value in values:
            candidate = dataclasses.replace(best, **{name: value})
            if candidate in tried:
                continue
            tried.add(candidate)
            seen = shown_views(case.session, case.out, candidate.times)[:2]
            focus = focus_point(list(case.session.rig.cameras))
            start = time.process_time()
            points, pixels = pair_points(seen[0], seen[1], focus, candidate, BAND)
            seconds = time.process_time() - start
            some = case.placed(points)[:: max(1, len(points) // 50_000)]
            off = surface.nearest(some)[0]
            share = float((off < NEAR_MM).mean()) * len(points) / pixels
            cells = [f"{getattr(candidate, key)}" for key in ASKED]
            rows.append(
                (
                    *cells,
                    f"{np.median(off):.3f} / {np.percentile(off, 95):.2f}",
                    f"{100 * share:.1f}",
                    f"{seconds:.1f}",
                )
            )
            print(*rows[-1], flush=True)
            if share > best_share:
                best, best_share = candidate, share
    return best, rows


def main() -> None:
    """Tune on one person."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--person", default="lps", choices=[known.name for known in PEOPLE])
    name = parser.parse_args().person
    best, rows = tune(Case(name))
    header = (*ASKED, "points: median / p95, mm", f"skin within {NEAR_MM} mm, %", "processor, s")
    record(
        "Geometry: tuning the peer",
        header,
        rows,
        f"OpenCV SGBM, {name}, two views of 1004 x 1504, points as matched; each parameter is "
        f"kept at its best before the next is tried: {best}.",
    )


if __name__ == "__main__":
    main()
