"""Photographs under one light: a mesh of matched pictures alone, and no maps."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lightstage.commands import quiet
from lightstage.formats.mesh import Mesh, vertex_normals, write_ply
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.template import default_template_path
from lightstage.rig import Rig, default_rig
from processing import pipeline
from processing.errors import ProcessingError
from processing.evaluation.folder import evaluate
from processing.pipeline import run
from processing.pipeline_config import PipelineConfig
from processing.reconstruction.config import ReconstructConfig
from processing.reconstruction.stage import reconstruct_views
from processing.registration.config import RegisterConfig
from processing.separation.choice import no_normals
from sim.light.world import World
from sim.session import SessionConfig, truth_path, write_direct
from tests.processing import lit_ball, textured_ball
from tests.processing.shots import coloured_rig
from tests.processing.textured_ball import RADIUS_MM
from tests.sim.conftest import ball_subject, one_person, write_truth_of_one_person

TEMPLATE = default_template_path()
ONE_LIGHT = "expected patterns that light a face from three directions: photographs under x"


def small_rig() -> Rig:
    """Three frontal cameras of 240 x 360 pixels, a millimetre each, and every fourth light."""
    rig = default_rig().scaled(360 / 6016)
    return dataclasses.replace(rig, lights=rig.lights[::4], cameras=rig.cameras[:3])


def photographed(rig: Rig, sequence: str, root: Path) -> Path:
    """A session of one person, truth beside it."""
    world = World(one_person(), rig)
    write_direct(world, root / "session", SessionConfig(sequence=sequence), 3, quiet)
    write_truth_of_one_person(world, truth_path(root / "session"))
    return root / "session"


def test_views_without_normals_become_a_ball() -> None:
    views, _ = textured_ball.views_of(textured_ball.cameras(5), np.random.default_rng(5))
    blind = [dataclasses.replace(v, normals=np.zeros_like(v.normals)) for v in views]
    found = reconstruct_views(
        blind, ReconstructConfig(cell_mm=3.0, trim_mm=5.0, agree_mm=1.5, splits=0)
    )
    error = np.abs(np.linalg.norm(found.mesh.vertices, axis=1) - RADIUS_MM)
    assert np.median(error) < 0.1
    assert np.percentile(error, 95) < 0.8
    normals = vertex_normals(found.mesh.vertices, found.mesh.faces)
    facing = np.einsum("nk,nk->n", normals, found.mesh.vertices) / RADIUS_MM
    assert np.median(facing) > 0.995
    front = found.mesh.vertices[:, 2] > 0
    assert np.percentile(error[front], 95) < 0.6
    corners = found.mesh.vertices[found.mesh.faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = 0.5 * np.linalg.norm(across[corners.mean(axis=1)[:, 2] > 0], axis=1).sum()
    assert area > 0.9 * 2 * np.pi * RADIUS_MM**2
    assert (found.facts["normals"], found.facts["alone_share"]) == ("none: pictures alone", 0)


def test_a_session_of_full_alone_becomes_a_mesh_and_states_what_it_is(
    tmp_path: Path, run_command: Callable[..., Any]
) -> None:
    session, out = photographed(small_rig(), "full", tmp_path), tmp_path / "out"
    (tmp_path / "c.toml").write_text("[reconstruct]\nsplits = 0\ncell_mm = 2.0\n")
    words = (session, "--out", out, "--config", tmp_path / "c.toml")
    done = run_command("processing", "run", *words, "--until", "reconstruct", "--json")
    assert done.code == 0, done.err
    stated = json.loads(done.out.splitlines()[-1])
    assert stated["ran"] == ["decode", "reconstruct"]
    facts = stated["stages"]["reconstruct"]
    assert facts["normals"] == "none: pictures alone"
    assert facts["alone_share"] == 0
    assert any("full: lights that give no normals" in warning for warning in stated["warnings"])
    assert "none: pictures alone" in (out / "report.html").read_text()
    # A pixel is a millimetre wide; of the skin a third is seen by one camera or none.
    errors = evaluate(out, truth_path(session))["base_mesh"]
    assert errors["base_mesh_median_mm"] < 0.25
    assert errors["base_mesh_p95_mm"] < 1.2
    assert errors["skin_within_share"] > 0.4
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    for command in ("run", "separate", "refine", "atlas"):
        refused = run_command("processing", command, session, "--out", out)
        assert refused.code == 2
        assert f"found full, {ONE_LIGHT}+, y+ and z+ as well" in refused.err
        assert "--until reconstruct" in refused.err
    again = run_command("processing", "run", *words, "--until", "reconstruct")
    assert "up to date" in again.out
    assert before == {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}


@pytest.mark.parametrize("sequence", ["full", "x+", "olat-003", "full,x+", "polarised", "mux-1"])
def test_one_light_is_decoded_and_matched_and_separated_by_nobody(
    sequence: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[bool] = []

    def matched(*words: Any) -> dict[str, Any]:
        given.append(words[-1])
        return {}

    monkeypatch.setattr(pipeline, "reconstruct", matched)
    session, out = tmp_path / "session", tmp_path / "out"
    world = World(ball_subject(), coloured_rig(lit_ball.small_rig(1, 0.015)))
    write_direct(world, session, SessionConfig(sequence=sequence), 3, quiet)
    report = run(session, out, TEMPLATE, PipelineConfig(), until="reconstruct")
    assert report["ran"] == ["decode", "reconstruct"]
    assert run(session, out, TEMPLATE, PipelineConfig(), only="reconstruct")["ran"] == [
        "reconstruct"
    ]
    assert given == [False, False]
    with pytest.raises(ProcessingError, match="three directions"):
        run(session, tmp_path / "other", TEMPLATE, PipelineConfig())
    assert not (tmp_path / "other").exists()


def test_photographs_of_three_directions_are_separated_and_matched_with_normals(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[bool] = []
    monkeypatch.setattr(pipeline, "reconstruct", lambda *words: given.append(words[-1]) or {})
    session = lit_ball.write_session(
        lit_ball.Ball(coated=True), lit_ball.small_rig(1, 0.015), tmp_path / "session"
    )
    report = run(session, tmp_path / "out", TEMPLATE, PipelineConfig(), until="reconstruct")
    assert report["ran"] == ["decode", "separate", "reconstruct"]
    assert given == [True]


def test_landmarks_are_looked_for_in_photographs_where_there_is_no_albedo(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run_command: Callable[..., Any]
) -> None:
    shown: dict[str, np.ndarray] = {}

    class Program:
        def __init__(self, command: str) -> None:
            assert command == "find-landmarks"

        def find(self, pictures: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
            shown.update(pictures)
            raise ProcessingError("find-landmarks", found="a ball", expected="a face")

    monkeypatch.setattr("processing.registration.stage.CommandLandmarks", Program)
    rig = dataclasses.replace(small_rig(), cameras=lit_ball.small_rig(2, 0.015).cameras)
    session, out = tmp_path / "session", tmp_path / "out"
    write_direct(World(ball_subject(), rig), session, SessionConfig(sequence="full"), 3, quiet)
    config = PipelineConfig(register=RegisterConfig(landmark_command="find-landmarks"))
    monkeypatch.setattr(pipeline, "reconstruct", lambda *_: {})
    run(session, out, TEMPLATE, config, until="reconstruct")
    square = np.array([[0, 0, 80.0], [50, 0, 80], [0, 50, 80]])
    write_ply(Mesh(square, np.array([[0, 1, 2]], np.int32)), ProcessedFolder(out).base_mesh)
    with pytest.raises(ProcessingError, match="found a ball"):
        run(session, out, TEMPLATE, config, only="register")
    assert set(shown) == {"cam0", "cam1"}
    for camera, picture in shown.items():
        lit = ProcessedFolder(out).read_mask(camera)
        assert picture[lit].mean() > 100 > 10 > picture[~lit].mean()


@pytest.mark.parametrize(
    ("patterns", "message"),
    [
        (("full",), r"under x\+, y\+ and z\+ as well, by every camera"),
        (("full", "x+", "x-", "lin-z-"), r"under y\+ as well"),
        (("full@cross",), r"under x\+, y\+ and z\+ as well, each as @cross and as @parallel"),
        (("mux-2",), "both mux-1 and mux-2"),
        (("olat-001", "x-", "y-", "z-"), "under lights elsewhere as well"),
    ],
)
def test_the_photographs_that_are_needed_are_named(patterns: tuple[str, ...], message: str) -> None:
    with pytest.raises(ProcessingError, match=message):
        raise no_normals(patterns)
