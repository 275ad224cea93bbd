"""What `reconstruct` takes for views of 24 megapixels: seconds, memory, and the error there.

`python -m benchmarks.geometry_large --person lps` takes a frontal triple, `--light direct` all nine
views. Photographs of 24 megapixels are matched at a quarter of their size, 1004 x 1504: here views
rendered at that size are matched as they are, which is the same work (a rendered one has the noise
of a single pixel in place of the mean of sixteen). What making 24 megapixels smaller takes is
measured on one view of that size, its photographs enlarged, and counted once a view. Run it alone:
the peak of memory is the process's.
"""

from __future__ import annotations

import argparse
import resource
import time

import cv2
import numpy as np

from benchmarks.geometry_case import Case
from benchmarks.geometry_people import PEOPLE
from benchmarks.geometry_scores import score
from benchmarks.record import record
from benchmarks.reflectance_people import SCALE
from lightstage.formats.processed import ProcessedFolder
from lightstage.rig import default_rig
from processing.frames.read import Frames, read_foreground, read_frames
from processing.reconstruction.config import ReconstructConfig
from processing.reconstruction.small_views import matched_times, small_view
from processing.reconstruction.stereo import match_views
from processing.reconstruction.twice import twice

CONFIG = ReconstructConfig()


def smaller_s(case: Case) -> tuple[float, int]:
    """Processor seconds in which one view's photographs of 24 megapixels are made smaller."""
    name = case.session.camera_ids()[0]
    camera = default_rig().camera(name)
    size = (camera.width_px, camera.height_px)
    frames = read_frames(case.out, name)
    large = np.stack([cv2.resize(frames.image(k), size) for k in range(len(frames.patterns))])
    mask = cv2.resize(read_foreground(case.out, name).astype(np.uint8), size) > 0
    normals = cv2.resize(ProcessedFolder(case.out).read_view(name, "diffuse_normal"), size)
    valid = cv2.resize(frames.valid.astype(np.uint8), size) > 0
    held = Frames.of(frames.patterns, large, valid)
    del large
    times = matched_times(camera.height_px, CONFIG.finest_rows)
    small_view(camera, held, mask, normals, times)  # compiled before the clock starts
    start = time.process_time()
    small_view(camera, held, mask, normals, times)
    return time.process_time() - start, times


def main() -> None:
    """Measure, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--person", default="lps", choices=[known.name for known in PEOPLE])
    parser.add_argument("--light", choices=("direct", "frontal-direct"), default="frontal-direct")
    chosen = parser.parse_args()
    name = chosen.person
    case = Case(name, chosen.light)
    count = len(case.session.camera_ids())
    rows: list[tuple[object, ...]] = []
    start, wall = time.process_time(), time.perf_counter()
    views, lights = case.views(CONFIG)
    depths = match_views(views, CONFIG)
    matched_s = time.process_time() - start
    mesh = twice(views, depths, CONFIG, lights)[2]
    whole_s, wall_s = time.process_time() - start, time.perf_counter() - wall
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    found = score(mesh=case.laid(mesh), skin=case.skin)
    del views, depths
    each_s, times = smaller_s(case)
    shape = f"{case.session.rig.cameras[0].width_px} x {case.session.rig.cameras[0].height_px}"
    for what, value in (
        (f"one view made {times} times smaller, processor s", f"{each_s:.1f}"),
        (f"{count} views, processor s", f"{count * each_s:.0f}"),
        (f"{count} views matched at {shape}, processor s", f"{matched_s:.0f}"),
        ("consistency, second look, fusion, processor s", f"{whole_s - matched_s:.0f}"),
        ("all, processor s", f"{whole_s + count * each_s:.0f}"),
        ("matching to mesh, wall s", f"{wall_s:.0f}"),
        ("peak of memory, matching to mesh, GiB", f"{peak:.1f}"),
        ("mesh to truth: median / p95, mm", "{:.3f} / {:.2f}".format(*found.to_truth)),
        ("true skin to mesh: median / p95, mm", "{:.3f} / {:.2f}".format(*found.to_mesh)),
        (
            "skin within .5 mm, % (seen by two)",
            f"{100 * found.within:.1f} ({100 * found.within_two:.1f})",
        ),
        ("normals: mean / median, deg", "{:.2f} / {:.2f}".format(*found.normals_deg)),
    ):
        rows.append((what, value))
    record(
        f"Geometry: {count} views of 24 megapixels",
        ("what", "value"),
        rows,
        f"{name}, light `{chosen.light}`, rendered {1 / SCALE:g} times smaller a side, "
        "matched at the size to which 24 megapixels are made smaller.",
    )


if __name__ == "__main__":
    main()
