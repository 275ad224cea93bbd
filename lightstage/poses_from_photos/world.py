"""Where the world's axes are, which photographs alone do not show: +y up, +z out of the face."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from lightstage.errors import MotionError
from lightstage.formats.template import default_template_path, load_template
from lightstage.nearest_point import nearest_equations
from lightstage.poses_from_photos.points import Clicks, place
from lightstage.rig import Camera

MIN_LANDMARKS = 6
FACE_MISFIT = 0.15
"""Landmarks farther from a face's than this share of their spread (root mean square) are none."""
LEVEL_WEIGHT = 1e-3
"""Weight of the pictures' mean up direction, where their horizontal axes have 1; these settle it
where cameras are around the subject."""
STEEPEST = 0.05
"""Least horizontal part of the direction to the frontal camera."""
PULL = 0.02
"""Weight of the subject's middle beside each camera's axis."""


def turned_by_landmarks(clicks: Clicks, cameras: Mapping[str, Camera]) -> np.ndarray | None:
    """The turn that brings a face upright and facing +z, from its landmarks.

    The points are fitted to those of our template, which is in those axes, by turn, shift and
    scale [Umeyama1991].

    Args:
        clicks: landmarks (0 to 67), by name; those in fewer than two photographs are left out.
        cameras: by id.

    Returns:
        (3, 3) world from the cameras' present world; None with fewer than MIN_LANDMARKS.

    Raises:
        MotionError: clicks that do not meet, or landmarks that make no face.
    """
    template = load_template(default_template_path())
    ideal, found = [], []
    for name, each in clicks.items():
        if name.isdigit() and sum(camera in cameras for camera in each) >= 2:
            found.append(place(f"landmark {name}", each, cameras).position)
            ideal.append(template.mesh.vertices[template.landmarks[int(name)]])
    if len(found) < MIN_LANDMARKS:
        return None
    there, here = np.array(ideal), np.array(found)
    turn, misfit = turn_between(here, there)
    if not misfit < FACE_MISFIT:
        raise MotionError(
            "landmarks",
            found=f"points {100 * misfit:.0f} % of their spread off a face's",
            expected=f"{100 * FACE_MISFIT:.0f} % at most",
            hint="Are they in iBUG's order, which begins at the subject's right?",
        )
    return turn


def turn_between(here: np.ndarray, there: np.ndarray) -> tuple[np.ndarray, float]:
    """(3, 3) that turns points (n, 3) as others are, shift and scale aside [Umeyama1991].

    Returns:
        The turn, and the root mean square misfit as a share of `there`'s spread.
    """
    from scipy.spatial.transform import Rotation

    one, other = here - here.mean(axis=0), there - there.mean(axis=0)
    turn = Rotation.align_vectors(other, one)[0].as_matrix()
    scale = float(((one @ turn.T) * other).sum() / max((one**2).sum(), 1e-300))
    misfit = np.sqrt(((scale * one @ turn.T - other) ** 2).sum() / (other**2).sum())
    return turn, float(misfit)


def turned_by_cameras(
    cameras: Mapping[str, Camera], middle: np.ndarray, front: str | None = None
) -> tuple[np.ndarray, str]:
    """The turn by which pictures are upright and +z is toward the frontal camera.

    Args:
        cameras: by id; their rows run horizontally.
        middle: (3,) of the subject.
        front: the frontal camera; None for the one in the middle of all.

    Returns:
        (3, 3) world from the cameras' present world, and the frontal camera.

    Raises:
        MotionError: the frontal camera is straight above the subject.
    """
    rights = np.array([camera.cam_from_world[0, :3] for camera in cameras.values()])
    up = -np.mean([camera.cam_from_world[1, :3] for camera in cameras.values()], axis=0)
    # Cameras around a subject have horizontal axes that only the vertical is square to; where all
    # look one way these leave it open, and the mean decides.
    moment = rights.T @ rights / len(rights) - LEVEL_WEIGHT * np.outer(up, up)
    vertical = np.linalg.eigh(moment)[1][:, 0]
    vertical *= np.sign(vertical @ up) or 1.0
    toward = {name: camera.centre_mm - middle for name, camera in cameras.items()}
    toward = {name: each / np.linalg.norm(each) for name, each in toward.items()}
    mean = np.mean(list(toward.values()), axis=0)
    chosen = front or max(toward, key=lambda name: float(toward[name] @ mean))
    forward = toward[chosen] - (toward[chosen] @ vertical) * vertical
    length = float(np.linalg.norm(forward))
    if length < STEEPEST:
        raise MotionError(
            "--front",
            found=f"{chosen}, which is straight above or below the subject",
            expected="the camera before the face",
        )
    forward /= length
    return np.stack([np.cross(vertical, forward), vertical, forward]), chosen


def looked_at(cameras: Mapping[str, Camera], middle: np.ndarray) -> np.ndarray:
    """(3,) the point nearest to all cameras' axes; near `middle` where they run side by side."""
    centres = np.array([camera.centre_mm for camera in cameras.values()])
    axes = np.array([camera.cam_from_world[2, :3] for camera in cameras.values()])
    moment, right = nearest_equations(centres, axes)
    pull = PULL * len(cameras)
    return np.asarray(np.linalg.solve(moment + pull * np.eye(3), right + pull * middle))


def moved(camera: Camera, scale: float, turn: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """(3, 4) cam_from_world of a camera whose world is shifted, turned and scaled.

    A point p of the old world is scale * turn @ (p - origin) in the new one.
    """
    rotation, shift = camera.cam_from_world[:, :3], camera.cam_from_world[:, 3]
    turned = rotation @ turn.T
    return np.concatenate([turned, (scale * (rotation @ origin + shift))[:, None]], axis=1)
