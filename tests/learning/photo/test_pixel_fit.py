"""A shape from pixels: normals and slopes, what is skipped, what it gains, bad photographs."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from learning.checkpoint import load_whole_face, shipped_weights
from learning.networks.whole_face import WholeFaceNetwork
from learning.photo.config import FitConfig
from learning.photo.face_light import Lit, irradiance
from learning.photo.face_places import turned_normals
from learning.photo.landmark_fit import Problem, Sighting, camera_of
from learning.photo.model import ShapeModel, shape_model
from learning.photo.outline import outline
from learning.photo.picture import read_photograph
from learning.photo.pixel_fit import Picture, PixelFit, State, skin, visible
from learning.photo.shape_fit import Photograph, Places, Shape, fit_shape
from lightstage.formats.mesh import Mesh, vertex_normals
from lightstage.formats.template import Template
from tests.learning.photo.scene import FOCAL_PX, HEIGHT_PX, SMALL, WIDTH_PX, Shot, camera_at

FACE_MM = 80.0


@pytest.fixture(scope="module")
def network() -> WholeFaceNetwork:
    return load_whole_face(shipped_weights())[0]


def photograph(shot: Shot, seed: int = 0, percent: float = 3.0) -> Photograph:
    """A person's photograph, its landmarks moved together and each on its own."""
    rng = np.random.default_rng(seed)
    rgb = read_photograph(shot.path).rgb_linear
    known = np.isfinite(shot.landmarks_px).all(axis=1)
    size = percent / 100 * 2 * np.prod(shot.landmarks_px[known].std(axis=0)) ** 0.5
    moved = shot.landmarks_px + size * rng.normal(size=shot.landmarks_px.shape)
    return Photograph("photo", rgb, moved, FOCAL_PX)


@pytest.fixture(scope="module")
def search(
    shot: Shot, template: Template, model: ShapeModel, places: Places, network: WholeFaceNetwork
) -> tuple[PixelFit, State]:
    """A search after its first look at a photograph."""
    rgb = read_photograph(shot.path).rgb_linear
    there = model.at(places.triangles, places.weights)
    problem = Problem(
        there, [Sighting(shot.landmarks_px, WIDTH_PX, HEIGHT_PX, FOCAL_PX)], FitConfig()
    )
    at, _ = problem.solved()
    fit = PixelFit(problem, model, template, network, [rgb], FitConfig())
    return fit, fit.seen_anew(State(at, np.zeros(fit.places.albedo.shape[1]), ()), 2.0)


def plain_normal(shape: np.ndarray, corners: np.ndarray, of: list[int]) -> np.ndarray:
    """The unit sum of triangles' cross products."""
    total = np.zeros(3)
    for a, b, c in corners[of]:
        total += np.cross(shape[b] - shape[a], shape[c] - shape[a])
    return total / np.linalg.norm(total)


def test_normals_and_their_slopes_are_those_of_a_plain_twin() -> None:
    rng = np.random.default_rng(1)
    shape, modes = rng.normal(size=(6, 3)), rng.normal(size=(6, 3, 4))
    corners = np.array([[0, 1, 2], [0, 2, 3], [3, 4, 5], [1, 4, 0]])
    touching, first = np.array([0, 1, 3, 2, 1]), np.array([0, 3, 5])
    normals, slopes = turned_normals(shape, modes, corners, first, touching)
    for place, of in enumerate(([0, 1, 3], [2, 1])):
        np.testing.assert_allclose(normals[place], plain_normal(shape, corners, of), atol=1e-12)
        for k in range(4):
            step = 1e-6 * modes[..., k]
            slope = (
                plain_normal(shape + step, corners, of) - plain_normal(shape - step, corners, of)
            ) / 2e-6
            np.testing.assert_allclose(slopes[place, :, k], slope, atol=1e-6)


values = st.one_of(
    st.sampled_from([0.0, -1.0, np.nan, np.inf, -np.inf, 1e-30, 1e30, -1e150]),
    st.floats(-100, 100),
)


