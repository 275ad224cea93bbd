"""Matches between pictures, found and verified without knowing how the cameras stand.

SIFT features of all views [Lowe2004], pair by pair, kept where one essential matrix explains them.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from lightstage.commands import ProgressCallback
from lightstage.rig import Camera
from processing.colmap import pycolmap

MAX_FEATURES = 1500
PEAK_THRESHOLD = 0.002
"""SIFT's; skin shows little contrast, so a third of its usual value."""
RATIO = 0.85
MIN_INLIERS = 15
RANSAC_PX = 2.0


def features(picture: np.ndarray, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """SIFT features of a picture.

    Returns:
        (n, 2) pixels (top-left pixel's centre 0.5) and (n, 128) float32 unit descriptors.
    """
    options = pycolmap.FeatureExtractionOptions()
    options.use_gpu = False
    options.num_threads = 1
    options.sift.max_num_features = MAX_FEATURES
    options.sift.peak_threshold = PEAK_THRESHOLD
    # Without the usual doubling of the picture: a quarter of the time, and enough features.
    options.sift.first_octave = 0
    extractor = pycolmap.FeatureExtractor.create(options, pycolmap.Device.cpu)
    keypoints, descriptors = extractor.extract_from_uint8_array(np.ascontiguousarray(picture))
    if not len(keypoints):
        return np.zeros((0, 2)), np.zeros((0, 128), np.float32)
    points = np.asarray(pycolmap.keypoints_to_matrix(keypoints), float)[:, :2]
    row = np.clip(points[:, 1].astype(int), 0, mask.shape[0] - 1)
    column = np.clip(points[:, 0].astype(int), 0, mask.shape[1] - 1)
    inside = mask[row, column]
    found = np.asarray(descriptors.data, np.float32)[inside]
    found /= np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-9)
    return points[inside], found


def match_features(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Mutual nearest neighbours among unit descriptors that pass the ratio test [Lowe2004].

    Returns:
        (n, 2) indices into first and second.
    """
    if min(len(first), len(second)) < 2:
        return np.zeros((0, 2), np.int64)
    alike = first @ second.T
    nearest, back = alike.argmax(axis=1), alike.argmax(axis=0)
    rows = np.arange(len(first))
    two = -np.partition(-alike, 1, axis=1)[:, :2]
    distance = np.arccos(np.clip(two, -1, 1))
    good = (distance[:, 0] < RATIO * distance[:, 1]) & (back[nearest] == rows)
    return np.stack([rows[good], nearest[good]], axis=1)


def find_matches(
    pictures: Sequence[np.ndarray],
    masks: Sequence[np.ndarray],
    cameras: Sequence[Camera],
    progress: ProgressCallback,
) -> list[tuple[int, int, np.ndarray]]:
    """Matches (first, second, (n, 2, 2) undistorted pixels) that fit one essential matrix."""
    pycolmap.set_random_seed(0)
    pycolmap.logging.minloglevel = pycolmap.logging.Level.WARNING.value
    # Else it leaves files in the system's temporary folder.
    pycolmap.logging.logtostderr = True
    total = len(pictures) + len(cameras) * (len(cameras) - 1) // 2
    points, descriptors = [], []
    for picture, mask, camera in zip(pictures, masks, cameras, strict=True):
        pixels, found = features(picture, mask)
        points.append(_undistorted(pixels, camera))
        descriptors.append(found)
        progress(len(points), total)
    lenses = [
        pycolmap.Camera(
            model="PINHOLE",
            width=camera.width_px,
            height=camera.height_px,
            params=[camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px],
        )
        for camera in cameras
    ]
    options = pycolmap.RANSACOptions()
    options.max_error = RANSAC_PX
    options.max_num_trials = 2000
    options.random_seed = 0
    pairs, done = [], len(pictures)
    for first in range(len(cameras)):
        for second in range(first + 1, len(cameras)):
            matches = match_features(descriptors[first], descriptors[second])
            pixels = np.stack([points[first][matches[:, 0]], points[second][matches[:, 1]]], axis=1)
            fit = (
                pycolmap.estimate_essential_matrix(
                    pixels[:, 0], pixels[:, 1], lenses[first], lenses[second], options
                )
                if len(matches) >= MIN_INLIERS
                else None
            )
            inliers = None if fit is None else np.asarray(fit["inlier_mask"], bool)
            if inliers is not None and inliers.sum() >= MIN_INLIERS:
                pairs.append((first, second, pixels[inliers]))
            done += 1
            progress(done, total)
    return pairs


def _undistorted(pixels: np.ndarray, camera: Camera) -> np.ndarray:
    """(n, 2) pixels that a pinhole camera of the same matrix would show."""
    if not len(pixels) or not any(camera.dist):
        return pixels
    lens = camera.opencv_matrix
    straight = cv2.undistortPoints((pixels - 0.5)[:, None], lens, np.array(camera.dist), P=lens)
    return np.asarray(straight, float)[:, 0] + 0.5
