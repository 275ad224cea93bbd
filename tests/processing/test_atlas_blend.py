import dataclasses

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter, map_coordinates

from lightstage.formats.mesh import vertex_normals
from processing.atlas.config import BlendConfig
from processing.atlas.sampling import SHARPNESS, low_band, room, side_by_side
from processing.atlas.visibility import depth_buffer, silhouette_distance
from processing.atlas.weights import Texels
from processing.rays import MeshRays, interpolate
from tests.processing.atlas_samples import blended, look, samples_of
from tests.processing.shapes import bumpy_ellipsoid, camera


def test_depth_buffer_agrees_with_rays_through_distortion():
    mesh = bumpy_ellipsoid()
    for cam in (camera("a", 30, 10), camera("b", -50, 0, dist=True)):
        found = depth_buffer(cam, mesh.vertices, mesh.triangles())
        hits = MeshRays(mesh.vertices, mesh.triangles()).cast_camera(cam)
        _, directions = cam.pixel_rays()
        along = directions.reshape(-1, 3) @ cam.cam_from_world[2, :3]
        truth = (hits.distance_mm * along).reshape(found.shape)
        both = np.isfinite(truth) & np.isfinite(found)
        assert (np.isfinite(truth) == np.isfinite(found)).mean() > 0.999
        inner = silhouette_distance(found, both, 15.0) > 1.5
        assert inner.sum() > 10_000
        error = np.abs(found[inner] - truth[inner])
        assert error.max() < 0.2
        assert np.median(error) < 2e-3


def test_what_is_behind_the_camera_is_not_drawn():
    mesh = bumpy_ellipsoid()
    behind = mesh.vertices + np.array([0, 0, 1500.0])
    assert np.isinf(depth_buffer(camera("a", 0), behind, mesh.triangles())).all()


def test_silhouette_distance_counts_from_jumps_holes_and_the_border():
    depth = np.full((40, 60), 1000, np.float32)
    depth[:, 30:] = 1050
    mask = np.ones(depth.shape, bool)
    mask[10, 10] = False
    found = silhouette_distance(depth, mask, 4.0)
    assert found[10, 10] == 0
    assert (found[:, 29:31] == 0).all()
    assert found[30, 15] == pytest.approx(10, abs=0.6)
    assert found[20, 45] == pytest.approx(15, abs=0.6)
    smooth = silhouette_distance(depth, mask, 100.0)
    assert smooth[20, 30] > 10


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    sigma=st.floats(0.5, 12),
    scale=st.sampled_from([1e-4, 1e-2, 1.0, 1e2, 6e4]),
)
def test_the_low_band_keeps_constants_and_never_reads_outside(seed, sigma, scale):
    rng = np.random.default_rng(seed)
    mask = rng.uniform(size=(24, 30)) > 0.5
    image = np.full((24, 30, 2), scale, np.float16)
    image[~mask] = [np.nan, -6e4]
    found = low_band(image.view(np.uint16), mask.view(np.uint8), sigma)
    read = found.counts > 1e-5
    assert read.any()
    assert np.allclose(found.sums[read] / found.counts[read, None], image[mask][0], rtol=1e-3)


@pytest.mark.parametrize("sigma", [3.0, 8.0, 17.0])
def test_the_low_band_is_the_gaussian_blur_of_the_whole_picture(sigma):
    rng = np.random.default_rng(0)
    image = rng.normal(size=(160, 200, 1)).astype(np.float16)
    found = low_band(image.view(np.uint16), np.ones((160, 200), np.uint8), sigma)
    blur = gaussian_filter(image[..., 0].astype(float), sigma, mode="constant")
    ones = gaussian_filter(np.ones((160, 200)), sigma, mode="constant")
    height, width = found.counts.shape
    rows = np.clip((np.arange(height) + 0.5) * found.step - 0.5, 0, 159)
    columns = np.clip((np.arange(width) + 0.5) * found.step - 0.5, 0, 199)
    at = np.stack(np.meshgrid(rows, columns, indexing="ij"))
    truth = map_coordinates(blur / ones, at, order=1)
    error = found.sums[..., 0] / found.counts - truth
    margin = int(sigma / found.step) + 1
    inner = (slice(margin, -margin), slice(margin, -margin))
    assert np.sqrt(np.mean(error[inner] ** 2)) < 0.1 * np.std(blur)


