"""What runs in its own process: `python -m lightstage.poses_from_photos.solver FOLDER`.

COLMAP's features, matches and incremental mapping [Schonberger2016], then a robust adjustment of
all. FOLDER holds job.json, pictures/CAMERA.png and masks/CAMERA.png.png; result.json is written
into it. COLMAP prints where it likes and ends the process where a check of its own fails:
`solving` starts it, and keeps both from the user.
"""

from __future__ import annotations

import dataclasses
import json
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from lightstage.formats.files import read_json
from lightstage.poses_from_photos.grouping import JobLens, Outcome, apart, best, parted

STARTS = (1.2, 3.0)
"""Focal lengths to begin with where none is known, as shares of the picture's longer side."""
PEAK_THRESHOLD = 0.002
"""SIFT's; skin shows little contrast, so a third of its usual value."""
MAX_RATIO = 0.85
LEAST_SEVERAL = 4
"""Cameras from which on several focal lengths are tried: three pictures do not determine three."""
LEAST_DISTORTED = 6
"""Cameras from which on distortion is fitted: of fewer it bends the surface instead."""
LONG, MOST_BENT, MOST_BENT_WIDE = 1.5, 0.02, 0.1
"""A lens of a focal length longer than this share of the picture's longer side moves corners by no
more than the first share, a wider one by no more than the second."""
LOSS_PX = 0.5
"""Scale of the last adjustment's loss (Cauchy): features are off by less, false matches by more."""


@dataclasses.dataclass
class _Try:
    """Lenses, and the scene that COLMAP made with them."""

    lenses: list[JobLens]
    scene: pycolmap.Reconstruction

    @property
    def outcome(self) -> Outcome:
        squares = np.array([off**2 for offs in _residuals(self.scene).values() for off in offs])
        cost = float(np.log1p(squares / LOSS_PX**2).mean()) if len(squares) else math.inf
        return Outcome(len(self.lenses), self.scene.num_reg_images(), len(squares), cost)


def solve(folder: Path, threads: int) -> dict[str, Any]:
    """Find cameras and points of the pictures in a folder.

    Args:
        folder: see above.
        threads: for matches; features and mapping take one, so that results repeat.

    Returns:
        pairs: [first, second, verified matches]; cameras: name to pose, parameters of its lens
        (focal length, principal point, k1), mean residual in px and count of its points; points:
        (n, 3); lenses: names of the cameras that share each; bent: name to the share by which its
        lens would move a corner, where that is no lens and distortion was left out; together_px:
        mean residual with one lens for each open one, where several were taken; doubted: what
        `_doubted` finds. Units of length are COLMAP's own.
    """
    job = read_json(folder / "job.json")
    pycolmap.set_random_seed(0)
    features = folder / "found.db"
    names = _features_and_matches(folder, features, threads)
    pairs = _matched_pairs(features, names)
    known = [
        JobLens(tuple(each["cameras"]), each["focal_px"], each["open"], tuple(each["centre_px"]))
        for each in job["lenses"]
    ]
    first = _tried(folder, features, known, len(names))
    if first is None:
        return {"pairs": pairs, "cameras": {}, "points": [], "residual_px": None}
    chosen = _chosen(folder, features, first, len(names))
    doubted = _doubted(folder, features, chosen, len(names))
    together = _mean_residual(first.scene) if chosen is not first else None
    bent = _adjust_with_distortion(chosen.scene)
    return {
        "pairs": pairs,
        **_scene_facts(chosen.scene),
        "lenses": [list(lens.cameras) for lens in chosen.lenses],
        "bent": bent,
        "together_px": together,
        "doubted": doubted,
    }


def _doubted(folder: Path, features: Path, chosen: _Try, count: int) -> dict[str, Any] | None:
    """Given lenses taken for open ones: None where that explains the pictures no better.

    Else a dict: together_px, apart_px: mean residuals as given and with more lenses; lenses: names
    of the cameras that share each of these; focal_px: each one's focal length.
    """
    if all(lens.open for lens in chosen.lenses):
        return None
    opened = _Try([dataclasses.replace(e, open=True) for e in chosen.lenses], chosen.scene)
    better = _chosen(folder, features, opened, count)
    if better is opened:
        return None
    focal = _focal_lengths(better.scene)
    return {
        "together_px": _mean_residual(chosen.scene),
        "apart_px": _mean_residual(better.scene),
        "lenses": [list(lens.cameras) for lens in better.lenses],
        "focal_px": [focal[lens.cameras[0]] for lens in better.lenses],
    }


