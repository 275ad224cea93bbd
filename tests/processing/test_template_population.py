"""`template population`: another model's people in a template's topology, kept in its folder."""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage.errors import FormatError
from lightstage.formats.mesh import Mesh
from lightstage.formats.population import (
    FILE,
    POINTS_FILE,
    Population,
    read_population,
    write_population,
)
from lightstage.formats.template import (
    Modes,
    Template,
    default_template_path,
    load_template,
    save_template,
)
from processing.errors import ProcessingError
from processing.template.config import PopulationConfig
from processing.template.population import population_of

WAVE_MM = 30.0


@pytest.fixture(scope="module")
def template() -> Template:
    return load_template(default_template_path())


def other_model(template: Template) -> Template:
    """A model of another topology, whose mean head is wider and flatter than our mesh.

    It has our mesh's surface in another order and without some vertices' quads kept together. Two
    of its modes are smooth: heads that are longer, and heads that are deeper on one side. The third
    is a wave over the head's height.
    """
    order = np.random.default_rng(5).permutation(len(template.mesh.vertices))
    place = np.argsort(order)
    vertices = template.mesh.vertices[order] * [1.06, 1.0, 0.92]
    x, y, _ = vertices.T
    longer = np.stack([0 * x, 0.04 * y, 0 * x], axis=1)
    aside = np.stack([0 * x, 0 * x, 4 / (1 + np.exp(-x / 20.0))], axis=1)
    wave = np.stack([0 * x, 0 * x, np.cos(2 * np.pi * y / WAVE_MM)], axis=1)
    uvs = template.mesh.uvs
    assert uvs is not None
    return dataclasses.replace(
        template,
        name="others",
        mesh=Mesh(vertices, place[template.mesh.triangles()], uvs, template.mesh.triangle_uvs()),
        landmarks=place[template.landmarks],
        regions={},
        modes=Modes(np.stack([longer, aside, wave]), np.zeros((0, len(x), 3)), ()),
        licence="CC0-1.0",
        source="made for this test",
        face_points=None,
        population=None,
    )


def test_people_of_another_topology_keep_their_mean_and_their_modes(template: Template) -> None:
    other = other_model(template)
    found, facts = population_of(template, other, PopulationConfig())
    assert facts["modes"] == 3
    assert facts["carried_share"] > 0.95
    place = np.argsort(np.random.default_rng(5).permutation(len(template.mesh.vertices)))
    face = np.linalg.norm(template.mesh.vertices - template.mesh.vertices[template.landmarks[30]],
                          axis=1) < 80  # fmt: skip
    true = other.mesh.vertices[place]
    # The head frame is rigid; the shape is compared by distances from the mean of the face.
    for one, two in zip(np.ptp(found.mean_mm[face], 0), np.ptp(true[face], 0), strict=True):
        assert one == pytest.approx(two, rel=0.03)
    assert other.modes is not None
    *smooth, wave = other.modes.identity[:, place]
    for carried, mode in zip(found.identity_mm, smooth, strict=False):
        off = np.linalg.norm(carried - mode, axis=1)[face]
        assert off.mean() < 0.15 * np.linalg.norm(mode, axis=1)[face].mean()
    # Smoothed over L = 6 mm by (1 + L^2 Laplacian)^-1, a wave of wave number k keeps this share.
    kept = np.sum(found.identity_mm[2][face] * wave[face]) / np.sum(wave[face] ** 2)
    assert kept == pytest.approx(1 / (1 + (6 * 2 * np.pi / WAVE_MM) ** 2), rel=0.1)


def test_a_template_with_a_vertex_of_no_triangle_has_people(template: Template) -> None:
    spare = np.array([[0.0, 500.0, 0.0]])
    mesh = dataclasses.replace(
        template.mesh, vertices=np.concatenate([template.mesh.vertices, spare])
    )
    with_spare = dataclasses.replace(template, mesh=mesh, modes=None)
    _, facts = population_of(with_spare, other_model(template), PopulationConfig())
    assert np.isfinite(facts["from_mesh_mm"])


def test_a_model_without_modes_is_refused(template: Template) -> None:
    bare = dataclasses.replace(template, modes=None)
    with pytest.raises(ProcessingError, match="no identity modes"):
        population_of(template, bare, PopulationConfig())


def test_the_command_keeps_a_population_that_is_there(run_command, tmp_path: Path) -> None:
    folder = tmp_path / "template"
    shutil.copytree(default_template_path(), folder)
    before = (folder / FILE).read_bytes()
    ended = run_command("processing", "template", "population", folder, "--to", folder)
    assert ended.code == 2
    assert "--overwrite" in ended.err
    assert (folder / FILE).read_bytes() == before


def test_our_template_has_people_of_known_source(template: Template) -> None:
    people = template.population
    assert people is not None
    assert people.licence == "CC0-1.0"
    assert "MakeHuman" in people.source
    assert people.identity_mm.shape == (20, len(template.mesh.vertices), 3)
    assert people.face_points is not None
    # In the template's head frame: the nose's tips of the two heads are near each other.
    tip = template.landmarks[30]
    assert np.linalg.norm(people.mean_mm[tip] - template.mesh.vertices[tip]) < 25


@settings(max_examples=20, deadline=None)
@given(
    scale=st.sampled_from([1e-6, 1e-3, 1.0, 1e3, 1e4]),
    modes=st.integers(0, 3),
    seed=st.integers(0, 99),
)
def test_what_is_written_is_read_again(
    tmp_path_factory: pytest.TempPathFactory, scale: float, modes: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    made = Population(
        scale * rng.normal(size=(7, 3)), scale * rng.normal(size=(modes, 7, 3)), "CC0", "a test"
    )
    folder = tmp_path_factory.mktemp("people")
    write_population(made, folder)
    read = read_population(folder, 7)
    assert read is not None
    assert np.allclose(read.mean_mm, made.mean_mm, rtol=1e-6)
    assert np.allclose(read.identity_mm, made.identity_mm, rtol=1e-3, atol=1e-7)
    assert (read.licence, read.source) == ("CC0", "a test")


def test_a_folder_without_a_population_has_none(tmp_path: Path) -> None:
    assert read_population(tmp_path, 7) is None


def test_points_of_another_mean_head_do_not_stay(template: Template, tmp_path: Path) -> None:
    save_template(template, tmp_path)
    assert (tmp_path / POINTS_FILE).is_file()
    again = load_template(tmp_path)
    assert again.population is not None
    assert again.population.face_points is not None
    write_population(dataclasses.replace(again.population, face_points=None), tmp_path)
    assert not (tmp_path / POINTS_FILE).exists()


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"mean_mm": np.zeros((6, 3))}, "mean_mm"),
        ({"mean_mm": np.full((7, 3), np.nan)}, "NaN"),
        ({"identity_mm": np.zeros((2, 7))}, "identity_mm"),
        ({"identity_mm": np.full((2, 7, 3), np.inf)}, "infinity"),
        ({"licence": None}, "licence"),
        ({}, "expected"),
    ],
)
def test_a_file_that_is_no_population_is_refused(
    tmp_path: Path, change: dict[str, object], named: str
) -> None:
    values: dict[str, object] = {
        "mean_mm": np.zeros((7, 3)), "identity_mm": np.zeros((2, 7, 3)),
        "licence": "", "source": "",
    }  # fmt: skip
    values |= change
    if change:
        kept = {name: np.asarray(value) for name, value in values.items() if value is not None}
        np.savez(tmp_path / FILE, **kept)
    else:
        (tmp_path / FILE).write_bytes(b"no archive")
    with pytest.raises(FormatError, match=named):
        read_population(tmp_path, 7)
