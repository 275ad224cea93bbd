import dataclasses

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter, map_coordinates

from lightstage.formats.mesh import vertex_normals
from processing.atlas.blend import BlendConfig, Blender
from processing.atlas.sampling import SHARPNESS, low_band, readable
from processing.atlas.visibility import depth_buffer, silhouette_distance
from processing.atlas.weights import Texels, ViewSamples, WeightConfig, view_samples
from processing.rays import MeshRays, interpolate
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
    scale=st.sampled_from([1e-6, 1e-3, 1.0, 1e3, 1e6]),
)
def test_the_low_band_keeps_constants_and_never_reads_outside(seed, sigma, scale):
    rng = np.random.default_rng(seed)
    mask = rng.uniform(size=(24, 30)) > 0.5
    image = np.full((24, 30, 2), scale, np.float32)
    image[~mask] = [np.nan, -1e9]
    found = low_band(image, mask, sigma)
    read = found.counts > 1e-5
    assert read.any()
    assert np.allclose(found.sums[read] / found.counts[read, None], scale, rtol=1e-3)


@pytest.mark.parametrize("sigma", [3.0, 8.0, 17.0])
def test_the_low_band_is_the_gaussian_blur_of_the_whole_picture(sigma):
    rng = np.random.default_rng(0)
    image = rng.normal(size=(160, 200, 1)).astype(np.float32)
    found = low_band(image, np.ones((160, 200), bool), sigma)
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


def samples_of(pixel, weight, shape=(20, 20), usable=None):
    return ViewSamples(
        np.arange(len(pixel), dtype=np.int32),
        np.asarray(pixel, np.float32),
        np.asarray(weight, np.float32),
        readable(np.ones(shape, bool) if usable is None else usable),
        1.0,
    )


def blended(count, views, best=None, config=None):
    """(count, c) of [(samples, picture)], the skip of detail off unless `best` is given."""
    samples = [one for one, _ in views]
    none = np.zeros(count, np.float32)
    blender = Blender(none if best is None else best, samples, config or BlendConfig())
    out = np.zeros((count, views[0][1].shape[2]), np.float32)
    for index, (_, picture) in enumerate(views):
        blender.add(index, picture, out)
    return out


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
    image = rng.normal(size=(20, 20, 1)).astype(np.float32)
    usable = rng.uniform(size=(20, 20)) > rng.choice([0.02, 0.3])
    image[~usable] = np.nan
    pixel = rng.uniform(-1, 21, size=(50, 2)).astype(np.float32)
    samples = samples_of(pixel, rng.uniform(0.1, 1, 50), usable=usable)
    found = blended(50, [(samples, image)])[:, 0]
    clean = np.where(usable[..., None], image, 0).astype(float)
    for value, (x, y) in zip(found, pixel, strict=True):
        assert value == pytest.approx(sampled(clean, usable, float(x), float(y)), abs=1e-4)


def test_a_pixel_centre_reads_exactly_that_pixel():
    image = np.arange(400, dtype=np.float32).reshape(20, 20, 1)
    found = blended(2, [(samples_of([[3.5, 7.5], [19.5, 19.5]], [1, 1]), image)])
    assert found[:, 0].tolist() == pytest.approx([7 * 20 + 3, 399], abs=1e-3)


def test_low_frequencies_are_averaged_and_detail_comes_from_the_best_view():
    rng = np.random.default_rng(0)
    detail = rng.normal(size=(20, 20, 1)).astype(np.float32)
    pixel = np.stack(np.meshgrid(np.arange(5, 15) + 0.5, np.arange(5, 15) + 0.5), -1).reshape(-1, 2)
    config = dataclasses.replace(BlendConfig(), band_mm=2.0)
    views = [
        (samples_of(pixel, np.full(len(pixel), 0.9)), 1.0 + detail),
        (samples_of(pixel, np.full(len(pixel), 0.3)), np.full((20, 20, 1), 2, np.float32)),
    ]
    found = blended(len(pixel), views, config=config)[:, 0]
    inside = detail[5:15, 5:15, 0].ravel()
    assert found.mean() == pytest.approx(0.75 * (1 + inside.mean()) + 0.25 * 2, abs=0.1)
    # The weights' ratio is 3, so the fine band takes 81 / 82 of the first view.
    assert np.std(found) > 0.9 * np.std(inside)


def test_texels_without_a_view_stay_zero_and_tiny_weights_stay_finite():
    samples = samples_of([[5, 5], [6, 6]], [1.0, 2e-6])
    found = blended(3, [(samples, np.full((20, 20, 1), 4, np.float32))])[:, 0]
    assert found == pytest.approx([4, 4, 0], abs=1e-3)


def texels_at(places, normals, trust):
    """In tiles of fifty."""
    start = np.append(np.arange(0, len(places), 50), len(places))
    return Texels.of(places.astype(np.float32), normals.astype(np.float32), trust, start)


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
    shape = (cam.height_px, cam.width_px)
    weights = {}
    for tilt_deg in (0, 20, 60):
        c, s = np.cos(np.deg2rad(tilt_deg)), np.sin(np.deg2rad(tilt_deg))
        tilt = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
        found = view_samples(
            cam,
            mesh.vertices,
            triangles,
            texels_of(mesh, normals),
            np.ones(shape, np.float32),
            np.ones(shape, bool),
            measured_normals(cam, mesh) @ tilt.T,
            1e9,
            WeightConfig(),
        )
        weights[tilt_deg] = np.zeros(len(normals))
        weights[tilt_deg][found.slot] = found.weight
    # The tilt is about x: normals without an x part turn by all of it.
    top = (np.abs(normals[:, 0]) < 0.2) & (mesh.vertices[:, 2] > 60)
    assert weights[20][top].sum() > 0.9 * weights[0][top].sum() > 0
    assert weights[60][top].sum() < 0.1 * weights[0][top].sum()