def spline(t):
    """Keys's weights of four taps as their polynomials' matrix gives them."""
    a = SHARPNESS
    matrix = np.array(
        [[0, a, -2 * a, a], [1, 0, -a - 3, a + 2], [0, -a, 2 * a + 3, -a - 2], [0, 0, a, -a]]
    )
    return matrix @ np.array([1, t, t**2, t**3])


def sampled(image, usable, x, y):
    """Plain float64 twin: a cubic over 16 usable taps, else bilinear over usable ones."""
    total, weight = 0.0, 0.0
    left, top = int(np.floor(x - 0.5)), int(np.floor(y - 0.5))
    if 1 <= left < image.shape[1] - 2 and 1 <= top < image.shape[0] - 2:
        window = (slice(top - 1, top + 3), slice(left - 1, left + 3))
        if usable[window].all():
            taps = image[window][..., 0]
            value = spline(y - 0.5 - top) @ taps @ spline(x - 0.5 - left)
            return float(np.clip(value, taps.min(), taps.max()))
    for row in (top, top + 1):
        for column in (left, left + 1):
            inside = 0 <= row < image.shape[0] and 0 <= column < image.shape[1]
            if inside and usable[row, column]:
                share = (1 - abs(x - 0.5 - column)) * (1 - abs(y - 0.5 - row))
                total += share * image[row, column, 0]
                weight += share
    return total / weight if weight >= 0.25 else 0.0


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_sampling_agrees_with_its_plain_twin(seed):
    rng = np.random.default_rng(seed)
    image = rng.normal(size=(20, 20, 1)).astype(np.float16)
    usable = rng.uniform(size=(20, 20)) > rng.choice([0.02, 0.3])
    image[~usable] = np.nan
    pixel = rng.uniform(-1, 21, size=(50, 2)).astype(np.float32)
    samples = samples_of(pixel, rng.uniform(0.1, 1, 50), usable=usable)
    found = blended(50, [(samples, image)])[:, 0]
    clean = np.where(usable[..., None], image, 0).astype(float)
    for value, (x, y) in zip(found, pixel, strict=True):
        assert value == pytest.approx(sampled(clean, usable, float(x), float(y)), abs=1e-4)


def test_a_pixel_centre_reads_exactly_that_pixel():
    image = np.arange(400, dtype=np.float16).reshape(20, 20, 1)
    found = blended(2, [(samples_of([[3.5, 7.5], [19.5, 19.5]], [1, 1]), image)])
    assert found[:, 0].tolist() == pytest.approx([7 * 20 + 3, 399], abs=1e-3)


def test_low_frequencies_are_averaged_and_detail_comes_from_the_best_view():
    rng = np.random.default_rng(0)
    detail = rng.normal(size=(20, 20, 1)).astype(np.float16)
    pixel = np.stack(np.meshgrid(np.arange(5, 15) + 0.5, np.arange(5, 15) + 0.5), -1).reshape(-1, 2)
    config = dataclasses.replace(BlendConfig(), band_mm=2.0)
    views = [
        (samples_of(pixel, np.full(len(pixel), 0.9)), 1.0 + detail),
        (samples_of(pixel, np.full(len(pixel), 0.3)), np.full((20, 20, 1), 2, np.float16)),
    ]
    found = blended(len(pixel), views, config=config)[:, 0]
    inside = detail[5:15, 5:15, 0].ravel()
    assert found.mean() == pytest.approx(0.75 * (1 + inside.mean()) + 0.25 * 2, abs=0.1)
    # The weights' ratio is 3, so the fine band takes 81 / 82 of the first view.
    assert np.std(found) > 0.9 * np.std(inside)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    kind=st.sampled_from(["noise", "step", "one bright pixel"]),
    scale=st.sampled_from([1e-6, 1e-3, 0.1, 1.0]),
)
def test_blended_values_stay_in_the_range_of_the_views_values(seed, kind, scale):
    rng = np.random.default_rng(seed)
    views, inputs = [], []
    for _ in range(3):
        picture = rng.uniform(size=(20, 20, 1))
        if kind == "step":
            picture[:] = np.arange(20)[None, :, None] >= rng.integers(3, 17)
        elif kind == "one bright pixel":
            picture[:] = 0
            picture[tuple(rng.integers(5, 15, 2))] = 1
        picture = (picture * scale).astype(np.float16)
        usable = rng.uniform(size=(20, 20)) < 0.98
        places, weight = rng.uniform(2, 18, (200, 2)), rng.uniform(0.01, 1, 200)
        views.append((samples_of(places, weight, usable=usable), picture))
        inputs.append(picture[usable])
    found = blended(200, views, config=dataclasses.replace(BlendConfig(), band_mm=2.0))
    values = np.concatenate(inputs).astype(np.float32)
    assert np.isfinite(found).all()
    assert found.min() >= values.min()
    assert found.max() <= values.max()


