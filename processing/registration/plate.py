"""A thin plate on a mesh, pulled by springs: what each round of non-rigid ICP solves.

It also finds landmarks that contradict all others, before they bend the mesh.
"""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import SuperLU, splu

from processing.errors import RegistrationError
from processing.laplacian import cotangent_laplacian, tie_components
from processing.registration.config import PlateConfig


@dataclasses.dataclass
class Springs:
    """What pulls: ``sum_i (d_i - goal_i)' M_i (d_i - goal_i)`` over displacements d.

    Attributes:
        stiffness: (n, 3, 3) M, symmetric and positive semidefinite, mm^2.
        pull: (n, 3) M goal, mm^3.
    """

    stiffness: np.ndarray
    pull: np.ndarray

    @classmethod
    def none(cls, count: int) -> Springs:
        """No springs yet at `count` vertices."""
        return cls(np.zeros((count, 3, 3)), np.zeros((count, 3)))

    def add(self, vertices: np.ndarray, matrix: np.ndarray, goal: np.ndarray) -> None:
        """Add springs.

        Args:
            vertices: (k,) indices, each at most once.
            matrix: (k, 3, 3) mm^2.
            goal: (k, 3) displacements, mm.
        """
        self.stiffness[vertices] += matrix
        self.pull[vertices] += np.einsum("kij,kj->ki", matrix, goal)

    def scale(self, shares: np.ndarray) -> None:
        """Let each vertex be pulled by (n,) shares of what pulls it."""
        self.stiffness *= shares[:, None, None]
        self.pull *= shares[:, None]


class Plate:
    """Displacements d of a mesh under ``l^4 |A^-1/2 L d|^2 + share l^2 d'Ld`` and springs.

    Springs of different directions join the three coordinates; the plate does not. So one n x n
    factorisation of the plate with each spring's mean stiffness is a preconditioner for the joint
    3n x 3n system, some ten times cheaper than factoring that. The order of elimination is found
    once and serves all stiffnesses.
    """

    def __init__(self, rest: np.ndarray, triangles: np.ndarray, config: PlateConfig) -> None:
        """Prepare.

        Args:
            rest: (n, 3) mm, where the plate is flat.
            triangles: (t, 3).
            config: settings.
        """
        self._config = config
        self._stretch, areas = cotangent_laplacian(rest, triangles)
        typical = float(np.median(areas))
        self.areas = np.maximum(areas, 0.05 * typical)
        """(n,) mm^2 of each vertex."""
        self._bend = (self._stretch @ sp.diags(1 / self.areas) @ self._stretch).tocsr()
        self._tie = tie_components(rest, triangles, 10 * typical)
        self._order: np.ndarray | None = None
        self._factor: SuperLU | None = None
        self._ordered = False
        self._matrix = self._bend
        self.worst_residual = 0.0
        """Largest relative residual of a solve so far."""

    def stiffen(self, stiffness_mm: float, springs: Springs) -> None:
        """Set the stiffness and factor the preconditioner for springs like these."""
        stretch = self._config.stretch_share * stiffness_mm**2
        self._matrix = stiffness_mm**4 * self._bend + stretch * self._stretch + self._tie
        # A trace of identity keeps the matrix regular where nothing pulls at a part.
        mean = np.einsum("nii->n", springs.stiffness) / 3 + 1e-9 * self.areas
        system = (self._matrix + sp.diags(mean)).tocsc()
        if self._order is None:
            self._factor = _splu(system, "MMD_AT_PLUS_A")
            # perm_c[j] is the place of column j: its inverse lists the columns in order.
            self._order = np.argsort(self._factor.perm_c)
            return
        self._factor = _splu(system[self._order][:, self._order].tocsc(), "NATURAL")
        self._ordered = True

    def smooth(self, right: np.ndarray) -> np.ndarray:
        """Displacements (n, c) under forces (n, c), springs taken as equal in all directions."""
        assert self._factor is not None, "stiffen first"
        assert self._order is not None
        if not self._ordered:
            found: np.ndarray = self._factor.solve(right)
            return found
        out = np.empty_like(right)
        out[self._order] = self._factor.solve(np.ascontiguousarray(right[self._order]))
        return out

    def solve(self, springs: Springs, start: np.ndarray) -> np.ndarray:
        """Displacements of least energy, by preconditioned conjugate gradients.

        Args:
            springs: what pulls.
            start: (n, 3) mm to begin with.

        Returns:
            (n, 3) mm.

        Raises:
            RegistrationError: the solution is not finite.
        """
        regular = 1e-9 * self.areas[:, None]

        def times(x: np.ndarray) -> np.ndarray:
            joined: np.ndarray = (
                self._matrix @ x + np.einsum("nij,nj->ni", springs.stiffness, x) + regular * x
            )
            return joined

        # Sums by numpy itself: the same on any number of threads.
        found = start.copy()
        left = springs.pull - times(found)
        step = self.smooth(left)
        direction = step.copy()
        slope = float((left * step).sum())
        for _ in range(self._config.iterations):
            if not slope > 0:
                break
            bent = times(direction)
            length = slope / float((direction * bent).sum())
            found += length * direction
            left -= length * bent
            if length * np.abs(direction).max() < self._config.settled_mm:
                break
            step = self.smooth(left)
            before, slope = slope, float((left * step).sum())
            direction = step + (slope / before) * direction
        if not np.isfinite(found).all():
            raise RegistrationError(
                "non-rigid ICP",
                found="a system without a finite solution",
                expected="a template with triangles of some area",
            )
        size = float(np.linalg.norm(springs.pull))
        residual = float(np.linalg.norm(springs.pull - times(found)))
        self.worst_residual = max(self.worst_residual, residual / max(size, 1e-300))
        return found


def _splu(matrix: sp.csc_matrix, order: Literal["NATURAL", "MMD_AT_PLUS_A"]) -> SuperLU:
    return splu(matrix, permc_spec=order, diag_pivot_thresh=0.0, options={"SymmetricMode": True})


def contradicted(
    gaps: np.ndarray, reach: np.ndarray, least_mm: float, times_typical: float
) -> np.ndarray:
    """Landmarks that are elsewhere than the plate, held by all others, predicts.

    A plate under independent forces is a Gaussian process whose covariance is its response, so what
    the others predict for one landmark has a closed form [Rasmussen2006] (5.4.2). The worst
    is taken out and the rest tested again, until none is left that is an outlier: a wrong landmark
    makes its neighbours seem wrong too.

    Args:
        gaps: (k, 3) mm from each landmark's vertex, with no landmark pulling, to the landmark.
        reach: (k, k) mm^-2, response of each one's vertex to a unit force at each other's, with
            one over a landmark's own pull added on the diagonal.
        least_mm: prediction errors below are never taken for wrong.
        times_typical: how many times the median error, each over its expected size, is an outlier.

    Returns:
        (k,) bool; never more than a quarter of them.
    """
    wrong = np.zeros(len(gaps), bool)
    while wrong.sum() < len(gaps) // 4:
        kept = np.flatnonzero(~wrong)
        if len(kept) < 5:
            break
        inverse = np.linalg.inv(reach[np.ix_(kept, kept)])
        spread = 1 / np.maximum(np.diag(inverse), 1e-300)
        error = np.linalg.norm(inverse @ gaps[kept], axis=1) * spread
        unusual = error / np.sqrt(spread)
        suspect = (error > least_mm) & (unusual > times_typical * np.median(unusual))
        if not suspect.any():
            break
        wrong[kept[np.argmax(np.where(suspect, unusual, 0))]] = True
    return wrong
