"""What else casts shadows, found in the pictures beside the skin."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from lightstage.commands import quiet
from lightstage.formats.mesh import Mesh, read_ply, write_ply
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.template import default_template_path
from lightstage.rig import Rig, default_rig
from processing.closest import ClosestPoints
from processing.errors import ReconstructionError
from processing.pipeline import run
from processing.pipeline_config import PipelineConfig
from processing.reconstruction import stage
from processing.reconstruction.config import ReconstructConfig
from processing.reconstruction.fusion import compact
from processing.reconstruction.hull import KEEP_MM, STEPPED
from processing.reconstruction.occluders import apart, found_occluders, nothing_beside
from processing.reconstruction.stage import Reconstructed, others_beside, reconstruct_views
from processing.reconstruction.views import View
from processing.refinement.stage import measured_alone
from sim.light.world import World
from sim.people.clothing import collar, dressed
from sim.people.subject import Subject
from sim.session import SessionConfig, write_direct
from tests.processing.test_given_meshes import ball_mesh, plate
from tests.sim.conftest import one_person

CAMERAS = default_rig().scaled(0.02).cameras[:3]


def view_of(index: int) -> View:
    """A view whose whole picture is foreground."""
    camera = CAMERAS[index]
    shape = (camera.height_px, camera.width_px)
    return View(
        camera, np.zeros((*shape, 4), np.float32), np.ones(shape, bool), np.ones((*shape, 3))
    )


def joined(*meshes: Mesh) -> Mesh:
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + start for mesh, start in zip(meshes, starts[:-1], strict=True)]
    vertices = np.concatenate([mesh.vertices for mesh in meshes])
    return Mesh(vertices, np.concatenate(faces).astype(np.int32))


def test_what_the_skin_covers_is_not_matched_again() -> None:
    skin, asked = ball_mesh(), []

    def matched(views: Sequence[View], config: ReconstructConfig) -> Mesh:
        asked.append((views, config))
        return plate(150, 60)

    views = [view_of(k) for k in range(3)]
    found = found_occluders(views, skin, ReconstructConfig(), matched)
    assert found is not None
    np.testing.assert_array_equal(found.vertices, plate(150, 60).vertices)
    (rest, config), *more = asked
    assert not more
    assert not config.look_again
    assert config.splits == 0
    for before, after in zip(views, rest, strict=True):
        left = after.mask.mean()
        assert 0.2 < left < 0.9
        assert before.mask.all()
        assert np.isnan(after.textures[~after.mask]).all()
        assert np.isfinite(after.textures[after.mask]).all()
        assert not after.normals.any()
        middle = after.mask[after.mask.shape[0] // 2, after.mask.shape[1] // 2]
        assert not middle


def test_nothing_is_matched_where_the_skin_covers_all_and_a_failure_is_nothing() -> None:
    def refused(*_: object) -> Mesh:
        raise ReconstructionError("reconstruct", found="no points", expected="some")

    def never(*_: object) -> Mesh:
        raise AssertionError

    views = [view_of(0), view_of(1)]
    assert found_occluders(views, ball_mesh(), ReconstructConfig(), refused) is None
    assert found_occluders(views, ball_mesh(400), ReconstructConfig(), never) is None
    assert nothing_beside(ball_mesh()) is None


def test_pieces_on_the_skin_and_small_ones_are_no_occluders() -> None:
    skin, wall = ball_mesh(), plate(150, 60)
    crumb = Mesh(plate(0, 5).vertices + np.array([0, 150, 0]), plate(0, 5).faces)
    near = ball_mesh(96.0)
    found = apart(joined(crumb, near, wall), skin)
    assert found is not None
    np.testing.assert_array_equal(found.vertices, wall.vertices)
    assert apart(joined(crumb, near), skin) is None


@pytest.fixture(scope="module")
def small_rig() -> Rig:
    """Five cameras of 160 x 240 pixels and every fifth light."""
    rig = default_rig().scaled(240 / 6016)
    return dataclasses.replace(rig, lights=rig.lights[::5], cameras=rig.cameras[:5])


def photographed(subject: Subject, rig: Rig, root: Path) -> Path:
    write_direct(World(subject, rig), root, SessionConfig(sequence="binary"), 3, quiet)
    return root


CLOTHS = {
    "grey": (0.2, 0.2, 0.2),
    "red": (0.4, 0.03, 0.02),
    "black, darker than the threshold of the foreground": (0.012, 0.012, 0.015),
}


class Collared(NamedTuple):
    """A person in a collar whose thirds are of three cloths, reconstructed."""

    session: Path
    out: ProcessedFolder
    config: PipelineConfig
    facts: dict[str, Any]
    clothes: Mesh
    third: np.ndarray
    matched: Reconstructed


@pytest.fixture(scope="module")
def collared(tmp_path_factory: pytest.TempPathFactory, small_rig: Rig) -> Collared:
    root, person = tmp_path_factory.mktemp("collared"), one_person()
    clothes = collar(person)
    # Seen from the front, each third is of another cloth: one person shows them all.
    place = clothes.vertices[clothes.faces].mean(axis=1) - clothes.vertices.mean(axis=0)
    third = np.digitize(np.degrees(np.arctan2(place[:, 0], place[:, 2])), [-30, 30])
    wearer = person
    for number, cloth in enumerate(CLOTHS.values()):
        part = compact(clothes.vertices, clothes.faces[third == number])
        wearer = dressed(wearer, part, cloth)
    session = photographed(wearer, small_rig, root / "s")
    out = root / "out"
    config = dataclasses.replace(
        PipelineConfig(), reconstruct=ReconstructConfig(splits=0, look_again=False)
    )
    matched: list[Reconstructed] = []

    def kept(*given: Any) -> Reconstructed:
        matched.append(reconstruct_views(*given))
        return matched[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stage, "reconstruct_views", kept)
        report = run(session, out, default_template_path(), config, until="reconstruct")
    facts = report["stages"]["reconstruct"]
    return Collared(session, ProcessedFolder(out), config, facts, clothes, third, matched[-1])


def test_a_collar_of_any_colour_is_found_and_is_no_part_of_the_skins_mesh(
    collared: Collared,
) -> None:
    folder, clothes, third = collared.out, collared.clothes, collared.third
    every = read_ply(folder.occluders)
    assert collared.facts["occluder_faces"] == len(every.faces)
    # The hull is where no camera looks, too: the rest is cloth.
    found = measured_alone(every, folder)
    assert found is not None
    closest = ClosestPoints(clothes.vertices, clothes.faces)
    nearest = closest.query(found.vertices)
    skin = closest.query(read_ply(folder.base_mesh).vertices)
    for number, name in enumerate(CLOTHS):
        there = third[nearest.face] == number
        assert there[found.faces].all(axis=1).sum() > 500, name
        away = nearest.distance_mm[there]
        assert np.median(away) < 1.5, name
        # It was 6.1 on one machine and below 6 on others: last bits decide single points.
        assert np.percentile(away, 90) < 8, name
        assert ((skin.distance_mm < 1) & (third[skin.face] == number)).mean() < 0.006, name


def test_the_hull_is_off_the_skin_and_without_it_mesh_and_cloth_are_the_same(
    collared: Collared, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, facts = collared.out, collared.facts
    hull, skin = read_ply(folder.hull), read_ply(folder.base_mesh)
    found = measured_alone(read_ply(folder.occluders), folder)
    assert found is not None
    assert facts["hull_cm2"] == pytest.approx(len(hull.faces) * 0.045 / STEPPED, abs=0.1)
    from_skin = ClosestPoints(skin.vertices, skin.faces).query(hull.vertices)
    assert from_skin.distance_mm.min() > facts["hull_keeps_off_skin_mm"] == KEEP_MM
    without = dataclasses.replace(
        collared.config,
        reconstruct=dataclasses.replace(collared.config.reconstruct, find_hull=False),
    )
    # The hull is carved after the matching, whose result is taken as it was.
    monkeypatch.setattr(stage, "reconstruct_views", lambda *_: collared.matched)
    mesh = folder.base_mesh.read_bytes()
    report = run(
        collared.session, folder.root, default_template_path(), without, until="reconstruct"
    )
    assert report["stages"]["reconstruct"]["hull_cm2"] == 0
    assert not folder.hull.exists()
    assert folder.base_mesh.read_bytes() == mesh
    cloth = read_ply(folder.occluders)
    np.testing.assert_array_equal(cloth.vertices, found.vertices)
    np.testing.assert_array_equal(cloth.faces, found.faces)


def test_nothing_is_looked_for_where_nothing_could_be_found_or_a_file_is_named(
    tmp_path: Path,
) -> None:
    views, config = [view_of(0), view_of(1)], ReconstructConfig()
    asked = dataclasses.replace(config, find_occluders=False)
    assert others_beside(views, asked, True) is nothing_beside
    assert others_beside(views, config, False) is nothing_beside  # all is in the mesh
    assert others_beside(views[:1], config, True) is nothing_beside
    assert others_beside(views, config, True) is not nothing_beside
    wall = plate(150, 60)
    named = dataclasses.replace(config, occluders=str(write_ply(wall, tmp_path / "wall.ply")))
    found = others_beside([], named, True)(ball_mesh())
    assert found is not None
    np.testing.assert_allclose(found.vertices, wall.vertices)
