"""`template transfer`: maps go from one UV to another, and what is not there is masked."""

from __future__ import annotations

import dataclasses
import json

import cv2
import hypothesis.extra.numpy as arrays
import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given
from scipy.spatial import Delaunay

from lightstage.formats.exr import read_exr, write_exr
from lightstage.formats.mesh import Mesh, read_obj, vertex_normals, write_obj
from lightstage.formats.png import write_png
from lightstage.formats.template import Template, save_template
from processing.atlas.raster import rasterise
from processing.atlas.tangents import from_tangent_space, tangent_frames, to_tangent_space
from processing.template.config import TransferConfig
from processing.template.correspond import Surface, carried_vertices
from processing.template.resample import halved, nearest, sampled

ROWS, COLUMNS = 192, 128


def grid(count, seed=0):
    """(n, 2) even points of the unit square, moved a little inside of it, and their triangles."""
    at = np.linspace(0, 1, count)
    places = np.stack(np.meshgrid(at, at), axis=-1).reshape(-1, 2)
    inner = ((places > 0) & (places < 1)).all(axis=1)
    rng = np.random.default_rng(seed)
    places[inner] += rng.uniform(-0.2, 0.2, (inner.sum(), 2)) / count
    return places, Delaunay(places).simplices.astype(np.int32)


def bent(places):
    """(n, 3) mm: the square as a part of a barrel that faces +z."""
    angle = 1.6 * (places[:, 0] - 0.5)
    return np.stack([90 * np.sin(angle), 160 * (places[:, 1] - 0.5), 90 * np.cos(angle)], axis=1)


@pytest.fixture(scope="module")
def pair():
    """Two templates of one surface, with their own topology and UV: one upright, one turned and
    mirrored, in part of its tile."""
    coarse, first = grid(24)
    fine, second = grid(33, 1)
    regions = {"skin": np.arange(68)}
    upright = Mesh(bent(coarse), first, 0.02 + 0.96 * coarse, first)
    turned = Mesh(bent(fine), second, 0.1 + 0.7 * (1 - fine[:, ::-1]), second)
    return tuple(
        Template(name, mesh, np.arange(68), regions, "", "")
        for name, mesh in (("one", upright), ("two", turned))
    )


@pytest.fixture(scope="module")
def folders(pair, tmp_path_factory):
    folder = tmp_path_factory.mktemp("pair")
    out = {t.name: save_template(t, folder / t.name) for t in pair}
    out |= {f"{t.name} mesh": write_obj(t.mesh, folder / f"{t.name}.obj") for t in pair}
    return out


def positions(template, rows=ROWS, columns=COLUMNS):
    """Covered texels, and their (k, 3) places and the barrel's own normals there."""
    mesh = template.mesh
    raster = rasterise(mesh.uvs, mesh.triangle_uvs(), rows, columns)
    places = raster.at(mesh.vertices, mesh.triangles()).astype(float)
    normals = places * [1, 0, 1]
    return raster, places, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def colour(places):
    """A smooth function of place, such as a skin's colour."""
    waves = np.stack([places[:, 0] / 25, places[:, 1] / 17, places[:, 1] / 40 + 1], axis=1)
    return 0.5 + 0.4 * np.sin(waves)


def relief(places, normals):
    """World normals with a relief that is a function of place."""
    moved = normals + 0.3 * np.sin(places / 20)
    return moved / np.linalg.norm(moved, axis=1, keepdims=True)


def map_of(template, values, background=0.0):
    raster = positions(template)[0]
    out = np.full((raster.face.size, values.shape[1]), background, np.float32)
    out[raster.texels()] = values
    return out.reshape(ROWS, COLUMNS, -1)


def tangent_of(template, world):
    mesh, triangles = template.mesh, template.mesh.triangles()
    normals = vertex_normals(mesh.vertices, triangles)
    frames = tangent_frames(mesh.vertices, triangles, mesh.uvs, mesh.triangle_uvs(), normals)
    raster = positions(template)[0]
    return to_tangent_space(world, raster, raster.texels(), triangles, normals, frames)


