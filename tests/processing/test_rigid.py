import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from processing.errors import RegistrationError
from processing.registration.rigid import Similarity, robust_umeyama, umeyama


def points(rng, count=20):
    return rng.normal(size=(count, 3)) * [30, 50, 40]


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    scale=st.floats(1e-3, 1e3),
    size=st.sampled_from([1e-6, 1e-3, 1.0, 1e3, 1e6]),
)
def test_similarity_of_any_size_is_recovered(seed, scale, size):
    rng = np.random.default_rng(seed)
    truth = Similarity(
        Rotation.random(random_state=seed).as_matrix(), size * rng.normal(size=3), scale
    )
    source = size * points(rng)
    found = umeyama(source, truth.apply(source), scale=True)
    assert np.allclose(found.rotation, truth.rotation, atol=1e-9)
    assert found.scale == pytest.approx(scale, rel=1e-9)
    assert np.allclose(found.apply(source), truth.apply(source), atol=1e-8 * size * scale * 100)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_scale_stays_one_by_default_and_noise_averages_out(seed):
    rng = np.random.default_rng(seed)
    truth = Similarity(Rotation.random(random_state=seed).as_matrix(), rng.normal(size=3) * 100)
    source = points(rng, 400)
    found = umeyama(source, truth.apply(source) + rng.normal(size=source.shape))
    assert found.scale == 1.0
    assert np.linalg.norm(found.apply(source) - truth.apply(source), axis=1).mean() < 0.4


def test_a_mirror_image_never_becomes_a_rotation():
    source = points(np.random.default_rng(0))
    mirrored = source * [-1, 1, 1]
    assert np.linalg.det(umeyama(source, mirrored).rotation) == pytest.approx(1)
    reflected = umeyama(source, mirrored, reflect=True)
    assert np.linalg.det(reflected.rotation) == pytest.approx(-1)
    assert np.allclose(reflected.apply(source), mirrored)


def test_points_in_a_plane_have_one_rotation():
    rng = np.random.default_rng(1)
    source = points(rng) * [1, 1, 0]
    truth = Similarity(Rotation.random(random_state=1).as_matrix(), np.array([1.0, 2, 3]))
    assert np.allclose(umeyama(source, truth.apply(source)).rotation, truth.rotation)


def test_weights_of_zero_leave_pairs_out():
    rng = np.random.default_rng(2)
    source = points(rng)
    target = source + np.array([5.0, 0, 0])
    target[3] += 1000
    weights = np.ones(len(source))
    weights[3] = 0
    assert np.allclose(umeyama(source, target, weights).translation, [5, 0, 0])


@pytest.mark.parametrize(
    "source",
    [
        np.zeros((5, 3)),
        np.outer(np.arange(5.0), [1, 2, 3]),
        np.eye(3)[:2],
        np.full((5, 3), np.nan),
    ],
    ids=["one place", "one line", "two points", "nan"],
)
def test_undetermined_alignments_are_refused(source):
    with pytest.raises(RegistrationError):
        umeyama(source, source)


def test_a_third_of_wrong_pairs_does_not_move_the_robust_alignment():
    for seed in range(5):
        rng = np.random.default_rng(seed)
        source = points(rng, 60)
        truth = Similarity(Rotation.random(random_state=seed).as_matrix(), rng.normal(size=3) * 50)
        target = truth.apply(source) + 0.1 * rng.normal(size=source.shape)
        target[:20] += rng.normal(size=(20, 3)) * 80
        found, residual = robust_umeyama(source, target)
        assert np.abs(found.apply(source) - truth.apply(source)).max() < 0.3
        assert np.median(residual[:20]) > 20 * np.median(residual[20:])


def test_inverse_and_matrix_agree_with_apply():
    some = Similarity(Rotation.random(random_state=3).as_matrix(), np.array([1.0, 2, 3]), 1.7)
    p = points(np.random.default_rng(3))
    assert np.allclose(some.inverse().apply(some.apply(p)), p)
    homogeneous = np.concatenate([p, np.ones((len(p), 1))], axis=1)
    assert np.allclose(homogeneous @ some.matrix().T, some.apply(p))
