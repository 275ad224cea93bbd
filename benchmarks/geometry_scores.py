"""A mesh against the truth: both ways, by region, and its normals."""

from __future__ import annotations

import dataclasses
import functools

import cv2
import numpy as np
import open3d

from lightstage.formats.landmarks import read_points_mm
from lightstage.formats.mesh import Mesh, read_ply, vertex_normals
from lightstage.formats.processed import ProcessedFolder
from lightstage.rig import Rig
from processing.readings import px_per_mm

EVERY = 5
"""Truth is asked at every 5th pixel across and down."""
NEAR_MM = 16.0
EAR_MM = 35.0
CAP_MM = 1.0
SHOWN_MM = 0.5
"""Sigma of the mean of shading normals: a mesh's cells are a millimetre wide."""
REGIONS = {"nose": (27, 36), "lids": (36, 48), "lips": (48, 68), "chin": (6, 11)}
"""Landmarks of each region, a point within NEAR_MM of one of them belongs to it."""


@dataclasses.dataclass(frozen=True)
class Skin:
    """True skin that cameras see.

    Attributes:
        places: (n, 3) mm.
        normals: (n, 3) of the true mesh there.
        shown: (n, 3) those that light the photographs, pores and all, averaged over SHOWN_MM.
        views: (n,) by how many cameras it is seen.
        regions: name to (n,) bool.
        mesh: the truth.
    """

    places: np.ndarray
    normals: np.ndarray
    shown: np.ndarray
    views: np.ndarray
    regions: dict[str, np.ndarray]
    mesh: Mesh

    @functools.cached_property
    def surface(self) -> Surface:
        """The truth to ask: of millions of triangles, it takes longer to build than to answer."""
        return Surface(self.mesh)


