"""People with a beard, hair over an ear, glasses and clothes that the picture's border cuts: the
other skin's maps are as good as without them. A scarf that moved is told."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lightstage.commands import quiet
from lightstage.formats.mesh import Mesh
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.template import default_template_path
from lightstage.rig import Rig, default_rig
from processing.closest import ClosestPoints
from processing.evaluation.maps import angle_deg
from processing.pipeline import PipelineConfig, run
from processing.reconstruction.config import ReconstructConfig
from sim.light.world import World
from sim.people.clothing import collar, dressed
from sim.people.subject import Subject
from sim.people.subjects import load_subject
from sim.people.worn import beard, glasses, hair_over_ear
from sim.session import SessionConfig, write_direct

FAR_MM = 25.0
"""Skin so far from all that is worn is held against the same skin with nothing worn."""
CONFIG = dataclasses.replace(
    PipelineConfig(), reconstruct=ReconstructConfig(splits=0, look_again=False)
)


@pytest.fixture(scope="module")
def rig() -> Rig:
    """Three cameras of 160 x 240 pixels and every fourth light."""
    rig = default_rig().scaled(240 / 6016)
    return dataclasses.replace(rig, lights=rig.lights[::4], cameras=rig.cameras[:3])


@pytest.fixture(scope="module")
def person() -> Subject:
    return load_subject("parametric", 3, None, 384)


class Restless(World):
    """A stage in which every second photograph shows another subject."""

    def __init__(self, subject: Subject, other: Subject, rig: Rig) -> None:
        super().__init__(subject, rig)
        self._other = World(other, rig)

    def photograph(self, camera_id: str, levels: np.ndarray) -> np.ndarray:
        pictures = super().photograph(camera_id, levels)
        pictures[1::2] = self._other.photograph(camera_id, levels[1::2])
        return pictures


def maps_of(world: World, root: Path) -> tuple[ProcessedFolder, dict[str, Any]]:
    """The coarse maps and the mesh, and the report."""
    session = write_direct(world, root / "session", SessionConfig(sequence="binary"), 3, quiet)
    out = root / "out"
    return ProcessedFolder(out), run(
        session, out, default_template_path(), CONFIG, until="reconstruct"
    )


def skin_error(folder: ProcessedFolder, world: World, worn: list[Mesh]) -> float:
    """Mean angle of the diffuse normals of skin that lies far from what is worn, in the front."""
    vertices = np.concatenate([mesh.vertices for mesh in worn])
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in worn)])
    faces = [mesh.triangles() + start for mesh, start in zip(worn, starts[:-1], strict=True)]
    near = ClosestPoints(vertices, np.concatenate(faces))
    errors = []
    for camera, surface in world.surfaces.items():
        skin = surface.skin & (np.einsum("nk,nk->n", surface.view, surface.normal) > 0.4)
        far = near.query(surface.position).distance_mm > FAR_MM
        chosen = surface.picture(skin & far)
        true = surface.picture(surface.normal)
        found = folder.read_view(camera, "diffuse_normal")
        errors.append(angle_deg(found[chosen], true[chosen]))
    return float(np.concatenate(errors).mean())


@pytest.fixture(scope="module")
def bare(
    person: Subject, rig: Rig, tmp_path_factory: pytest.TempPathFactory
) -> tuple[ProcessedFolder, World]:
    world = World(person, rig)
    return maps_of(world, tmp_path_factory.mktemp("bare"))[0], world


def test_beard_hair_over_an_ear_glasses_and_cut_clothes_leave_the_other_skin_as_it_was(
    person: Subject, rig: Rig, bare: tuple[ProcessedFolder, World], tmp_path: Path
) -> None:
    worn = [beard(person, 1), hair_over_ear(person, 1), glasses(person), collar(person)]
    wearing = dressed(person, worn[0], (0.05, 0.03, 0.02))
    wearing = dressed(wearing, worn[1], (0.03, 0.02, 0.015), 0.03, 0.2)
    wearing = dressed(wearing, worn[2], (0.02, 0.02, 0.02), 0.06, 0.08)
    wearing = dressed(wearing, worn[3], (0.4, 0.05, 0.03))
    world = World(wearing, rig)
    # The border cuts the shoulders.
    cut = [world.surfaces[c.id].picture(world.surfaces[c.id].face >= 0) for c in rig.cameras]
    assert sum(bool(seen[:, 0].any() or seen[:, -1].any()) for seen in cut) >= 2
    folder, _ = maps_of(world, tmp_path)
    alone = skin_error(*bare, worn)
    found = skin_error(folder, bare[1], worn)
    assert found < alone + 0.7
    sure, count = 0, 0
    for camera in rig.cameras:
        surface = world.surfaces[camera.id]
        hair = surface.picture(surface.face >= len(person.mesh.triangles()))
        sure += int((folder.read_view(camera.id, "confidence")[hair] > 0.5).sum())
        count += int(hair.sum())
    assert sure < 0.1 * count


def test_a_scarf_that_moved_between_patterns_is_told(
    person: Subject, rig: Rig, tmp_path: Path
) -> None:
    scarf = collar(person)
    lower = Mesh(scarf.vertices + np.array([4.0, -5.0, 2.0]), scarf.faces)
    red = (0.4, 0.05, 0.03)
    world = Restless(dressed(person, scarf, red), dressed(person, lower, red), rig)
    _, report = maps_of(world, tmp_path)
    assert any("pairs do not sum to full alike" in said for said in report["warnings"])
