"""Cameras from boards: lenses and poses in the stage's world, residuals, and who is refused."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from lightstage.counting import counted
from lightstage.formats.board import BoardConfig
from lightstage.rig import Camera, Rig
from processing.calibration.cameras.boards import Sight
from processing.calibration.cameras.config import CamerasConfig
from processing.calibration.cameras.fit import Adjusted, adjust
from processing.calibration.cameras.held_out import HeldOut, enough, held_out
from processing.calibration.cameras.start import first_poses
from processing.calibration.cameras.world import four, onto
from processing.errors import PoseError

MODELS = ("SIMPLE_RADIAL", "RADIAL", "OPENCV")
WIDE_PX, NARROWEST_PX = 0.3, 0.005
"""Scale of the loss by which cameras that moved are found, and the least of the last adjustment."""


@dataclasses.dataclass(frozen=True)
class MeasuredCameras:
    """What was measured.

    Attributes:
        cameras: of the rig, in its order, those that could not be measured as they were.
        facts: JSON-ready: residuals of each camera, also on boards that were held out.
        unmeasured: ids of cameras that keep what the rig had.
        unchecked: ids of measured cameras whose place could not be checked by other boards.
        warnings: sentences for the user.
    """

    cameras: tuple[Camera, ...]
    facts: dict[str, Any]
    unmeasured: list[str]
    unchecked: list[str]
    warnings: list[str]


def measure_cameras(
    sights: Sequence[Sight], rig: Rig, board: BoardConfig, config: CamerasConfig
) -> MeasuredCameras:
    """Lenses and poses of all cameras that saw boards.

    OpenCV's calibration of each camera alone gives lenses to start with, boards that pairs of
    cameras saw their relative poses; then everything is adjusted together. Boards determine the
    cameras' poses to each other, not where the stage is: the whole is fitted to the rig's own
    poses, where cameras that moved count little.

    Args:
        sights: boards as cameras saw them.
        rig: as it was: picture sizes, lenses and poses to start with.
        board: what was held.
        config: limits.

    Raises:
        PoseError: no two cameras share a board, or each camera whose residual is too large, in one
            message.
    """
    if config.model not in MODELS:
        raise PoseError("cameras", field="model", found=config.model, expected=" or ".join(MODELS))
    corners = board.corners_mm()
    rig_cameras = {camera.id: camera for camera in rig.cameras}
    usable = enough(sights, config.min_sights)
    if len({sight.camera for sight in usable}) < 1:
        raise PoseError(
            "cameras",
            found=f"{counted(len(sights), 'board')} seen",
            expected=f"at least {config.min_sights} by a camera",
            hint="Is it the board of the configuration, lit and sharp?",
        )
    lenses = {
        name: _lens_alone([s for s in usable if s.camera == name], corners, rig_cameras[name])
        for name in sorted({s.camera for s in usable})
    }
    placed, boards = first_poses(
        usable, corners, {n: (c.opencv_matrix, np.array(c.dist)) for n, c in lenses.items()}
    )
    start = {
        name: dataclasses.replace(lenses[name], cam_from_world=pose[:3])
        for name, pose in placed.items()
    }
    # From afar to near: a narrow loss takes a first guess that is pixels off for outliers.
    far = adjust(usable, corners, start, boards, model=config.model, lenses=False, scale_px=20.0)
    near = adjust(usable, corners, far.cameras, far.boards, model=config.model, scale_px=2.0)
    clean = _without_outliers(usable, near, config.outlier_px)
    found = adjust(clean, corners, near.cameras, near.boards, model=config.model, scale_px=WIDE_PX)
    warnings = _refuse(_contradicting(clean, corners, found, config), config)
    # Most corners are found to a hundredth of a pixel and a few to a half: a loss as wide as the
    # few lets them push cameras about.
    typical = float(np.median(np.concatenate(found.residual_px)))
    scale = float(np.clip(2 * typical, NARROWEST_PX, WIDE_PX))
    found = adjust(clean, corners, found.cameras, found.boards, model=config.model, scale_px=scale)
    held = held_out(clean, corners, found, config.min_sights, config.model, scale)
    world = onto(found.cameras, rig_cameras)
    facts, unmeasured = _facts(sights, clean, found, held, rig_cameras, world)
    warnings += unmeasured + _unsure(facts["cameras"], config)
    measured = {
        name: dataclasses.replace(camera, cam_from_world=four(camera.cam_from_world)[:3] @ world)
        for name, camera in found.cameras.items()
    }
    warnings += _moved(measured, rig_cameras, config)
    cameras = tuple(measured.get(camera.id, camera) for camera in rig.cameras)
    found_cameras = facts["cameras"]
    unmeasured = [name for name in rig_cameras if name not in found_cameras]
    unchecked = [name for name, one in found_cameras.items() if one["place_sigma_mm"] is None]
    return MeasuredCameras(cameras, facts, unmeasured, unchecked, warnings)


def _lens_alone(sights: Sequence[Sight], corners_mm: np.ndarray, camera: Camera) -> Camera:
    """A camera's lens from its own boards [Zhang2000], by OpenCV; its pose is left as it is."""
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_PRINCIPAL_POINT
    flags |= cv2.CALIB_FIX_ASPECT_RATIO | cv2.CALIB_ZERO_TANGENT_DIST
    flags |= cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3
    try:
        _, lens, dist, _, _ = cv2.calibrateCamera(
            [corners_mm[s.ids].astype(np.float32) for s in sights],
            [(s.pixels - 0.5).astype(np.float32) for s in sights],
            (camera.width_px, camera.height_px),
            camera.opencv_matrix,
            np.array([camera.dist[0], 0, 0, 0, 0]),
            flags=flags,
        )
    except cv2.error:
        return camera
    k1 = float(np.ravel(dist)[0])
    focal = float(lens[0, 0])
    # Few boards held alike determine no focal length: the result is then far from any lens.
    if not (0.7 < focal / camera.fx_px < 1.4 and abs(k1) < 2):
        return camera
    return dataclasses.replace(
        camera,
        fx_px=focal,
        fy_px=float(lens[1, 1]),
        dist=(k1, 0.0, 0.0, 0.0, 0.0),
    )


