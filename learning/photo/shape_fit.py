"""The shape of one person, and how each photograph was taken, from landmarks and pixels."""

from __future__ import annotations

import dataclasses

import numpy as np

from learning.errors import MapsError
from learning.networks.whole_face import WholeFaceNetwork
from learning.photo.config import FitConfig
from learning.photo.landmark_fit import LandmarkFit, Problem, Sighting, camera_of
from learning.photo.model import ShapeModel, shape_model
from learning.photo.pixel_fit import PixelFit
from lightstage.formats.mesh import Mesh, vertex_normals
from lightstage.formats.template import Template
from lightstage.rig import Camera

STEADY_MM = 3.0
"""Spread at which a landmark counts half."""


@dataclasses.dataclass(frozen=True)
class Photograph:
    """A photograph and the landmarks on it.

    Attributes:
        name: for messages.
        rgb_linear: (h, w, 3) float32, 1 = the picture's white.
        landmarks_px: (p, 2), NaN where hidden.
        focal_px: where the file states it.
        weight: (p,) how much each landmark counts; all the same where None.
        eyes_px: (2, 3, 2) where the eyes are open, see `learning.photo.eyes.openings`; None where
            that was not sought.
        whites: (2, 3) linear value of the eyes' whites, see `learning.photo.eyes.whites`; None
            where that was not sought.
        mouth_px: (8, 2) the inner edge of the lips, NaN where hidden; None where not sought.
    """

    name: str
    rgb_linear: np.ndarray
    landmarks_px: np.ndarray
    focal_px: float | None = None
    weight: np.ndarray | None = None
    eyes_px: np.ndarray | None = None
    whites: np.ndarray | None = None
    mouth_px: np.ndarray | None = None


@dataclasses.dataclass(frozen=True)
class Places:
    """Places of landmarks on a template.

    Attributes:
        triangles: (p, 3) vertex indices.
        weights: (p, 3) of these corners.
        spread_mm: (p,) how far apart the views of a head found them; zeros where it is not
            known.
    """

    triangles: np.ndarray
    weights: np.ndarray
    spread_mm: np.ndarray


def detector_places(template: Template) -> tuple[Places, np.ndarray] | None:
    """Places of the face detector's points that lie on a template, and which of the 468 these are.

    They are those of the population's mean head where its template has one, because detectors see
    them elsewhere on a head of another shape. None for a template without such points.
    """
    people = template.population
    points = template.face_points if people is None else people.face_points or template.face_points
    if points is None:
        return None
    there = points.triangles[:, 0] >= 0
    return Places(points.triangles[there], points.weights[there], points.spread_mm[there]), there


@dataclasses.dataclass(frozen=True)
class Shape:
    """A person's shape and how each photograph was taken.

    Attributes:
        model: that was fitted.
        landmarks: the fit's answer.
        cameras: of the photographs, world = the head frame.
        meshes: of the photographs: the person with each one's expression, head frame.
        neutral: the person without an expression, head frame.
        deviation_mm: (n,) standard deviation of each vertex by what the photographs do not show.
    """

    model: ShapeModel
    landmarks: LandmarkFit
    cameras: tuple[Camera, ...]
    meshes: tuple[Mesh, ...]
    neutral: Mesh
    deviation_mm: np.ndarray


def fit_shape(
    photographs: list[Photograph],
    template: Template,
    places: Places,
    config: FitConfig,
    model: ShapeModel | None = None,
    network: WholeFaceNetwork | None = None,
) -> Shape:
    """Find the shape of the person, the cameras and the expressions.

    Args:
        photographs: of one person.
        template: whose topology the head has.
        places: of the landmarks on it.
        config: what is known before.
        model: of the template, where it was made already.
        network: knows the albedo of the mean person and how others differ; without it, or where
            the configuration has no rounds of pixels, landmarks alone give the shape.

    Raises:
        MapsError: a photograph with too few landmarks, or none that agree with a face.
    """
    model = shape_model(template, config) if model is None else model
    there = model.at(places.triangles, places.weights)
    normals = vertex_normals(model.mean, template.mesh.triangles())
    facing = np.einsum("pck,pc->pk", normals[places.triangles], places.weights)
    sightings = []
    for photograph in photographs:
        height, width = photograph.rgb_linear.shape[:2]
        known = np.isfinite(photograph.landmarks_px).all(axis=1).sum()
        if known < 8:
            raise MapsError(
                photograph.name,
                field="landmarks",
                found=f"{known} of {len(photograph.landmarks_px)}",
                expected="8 or more",
            )
        points, weight = photograph.landmarks_px, photograph.weight
        sightings.append(Sighting(points, width, height, photograph.focal_px, weight=weight))
    trust = 1 / (1 + (places.spread_mm / STEADY_MM) ** 2)
    problem = Problem(there, sightings, config, facing, trust)
    at, covariance = problem.solved()
    found = problem.answer(at, covariance)
    for photograph, taken in zip(photographs, found.photographs, strict=True):
        if not (taken.used > 0.25).sum() >= 8:
            raise MapsError(
                photograph.name,
                field="landmarks",
                found="landmarks that fit no head",
                expected="those of one face, in the scheme's order",
            )
    if network is not None and config.pixel_rounds:
        pictures = [photograph.rgb_linear for photograph in photographs]
        search = PixelFit(problem, model, template, network, pictures, config)
        at, covariance = search.run(at)
        found = problem.answer(at, covariance)
    cameras, meshes = [], []
    for index, (photograph, taken) in enumerate(zip(photographs, found.photographs, strict=True)):
        height, width = photograph.rgb_linear.shape[:2]
        cameras.append(camera_of(at, index, width, height, photograph.name))
        meshes.append(template.mesh.with_vertices(model.vertices(found.identity, taken.expression)))
    neutral = model.vertices(found.identity, np.zeros(len(model.expression)))
    shapes = without_similarity(model.identity, model.mean, model.face)
    deviation = np.linalg.norm(found.deviation_mm(shapes), axis=1)
    return Shape(
        model,
        found,
        tuple(cameras),
        tuple(meshes),
        template.mesh.with_vertices(neutral),
        deviation,
    )


def without_similarity(modes: np.ndarray, mean: np.ndarray, face: np.ndarray) -> np.ndarray:
    """(k, n, 3) modes without the part that moves, turns or scales a face as a whole.

    Args:
        modes: (k, n, 3).
        mean: (n, 3) the shape that they change.
        face: (n,) bool, where the part is measured.
    """
    about = mean - mean[face].mean(axis=0)
    x, y, z = about.T
    zero = np.zeros_like(x)
    turns = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    moves = [np.broadcast_to(axis[:, None], (3, len(mean))) for axis in np.eye(3)]
    basis = np.stack([*moves, *turns, about.T]).transpose(0, 2, 1)  # (7, n, 3)
    flat = basis[:, face].reshape(len(basis), -1)
    if not face.any():
        return modes
    share = np.linalg.lstsq(flat.T, modes[:, face].reshape(len(modes), -1).T, rcond=None)[0]
    return modes - np.tensordot(share.T, basis, 1)


def aside_deg(camera: Camera) -> float:
    """Degrees that a camera stands from straight in front of a head in its own frame, 0 to 180."""
    across, above, ahead = camera.centre_mm
    return float(np.degrees(np.arctan2(np.hypot(across, above), ahead)))
