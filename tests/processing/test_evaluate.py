"""Errors that were put in are the errors that come out, in the units that their names say."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.errors import FormatError, LightstageError
from lightstage.formats.files import write_json
from lightstage.formats.landmarks import write_points_mm
from lightstage.formats.mesh import Mesh, read_ply, write_obj, write_ply
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.template import Template, save_template
from processing.closest import ClosestPoints, sample_texture, weighted_quantile
from processing.evaluation.config import AlbedoOf, EvaluateConfig
from processing.evaluation.folder import evaluate
from processing.evaluation.maps import (
    MapReader,
    angle_deg,
    map_errors,
    picture_errors,
    psnr_db,
    samples_of,
)
from processing.evaluation.texels import evaluate_maps, truth_in_atlas
from processing.reconstruction.pictures import write_pictures

ROWS, COLUMNS = 96, 64


def dome(radius_mm: float = 80.0, steps: int = 60, flip: bool = False) -> Mesh:
    """Front of a cylinder about y as a grid with UV; `flip` turns its texture upside down."""
    v, u = np.meshgrid(np.linspace(0, 1, steps), np.linspace(0, 1, steps), indexing="ij")
    points = dome_point(u, v, radius_mm).reshape(-1, 3)
    index = np.arange(steps * steps).reshape(steps, steps)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.stack([a, b, c, d], axis=-1).reshape(-1, 4).astype(np.int32)
    uvs = np.stack([u, 1 - v if flip else v], axis=-1).reshape(-1, 2)
    return Mesh(points, faces, uvs, faces)


def dome_point(u: np.ndarray, v: np.ndarray, radius_mm: float = 80.0) -> np.ndarray:
    angle = (u - 0.5) * 2.0
    up = (v - 0.5) * 240.0
    return np.stack([radius_mm * np.sin(angle), up, radius_mm * np.cos(angle)], axis=-1)


def texels(flip: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """The dome's (u, v) at each texel centre of a texture."""
    v, u = np.meshgrid(
        1 - (np.arange(ROWS) + 0.5) / ROWS, (np.arange(COLUMNS) + 0.5) / COLUMNS, indexing="ij"
    )
    return u, 1 - v if flip else v


def paint(u: np.ndarray, v: np.ndarray) -> dict[str, np.ndarray]:
    """Maps of the dome as smooth functions of the place."""
    angle = (u - 0.5) * 2.0
    normal = np.stack([np.sin(angle), np.zeros_like(u), np.cos(angle)], axis=-1)
    tone = 0.4 + 0.1 * np.sin(3 * u + 2 * v)
    return {
        "diffuse_albedo": tone[..., None] * np.array([1.0, 0.8, 0.6]),
        "specular_albedo": 0.028 + 0.01 * np.cos(5 * v),
        "ambient_occlusion": 0.8 + 0.1 * u,
        "diffuse_normal": normal,
        "specular_normal": normal,
        "position": dome_point(u, v),
        "confidence": np.ones_like(u),
    }


@pytest.fixture
def folders(tmp_path: Path) -> tuple[ProcessedFolder, ProcessedFolder]:
    """Result and truth of the same dome, equal but for the truth's texture lying upside down."""
    out, truth = ProcessedFolder(tmp_path / "out"), ProcessedFolder(tmp_path / "truth")
    for folder, flip in ((out, False), (truth, True)):
        for name, image in paint(*texels(flip)).items():
            folder.write_atlas(name, image)
        for name, image in paint(*texels()).items():
            folder.write_view("cam0", name, image)
        folder.write_mask("cam0", np.ones((ROWS, COLUMNS), bool))
        write_obj(dome(flip=flip), folder.registered_mesh)
        write_ply(dome(), folder.base_mesh)
    marks = np.arange(68) * 50
    write_points_mm(dome().vertices[marks], truth.true_landmarks)
    skin = {"skin": np.arange(3600)}
    save_template(Template("dome", dome(), marks, skin, "none", "test"), tmp_path / "template")
    return out, truth


def run(out: ProcessedFolder, truth: ProcessedFolder) -> dict:
    return evaluate(out.root, truth.root, out.root.parent / "template")