def _without_outliers(sights: Sequence[Sight], found: Adjusted, limit_px: float) -> list[Sight]:
    out = []
    for sight, miss in zip(sights, found.residual_px, strict=True):
        if not len(miss):
            continue
        # A camera that is off as a whole keeps its corners, so that it can be named.
        near = miss < max(limit_px, 5 * float(np.median(miss)))
        if near.sum() >= 4:
            out.append(dataclasses.replace(sight, ids=sight.ids[near], pixels=sight.pixels[near]))
    return out


def _facts(
    sights: Sequence[Sight],
    clean: Sequence[Sight],
    found: Adjusted,
    held: HeldOut,
    nominal: Mapping[str, Camera],
    world: np.ndarray,
) -> tuple[dict[str, Any], list[str]]:
    cameras: dict[str, Any] = {}
    warnings = []
    for name, camera in nominal.items():
        own = [m for s, m in zip(clean, found.residual_px, strict=True) if s.camera == name]
        if name not in found.cameras or not own:
            count = sum(s.camera == name for s in sights)
            warnings.append(
                f"{name} was not measured: of boards that others saw it saw {count}; rig.json "
                "keeps the lens and pose that it had. Hold the board so that it and a neighbour "
                "both see it"
            )
            continue
        miss = np.concatenate(own)
        now = found.cameras[name]
        moved = (four(now.cam_from_world) @ world)[:3]
        turn = moved[:, :3] @ camera.cam_from_world[:, :3].T
        off = held.off_px.get(name, np.zeros(0))
        cameras[name] = {
            "boards": len(own),
            "corners": len(miss),
            "residual_px": round(float(np.median(miss)), 4),
            "residual_95_px": round(float(np.percentile(miss, 95)), 4),
            "held_out_px": round(float(np.median(off)), 4) if len(off) else None,
            "place_sigma_mm": held.sigma_mm.get(name),
            "focal_px": round(now.fx_px, 2),
            "principal_px": [round(now.cx_px, 2), round(now.cy_px, 2)],
            "distortion": [float(f"{value:.4g}") for value in now.dist],
            "moved_mm": round(
                float(np.linalg.norm(-moved[:, :3].T @ moved[:, 3] - camera.centre_mm)), 2
            ),
            "turned_deg": round(float(np.degrees(Rotation.from_matrix(turn).magnitude())), 3),
        }
    return {"cameras": cameras, "boards": len(found.boards)}, warnings


