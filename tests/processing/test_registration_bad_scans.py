"""Scans that are damaged or wrong: the right result, or a clear refusal."""

import numpy as np
import pytest

from lightstage.formats.landmarks import write_points_mm
from lightstage.formats.mesh import Mesh, write_obj
from lightstage.formats.template import save_template
from processing.errors import RegistrationError
from processing.registration.config import NonrigidConfig, RegisterConfig
from processing.registration.stage import register_mesh
from processing.registration.start import first_pose, landmarks_unit
from processing.registration.target import Target
from tests.processing.shapes import ellipsoid, ellipsoid_template, refined, warp

QUICK = RegisterConfig(nonrigid=NonrigidConfig(stiffness_mm=(80.0, 40.0, 20.0, 10.0, 4.0, 2.0)))
TEMPLATE = ellipsoid_template()
TRUTH = warp(TEMPLATE.mesh.vertices, 4.0)
WHOLE = refined(TEMPLATE.mesh.with_vertices(TRUTH))
SCAN = Mesh(WHOLE.vertices, WHOLE.faces[(WHOLE.vertices[WHOLE.faces][:, :, 2] > -10).all(axis=1)])
SEEN = TRUTH[:, 2] > 15


def register(scan):
    return register_mesh(scan, TRUTH[TEMPLATE.landmarks], TEMPLATE, QUICK)


def duplicated():
    return Mesh(SCAN.vertices, np.concatenate([SCAN.faces, SCAN.faces[::3]]))


def degenerate():
    flat = SCAN.faces[::5].copy()
    flat[:, 2] = flat[:, 1]
    return Mesh(SCAN.vertices, np.concatenate([flat, SCAN.faces]))


def non_manifold():
    """A fin on every 40th edge: three triangles share it."""
    fins = SCAN.faces[::40].copy()
    tips = SCAN.vertices[fins[:, 0]] + 0.3
    fins[:, 2] = len(SCAN.vertices) + np.arange(len(fins))
    return Mesh(np.concatenate([SCAN.vertices, tips]), np.concatenate([SCAN.faces, fins]))


def islands():
    crumb = ellipsoid(6, 8)
    faces = [SCAN.faces]
    vertices = [SCAN.vertices]
    for shift in ([300, 0, 0], [0, -250, 100]):
        faces.append(crumb.faces + sum(map(len, vertices)))
        vertices.append(0.1 * crumb.vertices + shift)
    return Mesh(np.concatenate(vertices), np.concatenate(faces))


def isolated():
    loose = np.random.default_rng(0).normal(size=(500, 3)) * 200
    return Mesh(np.concatenate([SCAN.vertices, loose]), SCAN.faces)


@pytest.mark.parametrize("scan", [duplicated, degenerate, non_manifold, islands, isolated])
def test_damage_does_not_matter(scan):
    vertices, facts = register(scan())
    assert np.median(Target(SCAN).closest(vertices[SEEN]).distance_mm) < 0.1
    assert np.linalg.norm(vertices - TRUTH, axis=1)[SEEN].mean() < 0.8
    assert facts["triangles_flipped"] == 0
    assert facts["solver_residual"] < 1e-2


def refusal(scan):
    with pytest.raises(RegistrationError) as caught:
        register(scan)
    return str(caught.value)


def test_a_scan_turned_inside_out_is_refused():
    assert "inward" in refusal(Mesh(SCAN.vertices, SCAN.faces[:, ::-1].copy()))


def test_a_scan_of_the_back_is_refused():
    back = WHOLE.faces[(WHOLE.vertices[WHOLE.faces][:, :, 2] < -40).all(axis=1)]
    assert "surface" in refusal(Mesh(WHOLE.vertices, back))


def test_points_without_a_surface_are_refused():
    assert "surface" in refusal(Mesh(SCAN.vertices, np.zeros((0, 3), np.int32)))
    assert "area" in refusal(Mesh(SCAN.vertices, np.repeat(SCAN.faces[:5, :1], 3, axis=1)))


def test_vertices_that_are_not_finite_are_refused():
    broken = SCAN.vertices.copy()
    broken[[3, 9]] = [np.nan, 0, np.inf]
    assert "2 with NaN" in refusal(Mesh(broken, SCAN.faces))


@pytest.mark.parametrize("factor", [0.1, 0.001, 1000.0])
@pytest.mark.parametrize(
    ("off", "message"),
    [
        ("landmarks", "The scan is in mm. Scale the landmarks"),
        ("scan", "The landmarks are in mm. Scale the scan ("),
        ("both", "Scale the scan and its landmarks"),
    ],
)
def test_of_scan_and_landmarks_the_one_in_other_units_is_named(factor, off, message):
    scan = SCAN if off == "landmarks" else Mesh(factor * SCAN.vertices, SCAN.faces)
    marks = TRUTH[TEMPLATE.landmarks] * (1 if off == "scan" else factor)
    with pytest.raises(RegistrationError, match="units") as caught:
        first_pose(Target(scan), marks, np.ones(len(marks), bool), TEMPLATE)
    assert message in str(caught.value)