def _chosen(folder: Path, features: Path, first: _Try, count: int) -> _Try:
    """The try that explains the pictures: the first, or one whose open lenses are parted."""
    tries = [first, *_several(folder, features, first, count)]
    return tries[best([each.outcome for each in tries])]


def _several(folder: Path, features: Path, first: _Try, count: int) -> list[_Try]:
    """Tries with more lenses than the first; none where nothing suggests any."""
    if count < LEAST_SEVERAL or not any(len(e.cameras) > 1 for e in first.lenses if e.open):
        return []
    known = _focal_lengths(first.scene)
    begun = [
        dataclasses.replace(lens, focal_px=known.get(lens.cameras[0], lens.focal_px))
        for lens in apart(first.lenses)
    ]
    free = _tried(folder, features, begun, count) or first
    if free.scene.num_reg_images() < first.scene.num_reg_images():
        free = _relensed(first.scene, begun)
    lengths = _focal_lengths(free.scene)
    tries = []
    for lenses in parted(first.lenses, lengths):
        mapped = _tried(folder, features, lenses, count)
        if mapped is None or mapped.scene.num_reg_images() < first.scene.num_reg_images():
            mapped = _relensed(first.scene, lenses)
        tries.append(mapped)
    return tries


def _relensed(scene: pycolmap.Reconstruction, lenses: list[JobLens]) -> _Try:
    """The same scene adjusted with other lenses, each from its focal length or the scene's.

    Where mapping anew leaves cameras out, these give way from where other lenses have put them.
    """
    made = pycolmap.Reconstruction()
    placed = {Path(scene.images[i].name).stem: scene.images[i] for i in scene.reg_image_ids()}
    for number, lens in enumerate(lenses, 1):
        images = [placed[name] for name in lens.cameras if name in placed]
        if not images:
            continue
        old = scene.cameras[images[0].camera_id]
        made.add_camera_with_trivial_rig(
            pycolmap.Camera(
                model="SIMPLE_RADIAL",
                width=old.width,
                height=old.height,
                params=[lens.focal_px or old.params[0], *old.params[1:]],
                camera_id=number,
            )
        )
        for image in images:
            features = np.array([point.xy for point in image.points2D]).reshape(-1, 2)
            made.add_image_with_trivial_frame(
                pycolmap.Image(
                    name=image.name, keypoints=features, camera_id=number, image_id=image.image_id
                ),
                image.cam_from_world(),
            )
    for point in scene.points3D.values():
        made.add_point3D(point.xyz, point.track)
    _adjust(made, distorted=False, rounds=200)
    return _Try(lenses, made)


def _focal_lengths(scene: pycolmap.Reconstruction) -> dict[str, float]:
    return {
        Path(image.name).stem: float(scene.cameras[image.camera_id].params[0])
        for image in scene.images.values()
        if image.has_pose
    }


def _tried(folder: Path, features: Path, lenses: list[JobLens], count: int) -> _Try | None:
    """The best scene with such lenses, adjusted without distortion; None where there is none."""
    found: pycolmap.Reconstruction | None = None
    for start in STARTS:
        scene = _mapped(folder, features, lenses, start)
        if scene is not None and (found is None or _larger(scene, found)):
            found = scene
        known = all(lens.focal_px for lens in lenses)
        if known or (found is not None and found.num_reg_images() == count):
            break
    if found is None:
        return None
    _adjust(found, distorted=False)
    return _Try(lenses, found)


