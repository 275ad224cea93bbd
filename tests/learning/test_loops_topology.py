"""The template with closed loops: another topology, whose textures are those of the networks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from learning.checkpoint import load_whole_face, shipped_weights
from learning.render.uv import rasterise
from learning.whole.infer import infer_whole_face
from lightstage.formats.exr import read_exr, write_exr
from lightstage.formats.mesh import Mesh, read_mesh, write_obj
from lightstage.formats.processed import ProcessedFolder
from sim.head.loops import loops
from sim.head.loops_template import loops_mesh
from tests.programs import run_program


@pytest.fixture(scope="module")
def person(strangers: list[Path]) -> tuple[np.ndarray, Mesh, Mesh]:
    """A texture with light in it, and the person's mesh in both topologies."""
    folder = ProcessedFolder(strangers[0])
    mesh = read_mesh(folder.registered_mesh)
    albedo = read_exr(folder.root / "atlas" / "diffuse_albedo.exr")
    normal = rasterise(mesh, *albedo.shape[:2]).normals(mesh)
    toward = np.array([0.5, 0.3, 0.8]) / np.linalg.norm([0.5, 0.3, 0.8])
    lit = albedo * (0.25 + 0.75 * np.maximum(normal @ toward, 0))[..., None]
    return lit.astype(np.float32), mesh, loops_mesh().with_vertices(loops().carried(mesh.vertices))


def test_the_shipped_weights_find_the_same_albedo_in_either_topology(
    person: tuple[np.ndarray, Mesh, Mesh], capsys: pytest.CaptureFixture[str]
) -> None:
    texture, grid, looped = person
    network, _ = load_whole_face(shipped_weights())
    found = [infer_whole_face(network, texture, mesh).maps for mesh in (grid, looped)]
    both = np.logical_and(*(maps["diffuse_albedo"].max(axis=2) > 0 for maps in found))
    assert both.mean() > 0.99
    albedo, other = (maps["diffuse_albedo"][both] for maps in found)
    away = np.abs(np.log(albedo) - np.log(other))
    cosine = (found[0]["diffuse_normal"] * found[1]["diffuse_normal"]).sum(axis=2)[both]
    degrees = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    with capsys.disabled():
        print(f"\nalbedo: {100 * away.mean():.2f} %, 99 % {100 * np.quantile(away, 0.99):.2f}")
        print(f"normals: {np.median(degrees):.2f} deg, 99 % {np.quantile(degrees, 0.99):.1f}")
    assert away.mean() < 0.01
    assert np.quantile(away, 0.99) < 0.05
    assert np.median(degrees) < 0.5


def test_infer_takes_a_texture_of_the_template_with_loops(
    person: tuple[np.ndarray, Mesh, Mesh], tmp_path: Path
) -> None:
    texture, _, looped = person
    write_exr(tmp_path / "texture.exr", texture)
    write_obj(looped, tmp_path / "person.obj")
    words = ["infer", "--texture", tmp_path / "texture.exr", "--mesh", tmp_path / "person.obj"]
    ended = run_program("learning", *words, "--refine", "0", "--out", tmp_path / "maps")
    assert ended.code == 0, ended.err
    assert read_exr(tmp_path / "maps" / "diffuse_albedo.exr").shape == texture.shape
