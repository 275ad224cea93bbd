"""Cameras and boards adjusted together, the boards' known corners giving the scale.

The cameras are a rig that never moves and each holding of the board is the rig in another place
before one board, in COLMAP's words: rig, frames, and corners as points that stay where they are.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from lightstage.rig import Camera
from processing.calibration.cameras.boards import Sight
from processing.colmap import pycolmap

Placed = Mapping[str, Camera]
"""Cameras by id; `cam_from_world` is from the reference camera's frame here."""


@dataclasses.dataclass(frozen=True)
class Adjusted:
    """What came out.

    Attributes:
        cameras: id to camera, posed in the reference's frame.
        boards: shot to (3, 4) reference from board.
        residual_px: for each sight (n,) distances of its corners.
    """

    cameras: dict[str, Camera]
    boards: dict[int, np.ndarray]
    residual_px: list[np.ndarray]


def adjust(
    sights: Sequence[Sight],
    corners_mm: np.ndarray,
    cameras: Placed,
    boards: Mapping[int, np.ndarray],
    *,
    model: str = "SIMPLE_RADIAL",
    lenses: bool = True,
    poses: bool = True,
    scale_px: float = 0.3,
) -> Adjusted:
    """Least squares over reprojection [Triggs1999], corners far off counting little (Cauchy).

    Args:
        sights: whose camera and shot are both known; others are passed over.
        corners_mm: (m, 3) of the board.
        cameras: first guesses; k3 stays 0.
        boards: shot to first guess, (3, 4) or (4, 4) reference from board.
        model: COLMAP's of the lenses: SIMPLE_RADIAL (one focal length, k1), RADIAL (and k2) or
            OPENCV (two focal lengths, k1, k2, p1, p2).
        lenses: whether focal lengths, principal points and distortion move.
        poses: whether cameras move; boards always do.
        scale_px: of the loss.

    Raises:
        ValueError: the problem has no sights.
    """
    used = [s for s in sights if s.camera in cameras and s.shot in boards]
    if not used:
        raise ValueError("no camera saw a board that has a place")
    names = sorted({s.camera for s in used})
    # The origin of COLMAP's rig is its first sensor; the result is brought back to our frame.
    order = {name: k + 1 for k, name in enumerate(names)}
    first = _four(cameras[names[0]].cam_from_world)
    scene = pycolmap.Reconstruction()
    rig = pycolmap.Rig()
    rig.rig_id = 1
    for name in names:
        camera = _colmap_camera(cameras[name], order[name], model)
        scene.add_camera(camera)
        if name == names[0]:
            rig.add_ref_sensor(camera.sensor_id)
        else:
            relative = _four(cameras[name].cam_from_world) @ np.linalg.inv(first)
            rig.add_sensor(camera.sensor_id, _rigid(relative))
    scene.add_rig(rig)
    points = {}
    seen, times = np.unique(np.concatenate([s.ids for s in used]), return_counts=True)
    # COLMAP takes no point that a single picture shows.
    for index in seen[times > 1].tolist():
        points[index] = scene.add_point3D(corners_mm[index].reshape(3, 1), pycolmap.Track())
    images: dict[int, int] = {}
    shots = sorted({s.shot for s in used})
    for shot in shots:
        own = [(k, s) for k, s in enumerate(used) if s.shot == shot]
        frame = pycolmap.Frame()
        frame.frame_id, frame.rig_id = shot + 1, 1
        for k, sight in own:
            sensor = scene.camera(order[sight.camera]).sensor_id
            frame.add_data_id(pycolmap.data_t(sensor, k + 1))
        frame.rig_from_world = _rigid(first @ _four(boards[shot]))
        scene.add_frame(frame)
        for k, sight in own:
            image = pycolmap.Image(
                name=f"{sight.camera}-{shot}",
                keypoints=sight.pixels.astype(float),
                camera_id=order[sight.camera],
                image_id=k + 1,
            )
            image.frame_id = shot + 1
            scene.add_image(image)
            images[k] = k + 1
        scene.register_frame(shot + 1)
        for k, sight in own:
            for place, index in enumerate(sight.ids):
                if int(index) in points:
                    element = pycolmap.TrackElement(k + 1, place)
                    scene.add_observation(points[int(index)], element)
    _solve(scene, points.values(), lenses, poses, scale_px)
    moved = {
        name: _camera(
            cameras[name],
            scene.camera(order[name]),
            _sensor_from_rig(scene, order[name]) @ first,
        )
        for name in names
    }
    placed = {
        shot: (np.linalg.inv(first) @ _four(scene.frame(shot + 1).rig_from_world.matrix()))[:3]
        for shot in shots
    }
    return Adjusted(moved, placed, residuals(sights, corners_mm, moved, placed))