def test_equal_folders_have_no_error(folders: tuple[ProcessedFolder, ProcessedFolder]) -> None:
    facts = run(*folders)
    assert facts == {
        k: v
        for k, v in json.loads((folders[0].root / "evaluation.json").read_text()).items()
        if k != "schema"
    }
    views = facts["views"]
    assert views["coverage_share"] == 1.0
    assert views["diffuse_albedo_rmse"] == 0.0
    assert views["diffuse_normal_mean_deg"] == 0.0
    assert facts["base_mesh"]["base_mesh_p95_mm"] < 1e-4
    assert facts["base_mesh"]["skin_within_share"] == 1.0
    assert facts["registered_mesh"]["landmark_max_mm"] < 1e-3
    # Half floats and a texture looked up between texels.
    assert facts["atlas"]["diffuse_albedo_rmse"] < 1e-3
    assert facts["atlas"]["diffuse_normal_mean_deg"] < 0.1
    assert facts["atlas"]["position_median_mm"] < 0.02


def test_the_report_shows_the_distance_to_the_truth(
    folders: tuple[ProcessedFolder, ProcessedFolder],
) -> None:
    out, truth = folders
    run(out, truth)
    assert not (out.root / "report.html").exists()  # of what no stage ran there is no report
    write_pictures(out.root, {}, read_ply(out.base_mesh))
    write_json(out.root / "report.json", {"subject": "s", "expression": "neutral", "stages": {}})
    run(out, truth)
    assert "distance to the truth" in (out.root / "report.html").read_text()


def test_known_errors_of_views_come_out(folders: tuple[ProcessedFolder, ProcessedFolder]) -> None:
    out, truth = folders
    shifted = truth.read_view("cam0", "diffuse_albedo") + 0.0625
    out.write_view("cam0", "diffuse_albedo", shifted)
    tilt = np.radians(7.0)
    turn = np.array([[np.cos(tilt), 0, np.sin(tilt)], [0, 1, 0], [-np.sin(tilt), 0, np.cos(tilt)]])
    out.write_view("cam0", "diffuse_normal", truth.read_view("cam0", "diffuse_normal") @ turn.T)
    true_specular = truth.read_view("cam0", "specular_albedo")
    out.write_view("cam0", "specular_albedo", np.full_like(true_specular, true_specular.mean()))
    views = run(out, truth)["views"]
    assert views["diffuse_albedo_rmse"] == pytest.approx(0.0625, rel=2e-3)
    assert views["diffuse_albedo_bias"] == pytest.approx(0.0625, rel=2e-3)
    assert views["diffuse_albedo_linear_psnr_db"] == pytest.approx(24.08, abs=0.02)
    assert views["diffuse_normal_mean_deg"] == pytest.approx(7.0, abs=0.02)
    assert views["specular_normal_mean_deg"] == pytest.approx(0.0, abs=1e-6)
    assert views["diffuse_as_specular_normal_mean_deg"] == pytest.approx(7.0, abs=0.02)
    assert views["specular_albedo_share_of_best_constant"] == pytest.approx(1.0, rel=1e-3)


def test_an_albedo_of_incident_light_is_scored_with_the_light_that_enters(
    folders: tuple[ProcessedFolder, ProcessedFolder],
) -> None:
    out, truth = folders
    entered = truth.read_view("cam0", "diffuse_albedo") / 0.94
    out.write_view("cam0", "diffuse_albedo", entered)
    out.write_atlas("diffuse_albedo", out.read_atlas("diffuse_albedo") / 0.94)

    def albedo_bias(of: AlbedoOf) -> tuple[float, float]:
        template = out.root.parent / "template"
        facts = evaluate(out.root, truth.root, template, EvaluateConfig(albedo=of))
        assert facts["albedo_of"] == of
        return facts["views"]["diffuse_albedo_bias"], facts["atlas"]["diffuse_albedo_bias"]

    with pytest.raises(LightstageError, match="light_that_enters"):
        albedo_bias(AlbedoOf.INCIDENT)
    stages = {"refine": {"light_that_enters": 0.94, "seconds": 1.0, "peak_rss_mb": 1}}
    write_json(
        out.root / "report.json", {"subject": "s", "expression": "neutral", "stages": stages}
    )
    assert albedo_bias(AlbedoOf.INCIDENT) == pytest.approx((0, 0), abs=1e-3)
    assert min(albedo_bias(AlbedoOf.ENTERED)) > 0.01


