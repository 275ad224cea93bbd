import dataclasses

import numpy as np
import pytest

from lightstage.errors import ConfigError
from lightstage.formats.mesh import vertex_normals, write_obj, write_ply
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.session import Session, SessionFile
from lightstage.rig import Light, Rig
from processing.atlas.config import AtlasConfig
from processing.atlas.stage import atlas
from processing.errors import AtlasError
from processing.rays import MeshRays, interpolate
from processing.registration.target import Target
from tests.processing.shapes import camera, ellipsoid_template

ROWS = 192
ANGLES = (0, -35, 35, -65, 65)


def colours(points):
    """A smooth known albedo on the surface, with waves of 60 mm and more."""
    x, y, z = points.T / 10.0
    red = 0.5 + 0.2 * np.sin(x) * np.cos(0.8 * y)
    green = 0.4 + 0.15 * np.sin(0.7 * y + z)
    return np.stack([red, green, 0.3 + 0.1 * np.cos(x - y)], axis=1)


def constant(points):
    return np.full((len(points), 3), 0.4)


def capture(root, albedo=colours, gains=(1, 1, 1, 1, 1)):
    """An ellipsoid person seen by five cameras, as a processed folder; background is garbage."""
    template = ellipsoid_template()
    mesh, triangles = template.mesh, template.mesh.triangles()
    normals = vertex_normals(mesh.vertices, triangles)
    rays = MeshRays(mesh.vertices, triangles)
    cameras = [camera(f"cam{i}", a) for i, a in enumerate(ANGLES)]
    out = ProcessedFolder(root / "out")
    for cam, gain in zip(cameras, gains, strict=True):
        hits = rays.cast_camera(cam)
        hit = hits.face >= 0
        shape = (cam.height_px, cam.width_px)
        place = interpolate(mesh.vertices, triangles, hits)
        normal = interpolate(normals, triangles, hits)
        normal[hit] /= np.linalg.norm(normal[hit], axis=1, keepdims=True)
        colour = np.full((len(hit), 3), 50.0)
        colour[hit] = gain * albedo(place[hit])
        maps = {
            "diffuse_albedo": colour,
            "diffuse_normal": normal,
            "specular_normal": normal,
            "specular_albedo": np.where(hit, 0.028, 9)[:, None],
            "ambient_occlusion": np.where(hit, 0.9, 9)[:, None],
            "confidence": np.where(hit, 0.8, 1)[:, None],
        }
        for name, values in maps.items():
            out.write_view(cam.id, name, values.reshape(*shape, -1))
        out.write_mask(cam.id, hit.reshape(shape))
    write_obj(mesh, out.registered_mesh)
    write_ply(mesh, out.base_mesh)
    light = Light(0, "one", (0.0, 0.0, 1250.0), "horizontal")
    file = SessionFile(
        id="a", created_utc="", subject="s", expression="neutral", sequence=[], frames=[]
    )
    return Session(root, file, Rig((light,), tuple(cameras))), out, template


@pytest.fixture(scope="module")
def textured(tmp_path_factory):
    session, out, template = capture(tmp_path_factory.mktemp("textured"))
    facts = atlas(session, out.root, template, AtlasConfig(rows=ROWS))
    return out, template, facts


