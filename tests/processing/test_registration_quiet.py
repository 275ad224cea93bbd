"""Noise of a scan is taken down and its shape is not."""

import numpy as np
import pytest

from lightstage.formats.mesh import Mesh, vertex_normals
from processing.registration.target import border_vertices, quieted
from tests.processing.shapes import bumpy_ellipsoid


def noisy(sigma_mm):
    clean = bumpy_ellipsoid()
    noise = sigma_mm * np.random.default_rng(0).normal(size=(len(clean.vertices), 1))
    normals = vertex_normals(clean.vertices, clean.triangles())
    return clean, clean.with_vertices(clean.vertices + noise * normals)


def away(found, clean):
    normals = vertex_normals(clean.vertices, clean.triangles())
    return np.einsum("nk,nk->n", found.vertices - clean.vertices, normals)


@pytest.mark.parametrize("sigma_mm", [0.3, 1.0])
def test_noise_goes_down_and_no_vertex_moves_far(sigma_mm):
    clean, scan = noisy(sigma_mm)
    found = quieted(scan, 2)
    assert np.array_equal(found.triangles(), scan.triangles())
    assert away(found, clean).std() < 0.8 * away(scan, clean).std()
    moved = np.linalg.norm(found.vertices - scan.vertices, axis=1)
    assert moved.max() < 3 * sigma_mm


def test_a_clean_scan_keeps_its_shape():
    clean, _ = noisy(0.0)
    moved = np.linalg.norm(quieted(clean, 2).vertices - clean.vertices, axis=1)
    middle = clean.vertices.mean(axis=0)
    size = np.linalg.norm(clean.vertices - middle, axis=1).mean()
    assert np.median(moved) < 1e-3 * size


def test_no_rounds_change_nothing_and_borders_and_lone_vertices_stay():
    _, scan = noisy(0.5)
    assert quieted(scan, 0) is scan
    cut = Mesh(
        np.vstack([scan.vertices, [[0, 0, 500.0]]]), scan.triangles()[: len(scan.faces) // 2]
    )
    found = quieted(cut, 2)
    stays = border_vertices(cut.triangles(), len(cut.vertices))
    assert stays.any()
    assert np.array_equal(found.vertices[stays], cut.vertices[stays])
    assert np.array_equal(found.vertices[-1], [0, 0, 500])
    assert np.isfinite(found.vertices).all()
    flat = Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]]))
    assert quieted(flat, 2) is flat