def test_texels_without_a_view_stay_zero_and_tiny_weights_stay_finite():
    samples = samples_of([[5, 5], [6, 6]], [1.0, 2e-6])
    found = blended(3, [(samples, np.full((20, 20, 1), 4, np.float16))])[:, 0]
    assert found == pytest.approx([4, 4, 0], abs=1e-3)


def texels_at(places, normals, trust):
    """In tiles of fifty."""
    start = np.append(np.arange(0, len(places), 50), len(places))
    return Texels(places.astype(np.float32), normals.astype(np.float32), trust, start)


def texels_of(mesh, normals):
    return texels_at(mesh.vertices, normals, np.ones(len(normals), np.float32))


def measured_normals(cam, mesh):
    hits = MeshRays(mesh.vertices, mesh.triangles()).cast_camera(cam)
    normals = vertex_normals(mesh.vertices, mesh.triangles())
    found = interpolate(normals, mesh.triangles(), hits)
    return found.reshape(cam.height_px, cam.width_px, 3)


def test_a_view_whose_normals_are_wrong_is_not_believed():
    mesh = bumpy_ellipsoid()
    triangles = mesh.triangles()
    normals = vertex_normals(mesh.vertices, triangles).astype(np.float32)
    cam = camera("a", 0)
    weights = {}
    for tilt_deg in (0, 20, 60):
        c, s = np.cos(np.deg2rad(tilt_deg)), np.sin(np.deg2rad(tilt_deg))
        tilt = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
        found = look(
            cam, mesh, texels_of(mesh, normals), measured_normals(cam, mesh) @ tilt.T, finest=1e9
        )
        weights[tilt_deg] = np.zeros(len(normals))
        weights[tilt_deg][found.reading.slot] = found.reading.weight
    # The tilt is about x: normals without an x part turn by all of it.
    top = (np.abs(normals[:, 0]) < 0.2) & (mesh.vertices[:, 2] > 60)
    assert weights[20][top].sum() > 0.9 * weights[0][top].sum() > 0
    assert weights[60][top].sum() < 0.1 * weights[0][top].sum()


def test_views_see_only_what_faces_them_and_is_not_hidden():
    mesh = bumpy_ellipsoid()
    triangles = mesh.triangles()
    normals = vertex_normals(mesh.vertices, triangles)
    cam = camera("a", 50)
    found = look(cam, mesh, texels_of(mesh, normals), measured_normals(cam, mesh), finest=1e9)
    truth = MeshRays(mesh.vertices, triangles).visible(
        mesh.vertices, normals, cam.centre_mm[None], offset_mm=3.0
    )[:, 0]
    seen = np.zeros(len(normals), bool)
    seen[found.reading.slot] = True
    assert not seen[~truth].any()
    toward = cam.centre_mm - mesh.vertices
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    cosine = np.einsum("nk,nk->n", toward, normals)
    assert seen[truth & (cosine > 0.4)].mean() > 0.95
    # Straight and far from silhouettes the weight is cos^2.
    best = found.reading.weight.argmax()
    assert found.reading.weight[best] == pytest.approx(
        cosine[found.reading.slot[best]] ** 2, rel=1e-3
    )


def test_no_trust_or_no_confidence_means_no_sample():
    mesh = bumpy_ellipsoid()
    normals = vertex_normals(mesh.vertices, mesh.triangles()).astype(np.float32)
    cam = camera("a", 0)
    nothing = np.zeros((cam.height_px, cam.width_px), np.float32)
    ones = np.ones(len(normals), np.float32)
    for trust, confidence in ((0 * ones, None), (ones, nothing)):
        texels = texels_at(mesh.vertices, normals, trust)
        measured = measured_normals(cam, mesh)
        found = look(cam, mesh, texels, measured, confidence=confidence, finest=1e9)
        assert len(found.reading.slot) == 0


