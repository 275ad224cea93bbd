"""Cameras, poses, one identity and expressions from landmarks, by damped least squares.

Unknown are one identity, and for each photograph the focal length, the pose and the expression.
Each landmark's distance in pixels counts over its standard deviation, cut off robustly
[GemanMcClure1985]; each unknown counts by what is known of it before. The inverse of the last
normal matrix is the covariance of the answer: it is large where the photographs do not show the
answer.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.spatial.transform import Rotation

from learning.gauss_newton import descended
from learning.photo.config import FitConfig
from learning.photo.model import ShapeModel
from lightstage.rig import Camera

ROUNDS = 60
SETTLED = 1e-6
"""A step that lowers the cost by less than this share is the last."""
CUT_OFF = 3.0
"""Standard deviations at which a landmark loses its weight."""
FIRST_FOCAL = 1.3
"""Focal length of an unknown camera, of the picture's longer side: between a phone's .75 and a
portrait lens's 3, where most portraits are."""
BACKWARD = 1 / 3
"""Deviation of an expression of less than none, of that of one of more."""
NEAREST_MM, FARTHEST_MM = 150.0, 20_000.0
_PER_PHOTO = 7
"""Unknowns of a photograph before its expression: the logarithm of the focal length, a rotation
vector, the image of the head's origin (2) and the logarithm of its distance."""
STEEPEST = 0.05
"""Cosine between a landmark's normal and the direction to the camera below which it is hidden."""


@dataclasses.dataclass(frozen=True)
class Sighting:
    """The landmarks of one photograph.

    Attributes:
        points_px: (p, 2), NaN where there is none; the top-left pixel's centre is (0.5, 0.5).
        width_px: of the picture.
        height_px: of the picture.
        focal_px: where the file states it, else None.
        sigma_px: standard deviation of a landmark; None for the configuration's share of the eyes'
            distance.
        weight: (p,) how much each landmark counts; all the same where None.
    """

    points_px: np.ndarray
    width_px: int
    height_px: int
    focal_px: float | None = None
    sigma_px: float | None = None
    weight: np.ndarray | None = None


@dataclasses.dataclass(frozen=True)
class Taken:
    """How one photograph was taken, and with which face.

    Attributes:
        focal_px: focal length.
        rotation: (3, 3) of cam_from_head.
        offset_mm: (3,) of cam_from_head.
        expression: (m,) strengths.
        residual_px: root mean square over its landmarks, those that lost their weight left out.
        used: (p,) 0..1, how much each landmark counts at the end.
    """

    focal_px: float
    rotation: np.ndarray
    offset_mm: np.ndarray
    expression: np.ndarray
    residual_px: float
    used: np.ndarray


@dataclasses.dataclass(frozen=True)
class LandmarkFit:
    """A person and how they were photographed.

    Attributes:
        identity: (k,) coefficients.
        photographs: one for each sighting.
        covariance: (u, u) of identity, then of each photograph's unknowns.
    """

    identity: np.ndarray
    photographs: tuple[Taken, ...]
    covariance: np.ndarray

    def deviation_mm(self, identity_modes: np.ndarray) -> np.ndarray:
        """(n, 3) standard deviation of vertices by what is not known of the identity.

        Args:
            identity_modes: (k, n, 3).
        """
        count = len(self.identity)
        values, vectors = np.linalg.eigh(self.covariance[:count, :count])
        spread = np.tensordot((vectors * np.sqrt(np.maximum(values, 0))).T, identity_modes, 1)
        found: np.ndarray = np.sqrt((spread**2).sum(axis=0))
        return found