class Surface:
    """A mesh to ask for nearest points and hits."""

    def __init__(self, mesh: Mesh) -> None:
        """Build the tree."""
        self.mesh = mesh
        self._normals = vertex_normals(mesh.vertices, mesh.faces)
        self._scene = open3d.t.geometry.RaycastingScene()
        self._scene.add_triangles(
            open3d.core.Tensor(mesh.vertices.astype(np.float32)),
            open3d.core.Tensor(mesh.faces.astype(np.uint32)),
        )

    def nearest(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n,) distance in mm and (n, 3) smooth normal of the nearest point."""
        queries = open3d.core.Tensor(np.ascontiguousarray(places, np.float32))
        found = self._scene.compute_closest_points(queries)
        points, faces = found["points"].numpy(), found["primitive_ids"].numpy()
        u, v = found["primitive_uvs"].numpy().T
        corners = self.mesh.faces[faces]
        weights = np.stack([1 - u - v, u, v], axis=1)
        normals = np.einsum("nk,nkc->nc", weights, self._normals[corners])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
        return np.linalg.norm(points - places, axis=1), normals

    def signed(self, places: np.ndarray, along: np.ndarray, reach_mm: float = 2.0) -> np.ndarray:
        """(n,) how far places are above the mesh along (n, 3) unit directions; NaN out of reach."""
        start = places + reach_mm * along
        rays = np.concatenate([start, -along], axis=1).astype(np.float32)
        found = self._scene.cast_rays(open3d.core.Tensor(rays))["t_hit"].numpy().astype(float)
        return np.where(found < 2 * reach_mm, found - reach_mm, np.nan)

    def first_hit(self, origin: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """(n,) distance of the first hit along rays, in lengths of `directions`."""
        rays = np.concatenate([np.broadcast_to(origin, directions.shape), directions], axis=1)
        tensor = open3d.core.Tensor(rays.astype(np.float32))
        return np.asarray(self._scene.cast_rays(tensor)["t_hit"].numpy())


def true_skin(truth: ProcessedFolder, rig: Rig) -> Skin:
    """What of the truth's skin the rig's cameras see.

    Args:
        truth: of a session.
        rig: the true one.
    """
    mesh = read_ply(truth.base_mesh)
    surface = Surface(mesh)
    parts, finest = [], []
    for camera in rig.cameras:
        mask = truth.read_mask(camera.id)
        some = mask[::EVERY, ::EVERY]
        parts.append(truth.read_view(camera.id, "position")[::EVERY, ::EVERY][some])
        normal = truth.read_view(camera.id, "diffuse_normal").astype(np.float32) * mask[..., None]
        wide = cv2.GaussianBlur(normal, (0, 0), SHOWN_MM * px_per_mm(camera))
        finest.append(wide[::EVERY, ::EVERY][some])
    places, shown = np.concatenate(parts).astype(float), np.concatenate(finest).astype(float)
    shown /= np.maximum(np.linalg.norm(shown, axis=1, keepdims=True), 1e-9)
    views = np.zeros(len(places), int)
    for camera in rig.cameras:
        pixels, _ = camera.project(places)
        inside = (pixels > 0).all(axis=1)
        inside &= (pixels < [camera.width_px, camera.height_px]).all(axis=1)
        toward = places - camera.centre_mm
        short = 1 - 0.5 / np.linalg.norm(toward, axis=1)
        views += inside & (surface.first_hit(camera.centre_mm, toward) > short)
    normals = surface.nearest(places)[1]
    marks = read_points_mm(truth.true_landmarks)
    return Skin(places, normals, shown, np.maximum(views, 1), _regions(places, marks), mesh)


def _regions(places: np.ndarray, marks: np.ndarray) -> dict[str, np.ndarray]:
    out = {}
    taken = np.zeros(len(places), bool)
    for name, (first, last) in REGIONS.items():
        apart = np.min(
            [np.linalg.norm(places - mark, axis=1) for mark in marks[first:last]], axis=0
        )
        out[name] = (apart < (10.0 if name == "lids" else NEAR_MM)) & ~taken
        taken |= out[name]
    # Between the outer corner of the lids, the nose's wing and the lips' corner, to the jaw.
    cheek = np.zeros(len(places), bool)
    for lid, wing, lip, jaw in ((36, 31, 48, 3), (45, 35, 54, 13)):
        middle = (marks[lid] + marks[wing] + marks[lip] + marks[jaw]) / 4
        cheek |= np.linalg.norm(places - middle, axis=1) < 28
    out["cheek"] = cheek & ~taken
    ear = np.zeros(len(places), bool)
    for mark in (marks[0], marks[16]):
        behind = mark + np.array([0.0, -8.0, -15.0])
        ear |= (np.linalg.norm(places - behind, axis=1) < EAR_MM) & (places[:, 2] < mark[2] + 4)
    out["ear"] = ear & ~taken
    return out


@dataclasses.dataclass(frozen=True)
class Scores:
    """Errors of a mesh, mm and degrees.

    Attributes:
        to_truth: (median, 95th percentile) distance of the mesh's points to the truth.
        to_mesh: the same from true skin to the mesh.
        within: share of true skin within .5 mm of the mesh.
        within_two: the same of skin that two cameras or more see.
        capped_mm: mean distance of true skin to the mesh, CAP_MM at most: holes count as that.
        normals_deg: (mean, median) angle of the mesh's normals to the truth's, of skin within 1 mm.
        shown_deg: the same to `Skin.shown`.
        regions: name to (median, 95th, share within .5 mm) of its skin's distance to the mesh.
    """

    to_truth: tuple[float, float]
    to_mesh: tuple[float, float]
    within: float
    within_two: float
    capped_mm: float
    normals_deg: tuple[float, float]
    shown_deg: tuple[float, float]
    regions: dict[str, tuple[float, float, float]]


def where(mesh: Mesh, skin: Skin, other: Mesh, near_mm: float = 0.5) -> tuple[Mesh, Skin]:
    """The parts of a mesh and of true skin that another mesh has within `near_mm`, too."""
    there = Surface(other)
    held = there.nearest(mesh.vertices)[0] < near_mm
    faces = mesh.faces[held[mesh.faces].all(axis=1)]
    found = there.nearest(skin.places)[0] < near_mm
    return Mesh(mesh.vertices, faces), dataclasses.replace(
        skin,
        places=skin.places[found],
        normals=skin.normals[found],
        shown=skin.shown[found],
        views=skin.views[found],
        regions={name: inside[found] for name, inside in skin.regions.items()},
    )


def score(mesh: Mesh, skin: Skin) -> Scores:
    """Compare, both in the truth's world."""
    ours = Surface(mesh)
    gap, normals = ours.nearest(skin.places)
    away = skin.surface.nearest(points_on(mesh, 60_000))[0]
    near = gap < 1.0
    return Scores(
        _two(away),
        _two(gap),
        float((gap < 0.5).mean()),
        float((gap[skin.views > 1] < 0.5).mean()),
        float(np.minimum(gap, CAP_MM).mean()),
        _angles(normals[near], skin.normals[near]),
        _angles(normals[near], skin.shown[near]),
        {
            name: (*_two(gap[inside]), float((gap[inside] < 0.5).mean()))
            for name, inside in skin.regions.items()
            if inside.sum() > 20
        },
    )


def points_on(mesh: Mesh, count: int) -> np.ndarray:
    """(n, 3) points spread evenly over a mesh's area, always the same."""
    corners = mesh.vertices[mesh.faces]
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    rng = np.random.default_rng(0)
    face = rng.choice(len(area), count, p=area / area.sum())
    u, v = rng.random((2, count, 1))
    swap = (u + v) > 1
    u, v = np.where(swap, 1 - u, u), np.where(swap, 1 - v, v)
    chosen = corners[face]
    return np.asarray(
        chosen[:, 0] + u * (chosen[:, 1] - chosen[:, 0]) + v * (chosen[:, 2] - chosen[:, 0])
    )


def _angles(one: np.ndarray, two: np.ndarray) -> tuple[float, float]:
    """(mean, median) degrees between unit vectors."""
    if not len(one):
        return np.nan, np.nan
    angle = np.degrees(np.arccos(np.clip(np.einsum("nk,nk->n", one, two), -1, 1)))
    return float(angle.mean()), float(np.median(angle))


def _two(values: np.ndarray) -> tuple[float, float]:
    return float(np.median(values)), float(np.percentile(values, 95))
