"""Places of the face at which pixels are compared, and how their normals and albedo may differ."""

from __future__ import annotations

import dataclasses

import cv2
import numba
import numpy as np
from scipy import sparse
from scipy.spatial.distance import cdist
from torch import Tensor

from learning.networks.whole_face import WholeFaceNetwork
from learning.photo.config import FitConfig
from learning.photo.model import NOSE_TIP, ShapeModel, spread_out
from learning.photo.skin_mask import BROWS
from learning.render.view import sample_bilinear
from lightstage.formats.mesh import Mesh, vertex_normals
from lightstage.formats.srgb import LUMINANCE
from lightstage.formats.template import Template

PLACES = 2000
"""About 4 mm apart."""
REGIONS = ("skin",)
"""Of a template; eyes, ears, hair and lips are not compared: behind open lips there are teeth."""
RIM_MM = 130.0
"""Distance from the nose's tip within which an outline is the face's."""
BESIDE_MM = 6.0
"""Distance within which places are taken together where it is judged what is skin."""
ALBEDO_LENGTH_MM = 25.0
"""Over which an albedo's difference from the mean person's is alike."""
ALBEDO_FIELDS = 60
TONE_DEVIATION = 3.0
"""Of the logarithm of a person's tone, which pixels alone do not separate from the light."""
BACKWARD = -0.2
"""Places of the mean shape whose normals point farther backward are left out."""
TINY = 1e-6


@dataclasses.dataclass(frozen=True)
class FacePlaces:
    """Vertices of the face at which pixels are compared.

    Attributes:
        vertices: (s,) their indices.
        model: of these.
        first: (s + 1,) where each place's triangles begin in `touching`.
        touching: triangles that give the places their normals.
        corners: (f, 3) of all these triangles, as indices into the hull's vertices.
        hull: the model of the triangles' vertices.
        modes: (u, 3, k + m) of the hull: identity, then expression.
        area_mm2: of one place.
        near: (s, s) mean over the places beside each.
        pattern: (s,) natural logarithm of the mean person's albedo (its luminance).
        albedo: (s, a) ways in which albedos differ, each one standard deviation.
        uv: (s, 2).
        rim: (n,) bool, vertices whose outline is the face's.
    """

    vertices: np.ndarray
    model: ShapeModel
    first: np.ndarray
    touching: np.ndarray
    corners: np.ndarray
    hull: ShapeModel
    modes: np.ndarray
    area_mm2: float
    near: sparse.csr_matrix
    pattern: np.ndarray
    albedo: np.ndarray
    uv: np.ndarray
    rim: np.ndarray

    def kept(self, chosen: np.ndarray) -> FacePlaces:
        """Some of the places, by their (c,) indices."""
        parts = [self.touching[self.first[s] : self.first[s + 1]] for s in chosen]
        ends = np.cumsum([0, *(len(p) for p in parts)])
        return dataclasses.replace(
            self,
            vertices=self.vertices[chosen],
            model=part_of(self.model, chosen),
            first=ends.astype(np.int64),
            touching=np.concatenate([np.zeros(0, np.int64), *parts]),
            near=self.near[chosen][:, chosen],
            pattern=self.pattern[chosen],
            albedo=self.albedo[chosen],
            uv=self.uv[chosen],
        )


def part_of(model: ShapeModel, chosen: np.ndarray) -> ShapeModel:
    """The model of some vertices, by their (s,) indices."""
    return dataclasses.replace(
        model,
        mean=model.mean[chosen],
        identity=model.identity[:, chosen],
        expression=model.expression[:, chosen],
        face=model.face[chosen],
    )


def face_places(
    template: Template, model: ShapeModel, network: WholeFaceNetwork, config: FitConfig
) -> FacePlaces:
    """Where a template's face is compared with pixels."""
    triangles = template.mesh.triangles()
    normals = vertex_normals(model.mean, triangles)
    shown = np.zeros(len(model.mean), bool)
    for name in REGIONS:
        shown[template.regions.get(name, np.zeros(0, int))] = True
    # What is above is not compared, as hair or a hat often hides it.
    shown &= (
        template.mesh.vertices[:, 1] < template.mesh.vertices[template.landmarks[BROWS], 1].min()
    )
    candidates = model.face & (normals[:, 2] > BACKWARD) & shown
    chosen = np.sort(spread_out(model.mean, np.flatnonzero(candidates), PLACES))
    place_of = np.full(len(model.mean), -1)
    place_of[chosen] = np.arange(len(chosen))
    touching = (place_of[triangles] >= 0).any(axis=1)
    used, corners = np.unique(triangles[touching], return_inverse=True)
    corners = corners.reshape(-1, 3)
    at = place_of[triangles[touching]]
    face, corner = np.nonzero(at >= 0)
    around = sparse.csr_matrix(
        (np.ones(len(face)), (at[face, corner], face)), (len(chosen), len(corners))
    )
    mean = model.mean[chosen]
    edges = model.mean[triangles]
    area = 0.5 * np.linalg.norm(
        np.cross(edges[:, 1] - edges[:, 0], edges[:, 2] - edges[:, 0]), axis=1
    )
    area = float(area[candidates[triangles].all(axis=1)].sum()) / max(len(chosen), 1)
    beside = (cdist(mean, mean) < BESIDE_MM).astype(float)
    near = sparse.csr_matrix(beside / beside.sum(axis=1, keepdims=True))
    uv = _vertex_uv(template.mesh)[chosen]
    pattern = _luminance_of(network.mean_log_albedo[0].permute(1, 2, 0).numpy(), uv)
    modes = network.albedo_modes.permute(0, 2, 3, 1).numpy()
    deviations = network.mode_deviations.numpy()
    ways = [_luminance_of(m * d, uv) for m, d in zip(modes, deviations, strict=True)]
    smooth = smooth_fields(mean, config.albedo_deviation, ALBEDO_LENGTH_MM, ALBEDO_FIELDS)
    tone = np.full((1, len(mean)), TONE_DEVIATION)
    albedo = np.concatenate([tone, np.stack(ways), smooth]).T
    tip = model.mean[template.landmarks[NOSE_TIP]]
    rim = shown & (np.linalg.norm(model.mean - tip, axis=1) < RIM_MM)
    both = np.concatenate([model.identity, model.expression])[:, used]
    return FacePlaces(
        vertices=chosen,
        model=part_of(model, chosen),
        first=around.indptr.astype(np.int64),
        touching=around.indices.astype(np.int64),
        corners=corners.astype(np.int64),
        hull=part_of(model, used),
        modes=np.ascontiguousarray(np.moveaxis(both, 0, 2)),
        area_mm2=area,
        near=near,
        pattern=pattern,
        albedo=albedo,
        uv=uv,
        rim=rim,
    )