def test_a_known_texture_is_recovered(textured):
    out, _, facts = textured
    position, confidence = out.read_atlas("position"), out.read_atlas("confidence")
    found = out.read_atlas("diffuse_albedo")
    assert found.shape == (ROWS, ROWS * 2 // 3, 3)
    truth = colours(position.reshape(-1, 3)).reshape(found.shape)
    well = confidence > 0.1
    rms = np.sqrt(np.mean((found[well] - truth[well]) ** 2))
    assert -20 * np.log10(rms) > 38
    assert well.mean() > 0.4
    assert facts["seen_share"] > 0.5
    assert facts["views"] == 5


def test_positions_and_normals_are_the_surfaces_own(textured):
    out, template, _ = textured
    mesh = template.mesh
    position = out.read_atlas("position").reshape(-1, 3)
    assert Target(mesh).closest(position).distance_mm.max() < 1e-3
    well = out.read_atlas("confidence").ravel() > 0.1
    for name in ("diffuse_normal", "specular_normal"):
        normal = out.read_atlas(name).reshape(-1, 3)
        assert np.allclose(np.linalg.norm(normal, axis=1), 1, atol=2e-3)
        truth = Target(mesh).closest(position).normal
        angle = np.rad2deg(np.arccos(np.clip((normal * truth).sum(1), -1, 1)))
        assert np.median(angle[well]) < 1.0
        # Unseen texels have the mesh's own normal.
        assert angle[~well].mean() < 3.0


def test_no_background_bleeds_in_and_scalars_keep_their_value(textured):
    out, _, _ = textured
    assert out.read_atlas("diffuse_albedo").max() < 0.75
    assert np.abs(out.read_atlas("specular_albedo") - 0.028).max() < 2e-4
    assert np.abs(out.read_atlas("ambient_occlusion") - 0.9).max() < 2e-3


def test_unseen_texels_are_marked_and_carry_a_smooth_guess(textured):
    out, _, _ = textured
    confidence, view = out.read_atlas("confidence"), out.read_atlas("view")
    back = out.read_atlas("position")[..., 2] < -85
    assert (confidence[back] == 0).all()
    assert (view[back] == -1).all()
    assert ((view >= 0) == (confidence > 0)).mean() > 0.999
    assert confidence.max() <= 0.8
    assert set(np.unique(view)) <= {-1, 0, 1, 2, 3, 4}
    guess = out.read_atlas("diffuse_albedo")[back]
    assert guess.min() > 0.1
    assert guess.max() < 0.75


def test_coverage_and_filled_state_what_is_seen(textured):
    out, _, _ = textured
    confidence, view = out.read_atlas("confidence"), out.read_atlas("view")
    coverage, filled = out.read_atlas("coverage"), out.read_atlas("filled")
    assert ((coverage > 0) == (view >= 0)).all()
    assert coverage.max() <= 5
    front = out.read_atlas("position")[..., 2] > 60
    assert coverage[front].mean() > 2
    assert (filled[confidence > 1e-3] == 0).all()
    back = out.read_atlas("position")[..., 2] < -85
    assert set(np.unique(filled[back])) <= {1, 2}


def test_tangent_normals_are_straight_where_the_surface_has_no_relief(textured):
    out, _, _ = textured
    tangent = out.read_atlas("tangent_normal")
    known = np.linalg.norm(tangent, axis=2) > 0.5
    assert np.allclose(np.linalg.norm(tangent[known], axis=1), 1, atol=2e-3)
    assert np.median(tangent[known][:, 2]) > 0.999


def test_roughness_is_blended_where_every_view_has_it(tmp_path):
    session, out, template = capture(tmp_path)
    for cam in session.rig.cameras[:-1]:
        out.write_view(cam.id, "roughness", np.full((cam.height_px, cam.width_px), 0.3))
    facts = atlas(session, out.root, template, AtlasConfig(rows=48))
    assert "roughness" not in facts["maps"]
    last = session.rig.cameras[-1]
    out.write_view(last.id, "roughness", np.full((last.height_px, last.width_px), 0.3))
    facts = atlas(session, out.root, template, AtlasConfig(rows=48))
    assert "roughness" in facts["maps"]
    assert np.abs(out.read_atlas("roughness") - 0.3).max() < 1e-3


def test_maps_not_asked_for_are_neither_read_nor_written(tmp_path):
    session, out, template = capture(tmp_path)
    for cam in session.rig.cameras:
        out.view_path(cam.id, "specular_albedo").unlink()
    config = AtlasConfig(rows=48, maps=("diffuse_albedo",))
    facts = atlas(session, out.root, template, config)
    assert facts["maps"] == ["diffuse_albedo"]
    assert not out.atlas_path("specular_normal").exists()
    with pytest.raises(ConfigError, match="gloss"):
        AtlasConfig(maps=("gloss",))


def test_no_map_of_an_earlier_run_stays_beside_those_of_the_last(tmp_path):
    session, out, template = capture(tmp_path)
    for cam in session.rig.cameras:
        out.write_view(cam.id, "roughness", np.full((cam.height_px, cam.width_px), 0.3))
    atlas(session, out.root, template, AtlasConfig(rows=48))
    before = {path.stem for path in (out.root / "atlas").iterdir()}
    assert {"specular_albedo", "tangent_normal", "roughness"} <= before
    atlas(session, out.root, template, AtlasConfig(rows=48, maps=("diffuse_albedo",)))
    after = {path.stem for path in (out.root / "atlas").iterdir()}
    own = {"position", "view", "confidence", "coverage", "filled", "skin"}
    assert after == {"diffuse_albedo", *own}


def test_the_heaviest_view_is_the_one_that_faces_the_texel(textured):
    out, _, _ = textured
    position, view = out.read_atlas("position"), out.read_atlas("view")
    azimuth = np.rad2deg(np.arctan2(position[..., 0], position[..., 2]))
    left = (np.abs(position[..., 1]) < 30) & (azimuth < -60) & (view >= 0)
    right = (np.abs(position[..., 1]) < 30) & (azimuth > 60) & (view >= 0)
    assert (view[left] == 3).mean() > 0.9
    assert (view[right] == 4).mean() > 0.9


def test_a_constant_albedo_has_no_seams(tmp_path):
    session, out, template = capture(tmp_path, albedo=constant)
    atlas(session, out.root, template, AtlasConfig(rows=ROWS))
    found = out.read_atlas("diffuse_albedo")
    assert np.abs(found / 0.4 - 1).max() < 0.01


def test_views_that_disagree_by_a_tenth_leave_no_step(tmp_path):
    gains = (1.0, 1.1, 0.95, 1.05, 1.0)
    session, out, template = capture(tmp_path, albedo=constant, gains=gains)
    atlas(session, out.root, template, AtlasConfig(rows=ROWS))
    found = out.read_atlas("diffuse_albedo")[..., 0]
    view = out.read_atlas("view").astype(int)
    best_view = 0.4 * np.array(gains)[view]
    seen = out.read_atlas("confidence") > 0.05
    steps = {}
    for name, texture in (("blended", found), ("best view", best_view)):
        down = np.abs(np.diff(texture, axis=0))[seen[1:] & seen[:-1]]
        across = np.abs(np.diff(texture, axis=1))[seen[:, 1:] & seen[:, :-1]]
        steps[name] = np.concatenate([down, across])
    # A texel here is 2 to 3 mm wide, half the width over which a silhouette is feathered.
    assert steps["best view"].max() > 0.03
    assert steps["blended"].max() < 0.6 * steps["best view"].max()
    assert np.quantile(steps["blended"], 0.99) < 0.3 * np.quantile(steps["best view"], 0.99)


def test_a_surface_far_from_the_scan_is_not_believed(tmp_path):
    session, out, template = capture(tmp_path)
    mesh = template.mesh
    lifted = mesh.vertices + np.outer(mesh.vertices[:, 1] > 40, [0, 0, 30])
    write_ply(mesh.with_vertices(lifted), out.base_mesh)
    atlas(session, out.root, template, AtlasConfig(rows=48))
    confidence, position = out.read_atlas("confidence"), out.read_atlas("position")
    front = (position[..., 2] > 50) & (np.abs(position[..., 0]) < 20)
    assert (confidence[front & (position[..., 1] > 60)] == 0).all()
    assert (confidence[front & (position[..., 1] < 20)] > 0).mean() > 0.95


def test_missing_maps_are_named_all_at_once(tmp_path):
    session, out, template = capture(tmp_path)
    out.view_path("cam1", "specular_normal").unlink()
    out.view_path("cam4", "confidence").unlink()
    with pytest.raises(AtlasError) as caught:
        atlas(session, out.root, template, AtlasConfig(rows=48))
    assert "cam1/specular_normal.exr" in str(caught.value)
    assert "cam4/confidence.exr" in str(caught.value)
    assert not (out.root / "atlas").exists()


def test_another_topology_is_refused(tmp_path):
    session, out, template = capture(tmp_path)
    mesh = dataclasses.replace(
        template.mesh, faces=template.mesh.faces[:-1], face_uvs=template.mesh.face_uvs[:-1]
    )
    write_obj(mesh, out.registered_mesh)
    with pytest.raises(AtlasError, match="topology"):
        atlas(session, out.root, template, AtlasConfig(rows=48))


def test_a_mesh_that_no_camera_sees_is_refused(tmp_path):
    session, out, template = capture(tmp_path)
    away = template.mesh.with_vertices(template.mesh.vertices + np.array([0, 0, 5000.0]))
    write_obj(away, out.registered_mesh)
    write_ply(away, out.base_mesh)
    with pytest.raises(AtlasError, match="no view"):
        atlas(session, out.root, template, AtlasConfig(rows=48))


@pytest.mark.parametrize("rows", [0, 4, 100, -3])
def test_sizes_without_three_to_two_are_refused(tmp_path, rows):
    template = ellipsoid_template()
    session = Session(tmp_path, None, None)  # refused before anything is read
    with pytest.raises(ConfigError, match="multiple of 3"):
        atlas(session, tmp_path, template, AtlasConfig(rows=rows))