def _features_and_matches(folder: Path, database: Path, threads: int) -> dict[int, str]:
    """Fill a database; returns image ids and cameras' names."""
    extraction = pycolmap.FeatureExtractionOptions()
    extraction.use_gpu = False
    # Pictures are numbered as they are done: several at once would be another order every time.
    extraction.num_threads = 1
    extraction.sift.peak_threshold = PEAK_THRESHOLD
    # Without the usual doubling of the picture: a quarter of the time, and enough features.
    extraction.sift.first_octave = 0
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = "SIMPLE_RADIAL"
    reader.mask_path = folder / "masks"
    pycolmap.extract_features(
        database,
        folder / "pictures",
        camera_mode=pycolmap.CameraMode.PER_IMAGE,
        reader_options=reader,
        extraction_options=extraction,
        device=pycolmap.Device.cpu,
    )
    matching = pycolmap.FeatureMatchingOptions()
    matching.use_gpu = False
    matching.num_threads = threads
    matching.sift.max_ratio = MAX_RATIO
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = 0
    pycolmap.match_exhaustive(
        database, matching, verification_options=verification, device=pycolmap.Device.cpu
    )
    opened = pycolmap.Database.open(database)
    names = {image.image_id: Path(image.name).stem for image in opened.read_all_images()}
    opened.close()
    return names


def _matched_pairs(database: Path, names: Mapping[int, str]) -> list[list[Any]]:
    opened = pycolmap.Database.open(database)
    ids, found = opened.read_two_view_geometries()
    opened.close()
    out = []
    for pair, geometry in zip(ids, found, strict=True):
        first, second = pycolmap.pair_id_to_image_pair(pair)
        out.append([names[first], names[second], len(geometry.inlier_matches)])
    return out


def _with_lenses(features: Path, out: Path, lenses: Sequence[JobLens], start: float) -> None:
    """A database of the same pictures and matches, in which the cameras of a lens are one."""
    out.unlink(missing_ok=True)
    source, made = pycolmap.Database.open(features), pycolmap.Database.open(out)
    images = source.read_all_images()
    own = {camera.camera_id: camera for camera in source.read_all_cameras()}
    size = {Path(image.name).stem: own[image.camera_id] for image in images}
    lens_of = {name: 1 + i for i, lens in enumerate(lenses) for name in lens.cameras}
    for number, lens in enumerate(lenses, 1):
        picture = size[lens.cameras[0]]
        focal = lens.focal_px or start * max(picture.width, picture.height)
        camera = pycolmap.Camera(
            model="SIMPLE_RADIAL",
            width=picture.width,
            height=picture.height,
            params=[focal, *lens.centre_px, 0.0],
            camera_id=number,
        )
        camera.has_prior_focal_length = lens.focal_px is not None
        made.write_camera(camera, True)
        rig = pycolmap.Rig(rig_id=number)
        rig.add_ref_sensor(pycolmap.sensor_t(pycolmap.SensorType.CAMERA, number))
        made.write_rig(rig, True)
    for image in images:
        number = lens_of[Path(image.name).stem]
        made.write_image(
            pycolmap.Image(name=image.name, camera_id=number, image_id=image.image_id), True
        )
        frame = pycolmap.Frame()
        frame.frame_id, frame.rig_id = image.image_id, number
        sensor = pycolmap.sensor_t(pycolmap.SensorType.CAMERA, number)
        frame.add_data_id(pycolmap.data_t(sensor, image.image_id))
        made.write_frame(frame, True)
        made.write_keypoints(image.image_id, source.read_keypoints(image.image_id))
    for pair, matches in zip(*source.read_all_matches(), strict=True):
        made.write_matches(*pycolmap.pair_id_to_image_pair(pair), matches)
    for pair, geometry in zip(*source.read_two_view_geometries(), strict=True):
        made.write_two_view_geometry(*pycolmap.pair_id_to_image_pair(pair), geometry)
    source.close()
    made.close()


def _mapped(
    folder: Path, features: Path, lenses: Sequence[JobLens], start: float
) -> pycolmap.Reconstruction | None:
    """COLMAP's largest scene from one start of the focal lengths; None where there is none."""
    begun = folder / "begun.db"
    _with_lenses(features, begun, lenses, start)
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads = 1
    options.random_seed = 0
    options.multiple_models = False
    options.extract_colors = False
    # Two pictures fit one another as well with a bent lens: what distorts comes last, of all.
    options.ba_refine_extra_params = False
    options.mapper.abs_pose_refine_extra_params = False
    options.mapper.init_min_num_inliers = 50
    options.mapper.abs_pose_min_num_inliers = 15
    # A face turns away quickly: much of it is seen by two of nine cameras alone.
    options.triangulation.ignore_two_view_tracks = False
    out = folder / "scene"
    out.mkdir(exist_ok=True)
    scenes = pycolmap.incremental_mapping(begun, folder / "pictures", out, options)
    return max(scenes.values(), key=lambda scene: scene.num_reg_images(), default=None)