def test_only_confident_pixels_of_true_skin_count_and_the_share_is_reported(
    folders: tuple[ProcessedFolder, ProcessedFolder],
) -> None:
    out, truth = folders
    skin = np.zeros((ROWS, COLUMNS), bool)
    skin[:, :48] = True
    truth.write_mask("cam0", skin)
    confidence = np.ones((ROWS, COLUMNS))
    confidence[:, :12] = 0
    out.write_view("cam0", "confidence", confidence)
    albedo = truth.read_view("cam0", "diffuse_albedo")
    albedo[:, :12] += 9
    albedo[:, 48:] += 9
    out.write_view("cam0", "diffuse_albedo", albedo)
    views = run(out, truth)["views"]
    assert views["coverage_share"] == pytest.approx(0.75)
    assert views["diffuse_albedo_rmse"] == 0.0


def test_skin_of_a_view_in_which_nothing_is_known_counts_as_not_covered(
    folders: tuple[ProcessedFolder, ProcessedFolder],
) -> None:
    out, truth = folders
    for name, image in paint(*texels()).items():
        for folder in folders:
            folder.write_view("cam1", name, image)
    truth.write_mask("cam1", np.ones((ROWS, COLUMNS), bool))
    out.write_view("cam1", "confidence", np.zeros((ROWS, COLUMNS)))
    facts = run(out, truth)
    assert facts["views"]["coverage_share"] == pytest.approx(0.5)
    assert facts["view"]["cam0"]["coverage_share"] == 1.0


def test_a_report_that_is_no_object_is_named(
    folders: tuple[ProcessedFolder, ProcessedFolder],
) -> None:
    out, truth = folders
    (out.root / "report.json").write_text("[1]")
    with pytest.raises(FormatError, match=r"report\.json: found list, expected a JSON object"):
        run(out, truth)


def test_a_mesh_of_another_radius_is_that_far_away(
    folders: tuple[ProcessedFolder, ProcessedFolder],
) -> None:
    out, truth = folders
    mesh = dome(80.4)
    front = Mesh(mesh.vertices, mesh.faces[mesh.vertices[mesh.faces[:, 0], 1] < 0])
    write_ply(front, out.base_mesh)
    facts = run(out, truth)["base_mesh"]
    assert facts["base_mesh_median_mm"] == pytest.approx(0.4, abs=0.02)
    assert facts["skin_within_share"] == pytest.approx(0.5, abs=0.03)
    assert facts["skin_p95_mm"] > 80


def test_sliding_along_the_surface_is_seen_by_landmarks_alone(
    folders: tuple[ProcessedFolder, ProcessedFolder],
) -> None:
    out, truth = folders
    mesh = dome()
    v, u = np.meshgrid(np.linspace(0, 1, 60), np.linspace(0, 1, 60), indexing="ij")
    slid = dome_point(u + 0.05 * np.sin(np.pi * u), v).reshape(-1, 3)
    write_obj(dataclasses.replace(mesh, vertices=slid), out.registered_mesh)
    facts = run(out, truth)["registered_mesh"]
    assert facts["skin_median_mm"] < 0.1
    marks = np.arange(68) * 50
    expected = np.linalg.norm(slid[marks] - mesh.vertices[marks], axis=1)
    assert facts["landmark_mean_mm"] == pytest.approx(expected.mean(), abs=1e-3)
    assert facts["landmark_mean_mm"] > 3
    every = np.linalg.norm(slid - mesh.vertices, axis=1)
    assert facts["correspondence_mean_mm"] == pytest.approx(every.mean(), abs=1e-3)


def test_truth_arrives_in_the_atlas_at_its_closest_point(
    folders: tuple[ProcessedFolder, ProcessedFolder],
) -> None:
    out, truth = folders
    u, v = texels()
    u = u * 0.8 + 0.1
    v = v**2
    for name, image in paint(u, v).items():
        out.write_atlas(name, image)
    maps = truth_in_atlas(out.root, truth.root)
    for name, expected in paint(u, v).items():
        if name != "confidence":
            tolerance = 0.5 if name == "position" else 4e-3
            np.testing.assert_allclose(maps[name], expected, atol=tolerance)
    assert maps["distance_mm"].max() < 0.05


