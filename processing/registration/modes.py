"""A linear shape model and a pose fitted to landmarks and a scan: where non-rigid ICP starts."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import lsq_linear
from scipy.spatial.transform import Rotation

from lightstage.formats.mesh import vertex_normals
from lightstage.formats.template import Template
from processing.registration.config import ModesConfig
from processing.registration.rigid import Similarity
from processing.registration.target import Target

MOST_POINTS = 4000
"""Surface points used a round; more add time and no information."""
SETTLED = 1e-3
"""A round that changes nothing by more (radians, mm, log scale, deviations) is the last."""


@dataclasses.dataclass(frozen=True)
class ModelFit:
    """Pose and coefficients.

    Attributes:
        world_from_head: similarity; its scale is the person's size against the model's.
        identity: (k,) standard deviations.
        expression: (m,) shares of full strength.
        vertices: (n, 3) mm, the model in the world.
    """

    world_from_head: Similarity
    identity: np.ndarray
    expression: np.ndarray
    vertices: np.ndarray


def fit_modes(
    template: Template,
    triangles: np.ndarray,
    target: Target,
    landmarks_mm: np.ndarray,
    start: Similarity,
    config: ModesConfig,
    *,
    free: np.ndarray,
) -> ModelFit:
    """Gauss-Newton over pose, scale, identity and expression, with Gaussian priors.

    Args:
        template: with or without modes; without, pose and scale alone are fitted.
        triangles: (t, 3) of the template.
        target: the scan.
        landmarks_mm: (68, 3), NaN where unknown.
        start: world_from_head to begin with.
        config: settings.
        free: (n,) bool, vertices that never follow the scan.

    Returns:
        ModelFit.
    """
    mean = template.mesh.vertices
    none = np.zeros((0, *mean.shape))
    identity = none if template.modes is None else template.modes.identity
    expression = none if template.modes is None else template.modes.expression
    basis = np.concatenate([identity, expression])  # (c, n, 3)
    sigma = np.concatenate(
        [np.ones(len(identity)), np.full(len(expression), config.expression_sigma)]
    )
    prior = np.concatenate([np.zeros(6), [config.scale_sigma**-2], sigma**-2.0])
    coefficients = np.zeros(len(basis))
    side = np.full(len(identity), config.largest_identity)
    lowest = np.concatenate([-side, np.zeros(len(expression))])
    highest = np.concatenate([side, np.ones(len(expression))])
    pose = start
    known = np.flatnonzero(np.isfinite(landmarks_mm).all(axis=1))
    marks = template.landmarks[known]
    cos_gate = np.cos(np.deg2rad(config.normal_gate_deg))
    candidates = np.flatnonzero(~free)
    candidates = candidates[:: max(1, round(len(candidates) / (1.5 * MOST_POINTS)))]
    for step in range(config.iterations):
        head = mean + np.tensordot(coefficients, basis, axes=1)
        world = pose.apply(head)
        closest = target.closest(world[candidates])
        normals = vertex_normals(world, triangles)[candidates]
        facing = np.einsum("nk,nk->n", normals, closest.normal)
        # Half the rounds with the wide gate, then a tighter one.
        gate = config.gate_mm if 2 * step < config.iterations else config.gate_mm / 3
        use = (closest.distance_mm < gate) & (facing > cos_gate) & ~closest.border
        used = np.flatnonzero(use)
        used = used[:: max(1, len(used) // MOST_POINTS)]
        chosen = candidates[used]
        centre = world[marks].mean(axis=0)
        matrix = np.diag(prior)
        right = -prior * np.concatenate([np.zeros(6), [np.log(pose.scale)], coefficients])
        jacobian = _jacobian(pose, world[marks], centre, basis[:, marks])
        gap = landmarks_mm[known] - world[marks]
        # Geman-McClure's weight.
        squared = (gap**2).sum(axis=1) / config.landmark_robust_mm**2
        weight = config.landmark_sigma_mm**-2 / (1 + squared) ** 2
        matrix += np.einsum("pmi,m,qmi->pq", jacobian, weight, jacobian)
        right += np.einsum("pmi,m,mi->p", jacobian, weight, gap)
        if len(chosen):
            normal = closest.normal[used]
            jacobian = _jacobian(pose, world[chosen], centre, basis[:, chosen])
            along = np.einsum("pmi,mi->pm", jacobian, normal)
            gap_n = np.einsum("mi,mi->m", closest.point[used] - world[chosen], normal)
            share = min(1.0, config.surface_samples / len(chosen)) * config.surface_sigma_mm**-2
            matrix += share * along @ along.T
            right += share * along @ gap_n
        change = _bounded(matrix, right, lowest - coefficients, highest - coefficients)
        turn = Rotation.from_rotvec(change[:3]).as_matrix()
        factor = float(np.exp(change[6]))
        pose = Similarity(
            turn @ pose.rotation,
            factor * turn @ (pose.translation - centre) + centre + change[3:6],
            pose.scale * factor,
        )
        coefficients = coefficients + change[7:]
        if 2 * step >= config.iterations and np.abs(change).max() < SETTLED:
            break
    head = mean + np.tensordot(coefficients, basis, axes=1)
    count = len(identity)
    return ModelFit(pose, coefficients[:count], coefficients[count:], pose.apply(head))


def _bounded(
    matrix: np.ndarray, right: np.ndarray, lowest: np.ndarray, highest: np.ndarray
) -> np.ndarray:
    """Minimum of x'Mx/2 - r'x with the last unknowns within bounds; the first ones are free."""
    root = np.linalg.cholesky(matrix).T
    unbounded = np.full(len(right) - len(lowest), np.inf)
    bounds = (np.concatenate([-unbounded, lowest]), np.concatenate([unbounded, highest]))
    target = solve_triangular(root.T, right, lower=True)
    # Bounds that touch would be refused; a coefficient at its bound keeps a hair of room.
    found = lsq_linear(root, target, (bounds[0] - 1e-9, bounds[1] + 1e-9), method="bvls")
    change: np.ndarray = found.x
    return change


def _jacobian(
    pose: Similarity, world: np.ndarray, centre: np.ndarray, basis: np.ndarray
) -> np.ndarray:
    """(7 + c, m, 3) derivative of world points by turn and scale about a centre, shift, modes."""
    arm = world - centre
    turn = np.cross(np.eye(3)[:, None], arm[None])
    shift = np.broadcast_to(np.eye(3)[:, None], turn.shape)
    return np.concatenate([turn, shift, arm[None], pose.scale * basis @ pose.rotation.T])
