"""Template folder: what is missing or does not fit is named, through the command too."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from lightstage.errors import FormatError
from lightstage.formats.mesh import Mesh, write_obj
from lightstage.formats.template import (
    Modes,
    Template,
    default_template_path,
    load_template,
    save_template,
)


@pytest.fixture
def template():
    rng = np.random.default_rng(0)
    columns, rows = np.meshgrid(np.arange(9), np.arange(9))
    uvs = np.stack([columns.ravel(), rows.ravel()], 1) / 8
    first = np.arange(72)[np.arange(72) % 9 != 8]
    faces = np.stack([first, first + 1, first + 10, first + 9], 1).astype(np.int32)
    vertices = np.concatenate([uvs * 100, rng.normal(0, 5, (81, 1))], 1).round(6)
    return Template(
        name="grid",
        mesh=Mesh(vertices, faces, uvs, faces),
        landmarks=np.arange(68),
        regions={"skin": np.arange(10, 40), "lips": np.arange(3)},
        licence="CC0",
        source="a test",
        depth_ratio=0.9,
        modes=Modes(rng.normal(0, 1, (2, 81, 3)), rng.normal(0, 1, (1, 81, 3)), ("smile",)),
        maps={"shininess": np.full((6, 4), 40.0, np.float32)},
    )


def test_a_template_survives_its_folder(tmp_path, template):
    read = load_template(save_template(template, tmp_path / "T"))
    assert np.array_equal(read.mesh.vertices, template.mesh.vertices)
    assert np.array_equal(read.mesh.face_uvs, template.mesh.face_uvs)
    assert np.array_equal(read.landmarks, template.landmarks)
    assert {k: v.tolist() for k, v in read.regions.items()} == {
        k: v.tolist() for k, v in template.regions.items()
    }
    assert np.allclose(read.modes.identity, template.modes.identity, atol=1e-6)
    assert read.modes.expression_names == ("smile",)
    assert (read.maps["shininess"] == 40).all()
    assert (read.licence, read.source, read.depth_ratio) == ("CC0", "a test", 0.9)


def without_uv(path, template):
    write_obj(Mesh(template.mesh.vertices, template.mesh.faces), path / "mesh.obj")


def outside_tile(path, template):
    mesh = template.mesh
    write_obj(Mesh(mesh.vertices, mesh.faces, mesh.uvs * 2, mesh.face_uvs), path / "mesh.obj")


def other_modes(path, template):
    names = np.array([], str)
    modes = {"identity": np.zeros((2, 5, 3)), "expression": np.zeros((0, 81, 3))}
    np.savez(path / "modes.npz", **modes, expression_names=names)


def changed(**fields):
    def change(path, template):
        value = json.loads((path / "template.json").read_text()) | fields
        (path / "template.json").write_text(json.dumps(value))

    return change


DAMAGE = {
    "no UV": (without_uv, r"mesh.obj, uv: found no texture coordinates, expected UV"),
    "outside": (outside_tile, r"mesh.obj, uv: found UV from 0 to 2, expected one tile"),
    "units": (changed(units="m"), r"template.json, units: found 'm', expected 'mm'"),
    "67": (
        changed(landmarks={"ibug68": list(range(67))}),
        "landmarks.ibug68: found 67, expected 68",
    ),
    "index": (
        changed(landmarks={"ibug68": [81] * 68}),
        "index 81, expected 68 vertex indices",
    ),
    "no index": (changed(landmarks={"ibug68": [0.5] * 68}), "found index 0.5"),
    "region": (changed(regions={"lips": [-1]}), "regions.lips"),
    "depth": (changed(depth_ratio=0), r"depth_ratio: found 0, expected a number, 0.3 to 3"),
    "depth too": (changed(depth_ratio=True), "depth_ratio: found True"),
    "newer": (changed(schema="lightstage.template/2"), "newer version"),
    "modes": (other_modes, r"modes.npz, identity: found shape \(2, 5, 3\), expected \(k, 81, 3\)"),
    "not npz": (lambda p, _: (p / "modes.npz").write_bytes(b"x"), "modes.npz"),
    "no mesh": (lambda p, _: (p / "mesh.obj").unlink(), "mesh.obj: found no such file"),
    "no json": (
        lambda p, _: (p / "template.json").unlink(),
        "found no template.json, expected a template",
    ),
}


def test_indices_may_be_written_with_a_point(tmp_path, template):
    path = save_template(template, tmp_path / "T")
    marks = [float(index) for index in range(68)]
    changed(landmarks={"ibug68": marks}, regions={"lips": [2.0]})(path, template)
    read = load_template(path)
    assert read.landmarks.dtype == read.regions["lips"].dtype == np.int64
    assert (read.landmarks.tolist(), read.regions["lips"].tolist()) == (marks, [2])


@pytest.mark.parametrize("name", DAMAGE)
def test_each_fault_of_a_template_is_named(tmp_path, template, name):
    damage, message = DAMAGE[name]
    path = save_template(template, tmp_path / "T")
    damage(path, template)
    with pytest.raises(FormatError, match=message):
        load_template(path)


def test_a_template_without_uv_makes_a_command_exit_2_and_leave_nothing(tmp_path, template):
    path = save_template(template, tmp_path / "T")
    without_uv(path, template)
    script = (
        "from pathlib import Path\n"
        "from lightstage.commands import make_app, run_app\n"
        "from lightstage.formats.files import atomic_folder\n"
        "from lightstage.formats.template import load_template\n"
        "app = make_app('test')\n"
        "@app.command()\n"
        "def use(folder: Path, out: Path):\n"
        "    with atomic_folder(out, 'm'):\n"
        "        load_template(folder)\n"
        "run_app(app)\n"
    )
    command = [sys.executable, "-c", script, "use", str(path), str(tmp_path / "out")]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 2
    assert "FormatError" in done.stderr
    assert f"{path / 'mesh.obj'}, uv: found no texture coordinates" in done.stderr
    assert "Traceback" not in done.stderr
    assert os.listdir(tmp_path) == ["T"]


def test_the_committed_template_loads():
    template = load_template(default_template_path())
    assert len(template.landmarks) == 68
    assert template.licence