def test_views_see_only_what_faces_them_and_is_not_hidden():
    mesh = bumpy_ellipsoid()
    triangles = mesh.triangles()
    normals = vertex_normals(mesh.vertices, triangles)
    cam = camera("a", 50)
    shape = (cam.height_px, cam.width_px)
    found = view_samples(
        cam,
        mesh.vertices,
        triangles,
        texels_of(mesh, normals),
        np.ones(shape, np.float32),
        np.ones(shape, bool),
        measured_normals(cam, mesh),
        1e9,
        WeightConfig(),
    )
    truth = MeshRays(mesh.vertices, triangles).visible(
        mesh.vertices, normals, cam.centre_mm[None], offset_mm=3.0
    )[:, 0]
    seen = np.zeros(len(normals), bool)
    seen[found.slot] = True
    assert not seen[~truth].any()
    toward = cam.centre_mm - mesh.vertices
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    cosine = np.einsum("nk,nk->n", toward, normals)
    assert seen[truth & (cosine > 0.4)].mean() > 0.95
    # Straight and far from silhouettes the weight is cos^2.
    best = found.weight.argmax()
    assert found.weight[best] == pytest.approx(cosine[found.slot[best]] ** 2, rel=1e-3)


def test_no_trust_or_no_confidence_means_no_sample():
    mesh = bumpy_ellipsoid()
    triangles = mesh.triangles()
    normals = vertex_normals(mesh.vertices, triangles).astype(np.float32)
    cam = camera("a", 0)
    shape = (cam.height_px, cam.width_px)
    ones = np.ones(len(normals), np.float32)
    for trust, confidence in ((0 * ones, np.ones(shape)), (ones, np.zeros(shape))):
        found = view_samples(
            cam,
            mesh.vertices,
            triangles,
            texels_at(mesh.vertices, normals, trust),
            confidence.astype(np.float32),
            np.ones(shape, bool),
            measured_normals(cam, mesh),
            1e9,
            WeightConfig(),
        )
        assert len(found.slot) == 0


def test_threads_do_not_change_the_result():
    rng = np.random.default_rng(0)
    mesh = bumpy_ellipsoid()
    normals = vertex_normals(mesh.vertices, mesh.triangles()).astype(np.float32)
    cam = camera("a", 20)
    shape = (cam.height_px, cam.width_px)
    image = rng.normal(size=(*shape, 3)).astype(np.float32)
    measured = measured_normals(cam, mesh)
    kept = numba.get_num_threads()
    found = []
    try:
        for threads in (1, min(2, kept)):
            numba.set_num_threads(threads)
            samples = view_samples(
                cam,
                mesh.vertices,
                mesh.triangles(),
                texels_of(mesh, normals),
                np.ones(shape, np.float32),
                np.ones(shape, bool),
                measured,
                1.0,
                WeightConfig(),
            )
            found.append((samples.weight, blended(len(normals), [(samples, image)])))
    finally:
        numba.set_num_threads(kept)
    assert len(found[0][0]) > 300
    for one, two in zip(*found, strict=True):
        assert np.array_equal(one, two)


def test_projection_through_distortion_is_the_cameras_own():
    mesh = bumpy_ellipsoid()
    normals = vertex_normals(mesh.vertices, mesh.triangles()).astype(np.float32)
    cam = camera("b", -30, 10, dist=True)
    shape = (cam.height_px, cam.width_px)
    places = mesh.vertices.astype(np.float32)
    samples = view_samples(
        cam,
        mesh.vertices,
        mesh.triangles(),
        texels_at(places, normals, np.ones(len(normals), np.float32)),
        np.ones(shape, np.float32),
        np.ones(shape, bool),
        measured_normals(cam, mesh),
        1.0,
        WeightConfig(),
    )
    assert len(samples.slot) > 300
    truth, _ = cam.project(places[samples.slot])
    assert np.abs(samples.pixel - truth).max() < 1e-3


def test_a_view_from_farther_away_counts_less():
    mesh = bumpy_ellipsoid()
    normals = vertex_normals(mesh.vertices, mesh.triangles()).astype(np.float32)
    cam = camera("a", 0)
    shape = (cam.height_px, cam.width_px)
    heaviest = []
    for finest in (1e9, 0.4):  # its own pixels are 0.7 to 0.8 mm wide
        found = view_samples(
            cam,
            mesh.vertices,
            mesh.triangles(),
            texels_of(mesh, normals),
            np.ones(shape, np.float32),
            np.ones(shape, bool),
            measured_normals(cam, mesh),
            finest,
            WeightConfig(),
        )
        heaviest.append(found.weight.max())
    assert 0.2 < heaviest[1] / heaviest[0] < 0.4
