"""Refinement through the renderer: people not trained on, marks, edges of shadows."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from learning.checkpoint import load_whole_face, shipped_weights
from learning.errors import MapsError
from learning.infer import Inferred
from learning.maps import load_head
from learning.relight import lit_texture, shadows_of
from learning.whole import refine
from learning.whole.infer import infer_whole_face
from lightstage.formats.environment import LightSet
from lightstage.formats.mesh import Mesh, read_mesh
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.template import default_template_path, load_template
from processing.colour import srgb_from_linear

LAMP = LightSet(
    "one hard lamp", np.array([[800.0, 500.0, 700.0]]), np.full((1, 3), 1.0), np.full(3, 0.05)
)
CAMERA_MM = np.array([0.0, 0.0, 1100.0])


@pytest.fixture(scope="module")
def people(strangers: list[Path]) -> list[ProcessedFolder]:
    return [ProcessedFolder(folder) for folder in strangers[:2]]


@functools.cache
def photographed(person: ProcessedFolder) -> tuple[Mesh, np.ndarray, np.ndarray, np.ndarray]:
    """A person's mesh, texture under the lamp, true albedo and skin: made once."""
    mesh = read_mesh(person.registered_mesh)
    head = load_head(person.root / "atlas", mesh, load_template(default_template_path()))
    texture = lit_texture(head, LAMP, CAMERA_MM, seen=shadows_of(head, LAMP))
    true = person.read_atlas("diffuse_albedo")
    return mesh, texture, true, person.read_atlas("confidence") > 0


@functools.cache
def refined(person: ProcessedFolder) -> Inferred:
    """What refinement makes of that texture."""
    mesh, texture, *_ = photographed(person)
    network, _ = load_whole_face(shipped_weights())
    return infer_whole_face(network, texture, mesh, refine_seconds=600)


def psnr_db(found: np.ndarray, true: np.ndarray, skin: np.ndarray, gain: bool) -> float:
    if gain:
        found = found * (found * true)[skin].sum(axis=0) / (found**2)[skin].sum(axis=0)
    error = srgb_from_linear(np.minimum(found, 1)) - srgb_from_linear(true)
    return float(-10 * np.log10((error[skin] ** 2).mean()))


def test_refinement_takes_a_hard_lamps_shadows_out_and_finds_the_lamp(
    people: list[ProcessedFolder],
) -> None:
    network, _ = load_whole_face(shipped_weights())
    gains, raws = [], []
    for person in people:
        mesh, texture, true, skin = photographed(person)
        alone = infer_whole_face(network, texture, mesh)
        plain = alone.maps["diffuse_albedo"]
        found = refined(person)
        both = (found.maps["diffuse_albedo"], plain)
        gains.append(np.subtract(*(psnr_db(x, true, skin, True) for x in both)))
        raws.append(np.subtract(*(psnr_db(x, true, skin, False) for x in both)))
        # What is least sure is farthest from the truth.
        trust = found.maps["confidence"][skin]
        errors = np.abs(srgb_from_linear(found.maps["diffuse_albedo"]) - srgb_from_linear(true))
        order = np.argsort(trust)
        third = len(order) // 3
        error = errors[skin].mean(axis=1)
        assert error[order[:third]].mean() > 1.2 * error[order[-third:]].mean()
        assert found.light is not None
        strongest = found.light.position_mm[found.light.rgb.sum(axis=1).argmax()]
        cosine = strongest @ LAMP.position_mm[0] / np.linalg.norm(strongest)
        assert cosine / np.linalg.norm(LAMP.position_mm[0]) > np.cos(np.radians(15))
    # The network alone has 31 to 33 dB after the best gain.
    assert np.mean(gains) > 2
    assert np.mean(raws) > 0


def test_a_head_that_is_moved_gives_the_same_albedo_and_its_light_moves_with_it(
    people: list[ProcessedFolder],
) -> None:
    network, _ = load_whole_face(shipped_weights())
    mesh, texture, _, skin = photographed(people[0])
    turn = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    moved = dataclasses.replace(mesh, vertices=mesh.vertices @ turn.T + [300, -20, 50])

    here = refined(people[0])
    there = infer_whole_face(network, texture, moved, refine_seconds=600)
    difference = np.abs(here.maps["diffuse_albedo"] - there.maps["diffuse_albedo"])[skin]
    assert np.median(difference) < 2e-3
    assert here.light is not None
    assert there.light is not None
    place = here.light.position_mm[0] @ turn.T + [300, -20, 50]
    np.testing.assert_allclose(there.light.position_mm[0], place, atol=60)
    # Light of the same strength on the head, told at another origin.
    same = here.light.rgb[0] * (here.light.position_mm[0] ** 2).sum() / (place**2).sum()
    np.testing.assert_allclose(there.light.rgb[0], same, rtol=0.1)


def test_a_texture_upside_down_or_of_another_shape_is_refused_and_an_encoded_one_is_reported(
    people: list[ProcessedFolder],
) -> None:
    network, _ = load_whole_face(shipped_weights())
    for person in people:
        mesh, texture, _, _ = photographed(person)
        with pytest.raises(MapsError, match="upside down"):
            infer_whole_face(network, np.ascontiguousarray(texture[::-1]), mesh)
        # Whoever states what the network sees has made the texture, and knows its rows.
        turned = np.ascontiguousarray(texture[::-1])
        sees = np.ones(turned.shape[:2], bool)
        assert np.isfinite(
            infer_whole_face(network, turned, mesh, network_sees=sees).maps["diffuse_albedo"]
        ).all()
        with pytest.raises(MapsError, match="rows : columns = 96 : 64"):
            infer_whole_face(network, texture[:128], mesh)
    assert infer_whole_face(network, texture, mesh).notes == ()
    encoded = (np.round(255 * srgb_from_linear(np.clip(texture, 0, 1))) / 255).astype(np.float32)
    notes = infer_whole_face(network, encoded, mesh).notes
    assert any("8-bit sRGB" in note for note in notes)