def test_atlas_coverage_is_the_share_of_true_skin(
    folders: tuple[ProcessedFolder, ProcessedFolder],
) -> None:
    out, truth = folders
    confidence = (texels()[0] > 0.25).astype(float)
    out.write_atlas("confidence", confidence)
    assert run(out, truth)["atlas"]["coverage_share"] == pytest.approx(0.75, abs=0.01)


def test_truth_in_atlas_takes_nothing_from_uncovered_texels(
    folders: tuple[ProcessedFolder, ProcessedFolder],
) -> None:
    out, truth = folders
    u, _ = texels(True)
    half = u < 0.5
    for name, image in paint(*texels(True)).items():
        truth.write_atlas(name, image * (half if image.ndim == 2 else half[..., None]))
    maps = truth_in_atlas(out.root, truth.root)
    known = maps["confidence"] > 0
    assert known.mean() == pytest.approx(0.5, abs=0.02)
    expected = paint(*texels())["diffuse_albedo"]
    np.testing.assert_allclose(maps["diffuse_albedo"][known], expected[known], atol=4e-3)


def test_an_atlas_is_scored_where_more_than_half_of_the_truths_texels_around_are_skin(
    folders: tuple[ProcessedFolder, ProcessedFolder],
) -> None:
    out, truth = folders
    truth.write_atlas("confidence", (texels(True)[0] < 0.5).astype(float))
    u, v = texels()
    between = 2 * (v - 0.5)  # texels beside those of the truth: any share of skin
    u = u + between / COLUMNS
    out.write_atlas("position", paint(u, v)["position"])
    known = truth_in_atlas(out.root, truth.root)["confidence"] > 0
    clear = abs(u - 0.5) > 0.1 / COLUMNS
    np.testing.assert_array_equal(known[clear], (u < 0.5)[clear])


def test_predicted_maps_without_confidence_are_scored_on_all_skin(
    folders: tuple[ProcessedFolder, ProcessedFolder],
) -> None:
    out, truth = folders
    (out.root / "atlas" / "confidence.exr").rename(out.root / "kept.exr")
    maps = paint(*texels())
    maps["confidence"] = (texels()[0] < 0.25).astype(float)
    facts = evaluate_maps(out.root / "atlas", maps)
    assert facts["coverage_share"] == 1.0
    assert facts["diffuse_albedo_rmse"] < 1e-3
    assert truth.root.exists()


def test_nothing_to_compare_is_reported(tmp_path: Path) -> None:
    with pytest.raises(LightstageError, match="a: found no such folder"):
        evaluate(tmp_path / "a", tmp_path / "b")
    for name in "ab":
        (tmp_path / name).mkdir()
    with pytest.raises(LightstageError, match="nothing that"):
        evaluate(tmp_path / "a", tmp_path / "b")


def test_pictures_of_another_session_are_refused(
    folders: tuple[ProcessedFolder, ProcessedFolder],
) -> None:
    out, truth = folders
    truth.write_mask("cam0", np.ones((10, 10), bool))
    with pytest.raises(LightstageError, match="another session"):
        run(out, truth)


@pytest.mark.parametrize("channels", [1, 3])
def test_maps_of_another_shape_than_the_truths_are_refused(channels: int) -> None:
    true = {"confidence": np.ones((6, 4)), "diffuse_albedo": np.full((6, 4, 3), 0.5)}
    size = (6, 4) if channels == 1 else (12, 8, 3)
    found = {**true, "diffuse_albedo": np.full(size, 0.5)}

    def reader(maps: dict[str, np.ndarray]) -> MapReader:
        return lambda name: maps.get(name, np.zeros(0))

    skin = np.ones((6, 4), bool)
    with pytest.raises(LightstageError, match="diffuse_albedo: found a map of"):
        samples_of(reader(found), reader(true), skin, "here", "views")