@pytest.mark.parametrize("factor", [0.3, 40.0])
def test_a_scan_in_an_unknown_unit_is_named_with_its_file_and_its_landmarks(
    tmp_path, run_command, factor
):
    """Neither mm nor cm nor metres, such as inches or feet."""
    marks = write_points_mm(factor * TRUTH[TEMPLATE.landmarks], tmp_path / "L.json")
    write_obj(Mesh(factor * SCAN.vertices, SCAN.faces), tmp_path / "scan.obj")
    words = ("processing", "register-mesh", tmp_path / "scan.obj", "--out", tmp_path / "out.obj")
    words = (*words, "--template", save_template(TEMPLATE, tmp_path / "T"))
    done = run_command(*words, "--landmarks", marks)
    assert done.code == 2
    assert f"{marks}, landmarks, units: found a scan {factor:g}" in done.err
    assert "expected both in mm. Scale the scan and its landmarks" in done.err
    off = write_points_mm(TRUTH[TEMPLATE.landmarks], tmp_path / "M.json")
    write_obj(Mesh(1000 * SCAN.vertices, SCAN.faces), tmp_path / "scan.obj")
    done = run_command(*words, "--landmarks", off)
    assert done.code == 2
    assert f"{tmp_path / 'scan.obj'}, units: found a scan" in done.err
    assert not (tmp_path / "out.obj").exists()


@pytest.mark.parametrize("broken", ["faces", "face"])
def test_what_no_mesh_can_be_registered_without_is_named_with_the_scans_file(
    tmp_path, run_command, broken
):
    faces = SCAN.faces[:, :1].repeat(3, axis=1) if broken == "faces" else SCAN.faces
    scan = write_obj(Mesh(SCAN.vertices * (1, 1, 0.001), faces), tmp_path / "scan.obj")
    done = run_command("processing", "register-mesh", scan, "--out", tmp_path / "out.obj")
    assert done.code == 2
    field = "triangles" if broken == "faces" else "landmarks"
    assert f"{scan}, {field}: found " in done.err


@pytest.mark.parametrize(("factor", "name"), [(0.1, "cm"), (0.001, "metres"), (1.0, "mm")])
def test_landmarks_tell_a_scans_unit(factor, name):
    scan = Mesh(factor * SCAN.vertices, SCAN.faces)
    assert landmarks_unit(scan, factor * TRUTH[TEMPLATE.landmarks], TEMPLATE).name == name


def test_a_unit_that_is_not_certain_is_taken_for_mm():
    marks = TRUTH[TEMPLATE.landmarks]
    scan = Mesh(0.1 * SCAN.vertices, SCAN.faces)
    few = np.full_like(marks, np.nan)
    few[:3] = 0.1 * marks[:3]
    for points in (marks, few, 0.1 * marks + 900):  # in mm; too few; beside the scan
        assert landmarks_unit(scan, points, TEMPLATE).name == "mm"
    inches = Mesh(SCAN.vertices / 25.4, SCAN.faces)
    assert landmarks_unit(inches, marks / 25.4, TEMPLATE).name == "mm"


@pytest.mark.parametrize("factor", [0.1, 1.0, 10.0])
def test_parts_and_bodies_in_mm_have_no_other_units(factor):
    """Vertices of a shoulder far away, or of the nose alone: landmarks still lie on the scan."""
    far = Mesh(factor * SCAN.vertices + [0, -900.0, 0], SCAN.faces)
    both = Mesh(
        np.concatenate([SCAN.vertices, far.vertices, far.vertices]),
        np.concatenate([SCAN.faces, far.faces + len(SCAN.vertices)]),
    )
    marks = TRUTH[TEMPLATE.landmarks]
    pose = first_pose(Target(both), marks, np.ones(len(marks), bool), TEMPLATE)
    assert 0.8 < pose.scale < 1.25


def test_the_scan_is_not_replaced_by_what_is_registered_to_it(tmp_path, run_command):
    write_obj(SCAN, tmp_path / "scan.obj")
    before = (tmp_path / "scan.obj").read_bytes()
    (tmp_path / "link.obj").symlink_to(tmp_path / "scan.obj")
    for name in ("scan.obj", "link.obj"):
        done = run_command(
            "processing", "register-mesh", tmp_path / "scan.obj", "--out", tmp_path / name
        )
        assert done.code == 2
        assert f"{name}, --out: found the scan itself, expected another file" in done.err
        assert (tmp_path / "scan.obj").read_bytes() == before


def test_landmarks_and_a_program_that_finds_them_are_not_given_together(tmp_path, run_command):
    write_obj(SCAN, tmp_path / "scan.obj")
    done = run_command(
        *("processing", "register-mesh", tmp_path / "scan.obj", "--out", tmp_path / "out.obj"),
        *("--landmarks", tmp_path / "none.json", "--landmark-command", "true"),
    )
    assert done.code == 2
    assert "--landmark-command: found it beside --landmarks" in done.err