def _larger(scene: pycolmap.Reconstruction, other: pycolmap.Reconstruction) -> bool:
    """Whether a scene holds more cameras than another, or as many and more points."""
    one = scene.num_reg_images(), scene.num_points3D()
    return bool(one > (other.num_reg_images(), other.num_points3D()))


def _adjust(scene: pycolmap.Reconstruction, *, distorted: bool, rounds: int = 100) -> None:
    """Least squares over reprojection [Triggs1999], false matches counting little."""
    config = pycolmap.BundleAdjustmentConfig()
    for image in scene.reg_image_ids():
        config.add_image(image)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    options = pycolmap.BundleAdjustmentOptions()
    options.refine_principal_point = False
    options.refine_extra_params = distorted
    options.print_summary = False
    options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    options.ceres.loss_function_scale = LOSS_PX
    options.ceres.solver_options.num_threads = 1
    options.ceres.solver_options.max_num_iterations = rounds
    pycolmap.create_default_bundle_adjuster(options, config, scene).solve()
    scene.update_point_3d_errors()


def _adjust_with_distortion(scene: pycolmap.Reconstruction) -> dict[str, float]:
    """Fit distortion too, where there are cameras enough and it comes out as a lens's.

    Returns:
        By what share a corner would have moved, by camera; empty where distortion stays.
    """
    if scene.num_reg_images() < LEAST_DISTORTED:
        return {}
    _adjust(scene, distorted=True)
    bent = {}
    for image in scene.images.values():
        camera = scene.cameras[image.camera_id]
        focal, cx, cy, k1 = map(float, camera.params)
        share = abs(k1) * (cx**2 + cy**2) / focal**2
        long = focal > LONG * max(camera.width, camera.height)
        if image.has_pose and share > (MOST_BENT if long else MOST_BENT_WIDE):
            bent[Path(image.name).stem] = share
    if bent:
        for camera in scene.cameras.values():
            camera.params = [*camera.params[:3], 0.0]
        _adjust(scene, distorted=False)
    return bent


def _residuals(scene: pycolmap.Reconstruction) -> dict[str, list[float]]:
    """By camera, how far each of its features is from where its point falls, px."""
    out: dict[str, list[float]] = {}
    for image in scene.images.values():
        if not image.has_pose:
            continue
        seen = [point for point in image.points2D if point.has_point3D()]
        points = np.array([scene.points3D[point.point3D_id].xyz for point in seen]).reshape(-1, 3)
        there = scene.cameras[image.camera_id].img_from_cam(image.cam_from_world() * points)
        here = np.array([point.xy for point in seen]).reshape(-1, 2)
        out[Path(image.name).stem] = np.linalg.norm(np.asarray(there) - here, axis=1).tolist()
    return out


def _mean_residual(scene: pycolmap.Reconstruction) -> float:
    return float(np.mean([off for offs in _residuals(scene).values() for off in offs]))


def _scene_facts(scene: pycolmap.Reconstruction) -> dict[str, Any]:
    residuals = _residuals(scene)
    cameras = {}
    for image in scene.images.values():
        if not image.has_pose:
            continue
        name = Path(image.name).stem
        offs = residuals[name]
        cameras[name] = {
            "cam_from_world": image.cam_from_world().matrix().tolist(),
            "lens": [float(value) for value in scene.cameras[image.camera_id].params],
            "points": len(offs),
            "residual_px": sum(offs) / max(len(offs), 1),
        }
    return {
        "cameras": cameras,
        "points": [point.xyz.tolist() for point in scene.points3D.values()],
        "residual_px": _mean_residual(scene),
    }


def main() -> None:
    """Solve the job of the folder that is named."""
    pycolmap.logging.minloglevel = pycolmap.logging.Level.ERROR.value
    # Else each run leaves three files in the system's temporary folder.
    pycolmap.logging.logtostderr = True
    folder = Path(sys.argv[1])
    result = solve(folder, int(sys.argv[2]))
    (folder / "result.json").write_text(json.dumps(result))


if __name__ == "__main__":
    main()
