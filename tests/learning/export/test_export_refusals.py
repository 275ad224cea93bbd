"""What `export` refuses: one message, and nothing is written."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lightstage.formats.exr import write_exr
from lightstage.formats.mesh import Mesh, read_obj, write_obj
from lightstage.formats.processed import ProcessedFolder
from tests.learning.export.called import copied, refusal


def without_a_map(folder: ProcessedFolder) -> None:
    folder.atlas_path("specular_albedo").unlink()


def of_another_size(folder: ProcessedFolder) -> None:
    folder.write_atlas("roughness", np.full((48, 32), 0.3))


def with_nan(folder: ProcessedFolder) -> None:
    image = folder.read_atlas("diffuse_albedo")
    image[5, 5] = np.nan
    write_exr(folder.atlas_path("diffuse_albedo"), image)


def with_grey_normals(folder: ProcessedFolder) -> None:
    write_exr(folder.atlas_path("specular_normal"), folder.read_atlas("specular_albedo"))


def negative(folder: ProcessedFolder) -> None:
    folder.write_atlas("specular_albedo", -folder.read_atlas("specular_albedo"))


def negative_occlusion(folder: ProcessedFolder) -> None:
    folder.write_atlas("ambient_occlusion", -folder.read_atlas("ambient_occlusion"))


def inside_out(folder: ProcessedFolder) -> None:
    mesh = read_obj(folder.registered_mesh)
    assert mesh.face_uvs is not None
    faces, face_uvs = mesh.faces[:, ::-1], mesh.face_uvs[:, ::-1]
    write_obj(dataclasses.replace(mesh, faces=faces, face_uvs=face_uvs), folder.registered_mesh)


def of_another_head(folder: ProcessedFolder) -> None:
    mesh = read_obj(folder.registered_mesh)
    write_obj(mesh.with_vertices(mesh.vertices + np.array([30, 0, 0])), folder.registered_mesh)


def in_other_axes(folder: ProcessedFolder) -> None:
    folder.atlas_path("position").unlink()
    mesh = read_obj(folder.registered_mesh)
    write_obj(mesh.with_vertices(mesh.vertices[:, [2, 0, 1]]), folder.registered_mesh)


def without_uv(folder: ProcessedFolder) -> None:
    mesh = read_obj(folder.registered_mesh)
    write_obj(Mesh(mesh.vertices, mesh.faces), folder.registered_mesh)


def in_metres(folder: ProcessedFolder) -> None:
    mesh = read_obj(folder.registered_mesh)
    write_obj(mesh.with_vertices(mesh.vertices / 1000), folder.registered_mesh)


def without_mesh(folder: ProcessedFolder) -> None:
    folder.registered_mesh.unlink()


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (without_a_map, "specular_albedo.exr"),
        (of_another_size, "expected 96 x 64, as diffuse_albedo"),
        (with_nan, "diffuse_albedo.exr"),
        (with_grey_normals, "expected 3, as a map of this name has"),
        (negative, "negative"),
        (negative_occlusion, "expected values of at least 0"),
        (inside_out, "Is the mesh inside out?"),
        (of_another_head, "position.exr"),
        (in_other_axes, "maps of the mesh's own template, in its axes"),
        (without_uv, "uv: found none"),
        (in_metres, "Multiply it by 1000"),
        (without_mesh, "Name it by --mesh"),
    ],
)
def test_bad_input_is_one_message_that_names_it_and_nothing_is_written(
    spoil: Any, message: str, person: Path, tmp_path: Path
) -> None:
    folder = copied(person, tmp_path)
    spoil(folder)
    before = sorted(tmp_path.iterdir())
    err = refusal("export", folder.root, "--out", tmp_path / "out")
    assert message in err
    assert "Traceback" not in err
    assert sorted(tmp_path.iterdir()) == before


def test_a_comparison_with_maps_of_another_size_or_mesh_is_refused(
    person: Path, tmp_path: Path
) -> None:
    folder = copied(person, tmp_path)
    words = ("--format", "page", "--compare", folder.root, "--out", tmp_path / "out")
    of_another_head(folder)
    mesh = read_obj(folder.registered_mesh)
    folder.write_atlas("position", folder.read_atlas("position") + np.float32(30))
    write_obj(mesh, folder.registered_mesh)
    assert "position.exr" in refusal("export", person, *words)
    assert not (tmp_path / "out").exists()


def test_an_out_that_is_a_file_is_refused_and_stays(person: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.write_text("mine")
    assert str(out) in refusal("export", person, "--out", out)
    assert out.read_text() == "mine"


def test_a_folder_without_maps_is_named_by_the_option_that_gave_it_if_any(tmp_path: Path) -> None:
    none, out = tmp_path / "none", tmp_path / "H"
    for words in (
        ["export", none, "--out", out],
        ["detail", none, "--out", out],
        ["evaluate", none, "--truth", none],
    ):
        assert f"{none}: found no such folder" in refusal(*words)
    assert f"{none}, --maps: found no such folder" in refusal(
        "avatar", "--maps", none, "--out", out
    )
    assert not out.exists()


def test_a_place_that_is_taken_and_a_format_that_is_unknown_are_refused(
    person: Path, exported: Path
) -> None:
    before = (exported / "head.glb").read_bytes()
    assert "expected a new folder" in refusal("export", person, "--out", exported)
    assert (exported / "head.glb").read_bytes() == before
    assert "some of gltf, obj, maps, usd, page" in refusal(
        "export", person, "--out", exported / "new", "--format", "fbx"
    )
    assert not (exported / "new").exists()