def test_threads_do_not_change_the_result():
    rng = np.random.default_rng(0)
    mesh = bumpy_ellipsoid()
    normals = vertex_normals(mesh.vertices, mesh.triangles()).astype(np.float32)
    cam = camera("a", 20)
    shape = (cam.height_px, cam.width_px)
    image = rng.normal(size=(*shape, 3)).astype(np.float16)
    measured = measured_normals(cam, mesh)
    kept = numba.get_num_threads()
    found = []
    try:
        for threads in (1, min(2, kept)):
            numba.set_num_threads(threads)
            samples = look(cam, mesh, texels_of(mesh, normals), measured)
            found.append((samples.reading.weight, blended(len(normals), [(samples, image)])))
    finally:
        numba.set_num_threads(kept)
    assert len(found[0][0]) > 300
    for one, two in zip(*found, strict=True):
        assert np.array_equal(one, two)


def test_what_lies_outside_the_window_changes_nothing():
    mesh = bumpy_ellipsoid()
    normals = vertex_normals(mesh.vertices, mesh.triangles()).astype(np.float32)
    cam = camera("a", 20, dist=True)
    mask = np.zeros((cam.height_px, cam.width_px), bool)
    mask[70:170, 40:150] = True
    texels, measured = texels_of(mesh, normals), measured_normals(cam, mesh)
    image = np.random.default_rng(1).normal(size=(*mask.shape, 3)).astype(np.float16)
    found = look(cam, mesh, texels, measured, mask=mask)
    assert found.window == (slice(68, 172), slice(38, 152))
    with pytest.MonkeyPatch.context() as patch:
        whole = (slice(0, cam.height_px), slice(0, cam.width_px))
        patch.setattr("processing.atlas.weights.window_of", lambda _: whole)
        every = look(cam, mesh, texels, measured, mask=mask)
    assert len(found.reading.slot) > 100
    assert np.array_equal(found.reading.slot, every.reading.slot)
    assert np.allclose(found.reading.weight, every.reading.weight, rtol=1e-6)
    inside = np.add(found.reading.pixel, (38, 68))
    assert np.allclose(inside, every.reading.pixel, atol=1e-4)
    merged = [blended(len(normals), [(one, image)]) for one in (found, every)]
    assert np.abs(merged[0] - merged[1]).max() < 1e-3


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10**6), depths=st.lists(st.sampled_from([1, 3]), min_size=1, max_size=8))
def test_maps_read_together_are_what_they_are_one_by_one(seed, depths):
    rng = np.random.default_rng(seed)
    usable = rng.uniform(size=(20, 20)) > rng.choice([0.02, 0.3])
    pixel = rng.uniform(-1, 21, size=(50, 2)).astype(np.float32)
    samples = samples_of(pixel, rng.uniform(0.1, 1, 50), usable=usable)
    maps = [rng.normal(size=(20, 20, depth)).astype(np.float16) for depth in depths]
    alone = [blended(50, [(samples, one)]) for one in maps]
    together = blended(50, [(samples, np.concatenate(maps, axis=2))])
    assert np.array_equal(np.concatenate(alone, axis=1), together)
    flat = [one[..., 0] if one.shape[2] == 1 else one for one in maps]
    packed = side_by_side(flat, sum(depths))
    assert packed.shape[2] == room(sum(depths)) >= sum(depths)
    assert np.array_equal(packed[..., : sum(depths)], np.concatenate(maps, axis=2).view(np.uint16))
    assert not packed[..., sum(depths) :].any()


def test_projection_through_distortion_is_the_cameras_own():
    mesh = bumpy_ellipsoid()
    normals = vertex_normals(mesh.vertices, mesh.triangles()).astype(np.float32)
    cam = camera("b", -30, 10, dist=True)
    places = mesh.vertices.astype(np.float32)
    samples = look(
        cam,
        mesh,
        texels_at(places, normals, np.ones(len(normals), np.float32)),
        measured_normals(cam, mesh),
    )
    assert len(samples.reading.slot) > 300
    truth, _ = cam.project(places[samples.reading.slot])
    assert np.abs(samples.reading.pixel - truth).max() < 1e-3


def test_a_view_from_farther_away_counts_less():
    mesh = bumpy_ellipsoid()
    normals = vertex_normals(mesh.vertices, mesh.triangles()).astype(np.float32)
    cam = camera("a", 0)
    heaviest = []
    for finest in (1e9, 0.4):  # its own pixels are 0.7 to 0.8 mm wide
        found = look(
            cam, mesh, texels_of(mesh, normals), measured_normals(cam, mesh), finest=finest
        )
        heaviest.append(found.reading.weight.max())
    assert 0.2 < heaviest[1] / heaviest[0] < 0.4
