"""Where a face's points are expected, and pictures warped so that the detector's points are there.

The mean head's face, seen from in front, is a square picture. Thin plates [Bookstein1989] bring a
photograph into it by the detector's points: what is left between a template point and its place in
the square is what the detector does not know of the person.
"""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np

from learning.photo.config import FitConfig
from learning.photo.model import shape_model, spread_out
from learning.photo.shape_fit import detector_places
from learning.render.view import scene_of
from lightstage.formats.mesh import vertex_normals
from lightstage.formats.template import Template

SIDE_PX = 128
"""Side of the square."""
AROUND = 1.15
"""Its side over the height of the detector's points on the mean head."""
COARSE = 32
"""Cells a side on which the thin plates are computed; between them they are nearly linear."""
STIFF = 1e-4
"""Of the thin plates, which follow points that are off a little less closely by it."""
POINTS = 380
"""Template points, at most."""
REACH_MM, FORWARD = 92.0, 0.25
"""Distance from the nose's tip and forward part of the normal within which vertices are chosen."""
FREE_MM = 2.0
"""A ray forward from a chosen vertex begins so far off it, and meets nothing."""


@dataclasses.dataclass(frozen=True)
class Layout:
    """The square, for one template.

    Attributes:
        vertices: (p,) of the template points.
        places: (p, 2) of these in the square, 0..1, x to the person's left and y down.
        there: (468,) bool, the detector's points that have a place.
        control: (c, 2) places of those.
        at_points: (p, c) the thin plates' values at the template points, of values at `control`.
        at_grid: ((COARSE + 1)^2, c) the same at corners of the square's cells, row by row.
        side_mm: of the square, on the mean head.
    """

    vertices: np.ndarray
    places: np.ndarray
    there: np.ndarray
    control: np.ndarray
    at_points: np.ndarray
    at_grid: np.ndarray
    side_mm: float

    @staticmethod
    def of(
        vertices: np.ndarray,
        places: np.ndarray,
        there: np.ndarray,
        control: np.ndarray,
        side_mm: float,
    ) -> Layout:
        """A square with its thin plates; arguments as the attributes."""
        lines = np.arange(COARSE + 1) / COARSE
        grid = np.stack(np.meshgrid(lines, lines), axis=2).reshape(-1, 2)
        plates = thin_plates(control, places), thin_plates(control, grid)
        return Layout(vertices, places, there, control, *plates, side_mm)

    def similarity(self, points_px: np.ndarray) -> np.ndarray:
        """(2, 2) scaled turn from the square to a photograph, px, by the (468, 2) points."""
        ours = self.control - self.control.mean(axis=0)
        other = points_px[self.there]
        other = other - other.mean(axis=0)
        size = (ours**2).sum()
        a = (ours * other).sum() / size
        b = (ours[:, 0] * other[:, 1] - ours[:, 1] * other[:, 0]).sum() / size
        return np.array([[a, -b], [b, a]])

    def expected_px(self, points_px: np.ndarray) -> np.ndarray:
        """(p, 2) where a photograph would show the template points by the detector's alone."""
        found: np.ndarray = self.at_points @ points_px[self.there]
        return found

    def warped(self, picture: np.ndarray, points_px: np.ndarray) -> np.ndarray:
        """(SIDE_PX, SIDE_PX, 3) of the (h, w, 3) picture's type: the photograph in the square."""
        corners = (self.at_grid @ points_px[self.there]).reshape(COARSE + 1, COARSE + 1, 2)
        # Centres of the square's pixels among the cells' corners; OpenCV counts pixels' centres.
        centre = (np.arange(SIDE_PX, dtype=np.float32) + 0.5) * (COARSE / SIDE_PX)
        across, down = np.meshgrid(centre, centre)
        at = cv2.remap(corners.astype(np.float32) - 0.5, across, down, cv2.INTER_LINEAR)
        step = float(np.sqrt(abs(np.linalg.det(self.similarity(points_px))))) / SIDE_PX
        if step > 1:
            # The warp reads four pixels for each it makes: larger photographs are blurred first.
            low = np.clip(np.floor(at.min(axis=(0, 1)) - 3 * step), 0, None).astype(int)
            high = np.ceil(at.max(axis=(0, 1)) + 3 * step).astype(int) + 1
            part = picture[low[1] : max(high[1], 1), low[0] : max(high[0], 1)]
            if part.size:
                picture, at = (
                    cv2.GaussianBlur(part, (0, 0), 0.4 * step),
                    at - low.astype(np.float32),
                )
        return np.asarray(
            cv2.remap(
                picture,
                at[..., 0],
                at[..., 1],
                cv2.INTER_LINEAR,
                borderMode=cv2.BORDER_REPLICATE,
            )
        )

    def beside_mm(self, points_px: np.ndarray) -> np.ndarray:
        """(c, 2) of the detector's points in the square by the best similarity, less `control`."""
        points = points_px[self.there]
        turned = (points - points.mean(axis=0)) @ np.linalg.inv(self.similarity(points_px)).T
        off = turned + self.control.mean(axis=0) - self.control
        found: np.ndarray = self.side_mm * off
        return found

    def residual_mm(self, true_px: np.ndarray, points_px: np.ndarray) -> np.ndarray:
        """(p, 2) in the square: how far the true template points are from the expected ones."""
        off = true_px - self.expected_px(points_px)
        found: np.ndarray = self.side_mm * off @ np.linalg.inv(self.similarity(points_px)).T
        return found


