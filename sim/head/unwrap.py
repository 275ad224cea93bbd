"""How the head's UV tile is laid out: the face in front, cuts behind, little stretch on the skin.

The vertex grid's borders are the tile's sides: the seam down the back is its left and right side,
the slit of the scalp its upper one, the neck's border its lower one. Points slide along the sides,
so that the tile is full, and no triangle is turned over, so that none overlap. Within these bounds
the symmetric Dirichlet energy of all triangles [Smith2015], which rises with every stretch and with
every shrinking, is made as small as it can be by reweighted least squares [Rabinovich2017].
"""

from __future__ import annotations

import dataclasses

import numpy as np
import scipy.sparse as sparse
from scipy.sparse.linalg import spsolve

from lightstage.formats.files import atomic_path
from sim.head.grid import COLUMNS, smoothstep
from sim.head.layout import LAYOUT_PATH
from sim.head.mesh import HALF, grid_vertices, neutral_mesh, regions

HEIGHT, WIDTH = 3.0, 2.0
"""Of the tile."""
ROUNDS = 60
SETTLED = 1e-4
"""Share of the energy; a round that changes less is the last."""
GROWTH = 1.12
"""All lengths in the tile over those by which the energy were least: the tile is no wider than the
head's girth, and skin that grows beyond takes the scalp's room."""
WITHIN_STEP = 0.8
"""Share of the way to the first triangle without area that a round may go."""


@dataclasses.dataclass(frozen=True)
class Wishes:
    """What a part of the head is given in the tile.

    Attributes:
        weight: how much its stretch counts; skin of the face has 1.
        size: length in the tile of a millimetre there; skin of the face has 1.
    """

    weight: float
    size: float


HAIR, EARS, NECK = Wishes(0.03, 0.4), Wishes(0.5, 1.0), Wishes(0.4, 1.0)
FRONT = 1.4
"""How much larger than the sides, the nape and the neck the face is in the tile."""
FRONT_Z_MM, SIDE_Z_MM = 45.0, -30.0
CHIN_Y_MM, NECK_Y_MM = -118.0, -130.0


def make_layout() -> np.ndarray:
    """(rows + 1, columns + 1, 2) UV of each point of the vertex grid, 0..1, v upward."""
    mesh = neutral_mesh()
    row, column = np.divmod(mesh.triangle_uvs(), COLUMNS + 1)
    left = (column >= HALF).all(axis=1)
    corners = mesh.triangles()[left]

    def share(region: str) -> np.ndarray:
        inside = np.zeros(len(mesh.vertices))
        inside[regions()[region]] = 1.0
        return np.asarray(inside[corners].mean(axis=1))

    _, y, z = mesh.vertices[corners].mean(axis=1).T
    neck = np.clip((CHIN_Y_MM - y) / (CHIN_Y_MM - NECK_Y_MM), 0.0, 1.0)
    aside = np.maximum(smoothstep(FRONT_Z_MM, SIDE_Z_MM, z), neck)
    weight, size = np.ones(len(corners)), FRONT**-aside
    for wishes, part in ((HAIR, share("hair")), (EARS, share("ears")), (NECK, neck)):
        weight, size = weight * wishes.weight**part, size * wishes.size**part
    triangles = (row * (HALF + 1) + column - HALF)[left]
    return unwrapped(mesh.vertices[grid_vertices()][:, HALF:], triangles, weight, size)


def write_layout() -> None:
    """Replace the simulator's layout; the template is then to be written anew."""
    with atomic_path(LAYOUT_PATH) as path, path.open("wb") as file:
        np.savez_compressed(file, uv=make_layout().astype(np.float32))


def unwrapped(
    points_mm: np.ndarray, triangles: np.ndarray, weight: np.ndarray, size: np.ndarray
) -> np.ndarray:
    """Lay out one side of a head that is alike on both.

    Args:
        points_mm: (h, w, 3) grid of the left side, from the middle to the seam.
        triangles: (t, 3) indices of these points, row by row; seen from outside, anticlockwise in
            a texture whose v rises.
        weight: (t,) how much the stretch of a triangle counts, beside its area.
        size: (t,) length in the texture of a millimetre there, beside that of others.

    Returns:
        (h, 2 w - 1, 2) UV of both sides, 0..1.
    """
    gradient, area = _gradients(points_mm.reshape(-1, 3), triangles)
    last_row, last_column = points_mm.shape[0] - 1, points_mm.shape[1] - 1
    count = (last_row + 1) * (last_column + 1)
    row, column = np.divmod(np.arange(count), last_column + 1)
    place = np.concatenate([column / last_column * WIDTH / 2, (1 - row / last_row) * HEIGHT])
    free = np.concatenate([(column > 0) & (column < last_column), (row > 0) & (row < last_row)])
    mass = weight * area
    energy = np.inf
    for _ in range(ROUNDS):
        jacobian = _jacobian(gradient, place) / size[:, None, None]
        jacobian, scale = _scaled(jacobian, mass)
        before, energy = energy, _energy(jacobian, mass)
        if before - energy < SETTLED * energy:
            break
        step = _step(gradient, jacobian, mass, size * scale, place, free)
        place = _searched(gradient, place, step, mass, size * scale, energy)
    side = np.stack([place[:count] / WIDTH, place[count:] / HEIGHT], axis=-1)
    side = side.reshape(*points_mm.shape[:2], 2)
    other = side[:, :0:-1] * (-1, 1)
    uv: np.ndarray = np.concatenate([other, side], axis=1)
    uv[..., 0] += 0.5
    return uv


