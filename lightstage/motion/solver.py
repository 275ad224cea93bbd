"""The part that runs in a process of its own: `python -m lightstage.motion.solver FOLDER`.

COLMAP's features, matches and incremental mapping [Schonberger2016], then a robust adjustment of
all. FOLDER holds job.json, pictures/GROUP/CAMERA.png and masks/GROUP/CAMERA.png.png; result.json is
written into it. COLMAP prints where it likes and ends the process where a check of its own fails:
`solving` starts it, and keeps both from the user.
"""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path
from typing import Any

import pycolmap

from lightstage.formats.files import read_json

STARTS = (1.2, 3.0)
"""Focal lengths to begin with where none is known, as shares of the picture's longer side."""
PEAK_THRESHOLD = 0.002
"""SIFT's; skin shows little contrast, so a third of its usual value."""
MAX_RATIO = 0.85
LEAST_DISTORTED = 6
"""Cameras from which on distortion is fitted: of fewer it bends the surface instead."""
LOSS_PX = 0.5
"""Of the last adjustment (Cauchy): features are off by less, false matches by more."""


def solve(folder: Path, threads: int) -> dict[str, Any]:
    """Find cameras and points of the pictures in a folder.

    Args:
        folder: see above.
        threads: for matches; features and mapping take one, so that results repeat.

    Returns:
        pairs: [first, second, verified matches]; cameras: name to pose, parameters of its lens
        (focal length, principal point, k1), mean residual in px and count of its points; points:
        (n, 3); residual_px: mean of all. Units of length are COLMAP's own.
    """
    job = read_json(folder / "job.json")
    pycolmap.set_random_seed(0)
    database = folder / "found.db"
    names = _features_and_matches(folder, database, threads)
    pairs = _matched_pairs(database, names)
    best: pycolmap.Reconstruction | None = None
    for start in STARTS:
        scene = _mapped(folder, database, job["groups"], start)
        if scene is not None and (best is None or _better(scene, best)):
            best = scene
        known = all(group["focal_px"] for group in job["groups"])
        if known or (best is not None and best.num_reg_images() == len(names)):
            break
    if best is None:
        return {"pairs": pairs, "cameras": {}, "points": [], "residual_px": None}
    _adjust(best)
    return {"pairs": pairs, **_told(best)}


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
        camera_mode=pycolmap.CameraMode.PER_FOLDER,
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


def _matched_pairs(database: Path, names: dict[int, str]) -> list[list[Any]]:
    opened = pycolmap.Database.open(database)
    ids, found = opened.read_two_view_geometries()
    opened.close()
    out = []
    for pair, geometry in zip(ids, found, strict=True):
        first, second = pycolmap.pair_id_to_image_pair(pair)
        out.append([names[first], names[second], len(geometry.inlier_matches)])
    return out


def _mapped(
    folder: Path, database: Path, groups: list[dict[str, Any]], start: float
) -> pycolmap.Reconstruction | None:
    """COLMAP's largest scene from one start of the focal lengths; None where there is none."""
    begun = folder / "begun.db"
    shutil.copyfile(database, begun)
    opened = pycolmap.Database.open(begun)
    group_of = {
        image.camera_id: groups[int(Path(image.name).parts[0])]
        for image in opened.read_all_images()
    }
    for camera in opened.read_all_cameras():
        group = group_of[camera.camera_id]
        focal = group["focal_px"] or start * max(camera.width, camera.height)
        lens = pycolmap.Camera(
            model="SIMPLE_RADIAL",
            width=camera.width,
            height=camera.height,
            params=[focal, group["cx_px"], group["cy_px"], 0.0],
            camera_id=camera.camera_id,
        )
        lens.has_prior_focal_length = group["focal_px"] is not None
        opened.update_camera(lens)
    opened.close()
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


def _better(scene: pycolmap.Reconstruction, other: pycolmap.Reconstruction) -> bool:
    """Whether a scene holds more cameras than another, or as many and more points."""
    one = scene.num_reg_images(), scene.num_points3D()
    return bool(one > (other.num_reg_images(), other.num_points3D()))


def _adjust(scene: pycolmap.Reconstruction) -> None:
    """Least squares over reprojection [Triggs1999], false matches counting little."""
    config = pycolmap.BundleAdjustmentConfig()
    for image in scene.reg_image_ids():
        config.add_image(image)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    options = pycolmap.BundleAdjustmentOptions()
    options.refine_principal_point = False
    options.refine_extra_params = scene.num_reg_images() >= LEAST_DISTORTED
    options.print_summary = False
    options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    options.ceres.loss_function_scale = LOSS_PX
    options.ceres.solver_options.num_threads = 1
    options.ceres.solver_options.max_num_iterations = 100
    pycolmap.create_default_bundle_adjuster(options, config, scene).solve()
    scene.update_point_3d_errors()


def _told(scene: pycolmap.Reconstruction) -> dict[str, Any]:
    cameras = {}
    for image in scene.images.values():
        if not image.has_pose:
            continue
        seen = [point.point3D_id for point in image.points2D if point.has_point3D()]
        errors = [float(scene.points3D[point].error) for point in seen]
        cameras[Path(image.name).stem] = {
            "cam_from_world": image.cam_from_world().matrix().tolist(),
            "lens": [float(value) for value in scene.cameras[image.camera_id].params],
            "points": len(seen),
            "residual_px": sum(errors) / max(len(errors), 1),
        }
    return {
        "cameras": cameras,
        "points": [point.xyz.tolist() for point in scene.points3D.values()],
        "residual_px": float(scene.compute_mean_reprojection_error()),
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
