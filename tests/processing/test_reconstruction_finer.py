import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage.formats.mesh import Mesh, vertex_normals
from processing.displacement import heights_of_steps
from processing.reconstruction.finer import LINKS, SMALL, STEEPEST, finer, lifted
from processing.reconstruction.settle import settled
from processing.splitting import unsplit

SPLITS, SIGMA_MM, RELIEF_MM = 1, 0.4, 3.0


def height(x: np.ndarray, y: np.ndarray, wave_mm: float) -> np.ndarray:
    k = 2 * np.pi / wave_mm
    return np.asarray(0.05 * np.sin(k * x) * np.cos(k * y))


def wave_normals(x: np.ndarray, y: np.ndarray, wave_mm: float) -> np.ndarray:
    k = 2 * np.pi / wave_mm
    slopes = (
        0.05 * k * np.cos(k * x) * np.cos(k * y),
        -0.05 * k * np.sin(k * x) * np.sin(k * y),
    )
    out = np.stack([-slopes[0], -slopes[1], np.ones_like(x)], axis=-1)
    return np.asarray(out / np.linalg.norm(out, axis=-1, keepdims=True))


def sheet(step_mm: float, half_mm: float = 8.0) -> Mesh:
    """A flat square."""
    count = int(2 * half_mm / step_mm) + 1
    x, y = np.meshgrid(np.linspace(-half_mm, half_mm, count), np.linspace(-half_mm, half_mm, count))
    index = np.arange(count * count).reshape(count, count)
    a, b, c, d = (index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1])
    faces = np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])
    return Mesh(np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3), faces.astype(np.int32))


def waves(wave_mm: float = 4.0) -> tuple[np.ndarray, np.ndarray]:
    """Points .25 mm apart on a waved sheet, and their normals."""
    x, y, _ = sheet(0.25, 10.0).vertices.T
    return np.stack([x, y, height(x, y, wave_mm)], axis=-1), wave_normals(x, y, wave_mm)


def errors(mesh: Mesh, wave_mm: float = 4.0) -> tuple[float, float]:
    """Root mean squares off the waves: of triangles' middles, mm, and of vertices' normals, deg."""
    x, y, z = mesh.vertices[mesh.faces].mean(axis=1).T
    off = (z - height(x, y, wave_mm))[(np.abs(x) < 6) & (np.abs(y) < 6)]
    x, y, _ = mesh.vertices.T
    normals = vertex_normals(mesh.vertices, mesh.faces)
    cosine = np.einsum("nk,nk->n", normals, wave_normals(x, y, wave_mm))
    angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))[(np.abs(x) < 6) & (np.abs(y) < 6)]
    return float(np.sqrt(np.mean(off**2))), float(np.sqrt(np.mean(angle**2)))


def test_relief_between_the_vertices_is_found() -> None:
    points, normals = waves()
    coarse = settled(sheet(1.2), points, normals, SIGMA_MM)
    found = finer(sheet(1.2), points, normals, SPLITS, SIGMA_MM, RELIEF_MM)
    assert len(found.faces) == 4 * len(coarse.faces)
    assert errors(found)[1] < 0.5 * errors(coarse)[1]
    assert errors(found)[0] < 0.5 * errors(coarse)[0]


def test_normals_bring_back_what_noisy_points_have_lost() -> None:
    points, normals = waves()
    rng = np.random.default_rng(0)
    # Matched points are too smooth, besides.
    noisy = points * [1, 1, 0.7] + [0, 0, 1] * rng.normal(0, 0.02, (len(points), 1))
    alone = finer(sheet(1.2), noisy, normals, SPLITS, SIGMA_MM, 0.0)
    both = finer(sheet(1.2), noisy, normals, SPLITS, SIGMA_MM, RELIEF_MM)
    assert errors(both)[0] < 0.7 * errors(alone)[0]
    assert errors(both)[1] < 0.8 * errors(alone)[1]


def test_slowly_tipped_normals_do_not_bend_the_mesh() -> None:
    points, normals = waves()
    tip = np.radians(3) * np.stack([np.sin(points[:, 0] / 30), np.cos(points[:, 1] / 30)], axis=1)
    tipped = normals + np.column_stack([tip, np.zeros(len(tip))])
    tipped /= np.linalg.norm(tipped, axis=1, keepdims=True)
    found = finer(sheet(1.2), points, normals, SPLITS, SIGMA_MM, RELIEF_MM)
    bent = finer(sheet(1.2), points, tipped, SPLITS, SIGMA_MM, RELIEF_MM)
    inner = (np.abs(found.vertices[:, :2]) < 5).all(axis=1)
    # 3 degrees over 8 mm are .4 mm.
    assert np.abs(bent.vertices - found.vertices)[inner].max() < 0.04


