"""Textures of four people in one light that is known."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from learning.checkpoint import load_whole_face, shipped_weights
from learning.maps import SHININESS, TexturedHead, skin_maps_from
from learning.networks.whole_face import WholeFaceNetwork
from learning.relight import lit_texture, shadows_of
from learning.render.uv import rasterise
from lightstage.formats.environment import LightSet
from lightstage.formats.exr import write_exr
from lightstage.formats.mesh import Mesh, write_obj
from lightstage.formats.template import default_template_path, load_template

ROWS, COLUMNS, PEOPLE = 96, 64, 2
CAMERA_MM = np.array([0.0, 0.0, 1100.0])
LIGHT = LightSet(
    "known",
    np.array([[700.0, 500.0, 800.0], [-900.0, 100.0, 600.0]]),
    np.array([[0.75, 0.65, 0.55], [0.2, 0.25, 0.35]]),
    np.array([0.12, 0.12, 0.14]),
)


@dataclasses.dataclass(frozen=True)
class Domain:
    """Folders as `fit` leaves them, and what the textures in them are made of."""

    folder: Path
    textures: list[np.ndarray]
    albedos: list[np.ndarray]
    meshes: list[Mesh]


@pytest.fixture(scope="session")
def network() -> WholeFaceNetwork:
    return load_whole_face(shipped_weights())[0]


@pytest.fixture(scope="session")
def domain(network: WholeFaceNetwork, tmp_path_factory: pytest.TempPathFactory) -> Domain:
    """People of other shape and skin than the mean, lit by `LIGHT`."""
    template = load_template(default_template_path())
    rng = np.random.default_rng(4)
    folder = tmp_path_factory.mktemp("domain")
    textures, albedos, meshes = [], [], []
    for index in range(PEOPLE):
        along = rng.normal(size=len(network.mode_deviations))
        beside = np.einsum(
            "k,kchw->hwc", along * network.mode_deviations.numpy(), network.albedo_modes.numpy()
        )
        mean = network.mean_log_albedo[0].permute(1, 2, 0).numpy()
        albedo = np.clip(np.exp(mean + beside), 1e-3, 0.95)
        mesh = template.mesh
        if template.modes is not None:
            some = 0.7 * rng.normal(size=len(template.modes.identity))
            moved = np.tensordot(some, template.modes.identity, 1)
            mesh = mesh.with_vertices(mesh.vertices + moved)
        raster = rasterise(mesh, ROWS, COLUMNS)
        covered = raster.covered
        normal = raster.normals(mesh)
        ones = np.ones((ROWS, COLUMNS), np.float32)
        maps = {
            "diffuse_albedo": (albedo * covered[..., None]).astype(np.float32),
            "specular_albedo": 0.03 * covered.astype(np.float32),
            "diffuse_normal": normal,
            "specular_normal": normal,
            "position": raster.interpolate(mesh.vertices),
        }
        skin = skin_maps_from(maps, covered, SHININESS * ones, 0 * ones)
        head = TexturedHead(mesh, raster, skin, covered)
        texture = lit_texture(head, LIGHT, CAMERA_MM, None, shadows_of(head, LIGHT))
        own = folder / f"person{index}"
        own.mkdir()
        write_exr(own / "texture.exr", texture)
        write_obj(mesh, own / "registered_mesh.obj")
        textures.append(texture)
        albedos.append(maps["diffuse_albedo"])
        meshes.append(mesh)
    return Domain(folder, textures, albedos, meshes)
