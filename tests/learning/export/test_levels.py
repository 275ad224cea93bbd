"""Levels of detail of an exported head: fewer triangles, smaller pictures, the same look."""

from __future__ import annotations

import io
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from learning.export.levels import coarser, on_level
from learning.export.source import read_source
from lightstage.formats.mesh import read_obj
from processing.atlas.tangents import from_tangent_space
from tests.learning.export.called import printed, refusal


@pytest.fixture(scope="module")
def levels(person: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("levels") / "out"
    printed("export", person, "--out", out, "--format", "gltf,obj", "--lods", 2)
    return out


def test_each_level_has_a_quarter_of_the_triangles_and_pictures_of_half_the_rows(
    levels: Path,
) -> None:
    folders = [levels, levels / "lod1", levels / "lod2"]
    counts = [len(read_obj(folder / "head.obj").triangles()) for folder in folders]
    sizes = [
        cv2.imread(str(folder / "textures" / "base_color.png")).shape[:2] for folder in folders
    ]
    for finer, level in ((0, 1), (1, 2)):
        assert 0.95 < 4 * counts[level] / counts[finer] <= 1.0
        assert sizes[level] == tuple((side + 1) // 2 for side in sizes[finer])
    for folder, count in zip(folders, counts, strict=True):
        shape = trimesh.load(io.BytesIO((folder / "head.glb").read_bytes()), "glb", force="mesh")
        assert len(shape.faces) == count
    assert f"{counts[1]}, {counts[2]} triangles" in (levels / "README.txt").read_text()


def test_a_level_is_the_same_surface_and_its_normal_map_gives_the_same_directions(
    person: Path,
) -> None:
    """The directions that a renderer sees are those of the maps, whatever the triangles are."""
    source = read_source(person)
    level = coarser(source)
    texels = level.raster.texels()
    place = level.raster.at(level.mesh.vertices, level.mesh.triangles(), texels)
    radius = np.linalg.norm(source.mesh.vertices, axis=1).mean()
    assert abs(np.linalg.norm(place, axis=1) / radius - 1).max() < 0.05
    tangent = level.tangent("diffuse_normal").reshape(-1, 3)[texels]
    back = from_tangent_space(
        tangent, level.raster, texels, level.mesh.triangles(), level.normals, level.frames
    )
    own = level.maps["diffuse_normal"].reshape(-1, 3)[texels].astype(float)
    own /= np.linalg.norm(own, axis=1, keepdims=True)
    apart = np.degrees(np.arccos(np.clip(np.einsum("kc,kc->k", back, own), -1, 1)))
    assert np.quantile(apart, 0.99) < 1
    smooth = level.maps["diffuse_normal"].reshape(-1, 3)[texels].astype(float)
    outward = place / np.linalg.norm(place, axis=1, keepdims=True)
    smooth /= np.linalg.norm(smooth, axis=1, keepdims=True)
    degrees = np.degrees(np.arccos(np.clip(np.einsum("kc,kc->k", smooth, outward), -1, 1)))
    assert np.median(degrees) < 4


def test_morph_targets_move_a_levels_vertices_as_those_of_the_head(person: Path) -> None:
    source = read_source(person)
    level = coarser(source)
    offsets = 0.02 * source.mesh.vertices + np.array([1.0, 0, 0])
    moved = on_level(source, level, offsets)
    expected = 0.02 * level.mesh.vertices + np.array([1.0, 0, 0])
    away = np.linalg.norm(moved - expected, axis=1)
    assert np.median(away) < 0.1 * np.linalg.norm(expected, axis=1).mean()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--lods", 7], "--lods: found 7, expected 0 to 6"),
        (["--lods", -1], "--lods: found -1, expected 0 to 6"),
        (["--lods", 6], "the last of"),
        (["--lods", 1, "--format", "maps"], "some of gltf, obj, usd in --format"),
    ],
)
def test_levels_that_cannot_be_made_are_refused(
    person: Path, tmp_path: Path, words: list[object], message: str
) -> None:
    assert message in refusal("export", person, "--out", tmp_path / "out", *words)
    assert not (tmp_path / "out").exists()


def test_without_pymeshlab_levels_are_refused_and_the_extra_is_named(
    person: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("learning.export.levels.reason_without", lambda: "it is not installed")
    assert "--lods: found it is not installed" in refusal(
        "export", person, "--out", tmp_path / "out", "--lods", 1
    )