def inner_edges(mesh: Mesh) -> np.ndarray:
    """Edges, each once, as triangles have them from the lower to the higher vertex."""
    sides = [(int(f[k]), int(f[(k + 1) % 3])) for f in mesh.faces for k in range(3)]
    return np.array([side for side in sides if side[0] < side[1]])


def plain_lifted(mesh: Mesh, wanted: np.ndarray, known: np.ndarray, relief_mm: float) -> np.ndarray:
    """The same least squares, edge by edge, in a dense matrix."""
    own = vertex_normals(mesh.vertices, mesh.faces)
    rows, right, lengths = [], [], []
    for a, b in inner_edges(mesh):
        if not (known[a] and known[b]):
            continue
        along = mesh.vertices[b] - mesh.vertices[a]
        step = -0.5 * (wanted[a] - own[a] + wanted[b] - own[b]) @ along
        lengths.append(np.linalg.norm(along))
        if abs(step) < STEEPEST * lengths[-1]:
            row = np.zeros(len(own))
            row[b], row[a] = 1, -1
            rows.append(row)
            right.append(step)
    if not rows:
        return mesh.vertices
    weight = LINKS * (np.mean(lengths) / (SMALL * relief_mm)) ** 2
    rows += list(np.sqrt(weight) * np.eye(len(own)))
    right += [0.0] * len(own)
    heights = np.linalg.lstsq(np.array(rows), np.array(right), rcond=None)[0]
    return np.asarray(mesh.vertices + heights[:, None] * own)


@settings(max_examples=20, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.floats(1e-6, 1e6),
    st.floats(0.5, 8),
    st.floats(0, 1),
    st.floats(0, 1),
)
def test_lifting_is_its_plain_twin(
    seed: int, unit: float, relief: float, share: float, rough: float
) -> None:
    rng = np.random.default_rng(seed)
    flat = sheet(4.0)
    mesh = Mesh(unit * (flat.vertices + rng.normal(0, 0.3, flat.vertices.shape)), flat.faces)
    wanted = [0, 0, 1] + rough * rng.normal(size=flat.vertices.shape)
    wanted /= np.linalg.norm(wanted, axis=1, keepdims=True)
    known = rng.random(len(wanted)) < share
    found = lifted(mesh, wanted, known, unit * relief).vertices / unit
    twin = plain_lifted(mesh, wanted, known, unit * relief) / unit
    np.testing.assert_allclose(found, twin, atol=1e-3)


def test_a_mesh_stays_where_there_is_nothing_to_go_by() -> None:
    mesh, (points, normals) = sheet(1.2), waves()
    none = np.zeros((0, 3))
    for found in (
        finer(mesh, points, normals, 0, SIGMA_MM, RELIEF_MM),
        finer(mesh, none, none, SPLITS, SIGMA_MM, RELIEF_MM),
        lifted(mesh, np.zeros_like(mesh.vertices), np.zeros(len(mesh.vertices), bool), RELIEF_MM),
    ):
        np.testing.assert_array_equal(found.vertices, mesh.vertices)


def test_split_vertices_without_points_near_lie_between_their_neighbours() -> None:
    found = finer(sheet(1.2), *(points + 50.0 for points in waves()), SPLITS, SIGMA_MM, RELIEF_MM)
    assert len(found.faces) == 4 * len(sheet(1.2).faces)
    np.testing.assert_allclose(found.vertices[:, 2], 0.0, atol=1e-12)


def test_later_stages_find_the_coarse_mesh_in_it() -> None:
    mesh = sheet(1.2)
    found = unsplit(finer(mesh, *waves(), SPLITS, SIGMA_MM, RELIEF_MM), len(mesh.faces))
    np.testing.assert_array_equal(found.faces, mesh.faces)
    assert len(found.vertices) == len(mesh.vertices)


@pytest.mark.parametrize("weight", [1e-3, 1.0, 1e3])
def test_no_steps_no_heights(weight: float) -> None:
    edges = inner_edges(sheet(4.0))
    assert not heights_of_steps(25, edges, np.zeros(len(edges)), weight).any()
    assert not heights_of_steps(25, edges[:0], np.zeros(0), weight).any()