@pytest.fixture
def maps(pair, tmp_path):
    """Maps of the first template, of every kind."""
    one = pair[0]
    _, places, normals = positions(one)
    out = tmp_path / "maps"
    world = relief(places, normals)
    write_exr(out / "diffuse_albedo.exr", map_of(one, colour(places)))
    write_exr(out / "roughness.exr", map_of(one, colour(places)[:, :1]))
    write_exr(out / "position.exr", map_of(one, places), half=False)
    write_exr(out / "specular_normal.exr", map_of(one, world))
    write_exr(out / "tangent_normal.exr", map_of(one, tangent_of(one, world)))
    view = np.where(places[:, :1] > 0, 3.0, 1.0)
    write_exr(out / "view.exr", map_of(one, view, -1.0))
    write_png(out / "paint.png", np.round(65535 * map_of(one, colour(places))).astype(np.uint16))
    return out


def carried(run_command, maps, folders, out, *words):
    return run_command(
        "processing", "template", "transfer", maps, "--from", folders["one"],
        "--to", folders["two"], "--out", out, *words,
    )  # fmt: skip


def meshes(folders):
    return ["--from-mesh", folders["one mesh"], "--to-mesh", folders["two mesh"]]


def angles(found, true):
    length = np.maximum(np.linalg.norm(found, axis=1), 1e-9)
    cos = np.einsum("nk,nk->n", found, true) / length
    return np.rad2deg(np.arccos(np.clip(cos, -1, 1)))


def test_every_map_arrives_where_it_belongs(pair, maps, folders, tmp_path, run_command):
    out = tmp_path / "out"
    ended = carried(run_command, maps, folders, out, *meshes(folders), "--json")
    assert ended.code == 0, ended.err
    facts = json.loads(ended.out.splitlines()[-1])
    assert facts["carried_share"] > 0.99
    two = pair[1]
    raster, places, normals = positions(two)
    texels = raster.texels()
    mask = cv2.imread(str(out / "mask.png"), cv2.IMREAD_GRAYSCALE).ravel() > 0
    assert not mask[raster.face.ravel() < 0].any()
    assert mask[texels].mean() > 0.99
    there = mask[texels]

    def read(name):
        image = read_exr(out / f"{name}.exr")
        return image.reshape(-1, 3 if image.ndim == 3 else 1)[texels][there]

    # Chords of the two triangulations are up to .1 mm apart, a texel is 1 mm.
    assert np.abs(read("diffuse_albedo") - colour(places)[there]).max() < 0.02
    assert np.abs(read("roughness") - colour(places)[there, :1]).max() < 0.02
    # Beyond the old texture's outermost texels nothing is known: half a texel of 1.5 mm is lost.
    away = np.linalg.norm(read("position") - places[there], axis=1)
    assert np.quantile(away, 0.9) < 0.1
    assert away.max() < 1.1
    world = relief(places, normals)[there]
    assert np.quantile(angles(read("specular_normal"), world), 0.99) < 1.0
    assert np.quantile(angles(read("tangent_normal"), tangent_of(two, world_all(two))[there]),
                       0.99) < 1.5  # fmt: skip
    side = np.abs(places[there, 0]) > 1
    assert set(np.unique(read("view"))) == {1.0, 3.0}
    assert ((read("view")[:, 0] == 3) == (places[there, 0] > 0))[side].all()
    paint = cv2.imread(str(out / "paint.png"), cv2.IMREAD_UNCHANGED)
    assert paint.dtype == np.uint16
    found = paint[..., ::-1].reshape(-1, 3)[texels][there] / 65535
    assert np.abs(found - colour(places)[there]).max() < 0.02
    # The mesh that the maps lie on, in the new topology.
    written = read_obj(out / "registered_mesh.obj")
    np.testing.assert_array_equal(written.faces, two.mesh.faces)


def world_all(template):
    _, places, normals = positions(template)
    return relief(places, normals)


