"""A head to export, and what became of it."""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path

import numpy as np
import pytest

from learning.render.uv import rasterise
from lightstage.formats.mesh import read_obj, write_obj
from lightstage.formats.processed import ProcessedFolder
from tests.learning.export.called import printed


@pytest.fixture(scope="session")
def person(people: list[ProcessedFolder], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ball with rough and smooth skin, fine normals and a reflectance above that of n = 1.4.

    Its texture leaves a border free.
    """
    root = tmp_path_factory.mktemp("export") / "person"
    shutil.copytree(people[0].root, root)
    folder = ProcessedFolder(root)
    rng = np.random.default_rng(5)
    mesh = read_obj(folder.registered_mesh)
    assert mesh.uvs is not None
    mesh = dataclasses.replace(mesh, uvs=0.1 + 0.8 * mesh.uvs)
    write_obj(mesh, folder.registered_mesh)
    shape = folder.read_atlas("diffuse_albedo").shape
    raster = rasterise(mesh, *shape[:2])
    folder.write_atlas("position", raster.interpolate(mesh.vertices))
    smooth = raster.normals(mesh)
    folder.write_atlas("diffuse_normal", smooth)
    normal = smooth + 0.2 * rng.normal(size=shape)
    folder.write_atlas("specular_normal", normal / np.linalg.norm(normal, axis=2, keepdims=True))
    folder.write_atlas("diffuse_albedo", rng.uniform(0, 1, shape))
    folder.write_atlas("specular_albedo", rng.uniform(0, 0.07, shape[:2]))
    folder.write_atlas("roughness", rng.uniform(0.1, 0.5, shape[:2]))
    folder.write_atlas("ambient_occlusion", rng.uniform(0, 1, shape[:2]))
    return root


@pytest.fixture(scope="session")
def exported(person: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("exported") / "out"
    printed("export", person, "--out", out)
    return out
