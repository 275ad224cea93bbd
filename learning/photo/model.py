"""The shapes that a fit may take: a template's modes, and smooth changes beside them.

A template's modes span the people that it was made of; its population, where it has one, has a
mean and modes of its own. Another person differs from all of these; smooth changes, drawn from a
Gaussian process on the mean shape [Luthi2018], take up what the modes do not have. A face's two
sides are nearly alike, so the process is: what one side does the other mirrors, but for a small
part.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.spatial.distance import cdist

from learning.photo.config import FitConfig
from lightstage.formats.template import Template

SAMPLES = 400
"""Places of the face on which the smooth changes are computed [Williams2001]."""
FACE_MM = 95.0
"""Distance from the nose's tip within which a vertex belongs to the face."""
NOSE_TIP, EARS = 30, [0, 16]
"""In iBUG's order; the jaw's contour begins and ends before the ears."""
LEAST_SHARE = 1e-4
"""Of the largest eigenvalue, below which a direction of change is left out."""


@dataclasses.dataclass(frozen=True)
class ShapeModel:
    """Vertices = mean + identity . a + expression . b, in mm, head frame.

    Attributes:
        mean: (n, 3).
        identity: (k, n, 3), each of one standard deviation: the way from the population's mean to
            the template's mesh and the population's modes, where the template has one; the
            template's modes; the face's depth; then the smooth changes.
        expression: (m, n, 3) at full strength.
        expression_names: m names.
        named_modes: how many of the identity's are not smooth changes.
        face: (n,) bool, vertices of the face.
    """

    mean: np.ndarray
    identity: np.ndarray
    expression: np.ndarray
    expression_names: tuple[str, ...]
    named_modes: int
    face: np.ndarray

    def vertices(self, identity: np.ndarray, expression: np.ndarray) -> np.ndarray:
        """(n, 3) of (k,) identity and (m,) expression coefficients."""
        shape: np.ndarray = (
            self.mean
            + np.tensordot(identity, self.identity, 1)
            + np.tensordot(expression, self.expression, 1)
        )
        return shape

    def at(self, triangles: np.ndarray, weights: np.ndarray) -> ShapeModel:
        """The model of p places on the surface.

        Args:
            triangles: (p, 3) vertex indices.
            weights: (p, 3) of these corners.
        """

        def placed(values: np.ndarray) -> np.ndarray:
            found: np.ndarray = np.einsum("...pck,pc->...pk", values[..., triangles, :], weights)
            return found

        return dataclasses.replace(
            self,
            mean=placed(self.mean),
            identity=placed(self.identity),
            expression=placed(self.expression),
            face=self.face[triangles].all(axis=1),
        )


def shape_model(template: Template, config: FitConfig) -> ShapeModel:
    """The model of a template; one without modes has the smooth changes alone."""
    mean = template.mesh.vertices.astype(float)
    tip = mean[template.landmarks[NOSE_TIP]]
    face = np.linalg.norm(mean - tip, axis=1) < FACE_MM
    modes = template.modes
    none = np.zeros((0, *mean.shape))
    own = none if modes is None else modes.identity[: config.identity_modes].astype(float)
    expression = none if modes is None else modes.expression.astype(float)
    names = () if modes is None else modes.expression_names
    # All that is before the ears becomes deeper or flatter as a whole.
    behind = mean[template.landmarks[EARS], 2].mean()
    deeper = np.zeros_like(mean)
    deeper[:, 2] = np.maximum(mean[:, 2] - behind, 0)
    mean = mean + (template.depth_ratio - 1) * deeper
    people = template.population
    if people is not None:
        rest = mean - people.mean_mm
        mean = people.mean_mm + config.mesh_share * rest
        own = np.concatenate([config.mesh_deviation * rest[None], people.identity_mm, own])
    own = np.concatenate([own, config.depth_deviation * deeper[None]])
    scales = list(zip(config.free_mm, config.free_length_mm, strict=True))
    free = smooth_changes(mean, face, config.free_modes, scales, config.asymmetry)
    identity = np.concatenate([own, free])
    return ShapeModel(mean, identity, expression, names, len(own), face)


def smooth_changes(
    mean: np.ndarray,
    face: np.ndarray,
    count: int,
    scales: list[tuple[float, float]],
    asymmetry: float,
) -> np.ndarray:
    """The strongest directions of a Gaussian process of displacements, by Nystroem's method.

    The covariance of two places is a sum of squared exponentials, added to its mirror image.

    Args:
        mean: (n, 3) vertices, mirrored by x.
        face: (n,) bool, where displacements are drawn; they fade out beyond.
        count: of directions, at most.
        scales: of each squared exponential, the standard deviation of a displacement's component
            and the distance over which displacements are alike, both mm.
        asymmetry: deviation of what the sides do not share, of that of what they share.

    Returns:
        (k, n, 3) float64, each of one standard deviation, the strongest first; k <= count.
    """
    if count == 0 or not face.any():
        return np.zeros((0, *mean.shape))
    among = spread_out(mean, np.flatnonzero(face), SAMPLES)
    chosen = mean[among]
    mirror = np.array([-1.0, 1.0, 1.0])

    def covariance(one: np.ndarray, other: np.ndarray) -> np.ndarray:
        squared = cdist(one, other, "sqeuclidean")
        found = np.zeros_like(squared)
        for deviation_mm, length_mm in scales:
            found += deviation_mm**2 * np.exp(squared * (-0.5 / length_mm**2))
        return found

    straight, crossed = covariance(mean, chosen), covariance(mean, chosen * mirror)
    directions: list[tuple[float, np.ndarray, int]] = []
    for sign in (1.0, -1.0):
        # Half of each, so that the two signs add up to the plain covariance.
        shared_by = 0.5 * (straight + sign * crossed)
        values, vectors = np.linalg.eigh(shared_by[among])
        kept = values > LEAST_SHARE * values[-1]
        values, vectors = values[kept], vectors[:, kept]
        # A field phi_i with sqrt(l_i) phi_i of unit variance in its coefficient.
        fields = (shared_by @ vectors / np.sqrt(values)).T
        for axis in range(3):
            # Mirrored, x changes its sign: its symmetric fields are the odd ones.
            shared = (sign < 0) == (axis == 0)
            scale = np.sqrt(2.0) * (1.0 if shared else asymmetry)
            strength = scale**2 * values / len(chosen)
            directions += [
                (float(power), scale * field, axis)
                for power, field in zip(strength, fields, strict=True)
            ]
    directions.sort(key=lambda d: -d[0])
    out = np.zeros((min(count, len(directions)), *mean.shape))
    for index, (_, field, axis) in enumerate(directions[: len(out)]):
        out[index, :, axis] = field
    return out


def spread_out(points: np.ndarray, among: np.ndarray, count: int) -> np.ndarray:
    """(count,) indices of points, each as far as can be from those before; all where fewer.

    Args:
        points: (n, 3).
        among: indices to choose from, in order.
        count: how many.
    """
    if len(among) <= count:
        return among
    found = np.empty(count, among.dtype)
    places = points[among]
    far = np.full(len(among), np.inf)
    at = 0
    for index in range(count):
        found[index] = among[at]
        far = np.minimum(far, ((places - places[at]) ** 2).sum(axis=1))
        at = int(far.argmax())
    return found
