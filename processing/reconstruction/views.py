"""What the matcher sees of a session: pinhole pictures of all views, in a pyramid."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import cv2
import numpy as np

from lightstage.rig import Camera
from processing.normals import chroma_signal
from processing.reconstruction.patches import TEXTURES
from processing.vectors import unit

SMALL_ROWS = 600
"""Pictures of at most so many rows are searched as they are."""

WHITE = 0.5
"""Weight of the white part of colour, which holds the highlights, beside the rest."""

GREY = 0.1
"""A pixel less saturated than this has no colour that shows the light it scatters."""

SHORTEST = 1e-3
"""Least length of a mean of normals: they cancel each other in a shorter one."""

BASIS_ROWS = 380
"""Contrast is measured between pixels of about so many rows a picture."""


@dataclasses.dataclass(frozen=True)
class View:
    """One camera's pictures.

    Attributes:
        camera: the pinhole (undistorted) camera.
        textures: (h, w, TEXTURES) float32, NaN where background, clipped or not a number.
        mask: (h, w) bool, foreground.
        normals: (h, w, 3) float32 unit, world; zero where unknown.
        signal: (h, w, P) float32, what scattered light a pixel reads under each pattern, on a scale
            of its own; NaN where there is none. None where it was not wanted.
    """

    camera: Camera
    textures: np.ndarray
    mask: np.ndarray
    normals: np.ndarray
    signal: np.ndarray | None = None


@dataclasses.dataclass(frozen=True)
class Level:
    """All views at one level of the pyramid, padded to one size.

    Attributes:
        pictures: (views, h, w, TEXTURES) float32, NaN where unusable.
        masks: (views, h, w) bool foreground.
        normals: (views, h, w, 3) float32 world.
        lenses: (views, 4) fx, fy, cx, cy at this level.
        poses: (views, 3, 4) cam_from_world.
    """

    pictures: np.ndarray
    masks: np.ndarray
    normals: np.ndarray
    lenses: np.ndarray
    poses: np.ndarray

    def projections(self) -> np.ndarray:
        """(views, 3, 4) pixel_from_world."""
        matrices = [np.array([[f, 0, x], [0, g, y], [0, 0, 1]]) for f, g, x, y in self.lenses]
        return np.stack(matrices) @ self.poses


def common_basis(images: Sequence[np.ndarray], masks: Sequence[np.ndarray]) -> np.ndarray:
    """Weights from patterns and colours to the textures that carry most local contrast.

    Mirror reflection has the light's own (white) colour, and a highlight is behind the surface
    and wanders from view to view; the part of RGB orthogonal to white is free of it [Mallick2005]
    but noisier. So white is weighed down; of the rest, principal components of the differences
    between pixels a few apart: the pooled correlation over them is nearly that over all pictures.

    Args:
        images: of each view, (P, h, w, 3) linear.
        masks: of each view, (h, w) bool; only pixels inside count.

    Returns:
        (P, 3, k), k at most TEXTURES, the same for all views.
    """
    patterns = len(images[0])
    step_px = max(1, round(max(mask.shape[0] for mask in masks) / BASIS_ROWS))
    moment = np.zeros((3 * patterns, 3 * patterns))
    for image, mask in zip(images, masks, strict=True):
        some = (
            image[:, ::step_px, ::step_px]
            .astype(float)
            .transpose(0, 3, 1, 2)
            .reshape(3 * patterns, -1)
        )
        some = some.reshape(3 * patterns, *mask[::step_px, ::step_px].shape)
        inside = mask[::step_px, ::step_px]
        for step in (np.s_[1:, :], np.s_[:-1, :]), (np.s_[:, 1:], np.s_[:, :-1]):
            both = inside[step[0]] & inside[step[1]]
            change = (some[:, *step[0]] - some[:, *step[1]])[:, both]
            change = change[:, np.isfinite(change).all(axis=0)]
            moment += change @ change.T
    chroma = np.kron(np.eye(patterns), np.eye(3) - (1 - WHITE) / 3)
    moment = chroma @ moment @ chroma
    vectors = np.linalg.eigh(moment)[1][:, ::-1][:, :TEXTURES]
    # An eigenvector's sign is arbitrary: fixed here, so that results repeat.
    vectors = vectors * np.where(vectors.sum(axis=0) < 0, -1.0, 1.0)
    return (chroma @ vectors).reshape(patterns, 3, -1)


def make_view(
    camera: Camera,
    images: np.ndarray,
    valid: np.ndarray,
    mask: np.ndarray,
    normals: np.ndarray,
    basis: np.ndarray,
    white: np.ndarray | None = None,
) -> View:
    """Bring one camera's photographs into the matcher's form; undo the lens distortion, if any.

    Args:
        camera: of the rig.
        images: (P, h, w, 3) linear.
        valid: (h, w) bool.
        mask: (h, w) bool foreground.
        normals: (h, w, 3) world.
        basis: (P, 3, k) of `common_basis`.
        white: (3,) the lights' colour, where a signal is wanted.
    """
    usable = valid & mask
    rgb = np.ascontiguousarray(images[:, usable].transpose(1, 0, 2), np.float32)
    found = rgb.reshape(len(rgb), 3 * len(basis)) @ basis.reshape(-1, basis.shape[2]).astype(
        np.float32
    )
    finite = np.isfinite(found).all(axis=1)
    usable[usable] = finite
    textures = np.zeros((*mask.shape, TEXTURES), np.float32)
    textures[usable, : basis.shape[2]] = found[finite]
    normals = np.where(np.isfinite(normals), normals, 0).astype(np.float32)
    signal = None if white is None else _signal(rgb[finite], usable, white)
    if any(camera.dist):
        lens, straight = camera.opencv_matrix, dataclasses.replace(camera, dist=(0, 0, 0, 0, 0))
        size = (camera.width_px, camera.height_px)
        x, y = cv2.initUndistortRectifyMap(
            lens, np.array(camera.dist), None, lens, size, cv2.CV_32FC1
        )
        layers = [
            cv2.remap(np.ascontiguousarray(textures[:, :, k]), x, y, cv2.INTER_CUBIC)
            for k in range(textures.shape[2])
        ]
        textures = np.stack(layers, axis=2)
        # A pixel is as good as the worst that it is interpolated from.
        usable = cv2.remap(usable.astype(np.float32), x, y, cv2.INTER_LINEAR) > 0.999
        mask = cv2.remap(mask.astype(np.uint8), x, y, cv2.INTER_NEAREST) > 0
        normals = cv2.remap(normals, x, y, cv2.INTER_LINEAR)
        if signal is not None:
            signal = _each(signal, x, y)
        camera = straight
    textures[~(usable & mask)] = np.nan
    return View(camera, textures, mask, unit(normals, SHORTEST), signal)


def _signal(rgb: np.ndarray, usable: np.ndarray, white: np.ndarray) -> np.ndarray:
    """(h, w, P) the part of colour that no highlight has, NaN where there is none.

    Args:
        rgb: (n, P, 3) of the usable pixels.
        usable: (h, w) bool.
        white: (3,) the lights' colour.
    """
    found, saturation = chroma_signal(rgb / np.asarray(white, np.float32), np.ones(3))
    found[saturation < GREY] = np.nan
    out = np.full((*usable.shape, rgb.shape[1]), np.nan, np.float32)
    out[usable] = found
    return out


def _each(layers: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Layers (h, w, k) at other places; NaN beside a NaN."""
    moved = [
        cv2.remap(np.ascontiguousarray(layers[:, :, k]), x, y, cv2.INTER_LINEAR)
        for k in range(layers.shape[2])
    ]
    return np.stack(moved, axis=2)


