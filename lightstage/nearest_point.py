"""The point nearest to lines: where axes of cameras meet, or rays through the same place."""

from __future__ import annotations

import numpy as np


def nearest_equations(origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations of the point with the least sum of squared distances to n lines.

    Args:
        origins: (n, 3) a point of each line.
        directions: (n, 3) unit.

    Returns:
        (3, 3) symmetric matrix A and (3,) b of A p = b, b in the unit of the origins. The least
        eigenvalue of A measures how far the lines are from parallel: of two, about half their angle
        squared.
    """
    origins, directions = np.reshape(origins, (-1, 3)), np.reshape(directions, (-1, 3))
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    return across.sum(axis=0), np.einsum("nij,nj->i", across, origins)