def layout_of(template: Template, config: FitConfig) -> Layout:
    """The square of a template with the detector's points."""
    found = detector_places(template)
    assert found is not None, "the template has no mediapipe468.json"
    places, there = found
    model = shape_model(template, config)
    control_mm = np.einsum("pck,pc->pk", model.mean[places.triangles], places.weights)[:, :2]
    low, high = control_mm.min(axis=0), control_mm.max(axis=0)
    side = AROUND * float((high - low).max())
    corner = (low + high) / 2 + np.array([-side, side]) / 2

    def square(points_mm: np.ndarray) -> np.ndarray:
        return np.asarray((points_mm[:, :2] - corner) * np.array([1, -1]) / side)

    vertices = _chosen(template, model.mean)
    control, points = square(control_mm), square(model.mean[vertices])
    return Layout.of(vertices, points, there, control, side)


def _chosen(template: Template, mean: np.ndarray) -> np.ndarray:
    """(p,) vertices of the face's skin, spread out, that are seen from in front."""
    normals = vertex_normals(mean, template.mesh.triangles())
    tip = mean[template.landmarks[30]]
    usable = (normals[:, 2] > FORWARD) & (np.linalg.norm(mean - tip, axis=1) < REACH_MM)
    for region in ("eyes", "hair", "ears"):
        usable[template.regions.get(region, np.zeros(0, int))] = False
    # Inside of mouth and nose something is in front.
    rays = np.concatenate([mean + FREE_MM * normals, np.tile([0.0, 0, 1], (len(mean), 1))], axis=1)
    import open3d

    scene = scene_of(template.mesh.with_vertices(mean))
    usable &= ~scene.test_occlusions(open3d.core.Tensor(rays.astype(np.float32))).numpy()
    return np.sort(spread_out(mean, np.flatnonzero(usable), POINTS))


def thin_plates(control: np.ndarray, at: np.ndarray) -> np.ndarray:
    """(m, c) matrix from values at (c, 2) places to those at (m, 2) [Bookstein1989]."""

    def kernel(one: np.ndarray, other: np.ndarray) -> np.ndarray:
        squared = ((one[:, None] - other[None]) ** 2).sum(axis=2)
        return np.asarray(0.5 * squared * np.log(np.maximum(squared, 1e-20)))

    count = len(control)
    flat = np.column_stack([np.ones(count), control])
    matrix = np.zeros((count + 3, count + 3))
    matrix[:count, :count] = kernel(control, control) + STIFF * np.eye(count)
    matrix[:count, count:], matrix[count:, :count] = flat, flat.T
    known = np.linalg.solve(matrix, np.eye(count + 3)[:, :count])
    found: np.ndarray = np.column_stack([kernel(at, control), np.ones(len(at)), at]) @ known
    return found
