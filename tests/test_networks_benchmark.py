"""What `benchmarks.networks` measures with: its lights, guesses, flaws and figures."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from benchmarks.networks_flaws import FLAWS
from benchmarks.networks_guesses import Neighbours, Texture, harmonic_division, without_network
from benchmarks.networks_lights import (
    GROUPS,
    LEAST_COSINE,
    LitPoints,
    Points,
    light_of,
    starts,
    views,
    with_dome,
)
from benchmarks.networks_people import KINDS, chosen, on_texels
from benchmarks.networks_scores import (
    albedo_score,
    correlation,
    db,
    deciles,
    specular_share,
    specular_sums,
)
from learning.networks.whole_face import IN_CHANNELS, WholeFaceConfig, WholeFaceNetwork
from lightstage.formats.environment import LightSet
from lightstage.formats.mesh import Mesh
from sim.light.scene import Scene
from sim.people.subject import Subject
from sim.scans.ict import ict_folder

SIDE = 24


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(5)


def sphere_normals() -> tuple[np.ndarray, np.ndarray]:
    """(SIDE, SIDE, 3) normals of a ball seen from in front, and where it is."""
    across = (np.arange(SIDE) + 0.5) / SIDE * 2 - 1
    x, y = np.meshgrid(across, across)
    shown = x**2 + y**2 < 1
    z = np.sqrt(np.maximum(1 - x**2 - y**2, 0))
    return np.stack([x, y, z], axis=-1) * shown[..., None], shown


def square(albedo: float) -> tuple[Scene, Points]:
    """A matt square of 20 mm at the origin that faces +z, and four places on it."""
    corners = np.array([[-10.0, -10, 0], [10, -10, 0], [10, 10, 0], [-10, 10, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    one = np.full((96, 64), 1.0, np.float32)
    subject = Subject(
        name="square",
        expression="neutral",
        mesh=Mesh(corners, faces, corners[:, :2] / 20 + 0.5, faces),
        diffuse_albedo=np.repeat(one[..., None], 3, axis=2) * albedo,
        specular_albedo=0 * one,
        roughness=0.25 * one,
        normal=np.broadcast_to([0.0, 0, 1], (96, 64, 3)).astype(np.float32),
        translucency=one,
        landmarks_mm=np.zeros((68, 3)),
        skin=one > 0,
        head_from_world=np.eye(3, 4),
        source="test",
    )
    scene = Scene(subject)
    face = np.array([0, 0, 1, 1])
    weights = np.array([[0.3, 0.4, 0.3], [0.5, 0.25, 0.25], [0.3, 0.4, 0.3], [0.5, 0.25, 0.25]])
    place = np.einsum("nck,nc->nk", scene.vertices[scene.triangles[face]], weights)
    up = np.tile([0.0, 0, 1], (4, 1))
    points = Points(
        place,
        starts(scene, face, weights),
        up,
        up,
        np.full((4, 3), albedo),
        np.zeros(4),
        np.full(4, 0.25),
        "beckmann",
    )
    return scene, points


def test_a_white_surface_reads_one_in_white_light_from_everywhere() -> None:
    scene, points = square(1.0)
    around = LightSet("around", np.zeros((0, 3)), np.zeros((0, 3)), np.ones(3))
    seen = LitPoints(scene, points).under(around)
    # 64 lamps stand for all directions, and the interface sends back a little toward the grazing.
    np.testing.assert_allclose(seen, 1.0, atol=0.06)


def test_ambient_light_is_the_same_as_lamps_all_round() -> None:
    scene, points = square(0.5)
    light = light_of("front", 0)
    lit = LitPoints(scene, points)
    both = with_dome(light)
    np.testing.assert_allclose(lit.under(light), lit.relit(both, points), rtol=1e-4)


def test_a_lamp_behind_a_surface_gives_it_nothing() -> None:
    scene, points = square(1.0)
    behind = LightSet("back", np.array([[0.0, 0, -900]]), np.ones((1, 3)), np.zeros(3))
    assert not LitPoints(scene, points).under(behind).any()


def test_some_of_the_places_are_lit_as_they_are_among_all() -> None:
    scene, points = square(0.7)
    lit = LitPoints(scene, points)
    light = light_of("warm-cool", 0)
    some = np.array([True, False, True, False])
    np.testing.assert_array_equal(lit.under(light)[some], lit.kept(some).under(light))


def test_there_are_ten_lights_of_which_three_are_hard_two_behind_and_two_coloured() -> None:
    assert len(GROUPS) == 10
    groups = list(GROUPS.values())
    assert [groups.count(name) for name in ("hard", "behind", "coloured")] == [3, 2, 2]
    for name, group in GROUPS.items():
        light = light_of(name, 3)
        assert (light.rgb >= 0).all()
        assert light.rgb.any()
        if group == "hard":
            assert len(light.rgb) == 1
        if group == "coloured":
            assert np.ptp(light.rgb, axis=1).min() > 0.1


def test_random_light_differs_from_head_to_head_and_is_the_same_for_one() -> None:
    one, again, other = (light_of("random", seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.position_mm, again.position_mm)
    assert one.position_mm.shape != other.position_mm.shape or not np.array_equal(
        one.position_mm, other.position_mm
    )


def test_what_turns_away_is_seen_at_the_least_cosine(rng: np.random.Generator) -> None:
    normal = rng.normal(size=(200, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    view = views(60 * normal, normal)
    np.testing.assert_allclose(np.linalg.norm(view, axis=1), 1, atol=1e-5)
    assert (view * normal).sum(axis=1).min() > LEAST_COSINE - 1e-5


def test_harmonic_division_undoes_light_of_the_second_order() -> None:
    normal, shown = sphere_normals()
    mean = np.full((SIDE, SIDE, 3), 0.4)
    x, y, z = np.moveaxis(normal, 2, 0)
    light = (0.6 + 0.2 * x + 0.1 * y * z + 0.1 * (x * x - y * y))[..., None] * [1.0, 0.8, 0.5]
    found = harmonic_division(mean * light, mean, normal, shown)
    np.testing.assert_allclose(found[shown], 0.4, atol=1e-5)


def test_regression_on_neighbours_finds_a_law_that_its_features_have(
    rng: np.random.Generator,
) -> None:
    normal, shown = sphere_normals()
    fitted = Neighbours()

    def drawn() -> tuple[Texture, np.ndarray]:
        albedo = np.exp(rng.normal(-1, 0.3, (SIDE, SIDE, 3)))
        light = np.exp(0.4 * normal[..., :1] - 0.2 * normal[..., 1:2])
        return Texture(albedo * light, normal, 80 * normal, shown), albedo

    for _ in range(20):
        fitted.add(*drawn(), shown, rng)
    texture, albedo = drawn()
    found = fitted.find(texture)
    assert np.abs(np.log(found[shown] / albedo[shown])).mean() < 0.03
    assert not found[~shown].any()


def test_without_the_network_the_mean_person_is_the_answer_and_the_network_stays_as_it_was() -> (
    None
):
    torch.manual_seed(0)
    network = WholeFaceNetwork(WholeFaceConfig(16, 16, width=2, halvings=1, modes=2)).eval()
    torch.nn.init.normal_(network.here.weight)
    network.mean_log_albedo.fill_(-1.0)
    inputs = torch.rand(1, IN_CHANNELS, 16, 16)
    before = network(inputs).diffuse_albedo
    mean = without_network(network)(inputs).diffuse_albedo
    assert torch.allclose(mean, torch.full_like(mean, float(np.exp(-1))))
    assert torch.equal(network(inputs).diffuse_albedo, before)
    assert not torch.allclose(before, mean)


@pytest.mark.parametrize("name", list(FLAWS))
def test_flaws_keep_black_what_shows_nothing(name: str, rng: np.random.Generator) -> None:
    normal, shown = sphere_normals()
    texture = rng.uniform(0.2, 0.6, (SIDE, SIDE, 3)) * shown[..., None]
    found = FLAWS[name](texture, shown, normal)
    assert found.shape == texture.shape
    assert not found[~shown].any()
    assert np.isfinite(found).all()
    assert (name == "none") == np.array_equal(found, texture)


def test_one_side_leaves_the_other_black() -> None:
    normal, shown = sphere_normals()
    found = FLAWS["one side only"](np.ones((SIDE, SIDE, 3)) * shown[..., None], shown, normal)
    assert not found[:, : SIDE // 5].any()
    assert found[SIDE // 2, SIDE - SIDE // 5].all()


def test_the_gain_takes_away_a_wrong_tone_alone(rng: np.random.Generator) -> None:
    true = rng.uniform(0.1, 0.6, (96, 64, 3))
    skin = np.ones((96, 64), bool)
    scored = albedo_score(true * [0.5, 0.7, 0.9], true, skin)
    assert scored.gain < 1e-10 < scored.raw
    assert correlation([albedo_score(true, true, skin).detail]) == pytest.approx(1)


def test_the_best_constant_has_a_share_of_one_and_the_truth_none(rng: np.random.Generator) -> None:
    true = rng.uniform(0.02, 0.04, 500)
    assert specular_share([specular_sums(np.full(500, true.mean()), true)]) == pytest.approx(1)
    assert specular_share([specular_sums(true, true)]) == 0


def test_deciles_are_in_order_of_confidence(rng: np.random.Generator) -> None:
    trust = rng.permutation(1000) / 1000
    found = deciles(np.stack([trust, 1 - trust], axis=1))
    assert found == sorted(found, reverse=True)
    assert len(found) == 10
    assert db([0.01]) == pytest.approx(20)


def test_simulated_people_are_of_all_tones_in_equal_shares() -> None:
    heads = chosen(["simulated"], 12, unseen=False)
    assert sorted(head.tone or 0 for head in heads) == sorted(2 * [1, 2, 3, 4, 5, 6])
    assert "simulated" in KINDS


def test_people_of_ict_that_are_kept_apart_are_none_of_the_others() -> None:
    if ict_folder() is None:
        pytest.skip("no ICT Face Model Light")
    seen, apart = (
        {head.person.seed for head in chosen(["ict"], count, unseen) if head.person}
        for count, unseen in ((12, False), (3, True))
    )
    assert len(seen) == 12
    assert len(apart) == 3
    assert not seen & apart


def test_a_folder_without_heads_is_refused_by_name(tmp_path: object) -> None:
    with pytest.raises(SystemExit, match="no processed folder"):
        chosen([str(tmp_path)], 1, unseen=False)


def test_values_come_to_the_texels_of_a_mask() -> None:
    shown = np.array([[True, False], [False, True]])
    assert on_texels(np.array([1.0, 2.0]), shown).tolist() == [[1, 0], [0, 2]]