@settings(max_examples=60, deadline=None)
@given(arrays(float, (4, 3), elements=values))
def test_normals_of_any_triangles_are_unit_or_none(shape: np.ndarray) -> None:
    corners = np.array([[0, 1, 2], [0, 2, 3]])
    modes = np.ones((4, 3, 2))
    modes[1:] = 0.5
    normals, slopes = turned_normals(shape, modes, corners, np.array([0, 2]), np.array([0, 1]))
    length = float(np.linalg.norm(normals[0]))
    assert length == 0 or length == pytest.approx(1)
    assert np.isfinite(slopes).all()
    if length == 0:
        assert not slopes.any()


def test_irradiance_turns_with_the_normal_as_differences_say() -> None:
    rng = np.random.default_rng(2)
    normal = rng.normal(size=(20, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    position, lamps = 50 * rng.normal(size=(20, 3)), np.array([[500.0, 400, 900], [-900, 0, 300]])
    lit = Lit(lamps, rng.random((2, 20)), rng.random(20), np.ones(3), np.zeros(20), np.ones(20))
    each, slopes = irradiance(position, normal, lit)
    assert each.shape == (20, 11)
    for axis in np.eye(3):
        ahead, behind = (irradiance(position, normal + s * 1e-6 * axis, lit)[0] for s in (1, -1))
        slope = (ahead - behind) / 2e-6
        lit_well = each[:, :2].min(axis=1) > 1e-3
        np.testing.assert_allclose((slopes @ axis)[lit_well], slope[lit_well], atol=1e-5)


def test_slopes_of_pixels_and_outlines_are_those_of_differences(
    search: tuple[PixelFit, State],
) -> None:
    fit, state = search
    view = fit.views[0]
    size = fit.problem.size
    rng = np.random.default_rng(3)
    total = size + len(state.albedo) + len(state.light[0])
    step = 5e-5 * rng.normal(size=total)
    step[size + len(state.albedo) :] *= 0.01

    def off(at: State) -> tuple[np.ndarray, np.ndarray]:
        pixels = fit.pixel_term(at, 0, view.picture, view.places, view.lit)
        return pixels[0], fit.rim_term(at, 0, view.rims)[0]

    (ahead, ahead_rim), (behind, behind_rim) = (off(state.moved(s * step, size)) for s in (1, -1))
    _, slopes, _ = fit.pixel_term(state, 0, view.picture, view.places, view.lit)
    # The photograph's slope is that of a smoother picture than bilinear sampling has.
    change, expected = (ahead - behind) / 2, slopes @ step
    assert np.corrcoef(change, expected)[0, 1] > 0.97
    assert np.median(np.abs(change - expected)) < 0.15 * np.abs(expected).mean()
    rims, slopes_rim, _ = fit.rim_term(state, 0, view.rims)
    assert len(rims) > 20
    np.testing.assert_allclose((ahead_rim - behind_rim) / 2, slopes_rim @ step, atol=2e-4)


def test_places_that_do_not_count_are_skipped_and_change_nothing(
    search: tuple[PixelFit, State],
) -> None:
    fit, state = search
    view = fit.views[0]
    short = fit.equations(state)
    weight = np.zeros(len(fit.places.vertices))
    shown = np.isin(fit.places.vertices, view.places.vertices)
    assert 0.05 < shown.mean() < 0.95
    weight[shown] = view.lit.weight
    lamps = len(view.lit.lamps_mm)

    def spread(values: np.ndarray, other: float) -> np.ndarray:
        out = np.full((*values.shape[:-1], len(shown)), other)
        out[..., shown] = values
        return out

    lit = Lit(
        view.lit.lamps_mm,
        spread(view.lit.seen, 0.3).reshape(lamps, -1),
        spread(view.lit.openness, 0.4),
        view.lit.strength,
        spread(view.lit.shine, 0.1),
        weight,
    )
    before = fit.views
    fit.views = [dataclasses.replace(view, places=fit.places, lit=lit)]
    whole = fit.equations(state)
    fit.views = before
    for one, other in zip(short, whole, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-7 * np.abs(other).max())


def test_a_lamp_without_strength_changes_nothing(search: tuple[PixelFit, State]) -> None:
    fit, state = search
    view = fit.views[0]
    off, slopes, _ = fit.pixel_term(state, 0, view.picture, view.places, view.lit)
    dark = np.array([[-700.0, 200.0, 800.0]])
    more = dataclasses.replace(
        view.lit,
        lamps_mm=np.concatenate([dark, view.lit.lamps_mm]),
        seen=np.concatenate([np.ones((1, len(view.lit.openness))), view.lit.seen]),
    )
    brighter = dataclasses.replace(state, light=(np.r_[0.0, state.light[0]],))
    other, wider, _ = fit.pixel_term(brighter, 0, view.picture, view.places, more)
    np.testing.assert_allclose(other, off, atol=1e-12)
    without = np.delete(wider, fit.problem.size + len(state.albedo), axis=1)
    np.testing.assert_allclose(without, slopes, atol=1e-9)


def off_mm(found: np.ndarray, true: Mesh, template: Template) -> float:
    """Distance along the true normals after the best similarity, mean over the face."""
    mean = template.mesh.vertices
    near = np.linalg.norm(mean - mean[template.landmarks[30]], axis=1) < FACE_MM
    normals = vertex_normals(true.vertices, true.triangles())
    face = near & (vertex_normals(mean, true.triangles())[:, 2] > 0.3)
    one, two = found[face], true.vertices[face]
    one, two = one - one.mean(axis=0), two - two.mean(axis=0)
    left, size, right = np.linalg.svd(two.T @ one)
    off = size.sum() / (one**2).sum() * one @ (left @ right).T - two
    return float(np.abs((off * normals[face]).sum(axis=1)).mean())


def shape_of(
    photo: Photograph,
    template: Template,
    places: Places,
    network: WholeFaceNetwork,
    config: FitConfig,
    model: ShapeModel,
) -> Shape:
    return fit_shape([photo], template, places, config, model, network)


def test_pixels_bring_a_person_outside_the_modes_nearer(
    shot: Shot, template: Template, places: Places, network: WholeFaceNetwork
) -> None:
    # Without the template's modes the person is none that the model was made of.
    config = FitConfig(identity_modes=0, pixel_rounds=2)
    model, photo = shape_model(template, config), photograph(shot)
    alone, found = (
        shape_of(photo, template, places, network, how, model)
        for how in (dataclasses.replace(config, pixel_rounds=0), config)
    )
    before, after = (
        off_mm(shape.meshes[0].vertices, shot.mesh, template) for shape in (alone, found)
    )
    assert after < 0.9 * before
    # What the pixels tell makes the answer more certain.
    face = found.model.face
    assert found.deviation_mm[face].mean() < 0.9 * alone.deviation_mm[face].mean()


def test_foreheads_that_hair_may_hide_and_lips_before_teeth_are_not_compared(
    search: tuple[PixelFit, State], template: Template
) -> None:
    places, vertices = search[0].places, template.mesh.vertices
    brows = vertices[template.landmarks[17:27], 1]
    assert len(places.vertices) > 1000
    assert vertices[places.vertices, 1].max() < brows.min()
    assert not np.isin(places.vertices, template.regions["lips"]).any()
    assert vertices[places.rim, 1].max() < brows.min()


def test_a_hand_before_the_cheek_loses_its_weight(search: tuple[PixelFit, State]) -> None:
    fit, _ = search
    mean = fit.places.model.mean
    hand = np.linalg.norm(mean - mean[mean[:, 0].argmax()], axis=1) < 25
    assert 10 < hand.sum() < 0.3 * len(hand)
    rng = np.random.default_rng(4)
    off = np.where(hand, 6.0, rng.normal(size=len(hand)))
    found = skin(fit.places, off, np.ones(len(hand)))
    assert found[hand].mean() < 0.3
    assert np.median(found[~hand]) > 0.9
    nothing = skin(fit.places, off, np.zeros(len(hand)))
    assert np.isfinite(nothing).all()


@pytest.mark.parametrize("value", [0.0, 0.2, 1.0, np.nan, np.inf])
def test_a_photograph_that_shows_nothing_leaves_the_landmarks_shape(
    value: float,
    shot: Shot,
    template: Template,
    places: Places,
    network: WholeFaceNetwork,
    small: ShapeModel,
) -> None:
    photo = photograph(shot)
    empty = dataclasses.replace(photo, rgb_linear=np.full_like(photo.rgb_linear, value))
    config = dataclasses.replace(SMALL, pixel_rounds=1)
    found = shape_of(empty, template, places, network, config, small)
    assert np.isfinite(found.meshes[0].vertices).all()
    assert np.isfinite(found.deviation_mm).all()
    alone = shape_of(empty, template, places, network, SMALL, small)
    moved = np.linalg.norm(found.meshes[0].vertices - alone.meshes[0].vertices, axis=1)
    assert moved[found.model.face].mean() < 0.01


def test_clipped_pixels_do_not_count_and_those_beside_do(
    search: tuple[PixelFit, State], shot: Shot, network: WholeFaceNetwork
) -> None:
    fit, state = search
    camera = camera_of(state.at, 0, WIDTH_PX, HEIGHT_PX, "0")
    vertices = fit.model.vertices(state.at.identity, state.at.expression[0])
    place_px = camera.project(vertices)[0]
    # Beside the nose, where all places are seen.
    middle = fit.places.vertices[np.argmax(vertices[fit.places.vertices, 2])]
    rgb = read_photograph(shot.path).rgb_linear.copy()
    rows, columns = np.indices(rgb.shape[:2])
    beside = np.hypot(columns - place_px[middle, 0], rows - place_px[middle, 1])
    # One clipped channel is enough.
    rgb[beside < 20, 0] = 1.0
    clipped = PixelFit(fit.problem, fit.model, fit.template, network, [rgb], fit.config)
    mesh = fit.template.mesh.with_vertices(vertices)
    weight = clipped._lit(mesh, camera, Picture(rgb, 1.0), 0).weight
    before = fit._lit(mesh, camera, Picture(fit.rgb[0], 1.0), 0).weight
    off = np.linalg.norm(place_px[fit.places.vertices] - place_px[middle], axis=1)
    assert (before[off < 15] > 0.1).sum() > 20
    assert (weight[off < 15] == 0).all()
    far = off > 30
    assert (weight[far] > 0.1).sum() > 0.9 * (before[far] > 0.1).sum() > 100


def test_outlines_lie_where_the_head_ends(template: Template) -> None:
    camera = camera_at(20.0)
    mesh = template.mesh
    pairs = outline(mesh, camera)
    assert len(pairs) > 100
    middle = mesh.vertices[pairs].mean(axis=1)
    normals = vertex_normals(mesh.vertices, mesh.triangles())
    toward = camera.centre_mm - middle
    cosine = (normals[pairs].mean(axis=1) * toward).sum(axis=1) / np.linalg.norm(toward, axis=1)
    assert np.abs(cosine).mean() < 0.2
    # The widest places of the head as the camera sees it are among them.
    place, _ = camera.project(mesh.vertices)
    seen = place[pairs].reshape(-1, 2)
    assert abs(seen[:, 0].min() - place[:, 0].min()) < 2
    assert abs(seen[:, 0].max() - place[:, 0].max()) < 2


def test_hidden_and_grazing_places_are_not_seen(template: Template) -> None:
    mesh, camera = template.mesh, camera_at(0.0)
    normals = vertex_normals(mesh.vertices, mesh.triangles())
    seen = visible(mesh, camera, mesh.vertices, normals)
    assert seen[template.landmarks[30]] == 1
    assert not seen[mesh.vertices[:, 2].argmin()]
    assert ((seen >= 0) & (seen <= 1)).all()