def _gradients(points: np.ndarray, triangles: np.ndarray) -> tuple[sparse.csr_matrix, np.ndarray]:
    """(2 t, n): derivatives of a function of the points along each triangle's own axes; areas."""
    a, b, c = (points[triangles[:, i]] for i in range(3))
    along = b - a
    length = np.linalg.norm(along, axis=1)
    normal = np.cross(along, c - a)
    double = np.linalg.norm(normal, axis=1)
    first = along / length[:, None]
    second = np.cross(normal / double[:, None], first)
    cx, cy = ((c - a) * first).sum(axis=1), ((c - a) * second).sum(axis=1)
    # Derivatives of the three hat functions of a triangle (0, 0), (length, 0), (cx, cy).
    by_x = np.stack([-1 / length, 1 / length, 0 * length], axis=1)
    by_y = np.stack([(cx - length) / (length * cy), -cx / (length * cy), 1 / cy], axis=1)
    row = np.arange(2 * len(triangles)).repeat(3)
    values = np.concatenate([by_x, by_y]).ravel()
    corner = np.concatenate([triangles, triangles]).ravel()
    matrix = sparse.csr_matrix((values, (row, corner)), shape=(2 * len(triangles), len(points)))
    return matrix, 0.5 * double


def _jacobian(gradient: sparse.csr_matrix, place: np.ndarray) -> np.ndarray:
    """(t, 2, 2): rows are the texture's axes, columns the triangle's."""
    count = gradient.shape[1]
    both = np.stack([gradient @ place[:count], gradient @ place[count:]])
    return np.moveaxis(both.reshape(2, 2, -1), 2, 0)


def _scaled(jacobian: np.ndarray, mass: np.ndarray) -> tuple[np.ndarray, float]:
    """Jacobians over the scale by which their energy is least, and that scale."""
    inverse = np.linalg.inv(jacobian)
    stretch = (mass[:, None, None] * jacobian**2).sum()
    shrinking = (mass[:, None, None] * inverse**2).sum()
    scale = GROWTH * float((stretch / shrinking) ** 0.25)
    return jacobian / scale, scale


def _energy(jacobian: np.ndarray, mass: np.ndarray) -> float:
    """Symmetric Dirichlet energy |J|^2 + |J^-1|^2, weighted; infinite where one is turned over."""
    if (np.linalg.det(jacobian) <= 0).any():
        return np.inf
    inverse = np.linalg.inv(jacobian)
    return float((mass[:, None, None] * (jacobian**2 + inverse**2)).sum())


def _step(
    gradient: sparse.csr_matrix,
    jacobian: np.ndarray,
    mass: np.ndarray,
    size: np.ndarray,
    place: np.ndarray,
    free: np.ndarray,
) -> np.ndarray:
    """Change of the places: to the least squares whose slope here is the energy's own.

    They are those of W (J - R) with R the nearest rotation, J = U s V^T and
    W = U diag(sqrt((s - s^-3) / (s - 1))) U^T [Rabinovich2017].
    """
    u, s, vt = np.linalg.svd(jacobian)
    rotation = u @ vt
    # (s - s^-3) / (s - 1) without the division by zero at s = 1.
    root = np.sqrt((s + 1) * (s**2 + 1) / s**3)
    weigh = np.einsum("tik,tk,tjk->tij", u, root, u) * np.sqrt(mass)[:, None, None]
    apart = np.einsum("tik,tkj->tij", weigh, rotation - jacobian)
    count = len(mass)
    derivative = (gradient[:count], gradient[count:])
    ends = [(i, j) for i in range(2) for j in range(2)]
    blocks = [
        [sparse.diags_array(weigh[:, i, k] / size) @ derivative[j] for k in range(2)]
        for i, j in ends
    ]
    wanted = [apart[:, i, j] for i, j in ends]
    matrix = sparse.csr_matrix(sparse.block_array(blocks))[:, free]
    step = np.zeros_like(place)
    step[free] = spsolve(sparse.csc_matrix(matrix.T @ matrix), matrix.T @ np.concatenate(wanted))
    return step


def _searched(
    gradient: sparse.csr_matrix,
    place: np.ndarray,
    step: np.ndarray,
    mass: np.ndarray,
    size: np.ndarray,
    energy: float,
) -> np.ndarray:
    """Places after as much of a step as lowers the energy and turns no triangle over."""
    now, change = _jacobian(gradient, place), _jacobian(gradient, step)
    share = min(1.0, WITHIN_STEP * _first_flat(now, change))
    while share > 1e-6:
        tried = place + share * step
        if _energy(_jacobian(gradient, tried) / size[:, None, None], mass) < energy:
            return tried
        share *= 0.5
    return place


def _first_flat(now: np.ndarray, change: np.ndarray) -> float:
    """Least positive t at which now + t change has a determinant of 0, of all; infinite if none."""
    a, c = np.linalg.det(change), np.linalg.det(now)
    b = np.linalg.det(now + change) - a - c
    inside = b**2 - 4 * a * c
    q = -0.5 * (b + np.copysign(np.sqrt(np.maximum(inside, 0)), b))
    with np.errstate(divide="ignore", invalid="ignore"):
        roots = np.stack([q / a, c / q])
    roots[:, inside < 0] = np.inf
    roots = np.where(np.isfinite(roots) & (roots > 0), roots, np.inf)
    return float(roots.min())


if __name__ == "__main__":
    write_layout()