def test_there_and_back_again_leaves_next_to_nothing(pair, maps, folders, tmp_path, run_command):
    out, back = tmp_path / "out", tmp_path / "back"
    assert carried(run_command, maps, folders, out, *meshes(folders)).code == 0
    ended = run_command(
        "processing", "template", "transfer", out, "--from", folders["two"],
        "--to", folders["one"], "--out", back, "--from-mesh", folders["two mesh"],
        "--to-mesh", folders["one mesh"],
    )  # fmt: skip
    assert ended.code == 0, ended.err
    mask = cv2.imread(str(back / "mask.png"), cv2.IMREAD_GRAYSCALE) > 0
    covered = positions(pair[0])[0].face >= 0
    assert (mask & covered).sum() > 0.97 * covered.sum()
    before, after = (read_exr(each / "diffuse_albedo.exr")[mask] for each in (maps, back))
    error = np.sqrt(((before - after) ** 2).mean())
    print(f"round trip: {-20 * np.log10(error):.1f} dB", end="")
    assert -20 * np.log10(error) > 50
    for name in ("specular_normal", "tangent_normal"):
        before, after = (read_exr(each / f"{name}.exr")[mask] for each in (maps, back))
        off = angles(after, before / np.linalg.norm(before, axis=1, keepdims=True)).mean()
        print(f", {name} {off:.2f} deg", end="")
        assert off < 0.5


def test_what_the_first_template_lacks_is_masked(pair, maps, folders, tmp_path, run_command):
    # The second reaches farther down, and has a ball of its own that the first does not have.
    two = pair[1]
    low = two.mesh.vertices.copy()
    low[:, 1] -= 40
    longer = write_obj(two.mesh.with_vertices(low), tmp_path / "longer.obj")
    out = tmp_path / "out"
    words = ["--from-mesh", folders["one mesh"], "--to-mesh", longer]
    ended = carried(run_command, maps, folders, out, *words)
    assert ended.code == 0, ended.err
    raster = positions(two)[0]
    y = raster.at(low, two.mesh.triangles())[:, 1]
    mask = cv2.imread(str(out / "mask.png"), cv2.IMREAD_GRAYSCALE).ravel()[raster.texels()] > 0
    assert mask[y > -79].all()
    assert not mask[y < -85].any()
    albedo = read_exr(out / "diffuse_albedo.exr").reshape(-1, 3)[raster.texels()]
    assert (albedo[y < -85] == 0).all()
    assert (read_exr(out / "view.exr").ravel()[raster.texels()][y < -85] == -1).all()


def test_a_mask_of_the_maps_goes_with_them(pair, maps, folders, tmp_path, run_command):
    raster, places, _ = positions(pair[0])
    seen = np.zeros(raster.face.size, np.uint8)
    seen[raster.texels()[places[:, 0] > 0]] = 255
    write_png(maps / "mask.png", seen.reshape(ROWS, COLUMNS))
    out = tmp_path / "out"
    assert carried(run_command, maps, folders, out, *meshes(folders)).code == 0
    raster, places, _ = positions(pair[1])
    mask = cv2.imread(str(out / "mask.png"), cv2.IMREAD_GRAYSCALE).ravel()[raster.texels()]
    assert (mask[places[:, 0] > 2] == 255).mean() > 0.99
    assert not mask[places[:, 0] < -2].any()


def test_lips_that_touch_keep_their_own_colours():
    # Two sheets face each other at a distance of .01 mm; each point belongs to its own.
    flat = np.array([[0, 0, 0], [10, 0, 0], [10, 10, 0], [0, 10, 0]], float)
    both = np.concatenate([flat, flat + np.array([0, 0, 0.01])])
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 6, 5], [4, 7, 6]], np.int32)
    surface = Surface(Mesh(both, faces), TransferConfig())
    points = np.array([[3.0, 4, 0.006], [3, 4, 0.006], [3, 4, 9], [3, 4, 0.005]])
    normals = np.array([[0.0, 0, 1], [0, 0, -1], [0, 0, 1], [1, 0, 0]])
    found = surface.places(points, normals)
    assert found.face[0] in (0, 1)
    assert found.face[1] in (2, 3)
    assert found.there.tolist() == [True, True, False, False]
    np.testing.assert_allclose(found.weights.sum(axis=1), 1, atol=1e-6)