def test_too_little_time_is_reported_as_such_and_keeps_the_networks_answer(
    people: list[ProcessedFolder],
) -> None:
    network, _ = load_whole_face(shipped_weights())
    mesh, texture, _, _ = photographed(people[0])
    found = infer_whole_face(network, texture, mesh, refine_seconds=1e-3)
    assert "too few" in found.notes[-1]
    assert "no light" not in found.notes[-1]
    plain = infer_whole_face(network, texture, mesh)
    np.testing.assert_array_equal(found.maps["diffuse_albedo"], plain.maps["diffuse_albedo"])


def test_a_search_that_the_clock_ended_is_reported(
    people: list[ProcessedFolder], monkeypatch: pytest.MonkeyPatch
) -> None:
    network, _ = load_whole_face(shipped_weights())
    mesh, texture, _, _ = photographed(people[0])
    began = time.monotonic()
    clock = itertools.chain([began], itertools.repeat(began + 1e9))
    monkeypatch.setattr(refine, "time", SimpleNamespace(monotonic=lambda: next(clock)))
    found = infer_whole_face(network, texture, mesh, refine_seconds=600)
    assert found.light is not None
    assert "was ended after 600 s" in found.notes[-1]


def test_where_no_light_explains_a_texture_the_networks_answer_stays_and_is_reported(
    people: list[ProcessedFolder], monkeypatch: pytest.MonkeyPatch
) -> None:
    # More rounds move the skin by another thousandth each.
    monkeypatch.setattr(refine, "ROUNDS", 2)
    network, _ = load_whole_face(shipped_weights())
    mesh, _, true, _ = photographed(people[0])
    stripes = (np.arange(192) // 8 % 2)[:, None, None] * 0.9 + 0.05
    texture = (stripes * np.ones_like(true)).astype(np.float32)
    found = infer_whole_face(network, texture, mesh, refine_seconds=600)
    assert found.light is None
    assert "no light explains it" in found.notes[-1]
    plain = infer_whole_face(network, texture, mesh)
    np.testing.assert_array_equal(found.maps["diffuse_albedo"], plain.maps["diffuse_albedo"])


def test_a_mark_is_skin_and_a_slope_over_the_face_is_light() -> None:
    rows, columns = np.mgrid[0:96, 0:64]
    mark = np.exp(-((rows - 40) ** 2 + (columns - 30) ** 2) / 18)[..., None] * np.ones(3)
    slope = (rows / 96.0)[..., None] * np.ones(3)
    known = np.ones((96, 64), bool)
    assert refine._marks(mark, known)[40, 30, 0] > 0.85
    assert np.abs(refine._marks(slope, known)[24:-24]).max() < 0.1
    nothing = refine._marks(slope, np.zeros((96, 64), bool))
    assert not nothing.any()


def test_shares_of_nothing_leave_the_skins_that_people_have() -> None:
    rng = np.random.default_rng(3)
    unlit = 0.3 * np.exp(0.3 * rng.standard_normal((48, 32, 3))).clip(0.2, 3)
    found = refine.with_shares(unlit, grey(unlit), refine.OwnShares(0.0, 0.0))
    np.testing.assert_allclose(found, 0.3, rtol=1e-6)
    # With all of its detail the texture differs by what is coarse alone.
    all_detail = refine.with_shares(unlit, grey(unlit), refine.OwnShares(0.0, 1.0))
    assert np.log(all_detail / unlit).std() < 0.5 * np.log(unlit / 0.3).std()


def grey(unlit: np.ndarray, trust: float | np.ndarray = 1.0) -> refine.TakenOut:
    """A texture over its light, whose skin is expected to be even."""
    everywhere, nothing = np.ones(unlit.shape[:2], bool), np.zeros(0)
    share = np.broadcast_to(np.float32(trust), everywhere.shape)
    low = np.full((12, 8, 3), 0.3)
    lit = (everywhere, everywhere, share, everywhere)
    return refine.TakenOut(unlit, unlit, *lit, np.ones_like(unlit), low, nothing, nothing, False)


def test_what_is_not_trusted_is_left_to_the_skins_that_people_have() -> None:
    rng = np.random.default_rng(4)
    unlit = 0.3 * np.exp(0.3 * rng.standard_normal((48, 32, 3))).clip(0.2, 3)
    trust = np.zeros((48, 32), np.float32)
    trust[:, :16] = 1

    def beside(trust: np.ndarray | float) -> np.ndarray:
        found = refine.with_shares(unlit, grey(unlit, trust), refine.OwnShares(0.5, 1.0))
        return np.asarray(np.log(found / 0.3))

    assert np.abs(beside(0.0)).max() < 1e-6
    assert beside(trust)[:, 20:].std() < 0.1 * beside(1.0)[:, 20:].std()
    np.testing.assert_allclose(beside(trust)[:, :12], beside(1.0)[:, :12], atol=0.05)
