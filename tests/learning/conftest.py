from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
import pytest

from learning.render.uv import rasterise
from lightstage.formats.files import write_json
from lightstage.formats.mesh import Mesh, write_obj
from lightstage.formats.processed import ProcessedFolder
from processing.dataset import build_store
from sim.people.dataset import make_plan, write_people
from sim.people.table import load_table
from sim.truth import vertex_occlusion

ROWS, COLUMNS = 96, 64
RADIUS_MM = 90.0


def ball(radius_mm: float = RADIUS_MM, rows: int = 48, columns: int = 64) -> Mesh:
    """A sphere unrolled over the whole tile: u around +y from the back, v from pole to pole."""
    around = np.linspace(-np.pi, np.pi, columns + 1)
    up = np.linspace(-0.5 * np.pi, 0.5 * np.pi, rows + 1)
    azimuth, elevation = np.meshgrid(around, up)
    direction = np.stack(
        [
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
            np.cos(elevation) * np.cos(azimuth),
        ],
        axis=-1,
    )
    u, v = np.meshgrid(np.linspace(0, 1, columns + 1), np.linspace(0, 1, rows + 1))
    index = np.arange((rows + 1) * (columns + 1)).reshape(rows + 1, columns + 1)
    corners = [index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]]
    faces = np.stack(corners, axis=-1).reshape(-1, 4).astype(np.int32)
    uvs = np.stack([u, v], axis=-1).reshape(-1, 2)
    return Mesh(radius_mm * direction.reshape(-1, 3), faces, uvs, faces)


def write_person(root: Path, name: str, rng: np.random.Generator) -> ProcessedFolder:
    """A ball with blotched skin as a processed folder."""
    folder = ProcessedFolder(root / name)
    mesh = ball(RADIUS_MM * rng.uniform(0.9, 1.1))
    raster = rasterise(mesh, ROWS, COLUMNS)
    normal = raster.normals(mesh)
    blotches = np.kron(rng.uniform(0.7, 1.0, (ROWS // 8, COLUMNS // 8)), np.ones((8, 8)))
    tone = rng.uniform(0.3, 0.7) * np.array([1.0, 0.6, 0.45])
    folder.write_atlas("diffuse_albedo", blotches[..., None] * tone)
    folder.write_atlas("specular_albedo", 0.02 + 0.02 * (blotches > 0.85))
    folder.write_atlas("diffuse_normal", normal)
    folder.write_atlas("specular_normal", normal)
    folder.write_atlas("position", raster.interpolate(mesh.vertices))
    folder.write_atlas("confidence", raster.covered.astype(np.float32))
    folder.write_atlas("skin", raster.covered.astype(np.float32))
    write_obj(mesh, folder.registered_mesh)
    write_json(folder.head_pose, {"head_from_world": np.eye(3, 4).tolist()})
    write_json(folder.root / "report.json", {"subject": name, "expression": "neutral"})
    return folder


@pytest.fixture(scope="session")
def people(tmp_path_factory: pytest.TempPathFactory) -> list[ProcessedFolder]:
    root = tmp_path_factory.mktemp("people")
    rng = np.random.default_rng(3)
    return [write_person(root, f"person-{i}", rng) for i in range(3)]


@pytest.fixture(scope="session")
def store_path(people: list[ProcessedFolder], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_store([p.root for p in people], tmp_path_factory.mktemp("data") / "store")


@pytest.fixture(scope="session")
def strangers(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Three simulated people on whom no shipped weights were trained, 192 rows."""
    folder = tmp_path_factory.mktemp("strangers")
    with pytest.MonkeyPatch.context() as patch:
        # Half of the time a person takes is the occlusion of their vertices by 256 rays each.
        fewer_rays = functools.partial(vertex_occlusion, directions=32)
        patch.setattr("sim.people.dataset.vertex_occlusion", fewer_rays)
        write_people(make_plan(folder, load_table("balanced"), 3, 1, 900, 192), jobs=1)
    return sorted(path.parent for path in folder.glob("*/report.json"))


@pytest.fixture(scope="session")
def ball_mesh() -> Mesh:
    return ball()