def test_the_person_in_the_other_topology_moves_as_the_person_does(pair):
    one, two = pair
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    person = 1.1 * one.mesh.vertices @ turn.T + [5, 6, 7]
    ball = two.mesh.vertices[:8] - np.array(
        [0, 0, 40]
    )  # behind the surface: the first does not have it
    other = dataclasses.replace(
        two.mesh,
        vertices=np.concatenate([two.mesh.vertices, ball]),
        faces=np.concatenate([two.mesh.faces, len(two.mesh.vertices) + np.array([[0, 1, 2]])]),
    )
    found, known = carried_vertices(one.mesh, person, other, TransferConfig())
    true = 1.1 * other.vertices @ turn.T + [5, 6, 7]
    assert known[: len(two.mesh.vertices)].mean() > 0.95
    assert not known[-8:-5].any()
    np.testing.assert_allclose(found[known], true[known], atol=0.3)
    np.testing.assert_allclose(found[-8:-5], true[-8:-5], atol=0.5)


def test_normals_come_back_from_tangent_space(pair):
    for template in pair:
        mesh, triangles = template.mesh, template.mesh.triangles()
        normals = vertex_normals(mesh.vertices, triangles)
        frames = tangent_frames(mesh.vertices, triangles, mesh.uvs, mesh.triangle_uvs(), normals)
        raster, places, smooth = positions(template)
        world = relief(places, smooth)
        tangent = to_tangent_space(world, raster, raster.texels(), triangles, normals, frames)
        back = from_tangent_space(tangent, raster, raster.texels(), triangles, normals, frames)
        np.testing.assert_allclose(back, world, atol=1e-4)


VALUES = st.floats(-1e4, 1e4, width=32) | st.sampled_from([0.0, -1.0, 1e4])


@given(
    arrays.arrays(np.float32, (6, 5, 2), elements=VALUES),
    arrays.arrays(bool, (6, 5)),
    arrays.arrays(float, (9, 2), elements=st.floats(-0.5, 1.5)),
    arrays.arrays(float, 9, elements=st.floats(0, 1e6)),
)
def test_samples_stay_within_the_texels_and_take_none_that_hold_nothing(image, covered, uv, larger):
    hidden = np.where(covered[..., None], image, np.float32(np.nan))
    values, there = sampled(hidden, covered, uv, 0 * larger, 3)
    assert np.isfinite(values).all()
    if covered.any():
        low, high = image[covered].min(axis=0), image[covered].max(axis=0)
        slack = 1e-3 * (1 + np.abs(image).max())
        assert ((values >= low - slack) & (values <= high + slack))[there].all()
    assert (values[~there] == 0).all()
    smaller, _ = sampled(np.where(covered[..., None], image, 0), covered, uv, larger, 3)
    assert np.isfinite(smaller).all()
    chosen, there = nearest(hidden, covered, uv)
    assert np.isfinite(chosen[there]).all()
    assert there.shape == (9,)


def test_a_sample_is_what_cubic_convolution_says():
    rng = np.random.default_rng(2)
    image = rng.random((9, 8, 1)).astype(np.float32)
    uv = np.array([[0.5, 0.5], [0.41, 0.63]])
    found, _ = sampled(image, np.ones((9, 8), bool), uv, np.ones(2), 0)

    def weight(d):
        d = abs(d)
        near = 1.5 * d**3 - 2.5 * d**2 + 1
        far = -0.5 * d**3 + 2.5 * d**2 - 4 * d + 2
        return near if d < 1 else far if d < 2 else 0.0

    for (u, v), value in zip(uv, found[:, 0], strict=True):
        x, y = u * 8 - 0.5, (1 - v) * 9 - 0.5
        true = sum(
            weight(x - c) * weight(y - r) * image[r, c, 0] for r in range(9) for c in range(8)
        )
        window = image[int(y) - 1 : int(y) + 3, int(x) - 1 : int(x) + 3]
        assert value == pytest.approx(np.clip(true, window.min(), window.max()), abs=1e-5)


