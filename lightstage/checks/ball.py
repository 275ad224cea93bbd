"""The photograph to expect of a pattern: a matte ball in the head's place, lit by the rig's lamps.

A head is no ball, so single cells are wrong by a few tenths; but the ball suffices to find which
pattern a photograph shows, and whether it is as bright as it should be against `full`.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from lightstage.checks.photo_measures import Photo
from lightstage.checks.sums import MIN_CELLS, lit_cells
from lightstage.rig import Rig

FLOOR = 0.02
"""Light of neighbouring skin and shirt that a ball does not see, share of full."""


class BallModel:
    """Expected light of patterns, by the direction that a surface faces.

    Args:
        rig: lights and cameras.
        levels: pattern to (n,) levels.
    """

    def __init__(self, rig: Rig, levels: Mapping[str, np.ndarray]) -> None:
        positions = rig.positions_mm
        distance = np.linalg.norm(positions, axis=1, keepdims=True)
        self._directions = positions / distance
        gain = rig.rgb_gains.mean(axis=1) / (distance[:, 0] / distance.mean()) ** 2
        self.patterns = list(levels)
        self._lamps = np.stack([np.asarray(levels[name], float) * gain for name in self.patterns])
        self._gain = gain
        self._cameras = {camera.id: camera for camera in rig.cameras}

    def normals(self, camera_id: str, whole: Photo) -> tuple[np.ndarray, np.ndarray]:
        """Which way each lit coarse cell would face, were the lit part a ball.

        Args:
            camera_id: whose photograph.
            whole: taken under the most light, so that all of the subject shows.

        Returns:
            (r, c) bool cells, (m, 3) unit world directions of the m that are true.
        """
        lit = lit_cells(whole)
        rows, columns = np.nonzero(lit)
        if not len(rows):
            return lit, np.zeros((0, 3))
        middle = (rows.min() + rows.max()) / 2, (columns.min() + columns.max()) / 2
        half = (np.ptp(rows) + 1) / 2, (np.ptp(columns) + 1) / 2
        y, x = (rows - middle[0]) / half[0], (columns - middle[1]) / half[1]
        radius = np.sqrt(x * x + y * y)
        shrink = np.where(radius > 0.95, 0.95 / np.maximum(radius, 1e-9), 1.0)
        x, y = x * shrink, y * shrink
        toward = -np.sqrt(1 - x * x - y * y)
        local = np.stack([x, y, toward], axis=1)
        return lit, local @ self._cameras[camera_id].cam_from_world[:, :3]

    def expected(self, directions: np.ndarray) -> np.ndarray:
        """(p, m) light of each pattern on surfaces that face (m, 3) directions."""
        return np.asarray(self._lamps @ self._facing(directions))

    def single(self, directions: np.ndarray) -> np.ndarray:
        """(n, m) light of each lamp alone at level 1."""
        return np.asarray(self._gain[:, None] * self._facing(directions))

    def _facing(self, directions: np.ndarray) -> np.ndarray:
        return np.asarray(np.maximum(self._directions @ directions.T, 0.0))

    def is_part(self, pattern: str, whole: str) -> bool:
        """Whether no lamp shines brighter under a pattern than under the whole.

        Two shots of `mux` are no parts of each other: either shows light that the other lacks.
        """
        one, all_ = (self._lamps[self.patterns.index(name)] for name in (pattern, whole))
        return bool((one <= all_ + 1e-6 * all_.max()).all())

    def shares(self, camera_id: str, whole: Photo, whole_pattern: str) -> np.ndarray | None:
        """(p, m) each pattern's light as a share of the whole's; None where too little is lit."""
        _, directions = self.normals(camera_id, whole)
        if len(directions) < MIN_CELLS:
            return None
        light = self.expected(directions)
        base = light[self.patterns.index(whole_pattern)]
        return np.asarray(light / np.maximum(base, 1e-9 + 1e-3 * base.max()))


def seen_shares(photo: Photo, whole: Photo) -> np.ndarray | None:
    """(m,) a photograph's green in the whole's lit cells, as a share of the whole's."""
    lit = lit_cells(whole)
    if photo.coarse.shape != whole.coarse.shape or lit.sum() < MIN_CELLS:
        return None
    return np.asarray(photo.coarse[..., 1][lit] / whole.coarse[..., 1][lit], float)


def unlikeness(seen: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """(p,) how far a photograph is from each pattern: mean absolute difference of the shares.

    Args:
        seen: (m,) shares of the whole.
        expected: (p, m) of the patterns.
    """
    return np.asarray(np.abs(seen[None] - expected).mean(axis=1))


def brightness(seen: np.ndarray, expected: np.ndarray, weight: np.ndarray) -> float:
    """Ratio of what is seen to what is expected.

    Args:
        seen: (...) light of cells.
        expected: (...) of a ball there.
        weight: (...) light of the same cells in the whole.
    """
    wanted = float((expected * weight).sum() / weight.sum())
    return (float((seen * weight).sum() / weight.sum()) + FLOOR) / (wanted + FLOOR)
