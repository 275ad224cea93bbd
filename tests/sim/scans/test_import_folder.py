"""Subject folders: the same bits come back; what is wrong in one is named."""

from __future__ import annotations

import dataclasses
import json
import shutil

import numpy as np
import pytest

from lightstage.errors import FormatError, LightstageError
from lightstage.formats.exr import read_exr, write_exr
from sim.errors import SimError
from sim.people.subject import Subject
from sim.people.subjects import check_subject, is_folder, load_subject
from sim.scans.folder import load_subject_folder, require_free, save_subject


def same(one: Subject, other: Subject) -> None:
    for field in dataclasses.fields(Subject):
        a, b = getattr(one, field.name), getattr(other, field.name)
        if field.name == "mesh":
            for part in ("vertices", "faces", "uvs", "face_uvs"):
                np.testing.assert_array_equal(getattr(a, part), getattr(b, part))
        elif isinstance(a, np.ndarray):
            np.testing.assert_array_equal(a, b)
            assert a.dtype == b.dtype
        else:
            assert a == b


@pytest.fixture
def folder(ball, tmp_path):
    return save_subject(ball, tmp_path / "ball")


def test_a_subject_comes_back_to_the_bit(ball, tmp_path):
    same(load_subject_folder(save_subject(ball, tmp_path / "plain")), ball)
    marks = ball.landmarks_mm.copy()
    marks[[3, 40]] = np.nan
    angle = 0.3
    turn = np.array(
        [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    )
    odd = dataclasses.replace(
        ball,
        landmarks_mm=marks,
        distribution="ggx",
        anisotropy=np.full(ball.roughness.shape, 0.3, np.float32),
        head_from_world=np.concatenate([turn, [[0.1], [1 / 3], [2]]], axis=1),
        mesh=ball.mesh.with_vertices(ball.mesh.vertices / 3),
        expression="smile",
    )
    path = save_subject(odd, tmp_path / "odd", {"from": "a test"})
    same(load_subject_folder(path), odd)
    assert json.loads((path / "subject.json").read_text())["import"] == {"from": "a test"}


def test_a_parametric_person_can_be_kept_in_a_folder(tmp_path):
    person = load_subject("someone", 3, "smile", texture_rows=96)
    path = save_subject(person, tmp_path / "kept")
    same(load_subject(str(path), 99), person)
    with pytest.raises(SimError, match=r"expression: found jaw_open, expected smile"):
        load_subject(str(path), 0, "jaw_open")


def test_names_folders_and_paths_are_distinguished(folder, tmp_path, monkeypatch):
    assert is_folder(str(folder))
    assert is_folder("some/where")
    assert not is_folder("someone")
    check_subject(str(folder))
    with pytest.raises(LightstageError, match="pseudonym"):
        check_subject("a@b")
    with pytest.raises(
        SimError, match=r"found no such folder, expected a subject folder.*import-scan"
    ):
        load_subject(str(tmp_path / "absent"), 0)
    monkeypatch.chdir(tmp_path)
    assert load_subject("ball", 0).name == "ball"


def change_json(folder, **fields):
    value = json.loads((folder / "subject.json").read_text())
    value.update(fields)
    (folder / "subject.json").write_text(json.dumps(value))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"schema": "lightstage.subject/2"}, "schema"),
        ({"schema": "lightstage.rig/1"}, "schema"),
        ({"units": "cm"}, "units: found 'cm', expected 'mm'"),
        ({"distribution": "phong"}, "distribution: found 'phong', expected beckmann or ggx"),
        ({"name": None}, "name: found None"),
        ({"name": "a/b"}, "pseudonym"),
        ({"landmarks_mm": [[0, 0, 0]] * 67}, "landmarks_mm: found 67 entries, expected 68"),
        ({"landmarks_mm": [[0, 0]] * 68}, r"landmarks_mm\[0\].*expected 3 numbers"),
        ({"head_from_world": [[1, 0, 0, 0]] * 3}, "no rigid motion"),
        ({"head_from_world": [[2, 0, 0, 0], [0, 2, 0, 0], [0, 0, 2, 0]]}, "no rigid motion"),
        ({"head_from_world": "here"}, "expected 3 x 4 numbers"),
    ],
)
def test_wrong_fields_are_named(folder, fields, message):
    change_json(folder, **fields)
    with pytest.raises(LightstageError, match=message):
        load_subject_folder(folder)