def _contradicting(
    sights: Sequence[Sight], corners: np.ndarray, found: Adjusted, config: CamerasConfig
) -> dict[str, float]:
    """Cameras that the others contradict and by how many pixels, the worst first.

    A camera that moved pulls its neighbours' boards with it: after each that is found the others
    are adjusted without it, so that they are not blamed.
    """
    out: dict[str, float] = {}
    while True:
        off = {}
        for name in found.cameras:
            own = [m for s, m in zip(sights, found.residual_px, strict=True) if s.camera == name]
            if own:
                # Boards it saw before it moved, fitted well, must not hide those after.
                boards = float(np.percentile([np.median(m) for m in own], 75))
                off[name] = max(float(np.median(np.concatenate(own))), boards)
        worst = max(off, key=lambda name: off[name])
        if off[worst] <= config.max_residual_px:
            return out
        out[worst] = off[worst]
        if len(off) < 3:
            return out
        sights = [s for s in sights if s.camera != worst]
        cameras = {name: camera for name, camera in found.cameras.items() if name != worst}
        found = adjust(sights, corners, cameras, found.boards, model=config.model)


def _refuse(off: Mapping[str, float], config: CamerasConfig) -> list[str]:
    """Warnings of cameras that are off and allowed; PoseError for those that are not."""
    bad, warnings = [], []
    for name, miss_px in off.items():
        camera = f"{name} ({miss_px:.2f} px)"
        if name in config.allow:
            warnings.append(f"{camera} was allowed")
        else:
            bad.append(camera)
    if bad:
        raise PoseError(
            "cameras",
            field=", ".join(bad),
            found="corners that far off (median, or a quarter of its boards)",
            expected=f"at most {config.max_residual_px:g} px",
            hint="Did it move between the boards, or lose focus? Take the shots again, or name it "
            "with --allow-camera.",
        )
    return warnings


def _unsure(cameras: Mapping[str, Mapping[str, Any]], config: CamerasConfig) -> list[str]:
    """Warnings of cameras whose place chance may have moved by too much."""
    out = []
    for name, one in cameras.items():
        sigma = one["place_sigma_mm"]
        if sigma is None:
            out.append(
                f"{name} was seen on {counted(one['boards'], 'board')} alone, so its place, "
                f"{one['moved_mm']:.1f} mm from where rig.json had it, could not be checked: hold "
                "the board toward it more often"
            )
        elif sigma > config.unsure_mm:
            out.append(
                f"{name} may stand {sigma:.2f} mm from where it was measured: hold the board "
                "toward it more often, a hand's width nearer and farther"
            )
    return out


def _moved(
    measured: Mapping[str, Camera], nominal: Mapping[str, Camera], config: CamerasConfig
) -> list[str]:
    notes = []
    for name, camera in measured.items():
        shift = float(np.linalg.norm(camera.centre_mm - nominal[name].centre_mm))
        turn = camera.cam_from_world[:, :3] @ nominal[name].cam_from_world[:, :3].T
        turned = float(np.degrees(Rotation.from_matrix(turn).magnitude()))
        if shift > config.moved_mm or turned > config.turned_deg:
            near = min(
                nominal,
                key=lambda k: float(np.linalg.norm(camera.centre_mm - nominal[k].centre_mm)),
            )
            like = f"; it is where rig.json has {near}" if near != name else ""
            notes.append(
                f"{name} is {shift:.0f} mm and {turned:.1f} degrees from where rig.json "
                f"has it{like}"
            )
    return notes
