from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from lightstage.formats.exr import read_exr
from lightstage.formats.template import REGIONS, default_template_path, load_template
from sim.head.mesh import neutral_mesh
from sim.head.modes import EXPRESSIONS, expression_modes, identity_modes
from sim.head.parametric import random_head
from sim.head.template import write_template


@pytest.fixture(scope="module")
def written(tmp_path_factory) -> Path:
    return write_template(tmp_path_factory.mktemp("template") / "made")


def test_committed_template_is_what_the_command_writes(written):
    committed = default_template_path()
    names = sorted(p.relative_to(written).as_posix() for p in written.rglob("*") if p.is_file())
    assert names == [
        "maps/shininess.exr",
        "maps/skin.png",
        "maps/translucency.exr",
        "mesh.obj",
        "modes.npz",
        "template.json",
    ]
    there = sorted(p.relative_to(committed).as_posix() for p in committed.rglob("*") if p.is_file())
    # `template-points` adds where the face detector's points lie, `template population` the people.
    added = ["mediapipe468.json", "population.npz", "population_mediapipe468.json"]
    assert there == sorted([*names, *added])
    new, old = load_template(written), load_template(committed)
    assert np.abs(new.mesh.vertices - old.mesh.vertices).max() < 2e-6
    assert np.array_equal(new.mesh.faces, old.mesh.faces)
    assert np.array_equal(new.mesh.face_uvs, old.mesh.face_uvs)
    assert np.allclose(new.mesh.uvs, old.mesh.uvs, atol=1e-8)
    assert np.array_equal(new.landmarks, old.landmarks)
    assert new.modes.expression_names == old.modes.expression_names
    assert np.abs(new.modes.identity - old.modes.identity).max() < 1e-4
    assert np.abs(new.modes.expression - old.modes.expression).max() < 1e-4
    for name in REGIONS:
        assert np.array_equal(new.regions[name], old.regions[name])
    for name in ("shininess", "translucency"):
        assert np.array_equal(
            read_exr(written / "maps" / f"{name}.exr"), read_exr(committed / "maps" / f"{name}.exr")
        )
    masks = [
        cv2.imread(str(path / "maps" / "skin.png"), cv2.IMREAD_UNCHANGED)
        for path in (written, committed)
    ]
    assert np.array_equal(*masks)
    assert (new.name, new.licence, new.source) == (old.name, old.licence, old.source)


def test_writing_twice_gives_the_same_bytes(written, tmp_path):
    again = write_template(tmp_path / "again")
    for path in sorted(p for p in written.rglob("*") if p.is_file()):
        if path.suffix != ".exr":  # OpenEXR's header may hold a date
            assert (again / path.relative_to(written)).read_bytes() == path.read_bytes()


def test_committed_template_is_small():
    files = [p for p in default_template_path().rglob("*") if p.is_file()]
    assert sum(p.stat().st_size for p in files) < 6_000_000


def test_template_is_free_to_use_and_complete():
    template = load_template(default_template_path())
    assert template.licence == "Apache-2.0"
    assert set(template.regions) == set(REGIONS)
    assert template.modes is not None
    assert template.modes.identity.shape == (10, len(template.mesh.vertices), 3)
    assert template.modes.expression.shape == (6, len(template.mesh.vertices), 3)
    assert template.maps["shininess"].shape == (768, 512)
    assert template.maps["shininess"].min() > 1
    assert 0 <= template.maps["translucency"].min() <= template.maps["translucency"].max() <= 1


def test_the_template_is_the_head_that_the_simulator_makes_now():
    template = load_template(default_template_path())
    assert np.array_equal(random_head(np.random.default_rng(0)).faces, template.mesh.faces)
    assert np.abs(template.mesh.vertices - neutral_mesh().vertices).max() < 1e-4
    assert np.abs(template.modes.identity - identity_modes()).max() < 1e-4
    assert np.abs(template.modes.expression - expression_modes()).max() < 1e-4
    assert tuple(template.modes.expression_names) == EXPRESSIONS


def test_skin_mask_is_the_face_without_the_eyes():
    mask = cv2.imread(str(default_template_path() / "maps" / "skin.png"), cv2.IMREAD_UNCHANGED)
    assert mask.shape == (768, 512)
    assert set(np.unique(mask)) == {0, 255}
    template = load_template(default_template_path())
    grid = {}
    for face, uv in zip(template.mesh.faces, template.mesh.face_uvs, strict=True):
        grid.update(zip(face.tolist(), template.mesh.uvs[uv].tolist(), strict=True))

    def value(vertex: int) -> int:
        u, v = grid[vertex]
        return int(mask[min(767, int((1 - v) * 768)), min(511, int(u * 512))])

    eyes, hair = template.regions["eyes"], template.regions["hair"]
    assert all(value(int(v)) == 0 for v in eyes)
    assert np.mean([value(int(v)) == 0 for v in hair]) > 0.95
    assert value(int(template.landmarks[30])) == 255
    assert value(int(template.landmarks[57])) == 255


@pytest.mark.parametrize("words", [["template"], ["dataset", "--subjects", "1", "--maps-only"]])
def test_a_folder_of_others_is_left_alone(tmp_path, words, run_command):
    (tmp_path / "photo.exr").write_bytes(b"mine")
    ended = run_command("sim", *words, "--out", tmp_path)
    assert ended.code == 2
    assert "found a folder with photo.exr, expected a new folder" in ended.err
    assert [path.name for path in tmp_path.iterdir()] == ["photo.exr"]
