"""Cameras found from photographs of a person alone: pose, scale, and the mesh they give.

Run `python -m benchmarks.geometry_motion`. Each person's nine photographs under `full`, with pixel
noise, are given to `lightstage.poses_from_photos` without any rig; the scale comes from one length:
the distance of two cameras as it is, or that of two landmarks that were clicked a pixel off. Errors
are those left after the turn and shift that photographs cannot show; a wrong scale counts. --mesh
reconstructs a person with these cameras, beside those measured from boards.
"""

from __future__ import annotations

import argparse
import dataclasses
import resource
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.geometry_case import Case, timed
from benchmarks.geometry_people import PEOPLE, person, session
from benchmarks.geometry_poses import errors, true_rig
from benchmarks.geometry_scores import score
from benchmarks.record import record
from benchmarks.reflectance_people import NOISE, SCALE
from lightstage.formats.exr import read_exr, write_exr
from lightstage.formats.landmarks import read_points_mm
from lightstage.formats.session import load_session
from lightstage.poses_from_photos.cameras import FoundCameras, find_cameras
from lightstage.poses_from_photos.lengths import Length
from lightstage.poses_from_photos.points import read_clicks
from lightstage.rig import Rig
from processing.reconstruction.config import ReconstructConfig
from sim.session import truth_path

VIEWS = {
    "nine": tuple(f"cam{k}" for k in range(9)),
    "five on the equator": ("cam0", "cam1", "cam2", "cam3", "cam4"),
    "three frontal": ("cam0", "cam1", "cam2"),
}
OUTER_CORNERS = (36, 45)
Row = tuple[object, ...]


def photographs(name: str, out: Path) -> dict[str, Path]:
    """A person's photographs under `full` with pixel noise, by camera."""
    known = person(name)
    session_ = load_session(session(known))
    found = {}
    for index, camera in enumerate(session_.camera_ids()):
        light = read_exr(session_.frame_path(session_.frame("full", camera)))
        noise = np.random.default_rng([known.seed, index]).normal(0, NOISE, light.shape)
        found[camera] = out / f"{camera}.exr"
        write_exr(found[camera], light + noise.astype(np.float32))
    return found


def by_cameras(rig: Rig) -> Length:
    """The true distance of the first camera from the last."""
    first, last = rig.cameras[0], rig.cameras[-1]
    apart = float(np.linalg.norm(first.centre_mm - last.centre_mm))
    return Length(first.id, last.id, apart)


def by_landmarks(name: str) -> Length:
    """The true distance of the outer corners of a person's eyes."""
    marks = read_points_mm(truth_path(session(person(name))) / "landmarks_mm.json")
    first, second = OUTER_CORNERS
    return Length(str(first), str(second), float(np.linalg.norm(marks[first] - marks[second])))


def found_by(
    shots: dict[str, Path], rig: Rig, length: Length, name: str
) -> tuple[FoundCameras, float]:
    """The cameras, and processor seconds of this process and of the solver's."""
    marks = read_clicks(session(person(name)) / "landmarks.json")
    before = _spent_s()
    found = find_cameras(shots, rig.lights, [length], landmarks=marks)
    return found, _spent_s() - before


def row(who: str, by: str, found: FoundCameras, rig: Rig, spent_s: float) -> Row:
    """One row of the table."""
    pixels, degrees, apart = errors(found.rig.cameras, rig)
    focal = np.mean(
        [c.fx_px / t.fx_px for c, t in zip(found.rig.cameras, rig.cameras, strict=True)]
    )
    return (
        who,
        by,
        found.facts["points"],
        f"{found.facts['residual_px']:.2f}",
        f"{np.median(pixels):.2f} / {pixels.max():.2f}",
        f"{np.median(degrees):.3f} / {degrees.max():.3f}",
        f"{np.median(apart):.2f} / {apart.max():.2f}",
        f"{100 * (scale_of(found.rig, rig) - 1):+.2f}",
        f"{100 * (focal - 1):+.2f}",
        f"{spent_s:.1f}",
    )


def scale_of(found: Rig, true: Rig) -> float:
    """Spread of the cameras' places as a share of the true one."""
    spreads = []
    for rig in (found, true):
        places = np.array([camera.centre_mm for camera in rig.cameras])
        spreads.append(np.linalg.norm(places - places.mean(axis=0)))
    return float(spreads[0] / spreads[1])


def rows_of(name: str) -> Iterator[Row]:
    """All rows of a person."""
    whole = true_rig(SCALE)
    with tempfile.TemporaryDirectory() as place:
        shots = photographs(name, Path(place))
        for views, chosen in VIEWS.items():
            rig = dataclasses.replace(whole, cameras=tuple(whole.camera(c) for c in chosen))
            own = {camera: shots[camera] for camera in chosen}
            found, spent = found_by(own, rig, by_cameras(rig), name)
            yield row(f"{name}, {views}", "two cameras' distance", found, rig, spent)
            if views != "nine":
                continue
            found, spent = found_by(own, rig, by_landmarks(name), name)
            yield row(f"{name}, {views}", "two clicked landmarks", found, rig, spent)


def mesh_rows(name: str) -> Iterator[Row]:
    """Meshes with cameras that were found, and with those measured from boards."""
    config = ReconstructConfig()
    with tempfile.TemporaryDirectory() as place:
        rig = true_rig(SCALE)
        found, _ = found_by(photographs(name, Path(place)), rig, by_cameras(rig), name)
    for by, label, cameras in (
        ("boards", "", None),
        ("photographs alone", "-motion", found.rig.cameras),
    ):
        case = Case(name, cameras=cameras, label=label)
        got = score(case.mesh_placed(timed(*case.views(config), config)[1]), case.skin)
        yield (
            name,
            by,
            f"{got.to_truth[0]:.3f} / {got.to_truth[1]:.2f}",
            f"{got.to_mesh[0]:.3f} / {got.to_mesh[1]:.2f}",
            f"{100 * got.within:.1f} ({100 * got.within_two:.1f})",
            f"{got.normals_deg[0]:.2f} / {got.normals_deg[1]:.2f}",
        )


def _spent_s() -> float:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)


def main() -> None:
    """Measure, and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--people", default=",".join(known.name for known in PEOPLE))
    parser.add_argument("--mesh", help="A person to reconstruct; no table of cameras then.")
    chosen = parser.parse_args()
    if chosen.mesh:
        record(
            "Geometry: a mesh with cameras found from photographs",
            (
                "person",
                "cameras by",
                "mesh to truth: median / p95, mm",
                "true skin to mesh: median / p95, mm",
                "skin within .5 mm, % (seen by two)",
                "normals: mean / median, deg",
            ),
            list(mesh_rows(chosen.mesh)),
            "Nine views of 1004 x 1504, pixel noise .001; fitted to the truth by turn and shift, "
            "scale as it came from the distance of two cameras.",
        )
        return
    record(
        "Geometry: cameras found from photographs alone",
        (
            "person, views",
            "scale by",
            "points",
            "residual, px",
            "places nobody saw, px off: median / worst camera",
            "turned, deg",
            "centre, mm",
            "scale, %",
            "focal length, %",
            "processor, s",
        ),
        [each for name in chosen.people.split(",") for each in rows_of(name)],
        f"Photographs under `full` of 1004 x 1504, pixel noise {NOISE}, no rig and no EXIF. After "
        "the turn and shift that photographs cannot show.",
    )


if __name__ == "__main__":
    main()
