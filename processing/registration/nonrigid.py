"""Non-rigid ICP: the template's vertices drawn onto the scan by a smooth displacement field.

Amberg's optimal step [Amberg2007], an exact solve for given closest points under a stiffness that
is annealed, with his per-vertex affine maps replaced by displacements under a thin-plate energy.
Three coordinates share one n x n factorisation, some hundred times cheaper than the 4n x 4n of
affine maps.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from lightstage.commands import ProgressCallback, quiet
from lightstage.formats.mesh import vertex_normals
from processing.registration.flips import mend
from processing.registration.laplacian import cotangent_laplacian, tie_components
from processing.registration.target import Closest, Target


@dataclasses.dataclass(frozen=True)
class NonrigidConfig:
    """Non-rigid ICP's settings."""

    stiffness_mm: tuple[float, ...] = (40.0, 25.0, 15.0, 10.0, 6.0, 4.0, 2.5, 1.7)
    """Annealed: details of the displacement shorter than about 2 pi times this are suppressed."""
    iterations: int = 4
    """Closest-point rounds per stiffness."""
    gate_share: float = 0.7
    """A closest point farther than this share of the stiffness does not count."""
    least_gate_mm: float = 3.0
    normal_gate_deg: float = 50.0
    """Nor does one whose normal is farther than this from the vertex's."""
    landmark_pull: float = 2.0
    """A landmark pulls so many times as hard as the plate resists: a point on a thin plate that
    lies on springs is held by 8 l^2, so the pull follows the stiffness l down."""
    stretch_share: float = 0.3
    """Weight of first against second derivatives: keeps unseen parts from running away."""
    intricate_stiffness_mm: float = 10.0
    """Ears, whose folds no template shares with a person, stop following below this."""
    mend_rounds: int = 20
    """At most so often are folded or crossing places smoothed and looked at again."""


@dataclasses.dataclass(frozen=True)
class Fit:
    """What non-rigid ICP found.

    Attributes:
        vertices: (n, 3) mm.
        matched: (n,) bool, vertices that had a closest point within the gates at the end.
        distance_mm: (n,) of each vertex to the scan.
        faulty: (t,) bool, triangles that are still folded over or cross others.
        mended: how many were before mending.
    """

    vertices: np.ndarray
    matched: np.ndarray
    distance_mm: np.ndarray
    faulty: np.ndarray
    mended: int


def fit_nonrigid(
    rest: np.ndarray,
    triangles: np.ndarray,
    target: Target,
    landmark_vertices: np.ndarray,
    landmarks_mm: np.ndarray,
    config: NonrigidConfig,
    *,
    free: np.ndarray | None = None,
    intricate: np.ndarray | None = None,
    progress: ProgressCallback = quiet,
) -> Fit:
    """Draw a mesh onto a scan.

    Minimises over displacements d, with l the stiffness and areas A,
    ``l^4 |A^-1/2 L d|^2 + share l^2 d'Ld + sum_i A_i w_i |n n.(x_i + d_i - c_i)|^2 + landmarks``;
    the data term's tangential part holds the vertex where it is in each round, so that one matrix
    serves all three coordinates.

    Args:
        rest: (n, 3) mm, roughly aligned.
        triangles: (t, 3).
        target: the scan.
        landmark_vertices: (m,) indices into `rest`.
        landmarks_mm: (m, 3), finite.
        config: settings.
        free: (n,) bool, vertices that never follow the scan (inside of the mouth).
        intricate: (n,) bool, vertices that follow its coarse shape only (ears).
        progress: called once a round.

    Returns:
        Fit.
    """
    system = _System(rest, triangles, landmark_vertices, landmarks_mm, config)
    allowed = np.ones(len(rest), bool) if free is None else ~free
    stiff = np.zeros(len(rest), bool) if intricate is None else intricate
    vertices = rest.copy()
    rounds = len(config.stiffness_mm) * config.iterations
    for step in range(rounds):
        stiffness = config.stiffness_mm[step // config.iterations]
        closest = target.closest(vertices)
        followed = allowed if stiffness >= config.intricate_stiffness_mm else allowed & ~stiff
        matched = followed & _gated(vertices, triangles, closest, stiffness, config)
        vertices = system.solve(vertices, closest, matched, stiffness)
        progress(step + 1, rounds)
    vertices, faulty, mended = mend(rest, vertices, triangles, rounds=config.mend_rounds)
    closest = target.closest(vertices)
    matched = allowed & _gated(vertices, triangles, closest, config.stiffness_mm[-1], config)
    return Fit(vertices, matched, closest.distance_mm, faulty, mended)


class _System:
    """The quadratic energy; everything in it that closest points do not change."""

    def __init__(
        self,
        rest: np.ndarray,
        triangles: np.ndarray,
        landmark_vertices: np.ndarray,
        landmarks_mm: np.ndarray,
        config: NonrigidConfig,
    ) -> None:
        self._rest = rest
        self._config = config
        self._landmark_vertices = landmark_vertices
        self._landmarks_mm = landmarks_mm
        self._stretch, areas = cotangent_laplacian(rest, triangles)
        self._areas = np.maximum(areas, 0.05 * np.median(areas))
        self._bend = (self._stretch @ sp.diags(1 / self._areas) @ self._stretch).tocsc()
        self._tie = tie_components(rest, triangles, 10 * float(np.median(areas)))

    def solve(
        self,
        vertices: np.ndarray,
        closest: Closest,
        matched: np.ndarray,
        stiffness_mm: float,
    ) -> np.ndarray:
        """One optimal step from `vertices`."""
        weight = self._areas * matched
        gap = np.einsum("nk,nk->n", closest.normal, closest.point - vertices)
        goal = vertices + gap[:, None] * closest.normal
        right = weight[:, None] * (goal - self._rest)
        pull = np.full(
            len(self._landmark_vertices), self._config.landmark_pull * 8 * stiffness_mm**2
        )
        offset = self._landmarks_mm - self._rest[self._landmark_vertices]
        np.add.at(weight, self._landmark_vertices, pull)
        np.add.at(right, self._landmark_vertices, pull[:, None] * offset)
        stretch = self._config.stretch_share * stiffness_mm**2
        # A trace of identity keeps the matrix regular where a part has no match at all.
        weight += 1e-9 * self._areas
        matrix = stiffness_mm**4 * self._bend + stretch * self._stretch + self._tie
        factor = splu(
            (matrix + sp.diags(weight)).tocsc(),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        moved: np.ndarray = self._rest + factor.solve(right)
        return moved


def _gated(
    vertices: np.ndarray,
    triangles: np.ndarray,
    closest: Closest,
    stiffness_mm: float,
    config: NonrigidConfig,
) -> np.ndarray:
    """(n,) bool: closest points near enough, facing the same way and not on the scan's border."""
    normals = vertex_normals(vertices, triangles)
    facing = np.einsum("nk,nk->n", normals, closest.normal)
    gate = max(config.gate_share * stiffness_mm, config.least_gate_mm)
    near = closest.distance_mm < gate
    alike = facing > np.cos(np.deg2rad(config.normal_gate_deg))
    accepted: np.ndarray = near & alike & ~closest.border
    return accepted