def test_another_template_is_refused(folders: tuple[ProcessedFolder, ProcessedFolder]) -> None:
    out, truth = folders
    write_obj(dome(steps=20), out.registered_mesh)
    with pytest.raises(LightstageError, match="Name the template"):
        run(out, truth)


def test_psnr_of_a_tenth_is_twenty() -> None:
    assert psnr_db(np.full((5, 3), 0.4), np.full((5, 3), 0.5)) == pytest.approx(20.0)
    assert psnr_db(np.ones(4), np.ones(4)) == 120.0


def test_picture_error_is_relative_to_the_true_picture() -> None:
    true = np.full((4, 4, 3), 0.5)
    found = picture_errors(true * 1.1, true, np.ones((4, 4), bool))
    assert found["rmse"] == pytest.approx(0.05)
    assert found["relative_rmse"] == pytest.approx(0.1)
    with pytest.raises(LightstageError):
        picture_errors(true, true, np.zeros((4, 4), bool))


def test_map_errors_of_no_sample_is_zero_coverage() -> None:
    assert map_errors({}, 100) == {"coverage_share": 0.0}


vectors = st.lists(st.floats(-1, 1), min_size=3, max_size=3)


@given(vectors, vectors, st.sampled_from([1e-6, 1.0, 1e6]))
def test_angles_are_those_of_the_cosine(a: list[float], b: list[float], scale: float) -> None:
    x, y = np.array(a), np.array(b)
    found = float(angle_deg(x[None] * scale, y[None])[0])
    assert 0 <= found <= 180
    lengths = np.linalg.norm(x) * np.linalg.norm(y)
    if lengths < 1e-3:
        return
    expected = np.degrees(np.arccos(np.clip(x @ y / lengths, -1, 1)))
    assert found == pytest.approx(expected, abs=2e-4)


def test_angle_with_a_zero_vector_is_an_error_of_ninety_degrees() -> None:
    assert angle_deg(np.zeros((1, 3)), np.array([[0, 0, 1.0]]))[0] == 90


@given(
    st.lists(st.tuples(st.integers(-50, 50), st.integers(0, 5)), min_size=1, max_size=20).filter(
        lambda rows: any(w for _, w in rows)
    ),
    st.floats(0.01, 0.99),
)
def test_weighted_quantile_is_that_of_repeated_values(
    rows: list[tuple[int, int]], share: float
) -> None:
    values, weights = np.array(rows, float).T
    repeated = np.repeat(values, weights.astype(int))
    expected = np.quantile(repeated, share, method="inverted_cdf")
    assert weighted_quantile(values, weights, share) == expected


def test_closest_points_on_a_plane_are_feet_of_perpendiculars() -> None:
    corners = np.array([[-100, -100, 0], [100, -100, 0], [0, 200, 0.0]])
    points = np.array([[0, 0, 5.0], [3, 4, -2.0], [500, -100, 0.0]])
    found = ClosestPoints(corners, np.array([[0, 1, 2]])).query(points)
    np.testing.assert_allclose(found.point_mm, [[0, 0, 0], [3, 4, 0], [100, -100, 0]], atol=1e-4)
    np.testing.assert_allclose(found.distance_mm, [5, 2, 400], atol=1e-4)
    np.testing.assert_allclose(found.barycentric @ corners, found.point_mm, atol=1e-3)


def test_texture_is_looked_up_between_texels_as_by_hand() -> None:
    image = np.arange(12, dtype=float).reshape(3, 4, 1)
    covered = np.ones((3, 4), bool)
    centre = np.array([[1.5 / 4, 1 - 1.5 / 3]])
    assert sample_texture(image, covered, centre)[0, 0] == pytest.approx(5)
    between = np.array([[2.0 / 4, 1 - 1.0 / 3]])
    assert sample_texture(image, covered, between)[0, 0] == pytest.approx((1 + 2 + 5 + 6) / 4)
    covered[1, 2] = False
    assert sample_texture(image, covered, between)[0, 0] == pytest.approx((1 + 2 + 5) / 3)
    outside = np.array([[-3.0, 9.0]])
    assert sample_texture(image, covered, outside)[0, 0] == pytest.approx(0)