@dataclasses.dataclass
class Unknowns:
    """The state of the search, over f photographs.

    Attributes:
        identity: (k,) coefficients.
        log_focal: (f,) natural logarithm of the focal length in px.
        rotation: f of cam_from_head.
        image: (f, 2) place of the head's origin, over its distance along the lens's axis.
        log_depth: (f,) natural logarithm of that distance in mm.
        expression: (f, m) strengths.
    """

    identity: np.ndarray
    log_focal: np.ndarray
    rotation: list[Rotation]
    image: np.ndarray
    log_depth: np.ndarray
    expression: np.ndarray

    def moved(self, step: np.ndarray) -> Unknowns:
        """After a (u,) step, in the order of the normal equations."""
        kept = len(self.identity)
        each = step[kept:].reshape(len(self.log_focal), -1)
        return Unknowns(
            self.identity + step[:kept],
            self.log_focal + each[:, 0],
            [
                Rotation.from_rotvec(turn) * before
                for turn, before in zip(each[:, 1:4], self.rotation, strict=True)
            ],
            self.image + each[:, 4:6],
            np.clip(self.log_depth + each[:, 6], np.log(NEAREST_MM), np.log(FARTHEST_MM)),
            self.expression + each[:, 7:],
        )


class Problem:
    """The equations of a person and the landmarks of one or several photographs."""

    def __init__(
        self,
        model: ShapeModel,
        sightings: list[Sighting],
        config: FitConfig,
        normals: np.ndarray | None = None,
        trust: np.ndarray | None = None,
    ) -> None:
        """What is known.

        Args:
            model: of the p landmarks (`ShapeModel.at`).
            sightings: of the photographs, each with 8 landmarks or more.
            config: what is known before.
            normals: (p, 3) of the mean surface there, head frame: landmarks turned away from the
                camera do not count.
            trust: (p,) 0..1, how much each landmark counts; all the same where None.
        """
        self.trust = np.ones(len(model.mean)) if trust is None else trust
        self.model, self.sightings, self.config = model, sightings, config
        self.normals = normals
        self.seen = [np.isfinite(s.points_px).all(axis=1) for s in sightings]
        self.sigma = [
            s.sigma_px or max(config.landmark_percent / 100 * _extent(s.points_px), 0.25)
            for s in sightings
        ]
        self.focal = [
            (np.log(s.focal_px), config.focal_told_spread)
            if s.focal_px
            else (np.log(FIRST_FOCAL * max(s.width_px, s.height_px)), config.focal_spread)
            for s in sightings
        ]

    @property
    def size(self) -> int:
        """How many unknowns there are."""
        each = _PER_PHOTO + len(self.model.expression)
        return len(self.model.identity) + each * len(self.sightings)

    def columns(self, index: int) -> np.ndarray:
        """Where the identity and a photograph's unknowns are among all."""
        k, per = len(self.model.identity), _PER_PHOTO + len(self.model.expression)
        return np.r_[0:k, k + per * index : k + per * (index + 1)]

    def solved(self) -> tuple[Unknowns, np.ndarray]:
        """What the landmarks determine: the unknowns, and their covariance."""
        here, _, matrix = descended(
            self.begin(), self.equations, Unknowns.moved, ROUNDS, least_gain=SETTLED
        )
        return here, np.linalg.inv(matrix)

    def begin(self) -> Unknowns:
        """The mean person at rest, turned and moved onto each photograph's landmarks."""
        count, m = len(self.sightings), len(self.model.expression)
        rotations, images, depths, focals = [], [], [], []
        for index, sighting in enumerate(self.sightings):
            seen = self.seen[index]
            focal = float(np.exp(self.focal[index][0]))
            rotation, scale, offset = _weak_perspective(
                self.model.mean[seen], sighting.points_px[seen]
            )
            rotations.append(rotation)
            depths.append(np.log(np.clip(focal / scale, NEAREST_MM, FARTHEST_MM)))
            images.append((offset - self.centre(index)) / focal)
            focals.append(np.log(focal))
        return Unknowns(
            np.zeros(len(self.model.identity)),
            np.array(focals),
            rotations,
            np.array(images),
            np.array(depths),
            np.zeros((count, m)),
        )

    def equations(self, at: Unknowns) -> tuple[float, np.ndarray, np.ndarray]:
        """Cost, normal matrix and gradient at a place."""
        k, size = len(at.identity), self.size
        matrix, right = np.zeros((size, size)), np.zeros(size)
        matrix[range(k), range(k)] += 1.0
        right[:k] += at.identity
        cost = float((at.identity**2).sum())
        for index in range(len(self.sightings)):
            off, jacobian, weight = self._photo(at, index)
            columns = self.columns(index)
            # Geman and McClure's function weighs by (c / (c + r^2))^2.
            squared = (off**2).sum(axis=1)
            cut = CUT_OFF**2
            cost += float((weight * squared / (1 + squared / cut)).sum())
            robust = weight / (1 + squared / cut) ** 2
            rows = jacobian.reshape(-1, len(columns))
            each = np.repeat(robust, 2)
            matrix[np.ix_(columns, columns)] += rows.T @ (each[:, None] * rows)
            right[columns] += rows.T @ (each * off.reshape(-1))
            prior = self._priors(at, index)
            for place, (value, spread) in zip(columns[k:], prior, strict=True):
                matrix[place, place] += 1 / spread**2
                right[place] += value / spread**2
                cost += value**2 / spread**2
        return cost, matrix, right

    def answer(self, at: Unknowns, covariance: np.ndarray) -> LandmarkFit:
        """What was found, with the (u, u) covariance of all unknowns."""
        taken = []
        for index in range(len(self.sightings)):
            off, _, weight = self._photo(at, index)
            squared = (off**2).sum(axis=1)
            used = weight / (1 + squared / CUT_OFF**2) ** 2
            kept = used > 0.25
            mean = float(squared[kept].mean() / 2) if kept.any() else float("nan")
            taken.append(
                Taken(
                    float(np.exp(at.log_focal[index])),
                    at.rotation[index].as_matrix(),
                    _offset(at, index),
                    at.expression[index],
                    self.sigma[index] * mean**0.5,
                    used,
                )
            )
        return LandmarkFit(at.identity, tuple(taken), covariance)

    def centre(self, index: int) -> np.ndarray:
        """(2,) the middle of a photograph, through which the lens's axis is taken to go."""
        sighting = self.sightings[index]
        return np.array([sighting.width_px, sighting.height_px]) / 2

    def _photo(self, at: Unknowns, index: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(p, 2) residuals over their deviation, (p, 2, u) their slopes, (p,) weights."""
        sighting = self.sightings[index]
        here = projected(self.model, at, index, self.centre(index))
        local = here.local
        seen = self.seen[index] & (local[:, 2] > 1.0)
        weight = seen * self.trust
        if sighting.weight is not None:
            weight = weight * sighting.weight
        if self.normals is not None:
            toward = -local / np.linalg.norm(local, axis=1, keepdims=True)
            rotation = at.rotation[index].as_matrix()
            cosine = ((self.normals @ rotation.T) * toward).sum(axis=1)
            weight *= np.clip((cosine - STEEPEST) / 0.25, 0, 1)
        sigma = self.sigma[index]
        off = np.where(seen[:, None], (here.found - sighting.points_px) / sigma, 0.0)
        return off, here.slopes / sigma, weight

    def _priors(self, at: Unknowns, index: int) -> list[tuple[float, float]]:
        """What is known before of a photograph's unknowns: how far off, and the deviation."""
        mean, spread = self.focal[index]
        free = [(0.0, 1e6)] * 5
        depth = (0.0, 1e6)
        ahead = self.config.expression_spread
        expression = [
            (float(e), ahead if e > 0 else BACKWARD * ahead) for e in at.expression[index]
        ]
        return [(float(at.log_focal[index] - mean), spread), *free, depth, *expression]


@dataclasses.dataclass(frozen=True)
class Projected:
    """Places of a model as a photograph shows them.

    Attributes:
        local: (p, 3) in the camera's axes, mm.
        found: (p, 2) in the picture, px.
        slopes: (p, 2, u) of `found` by the identity and the photograph's unknowns.
    """

    local: np.ndarray
    found: np.ndarray
    slopes: np.ndarray


def projected(model: ShapeModel, at: Unknowns, index: int, centre_px: np.ndarray) -> Projected:
    """Places of a model in one photograph, and how they move with the unknowns.

    Args:
        model: of p places.
        at: the state of the search.
        index: of the photograph.
        centre_px: (2,) where the lens's axis meets the picture.
    """
    rotation = at.rotation[index].as_matrix()
    turned = model.vertices(at.identity, at.expression[index]) @ rotation.T
    offset = _offset(at, index)
    local = turned + offset
    focal = float(np.exp(at.log_focal[index]))
    depth = np.maximum(local[:, 2], 1.0)
    image = local[:, :2] / depth[:, None]
    # Slope of the picture's place by the place in the camera's axes: (p, 2, 3).
    by_local = np.zeros((len(local), 2, 3))
    by_local[:, 0, 0] = by_local[:, 1, 1] = focal / depth
    by_local[:, :, 2] = -focal * image / depth[:, None]
    modes = np.concatenate([model.identity, model.expression]) @ rotation.T
    by_modes = np.einsum("pij,kpj->pik", by_local, modes)
    k = len(model.identity)
    by_turn = np.einsum("pij,pjk->pik", by_local, cross_matrices(-turned))
    own_depth = float(np.exp(at.log_depth[index]))
    axes = np.eye(3)
    by_offset = by_local @ np.column_stack([own_depth * axes[0], own_depth * axes[1], offset])
    by_focal = (focal * image)[:, :, None]
    slopes = [by_modes[:, :, :k], by_focal, by_turn, by_offset, by_modes[:, :, k:]]
    return Projected(local, focal * image + centre_px, np.concatenate(slopes, axis=2))


def camera_of(at: Unknowns, index: int, width_px: int, height_px: int, name: str) -> Camera:
    """A photograph's camera; its world is the head frame."""
    focal = float(np.exp(at.log_focal[index]))
    return Camera(
        id=name,
        serial="",
        model="",
        width_px=width_px,
        height_px=height_px,
        fx_px=focal,
        fy_px=focal,
        cx_px=width_px / 2,
        cy_px=height_px / 2,
        dist=(0.0, 0.0, 0.0, 0.0, 0.0),
        cam_from_world=np.column_stack([at.rotation[index].as_matrix(), _offset(at, index)]),
    )


def _offset(at: Unknowns, index: int) -> np.ndarray:
    """(3,) of cam_from_head in mm."""
    depth = float(np.exp(at.log_depth[index]))
    return np.array([*(at.image[index] * depth), depth])


def cross_matrices(vectors: np.ndarray) -> np.ndarray:
    """(p, 3, 3) matrices of the cross product with (p, 3) vectors."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return np.moveaxis(np.array(rows), 2, 0)


def _extent(points_px: np.ndarray) -> float:
    """A measure of a face's size in the picture: about the distance between the eyes' corners."""
    known = points_px[np.isfinite(points_px).all(axis=1)]
    # Of points spread over a face, twice the root of the product of the deviations is about that.
    return float(2.0 * np.prod(np.maximum(known.std(axis=0), 1e-9)) ** 0.5)


def _weak_perspective(
    points_mm: np.ndarray, points_px: np.ndarray
) -> tuple[Rotation, float, np.ndarray]:
    """Rotation, scale in px / mm and the origin's picture, of a camera far away.

    The least-squares affine camera is brought to the nearest scaled rotation.
    """
    rows = np.column_stack([points_mm, np.ones(len(points_mm))])
    affine = np.linalg.lstsq(rows, points_px, rcond=None)[0].T
    first, second = affine[0, :3], affine[1, :3]
    both = np.stack([first, second])
    left, scale, right = np.linalg.svd(both, full_matrices=False)
    upper = left @ right
    rotation = Rotation.from_matrix(np.vstack([upper, np.cross(upper[0], upper[1])]))
    return rotation, max(float(scale.mean()), 1e-6), affine[:, 3]
