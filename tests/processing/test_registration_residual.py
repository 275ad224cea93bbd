"""What registration left is measured, written and shown."""

import numpy as np
import pytest

from lightstage.formats.mesh import Mesh
from lightstage.formats.template import default_template_path, load_template
from processing.registration.areas import AREAS, areas_of
from processing.registration.residual import (
    Residual,
    drawn,
    residual,
    residual_section,
    scan_in_common,
    write_residual,
)
from tests.processing.shapes import bumpy_ellipsoid


def test_a_grown_mesh_is_as_far_as_it_grew_and_on_the_right_side():
    scan = bumpy_ellipsoid()
    middle = scan.vertices.mean(axis=0)
    for factor in (0.97, 1.03):
        grown = middle + factor * (scan.vertices - middle)
        found = residual(scan, grown, scan.triangles())
        radius = np.linalg.norm(scan.vertices - middle, axis=1)
        assert (np.sign(found.distance_mm) == np.sign(1 - factor)).all()
        assert np.abs(found.distance_mm).max() <= 0.03 * radius.max() + 1e-3
        assert np.median(found.angle_deg) < 5
    same = residual(scan, scan.vertices, scan.triangles())
    assert np.abs(same.distance_mm).max() < 1e-3


def test_what_the_scan_does_not_have_is_not_a_number():
    whole = bumpy_ellipsoid()
    front = whole.vertices[whole.triangles()].mean(axis=1)[:, 2] > 0
    scan = Mesh(whole.vertices, whole.triangles()[front])
    found = residual(scan, whole.vertices, whole.triangles())
    back = whole.vertices[:, 2] < -30
    assert np.isnan(found.distance_mm[back]).mean() > 0.9
    assert np.isfinite(found.distance_mm[whole.vertices[:, 2] > 30]).all()
    assert (np.isnan(found.distance_mm) == np.isnan(found.angle_deg)).all()


def test_what_the_mesh_does_not_have_is_not_compared():
    """Shoulders far below a head would make the 95th percentile their distance from it."""
    scan = bumpy_ellipsoid()
    upper = scan.triangles()[scan.vertices[scan.triangles()].mean(axis=1)[:, 1] > 0]
    middle = scan.vertices.mean(axis=0)
    head = Mesh(middle + 0.99 * (scan.vertices - middle), upper)
    found = scan_in_common(scan, head)
    assert 0.3 < found["scan_in_common_share"] < 0.7
    radius = np.linalg.norm(scan.vertices - middle, axis=1).max()
    assert 0 < found["scan_in_common_to_template_median_mm"] < 0.01 * radius
    assert found["scan_in_common_to_template_p95_mm"] < 0.02 * radius
    below = scan.vertices + np.array([0.0, -500.0, 0.0])
    none = scan_in_common(Mesh(below, scan.faces), head)
    assert none["scan_in_common_share"] == 0
    assert none["scan_in_common_to_template_p95_mm"] is None


def test_an_area_that_is_pressed_flat_is_reported_by_its_name_and_drawn_on_the_scan(tmp_path):
    """Every vertex of the mesh lies on the scan; only the scan's points see what it leaves out."""
    mesh = bumpy_ellipsoid()
    side = mesh.vertices[:, 0] > 0.9 * mesh.vertices[:, 0].max()
    areas = np.where(side, AREAS.index("ears"), AREAS.index("cheeks"))
    shell = mesh.triangles()[side[mesh.triangles()].all(axis=1)]
    scan = Mesh(
        np.concatenate([mesh.vertices, mesh.vertices[side] + [5.0, 0, 0]]),
        np.concatenate([mesh.triangles(), len(mesh.vertices) + (np.cumsum(side) - 1)[shell]]),
    )
    found = scan_in_common(scan, mesh, areas)["scan_in_common_by_area"]
    assert list(found) == ["ears", "cheeks"]
    assert found["ears"]["p95_mm"] > 3 > 0.01 > found["cheeks"]["median_mm"]
    assert sum(area["share"] for area in found.values()) == pytest.approx(1)
    write_residual(tmp_path, residual(scan, mesh.vertices, mesh.triangles()), mesh, scan)
    facts = {"scan_in_common_by_area": found}
    pictures_and_table = residual_section(tmp_path, facts).parts
    assert [row[0] for row in pictures_and_table[2].rows] == ["ears", "cheeks"]
    assert pictures_and_table[1].image.shape[1] == pictures_and_table[0].image.shape[1]


def test_every_area_of_the_template_is_where_its_name_says():
    template = load_template(default_template_path())
    areas, vertices = areas_of(template), template.mesh.vertices
    middle = {name: vertices[areas == k].mean(axis=0) for k, name in enumerate(AREAS)}
    assert middle["scalp"][1] > middle["eyes"][1] > middle["nose"][1] > middle["lips"][1]
    assert middle["forehead"][1] > middle["eyes"][1]
    assert middle["lips"][1] > middle["chin"][1] > middle["neck"][1]
    assert set(template.regions["ears"]) == set(np.flatnonzero(areas == AREAS.index("ears")))


def test_files_and_picture_show_where_it_is_off(tmp_path):
    mesh = bumpy_ellipsoid()
    distance = np.where(mesh.vertices[:, 1] > 0, 2.0, 0.0).astype(np.float32)
    distance[mesh.vertices[:, 0] < -40] = np.nan
    left = Residual(distance, np.abs(distance))
    image = drawn(left, mesh)
    half = image.shape[0] // 2
    above, below = image[half // 2 - 60, 540].astype(int), image[half // 2 + 60, 540].astype(int)
    assert np.abs(above - below).max() > 100
    assert residual_section(tmp_path) is None
    write_residual(tmp_path, left, mesh)
    section = residual_section(tmp_path)
    assert section is not None
    assert section.parts[0].image.shape == image.shape
    assert len(section.parts) == 1
    facts = {"template_to_scan_median_mm": 0.1, "template_to_scan_p95_mm": 0.4}
    facts |= {"scan_in_common_share": 0.613, "scan_in_common_to_template_median_mm": None}
    table = residual_section(tmp_path, facts).parts[1]
    assert [row[1:] for row in table.rows] == [(0.1, 0.4)]
    assert "61% of the scan's points" in table.caption
    with np.load(tmp_path / "work" / "registration" / "residual.npz") as kept:
        assert np.array_equal(kept["distance_mm"], distance, equal_nan=True)
        assert kept["angle_deg"][0] == pytest.approx(left.angle_deg[0], nan_ok=True)