def test_maps_of_another_size_negative_albedo_and_nan_are_refused(folder):
    maps = folder / "maps"
    rough = read_exr(maps / "roughness.exr")
    write_exr(maps / "roughness.exr", rough[:48], half=False)
    with pytest.raises(
        SimError, match=r"roughness.exr: found shape \(48, 96\), expected \(96, 96\)"
    ):
        load_subject_folder(folder)
    write_exr(maps / "roughness.exr", rough, half=False)
    albedo = read_exr(maps / "diffuse_albedo.exr")
    albedo[7, 9, 1] = -0.25
    write_exr(maps / "diffuse_albedo.exr", albedo, half=False)
    with pytest.raises(
        SimError, match=r"diffuse_albedo.exr, texel \(7, 9, 1\): found -0.25 .*expected 0 to 1"
    ):
        load_subject_folder(folder)
    albedo[7, 9, 1] = np.nan
    write_exr(maps / "diffuse_albedo.exr", albedo, half=False)
    with pytest.raises(FormatError, match=r"diffuse_albedo.exr.*NaN"):
        load_subject_folder(folder)


@pytest.mark.parametrize("name", ["maps/normal.exr", "mesh.obj", "skin.png", "subject.json"])
def test_a_missing_or_damaged_file_is_named(folder, name):
    whole = (folder / name).read_bytes()
    (folder / name).write_bytes(whole[: len(whole) // 3])
    if name != "skin.png":  # half a PNG is still decoded by some readers
        with pytest.raises(LightstageError, match=name.rpartition("/")[2]):
            load_subject_folder(folder)
    (folder / name).unlink()
    with pytest.raises(LightstageError, match=name.rpartition("/")[2]):
        load_subject_folder(folder)


def test_a_mesh_without_uv_or_outside_the_tile_is_refused(folder):
    text = (folder / "mesh.obj").read_text()
    (folder / "mesh.obj").write_text(text.replace("vt 0.0 ", "vt 1.5 "))
    with pytest.raises(SimError, match=r"mesh.obj, uv: found UV from 0.* to 1.5"):
        load_subject_folder(folder)
    bare = "\n".join(line for line in text.splitlines() if not line.startswith(("vt", "f")))
    (folder / "mesh.obj").write_text(bare + "\nf 1 2 3\n")
    with pytest.raises(SimError, match="uv: found none"):
        load_subject_folder(folder)


def test_nothing_half_written_and_nothing_foreign_replaced(ball, tmp_path):
    bad = dataclasses.replace(ball, diffuse_albedo=ball.diffuse_albedo - 1)
    with pytest.raises(SimError, match="diffuse_albedo"):
        save_subject(bad, tmp_path / "bad")
    assert list(tmp_path.iterdir()) == []
    foreign = tmp_path / "photos"
    foreign.mkdir()
    (foreign / "me.jpg").write_bytes(b"x")
    with pytest.raises(SimError, match="photos: found something else"):
        require_free(foreign)
    with pytest.raises(LightstageError, match="photos"):
        save_subject(ball, foreign)
    assert [path.name for path in foreign.iterdir()] == ["me.jpg"]
    kept = save_subject(ball, tmp_path / "kept")
    require_free(kept)
    (kept / "maps" / "mine.exr").write_bytes(b"x")
    for call in (lambda: require_free(kept), lambda: save_subject(ball, kept)):
        with pytest.raises(LightstageError, match=r"kept: found maps/mine\.exr, which"):
            call()
    (kept / "maps" / "mine.exr").unlink()
    (kept / "maps" / "anisotropy.exr").write_bytes(b"x")
    save_subject(ball, kept)
    assert not (kept / "maps" / "anisotropy.exr").exists()
    shutil.rmtree(kept)
    require_free(kept)
