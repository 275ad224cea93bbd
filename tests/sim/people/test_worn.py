"""Hair and glasses as geometry: where they lie, and that they are closed."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from lightstage.formats.mesh import Mesh, directed_edges
from processing.closest import ClosestPoints
from sim.errors import SimError
from sim.people.clothing import dressed
from sim.people.subject import Subject
from sim.people.subjects import load_subject
from sim.people.worn import fringe, glasses, tubes
from tests.sim.conftest import ball_subject


@pytest.fixture(scope="module")
def person() -> Subject:
    return load_subject("parametric", 7, None, 96)


def closed(mesh: Mesh) -> bool:
    """Whether each edge is met once in either direction."""
    edges = directed_edges(mesh.faces)
    there = {tuple(edge) for edge in edges.tolist()}
    return len(there) == len(edges) and all((b, a) in there for a, b in there)


def volume(mesh: Mesh) -> float:
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    return float(np.einsum("nk,nk->n", a, np.cross(b, c)).sum() / 6)


def test_a_tube_is_closed_faces_outward_and_has_the_volume_of_its_section() -> None:
    path = np.stack([np.linspace(0, 50, 12), np.zeros(12), np.zeros(12)], axis=1)
    bent = np.stack([np.zeros(9), np.linspace(90, 130, 9), np.linspace(0, 1, 9) ** 2], axis=1)
    for each, length in ((path, 50.0), (bent, 40.0)):
        tube = tubes([each], 2.0)
        assert closed(tube)
        section = 6 * 0.5 * 4 * np.sin(np.pi / 3)
        assert volume(tube) == pytest.approx(length * section, rel=0.02)
    assert closed(tubes([path, bent], 2.0))


def test_a_fringe_hangs_before_the_forehead_and_glasses_stand_before_the_eyes(
    person: Subject,
) -> None:
    skin = ClosestPoints(person.mesh.vertices, person.mesh.triangles())
    to_head = person.head_from_world
    brows = person.landmarks_mm[17:27] @ to_head[:, :3].T + to_head[:, 3]
    for worn, farthest in ((fringe(person, 3), 15.0), (glasses(person), 40.0)):
        assert closed(worn)
        assert volume(worn) > 0
        away = skin.query(worn.vertices).distance_mm
        assert away.max() < farthest
        assert np.median(away) > 1.0
    hair = fringe(person, 3).vertices @ to_head[:, :3].T + to_head[:, 3]
    assert hair[:, 1].min() > brows[:, 1].min() - 5
    np.testing.assert_array_equal(fringe(person, 3).vertices, fringe(person, 3).vertices)
    assert not np.array_equal(fringe(person, 3).vertices, fringe(person, 4).vertices)


def test_what_is_worn_has_its_own_mirror_and_is_no_skin(person: Subject) -> None:
    wearing = dressed(person, glasses(person), (0.02, 0.02, 0.02), 0.05, 0.1)
    assert not wearing.skin[-1].any()
    np.testing.assert_allclose(wearing.specular_albedo[-1], 0.05)
    np.testing.assert_allclose(wearing.roughness[-1], 0.1)
    assert wearing.skin.sum() == person.skin.sum()


def test_who_has_no_landmarks_wears_nothing() -> None:
    bare = dataclasses.replace(ball_subject(), landmarks_mm=np.full((68, 3), np.nan))
    with pytest.raises(SimError, match="no landmarks"):
        fringe(bare, 0)
    with pytest.raises(SimError, match="no landmarks"):
        glasses(bare)