def residuals(
    sights: Sequence[Sight],
    corners_mm: np.ndarray,
    cameras: Placed,
    boards: Mapping[int, np.ndarray],
) -> list[np.ndarray]:
    """For each sight (n,) distances in px; empty where its camera or board has no place."""
    out = []
    for sight in sights:
        if sight.camera not in cameras or sight.shot not in boards:
            out.append(np.zeros(0))
            continue
        pose = boards[sight.shot]
        points = corners_mm[sight.ids] @ pose[:3, :3].T + pose[:3, 3]
        shown, _ = cameras[sight.camera].project(points)
        out.append(np.linalg.norm(shown - sight.pixels, axis=1))
    return out


def _solve(
    scene: pycolmap.Reconstruction,
    points: Iterable[int],
    lenses: bool,
    poses: bool,
    scale_px: float,
) -> None:
    config = pycolmap.BundleAdjustmentConfig()
    for image in scene.reg_image_ids():
        config.add_image(image)
    for point in points:
        config.add_constant_point(point)
    options = pycolmap.BundleAdjustmentOptions()
    options.refine_focal_length = lenses
    options.refine_principal_point = lenses
    options.refine_extra_params = lenses
    options.refine_sensor_from_rig = poses
    options.print_summary = False
    options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    options.ceres.loss_function_scale = scale_px
    # Sums of several threads would differ from run to run.
    options.ceres.solver_options.num_threads = 1
    options.ceres.solver_options.max_num_iterations = 200
    options.ceres.solver_options.function_tolerance = 1e-12
    pycolmap.create_default_bundle_adjuster(options, config, scene).solve()


def _colmap_camera(camera: Camera, number: int, model: str) -> pycolmap.Camera:
    k1, k2, p1, p2, _ = camera.dist
    middle, focal = [camera.cx_px, camera.cy_px], 0.5 * (camera.fx_px + camera.fy_px)
    params = {
        "SIMPLE_RADIAL": [focal, *middle, k1],
        "RADIAL": [focal, *middle, k1, k2],
        "OPENCV": [camera.fx_px, camera.fy_px, *middle, k1, k2, p1, p2],
    }[model]
    return pycolmap.Camera(
        model=model,
        width=camera.width_px,
        height=camera.height_px,
        params=params,
        camera_id=number,
    )


def _camera(camera: Camera, found: pycolmap.Camera, pose: np.ndarray) -> Camera:
    values = [float(value) for value in found.params]
    if len(values) < 8:
        focal, cx, cy, *bent = values
        values = [focal, focal, cx, cy, *bent, *[0.0] * (4 - len(bent))]
    fx, fy, cx, cy, k1, k2, p1, p2 = values
    return dataclasses.replace(
        camera,
        fx_px=fx,
        fy_px=fy,
        cx_px=cx,
        cy_px=cy,
        dist=(k1, k2, p1, p2, 0.0),
        cam_from_world=pose[:3],
    )


def _sensor_from_rig(scene: pycolmap.Reconstruction, number: int) -> np.ndarray:
    rig, sensor = scene.rig(1), scene.camera(number).sensor_id
    if rig.is_ref_sensor(sensor):
        return np.eye(4)
    return _four(rig.sensor_from_rig(sensor).matrix())


def _rigid(pose: np.ndarray) -> pycolmap.Rigid3d:
    return pycolmap.Rigid3d(np.ascontiguousarray(pose[:3, :4], float))


def _four(pose: np.ndarray) -> np.ndarray:
    out = np.eye(4)
    out[:3] = np.asarray(pose)[:3]
    return out