def finest_level(views: Sequence[View]) -> Level:
    """The views at full size, stacked."""
    height = max(view.camera.height_px for view in views)
    width = max(view.camera.width_px for view in views)
    pictures = np.full((len(views), height, width, TEXTURES), np.nan, np.float32)
    masks = np.zeros((len(views), height, width), bool)
    normals = np.zeros((len(views), height, width, 3), np.float32)
    for index, view in enumerate(views):
        h, w = view.mask.shape
        pictures[index, :h, :w] = view.textures
        masks[index, :h, :w] = view.mask
        normals[index, :h, :w] = view.normals
    cameras = [view.camera for view in views]
    lenses = np.array([[c.fx_px, c.fy_px, c.cx_px, c.cy_px] for c in cameras])
    poses = np.array([c.cam_from_world for c in cameras])
    return Level(pictures, masks, normals, lenses, poses)


def halved(level: Level) -> Level:
    """The next coarser level: means over 2 x 2 valid pixels."""
    valid = ~np.isnan(level.pictures[..., :1])
    weight = block_sum(valid.astype(np.float32))
    pictures = block_sum(np.where(valid, level.pictures, 0)) / np.maximum(weight, 1)
    # Half a block of valid pixels makes a valid pixel.
    pictures[weight[..., 0] < 2] = np.nan
    masks = block_sum(level.masks[..., None].astype(np.float32))[..., 0] > 0
    return Level(
        pictures, masks, unit(block_sum(level.normals), SHORTEST), level.lenses / 2, level.poses
    )


def pictures_of(views: Sequence[View], finest_rows: int) -> Level:
    """The views, halved until they have at most so many rows."""
    level = finest_level(views)
    while level.pictures.shape[1] > finest_rows:
        level = halved(level)
    return level


def pyramid(views: Sequence[View], finest_rows: int, coarsest_rows: int) -> list[Level]:
    """Levels that are searched, from the coarsest to the finest, each twice as fine as the last.

    The finest has half the size of `pictures_of`, or the whole of pictures that are small.
    """
    level = pictures_of(views, finest_rows)
    levels = [halved(level) if level.pictures.shape[1] > SMALL_ROWS else level]
    while levels[-1].pictures.shape[1] > coarsest_rows:
        levels.append(halved(levels[-1]))
    return levels[::-1]


def depth_to_points(inverse_depth: np.ndarray, lens: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """World points of a depth map.

    Args:
        inverse_depth: (h, w) 1/mm along the optical axis, 0 where there is none.
        lens: (4,) fx, fy, cx, cy.
        pose: (3, 4) cam_from_world.

    Returns:
        (h, w, 3) float32 mm, NaN where there is none.
    """
    height, width = inverse_depth.shape
    fx, fy, cx, cy = lens
    depth = np.full((height, width), np.nan)
    np.divide(1.0, inverse_depth, out=depth, where=inverse_depth > 0)
    x = ((np.arange(width) + 0.5 - cx) / fx)[None] * depth
    y = ((np.arange(height) + 0.5 - cy) / fy)[:, None] * depth
    local = np.stack([x, y, depth], axis=-1)
    return ((local - pose[:, 3]) @ pose[:, :3]).astype(np.float32)


def block_sum(values: np.ndarray) -> np.ndarray:
    """Sums over 2 x 2 pixels of (views, h, w, c); odd sides are padded with zeros."""
    views, height, width, channels = values.shape
    padded = np.pad(values, ((0, 0), (0, height % 2), (0, width % 2), (0, 0)))
    rows, columns = padded.shape[1] // 2, padded.shape[2] // 2
    return padded.reshape(views, rows, 2, columns, 2, channels).sum(axis=(2, 4))