def test_a_smaller_copy_has_the_mean_of_what_is_covered():
    image = np.arange(16, dtype=np.float32).reshape(4, 4, 1)
    covered = np.ones((4, 4), bool)
    covered[0, 0] = covered[:2, 2:] = False
    small, there = halved(image, covered)
    np.testing.assert_allclose(small[..., 0], [[10 / 3, 0], [10.5, 12.5]])
    assert there.tolist() == [[True, False], [True, True]]


@pytest.mark.parametrize("odd", [(33, 48), (32, 49), (35, 51)])
def test_smaller_copies_of_odd_sizes_have_everything_where_it_was(odd):
    row, column = np.mgrid[: odd[0], : odd[1]]
    place = np.stack([(column + 0.5) / odd[1], 1 - (row + 0.5) / odd[0]], axis=2)
    image, covered = place.astype(np.float32), np.ones(odd, bool)
    uv = np.random.default_rng(0).uniform(0.3, 0.7, (50, 2))
    for larger in (1.0, 2.0, 4.0):
        found, there = sampled(image, covered, uv, np.full(50, larger), 3)
        assert there.all()
        np.testing.assert_allclose(found, uv, atol=1e-3)


def test_finer_maps_do_not_alias_in_a_coarser_texture(pair, folders, tmp_path, run_command):
    one = pair[0]
    maps = tmp_path / "maps"
    checker = np.indices((ROWS, COLUMNS)).sum(axis=0) % 2
    write_exr(maps / "roughness.exr", checker.astype(np.float32))
    assert positions(one)[0].face.shape == checker.shape
    out = tmp_path / "out"
    ended = carried(run_command, maps, folders, out, *meshes(folders), "--rows", "48")
    assert ended.code == 0, ended.err
    found = read_exr(out / "roughness.exr")
    assert found.shape == (48, 32)
    mask = cv2.imread(str(out / "mask.png"), cv2.IMREAD_GRAYSCALE) > 0
    assert np.abs(found[mask] - 0.5).mean() < 0.05


def test_wrong_input_is_one_message_and_nothing_is_left(maps, folders, tmp_path, run_command):
    out = tmp_path / "out"
    empty = tmp_path / "empty"
    empty.mkdir()
    elsewhere = read_obj(folders["two mesh"])
    elsewhere = elsewhere.with_vertices(elsewhere.vertices / 1000)
    metres = write_obj(elsewhere, tmp_path / "metres.obj")
    nan = tmp_path / "nan"
    write_exr(nan / "roughness.exr", np.full((6, 4), np.nan, np.float32))
    other = ["--from-mesh", folders["two mesh"], "--to-mesh", folders["one mesh"]]
    cases = {
        "neither": (empty, meshes(folders)),
        "no such folder": (tmp_path / "nowhere", meshes(folders)),
        "NaN": (nan, meshes(folders)),
        "of the template": (maps, other),
        "in the same place": (maps, ["--from-mesh", folders["one mesh"], "--to-mesh", metres]),
        "--from-mesh": (maps, ["--to-mesh", folders["two mesh"]]),
    }
    ended = carried(run_command, maps, folders, maps, *meshes(folders), "--overwrite")
    assert (ended.code, "--out: found the folder of the maps" in ended.err) == (2, True)
    wrong = {}
    for message, (folder, words) in cases.items():
        ended = carried(run_command, folder, folders, out, *words)
        if ended.code != 2 or message not in ended.err or out.exists() or "Traceback" in ended.err:
            wrong[message] = (ended.code, ended.err)
    assert wrong == {}
    assert carried(run_command, maps, folders, out, *meshes(folders)).code == 0
    again = carried(run_command, maps, folders, out, *meshes(folders))
    assert again.code == 2
    assert "--overwrite" in again.err
    (out / "letters.txt").write_text("mine")
    again = carried(run_command, maps, folders, out, *meshes(folders), "--overwrite")
    assert again.code == 2
    assert "found letters.txt, which the command did not make" in again.err
    (out / "letters.txt").unlink()
    assert carried(run_command, maps, folders, out, *meshes(folders), "--overwrite").code == 0