def smooth_fields(places: np.ndarray, deviation: float, length_mm: float, count: int) -> np.ndarray:
    """(k, s) strongest directions of a Gaussian process, each of one standard deviation.

    Args:
        places: (s, 3) mm.
        deviation: of the field at a place.
        length_mm: over which it is alike.
        count: of directions, at most.
    """
    squared = cdist(places, places, "sqeuclidean")
    values, vectors = np.linalg.eigh(deviation**2 * np.exp(squared * (-0.5 / length_mm**2)))
    order = np.argsort(-values)[:count]
    found: np.ndarray = (vectors[:, order] * np.sqrt(np.maximum(values[order], 0))).T
    return found


def sampled_texels(log_values: Tensor, size: tuple[int, int]) -> np.ndarray:
    """(rows, columns, c) of (1, c, h, w) logarithms at another size, no longer logarithms."""
    image = log_values[0].permute(1, 2, 0).numpy()
    small = cv2.resize(image, size[::-1], interpolation=cv2.INTER_AREA)
    found: np.ndarray = np.exp(small.reshape(*size, -1).astype(float))
    return found


def _vertex_uv(mesh: Mesh) -> np.ndarray:
    """(n, 2) of each vertex, one of its corners'."""
    uv = np.zeros((len(mesh.vertices), 2))
    assert mesh.uvs is not None
    uv[mesh.triangles()] = mesh.uvs[mesh.triangle_uvs()]
    return uv


def _luminance_of(log_albedo: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """(s,) of a (rows, columns, 3) map of logarithms at (s, 2) UV."""
    found: np.ndarray = sample_bilinear(log_albedo.astype(float), uv) @ LUMINANCE
    return found


def normals_with_slopes(
    places: FacePlaces, identity: np.ndarray, expression: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Normals of the places and how they turn.

    Args:
        places: s of them.
        identity: (k,) coefficients.
        expression: (m,) coefficients.

    Returns:
        (s, 3) unit normals, and (s, 3, k + m) their slopes by the coefficients.
    """
    shape = places.hull.vertices(identity, expression)
    found: tuple[np.ndarray, np.ndarray] = turned_normals(
        shape, places.modes, places.corners, places.first, places.touching
    )
    return found


@numba.njit(cache=True)
def turned_normals(
    shape: np.ndarray,
    modes: np.ndarray,
    corners: np.ndarray,
    first: np.ndarray,
    touching: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Unit vertex normals, each the mean of its triangles' weighted by area, and their slopes.

    Args:
        shape: (u, 3) vertices.
        modes: (u, 3, k) how these move.
        corners: (f, 3) vertices of the triangles.
        first: (s + 1,) where each place's triangles begin in `touching`.
        touching: indices of triangles.

    Returns:
        (s, 3) normals, zero where the triangles have no area, and (s, 3, k) slopes.
    """
    count, k = len(first) - 1, modes.shape[2]
    normals, slopes = np.zeros((count, 3)), np.zeros((count, 3, k))
    change = np.empty((3, k))
    for s in range(count):
        n0 = n1 = n2 = 0.0
        change[:] = 0.0
        for at in range(first[s], first[s + 1]):
            a, b, c = corners[touching[at]]
            x0, x1, x2 = shape[b] - shape[a]
            y0, y1, y2 = shape[c] - shape[a]
            n0 += x1 * y2 - x2 * y1
            n1 += x2 * y0 - x0 * y2
            n2 += x0 * y1 - x1 * y0
            for j in range(k):
                p0 = modes[b, 0, j] - modes[a, 0, j]
                p1 = modes[b, 1, j] - modes[a, 1, j]
                p2 = modes[b, 2, j] - modes[a, 2, j]
                q0 = modes[c, 0, j] - modes[a, 0, j]
                q1 = modes[c, 1, j] - modes[a, 1, j]
                q2 = modes[c, 2, j] - modes[a, 2, j]
                change[0, j] += p1 * y2 - p2 * y1 + x1 * q2 - x2 * q1
                change[1, j] += p2 * y0 - p0 * y2 + x2 * q0 - x0 * q2
                change[2, j] += p0 * y1 - p1 * y0 + x0 * q1 - x1 * q0
        length = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
        if not (length > TINY and length < np.inf):
            continue
        n0, n1, n2 = n0 / length, n1 / length, n2 / length
        normals[s] = (n0, n1, n2)
        for j in range(k):
            along = n0 * change[0, j] + n1 * change[1, j] + n2 * change[2, j]
            slopes[s, 0, j] = (change[0, j] - n0 * along) / length
            slopes[s, 1, j] = (change[1, j] - n1 * along) / length
            slopes[s, 2, j] = (change[2, j] - n2 * along) / length
    return normals, slopes
