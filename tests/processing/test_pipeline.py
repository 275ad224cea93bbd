"""Decode, coarse maps, staleness and bad input, through the pipeline and its commands."""

from __future__ import annotations

import functools
import itertools
import json
import os
import resource
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from lightstage.errors import ConfigError, FormatError
from lightstage.faces import weights
from lightstage.formats.config import all_fields, require_bounds
from lightstage.formats.exr import read_exr, write_exr
from lightstage.formats.files import sha256_file
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.template import default_template_path
from processing.bounds import BOUNDS
from processing.calibration.cameras.config import CamerasFile
from processing.calibration.config import CalibrateConfig
from processing.errors import ProcessingError, RegistrationError
from processing.frames.read import Frames, read_frames, write_frames
from processing.masks import foreground
from processing.pipeline import run
from processing.pipeline_config import PipelineConfig, read_config
from processing.records import measured
from tests.processing import lit_ball
from tests.processing.lit_ball import Ball

BALL = Ball(coated=True)
TEMPLATE = default_template_path()


@pytest.fixture
def session(tmp_path: Path) -> Path:
    return lit_ball.write_session(BALL, lit_ball.small_rig(2, 0.015), tmp_path / "session")


def coarse(session: Path, out: Path, config: PipelineConfig | None = None) -> list[str]:
    report = run(session, out, TEMPLATE, config or PipelineConfig(), until="separate")
    return list(report["ran"])


@pytest.fixture
def command(run_command: Callable[..., Any]) -> Callable[..., Any]:
    """A function that runs a command of `processing` in this process."""
    return functools.partial(run_command, "processing")


def test_frames_come_back_as_they_were_written(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    images = rng.uniform(0, 30, (3, 5, 7, 3)).astype(np.float32)
    valid = rng.uniform(size=(5, 7)) > 0.3
    write_frames(tmp_path, "cam0", Frames.of(("full", "x+", "x-"), images, valid))
    found = read_frames(tmp_path, "cam0")
    assert found.patterns == ("full", "x+", "x-")
    np.testing.assert_allclose(found.images, images, rtol=5e-4, atol=1e-5)
    np.testing.assert_array_equal(found.valid, valid)


def test_missing_frames_name_which_stage_makes_them(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="decode"):
        read_frames(tmp_path, "cam0")


def test_foreground_is_the_largest_bright_region_without_holes() -> None:
    image = np.zeros((60, 80), np.float32)
    image[10:50, 20:60] = 1.0
    image[25:30, 30:35] = 0.0
    image[5:8, 70:75] = 1.0
    mask = foreground(image, 0.03)
    assert mask[27, 32]
    assert not mask[6, 72]
    assert abs(int(mask.sum()) - 1600) < 20
    assert not foreground(np.zeros((9, 9)), 0.03).any()


def test_a_run_that_has_nothing_to_do_links_a_head_that_was_exported_since(
    session: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    assert run(session, out, TEMPLATE, PipelineConfig(), until="decode")["ran"] == ["decode"]
    assert "page.html" not in (out / "report.html").read_text()
    (out / "head").mkdir()
    (out / "head" / "page.html").write_text("<html></html>")
    later = (out / "report.html").stat().st_mtime_ns + 10**9
    os.utime(out / "head" / "page.html", ns=(later, later))
    assert run(session, out, TEMPLATE, PipelineConfig(), until="decode")["ran"] == []
    assert 'href="head/page.html"' in (out / "report.html").read_text()


def test_linear_sessions_become_maps_of_the_ball(session: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert coarse(session, out) == ["decode", "separate"]
    folder = ProcessedFolder(out)
    mask = folder.read_mask("cam1")
    sight = lit_ball.see(BALL, lit_ball.small_rig(2, 0.015).cameras[1])
    assert (mask ^ sight.mask).mean() < 0.01
    albedo = folder.read_view("cam1", "diffuse_albedo")
    confident = folder.read_view("cam1", "confidence") > 0.9
    np.testing.assert_allclose(albedo[confident].mean(axis=0), BALL.albedo, atol=0.02)


def test_a_second_run_does_nothing_and_a_changed_setting_reruns_its_stage(
    session: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    coarse(session, out)
    assert coarse(session, out) == []
    toml = tmp_path / "c.toml"
    toml.write_text("[separate]\nroughness = 0.3\n")
    assert coarse(session, out, read_config(toml)) == ["separate"]
    ProcessedFolder(out).view_path("cam0", "diffuse_normal").unlink()
    assert coarse(session, out, read_config(toml)) == ["separate"]


def test_the_report_states_the_settings_that_each_stage_ran_with(
    session: Path, tmp_path: Path
) -> None:
    out, toml = tmp_path / "out", tmp_path / "c.toml"
    toml.write_text("[decode]\nclip_share = 0.9\n[separate]\nroughness = 0.3\n")
    coarse(session, out, read_config(toml))
    toml.write_text("[decode]\nclip_share = 0.9\n[separate]\nroughness = 0.4\n")
    assert run(session, out, TEMPLATE, read_config(toml), until="decode")["ran"] == []
    written = json.loads((out / "report.json").read_text())["config"]
    assert set(written) == {"decode", "separate"}
    assert written["decode"]["clip_share"] == 0.9
    assert written["separate"]["roughness"] == 0.3


def test_errors_against_truth_do_not_outlive_the_maps_that_they_are_of(
    session: Path, tmp_path: Path
) -> None:
    out, toml = tmp_path / "out", tmp_path / "c.toml"
    coarse(session, out)
    (out / "evaluation.json").write_text("{}")
    assert coarse(session, out) == []
    assert (out / "evaluation.json").exists()
    toml.write_text("[separate]\nroughness = 0.3\n")
    assert coarse(session, out, read_config(toml)) == ["separate"]
    assert not (out / "evaluation.json").exists()


def test_a_changed_photograph_reruns_everything(session: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    coarse(session, out)
    path = session / "frames" / "x+" / "cam0.exr"
    old = sha256_file(path)
    write_exr(path, 1.01 * read_exr(path), half=False)
    text = (session / "session.json").read_text()
    (session / "session.json").write_text(text.replace(old, sha256_file(path)))
    assert coarse(session, out) == ["decode", "separate"]


def test_of_a_camera_that_is_left_out_nothing_stays(session: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    coarse(session, out)
    for name, field, key in (("session.json", "frames", "camera"), ("rig.json", "cameras", "id")):
        value = json.loads((session / name).read_text())
        value[field] = [each for each in value[field] if each[key] != "cam1"]
        (session / name).write_text(json.dumps(value))
    assert coarse(session, out) == ["decode", "separate"]
    assert ProcessedFolder(out).view_ids() == ["cam0"]
    assert [path for path in out.rglob("*") if path.stem == "cam1"] == []
    assert any(path.stem == "cam0" for path in out.rglob("*"))


def test_a_dark_frame_is_taken_off_the_others(tmp_path: Path) -> None:
    root = lit_ball.write_session(Ball(), lit_ball.small_rig(1, 0.015), tmp_path / "session")
    value = json.loads((root / "session.json").read_text())
    for frame in value["frames"]:
        path = root / frame["path"]
        write_exr(path, read_exr(path) + np.float32(0.05), half=False)
        frame["sha256"] = sha256_file(path)
    dark = root / "frames" / "dark" / "cam0.exr"
    write_exr(dark, np.full_like(read_exr(path), 0.05), half=False)
    value["sequence"].append("dark")
    value["frames"].append(
        {**value["frames"][0], "pattern": "dark", "path": "frames/dark/cam0.exr"}
        | {"sha256": sha256_file(dark)}
    )
    (root / "session.json").write_text(json.dumps(value))
    out = tmp_path / "out"
    coarse(root, out)
    frames = read_frames(out, "cam0")
    assert "dark" not in frames.patterns
    sight = lit_ball.see(Ball(), lit_ball.small_rig(1, 0.015).cameras[0])
    exact = lit_ball.photograph(Ball(), sight, lit_ball.small_rig(1, 0.015))
    found = frames.images[:, sight.mask].transpose(1, 0, 2)
    np.testing.assert_allclose(found, exact, atol=1e-3)


def test_a_photograph_in_which_nothing_is_lit_is_named(session: Path, tmp_path: Path) -> None:
    value = json.loads((session / "session.json").read_text())
    for frame in value["frames"]:
        if frame["camera"] == "cam1":
            path = session / frame["path"]
            write_exr(path, np.zeros_like(read_exr(path)))
            frame["sha256"] = sha256_file(path)
    (session / "session.json").write_text(json.dumps(value))
    with pytest.raises(ProcessingError, match="cam1"):
        coarse(session, tmp_path / "out")


def test_missing_and_changed_photographs_exit_2_and_write_nothing(
    session: Path, tmp_path: Path, command: Callable[..., Any]
) -> None:
    out = tmp_path / "out"
    cut = session / "frames" / "z+" / "cam0.exr"
    cut.write_bytes(cut.read_bytes()[:-100])
    done = command("run", session, "--out", out, "--until", "separate")
    assert (done.code, out.exists()) == (2, False)
    assert "sha256" in done.err
    assert "Traceback" not in done.err
    for pattern in ("z+", "z-"):
        (session / "frames" / pattern / "cam0.exr").unlink()
    done = command("run", session, "--out", out)
    assert (done.code, out.exists()) == (2, False)
    assert "2 problems" in done.err


@pytest.mark.parametrize("sequence", [[], ["dark"]])
def test_a_session_without_a_lit_photograph_exits_2_and_writes_nothing(
    session: Path, tmp_path: Path, command: Callable[..., Any], sequence: list[str]
) -> None:
    file = session / "session.json"
    value = json.loads(file.read_text())
    frames = [{**f, "pattern": "dark"} for f in value["frames"] if f["pattern"] == "full"]
    kept = {"sequence": sequence, "frames": frames if sequence else [], "patterns": {}}
    file.write_text(json.dumps({**value, **kept}))
    for stage in ("decode", "separate", "atlas"):
        done = command("run", session, "--out", tmp_path / "out", "--until", stage)
        assert done.code == 2
        assert "session.json, sequence: found no pattern" in done.err
        assert "Traceback" not in done.err
        assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[decode]\nmesh = "none.ply"', "none.ply: found no such file"),
        ('[reconstruct]\ncolmap_from = "none"', "none: found no such folder, expected stereo/"),
        ('[reconstruct]\ncolmap_from = "."', "found no depth map, expected stereo/depth_maps"),
    ],
)
def test_files_that_a_configuration_names_are_found_before_any_stage_runs(
    session: Path,
    tmp_path: Path,
    command: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
    text: str,
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("c.toml").write_text(text)
    done = command("run", session, "--out", "out", "--config", "c.toml", "--until", "reconstruct")
    assert (done.code, Path("out").exists()) == (2, False)
    assert message in done.err


def test_unknown_keys_and_stages_exit_2(
    session: Path, tmp_path: Path, command: Callable[..., Any]
) -> None:
    toml = tmp_path / "c.toml"
    toml.write_text("[refine]\nrougness = 0.3\n")
    with pytest.raises(ConfigError, match="rougness"):
        read_config(toml)
    done = command("run", session, "--out", tmp_path / "out", "--until", "polish")
    assert done.code == 2
    assert "polish" in done.err


def test_a_batchs_file_serves_run_too_and_its_table_is_checked(
    session: Path, tmp_path: Path, command: Callable[..., Any]
) -> None:
    toml = tmp_path / "c.toml"
    ask = functools.partial(
        command, "run", session, "--out", tmp_path / "out", "--config", toml, "--why"
    )
    toml.write_text("[batch]\ntries = 2\n[separate]\nroughness = 0.3\n")
    assert ask("--until", "separate").code == 0
    for text, message in (
        ("batch = 3", "c.toml, batch: found 3, expected"),
        ("[batch]\ntris = 2", "batch.tris: found an unknown key"),
        ("[batch]\ntries = 0", "tries: found 0, expected from 1 to 100"),
    ):
        toml.write_text(text)
        done = ask()
        assert done.code == 2
        assert message in done.err


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[decode]\nclip_share = 99", r"decode\.clip_share: found 99\.0, expected from 0\.1 to 1"),
        ("[decode.prepare]\nstill_px = -1.0", r"still_px: found -1\.0, expected 0 or more"),
        ("[reconstruct]\npatch_stride_px = 0", r"patch_stride_px: found 0, expected from 1 to"),
        ("[reconstruct]\niterations = [3, -2]", r"reconstruct\.iterations: found -2"),
        ("[refine]\nscattering = []", r"refine\.scattering: found no value, expected at least one"),
        ("[register.nonrigid]\nstiffness_mm = []", r"stiffness_mm: found no value"),
        ("[refine]\ngloss_pixels = 0", r"refine\.gloss_pixels: found 0, expected 1 or more"),
        ("[refine]\ngloss_spread = 0", r"refine\.gloss_spread: found 0\.0, expected 1e-06 or more"),
        ("[refine]\nrounds = 0", r"refine\.rounds: found 0, expected from 1 to 1000"),
        ("[refine]\nedge_px = 0", r"refine\.edge_px: found 0\.0, expected 0\.001 or more"),
        ("[separate]\nhalf_trust_deg = 0", r"half_trust_deg: found 0\.0, expected 0\.001 or more"),
        ("[atlas]\nlargest_gap_mm = 0", r"atlas\.largest_gap_mm: found 0\.0, expected 0\.001"),
    ],
)
def test_settings_that_no_stage_can_work_with_are_refused_by_file_and_name(
    text: str, message: str, tmp_path: Path
) -> None:
    toml = tmp_path / "c.toml"
    toml.write_text(text)
    with pytest.raises(ConfigError, match=rf"c\.toml, .*{message}"):
        read_config(toml)


def test_the_defaults_are_possible_and_every_bound_is_of_a_setting() -> None:
    names = set()
    for config in (PipelineConfig(), CalibrateConfig(), CamerasFile()):
        require_bounds(config, "defaults", BOUNDS)
        names |= dict(all_fields(config)).keys()
    assert BOUNDS.keys() <= names


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[atlas]\nmaps = []", "maps: found none, expected some of"),
        ('[atlas]\nmaps = ["roughness", "roughness"]', "maps: found roughness twice"),
        ("[separate.linear]\nroughness = [0.3, 0.2, 0.1]", "each above the one before"),
        ("[separate.polarised]\nroughness = [0.3]", r"found \[0\.3\], expected three values"),
        (
            "[atlas.blend.weights]\ndoubt_deg = 50.0",
            "disbelief_deg: found 50, with doubt_deg = 50, expected more than doubt_deg",
        ),
    ],
)
def test_settings_that_contradict_each_other_are_refused(
    text: str, message: str, tmp_path: Path
) -> None:
    toml = tmp_path / "c.toml"
    toml.write_text(text)
    with pytest.raises(ConfigError, match=message):
        read_config(toml)


def test_a_batch_refuses_a_table_of_its_own_that_is_none(
    session: Path, tmp_path: Path, command: Callable[..., Any]
) -> None:
    toml = tmp_path / "c.toml"
    toml.write_text("batch = 3")
    done = command("batch", session, "--out", tmp_path / "out", "--config", toml)
    assert (done.code, (tmp_path / "out").exists()) == (2, False)
    assert "batch: found 3" in done.err


def test_a_stage_without_those_before_it_states_what_to_run(session: Path, tmp_path: Path) -> None:
    with pytest.raises(ProcessingError, match="--until reconstruct"):
        run(session, tmp_path / "out", TEMPLATE, PipelineConfig(), only="refine")


def test_separate_alone_decodes_first_and_prints_facts(
    session: Path, tmp_path: Path, command: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = itertools.count(100.0, 7.25)
    fake = SimpleNamespace(perf_counter=lambda: next(clock))
    monkeypatch.setattr("processing.records.time", fake)
    done = command("separate", session, "--out", tmp_path / "out", "--json")
    assert done.code == 0, done.err
    facts = json.loads(done.out.splitlines()[-1])
    assert facts["ran"] == ["decode", "separate"]
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["subject"] == "ball"
    assert report["consent"] is None
    assert {report["stages"][name]["seconds"] for name in facts["ran"]} == {7.25}


@pytest.mark.skipif(
    not os.access("/proc/self/clear_refs", os.W_OK), reason="this system keeps one peak alone"
)
def test_the_peak_of_memory_is_of_the_block_that_is_measured() -> None:
    def measured_mb(held_mb: int) -> float:
        facts: dict[str, Any] = {}
        with measured(facts):
            # What is not written takes no memory.
            assert np.ones(held_mb << 17).all()
        return float(facts["peak_rss_mb"])

    before_mb = resident_mb()
    large = measured_mb(64)
    assert large == pytest.approx(before_mb + 64, abs=8)
    # Whether what was freed is given back to the system is the allocator's affair.
    before_mb = resident_mb()
    assert measured_mb(0) == pytest.approx(before_mb, abs=8)


def resident_mb() -> float:
    """Memory of this process now, in units of 2^20 bytes."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 2**20


def test_separate_alone_decodes_again_what_was_removed(session: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    coarse(session, out)
    again = functools.partial(run, session, out, TEMPLATE, PipelineConfig(), only="separate")
    assert again()["ran"] == ["separate"]
    shutil.rmtree(out / "work")
    assert again()["ran"] == ["decode", "separate"]


def test_the_report_carries_the_id_of_the_sessions_consent_record(
    session: Path, tmp_path: Path
) -> None:
    file = session / "session.json"
    file.write_text(json.dumps({**json.loads(file.read_text()), "consent": "C-17"}))
    coarse(session, tmp_path / "out")
    assert json.loads((tmp_path / "out" / "report.json").read_text())["consent"] == "C-17"


@pytest.mark.parametrize("rows", [7, 100])
def test_atlas_rows_are_refused_before_any_stage_runs(
    session: Path, tmp_path: Path, rows: int, command: Callable[..., Any]
) -> None:
    done = command("run", session, "--out", tmp_path / "out", "--atlas-rows", rows)
    assert done.code == 2
    assert f"rows: found {rows}, expected a multiple of 3" in done.err
    assert not (tmp_path / "out").exists()


def test_no_landmarks_and_no_detector_are_reported_before_any_stage_runs(
    session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (session / "landmarks.json").unlink(missing_ok=True)
    monkeypatch.setattr(weights, "PACKAGE", "no_such_package_at_all")
    text = (
        r"landmarks\.json: found no such file, and no detector, expected 68 iBUG.*"
        r"Click them.*landmark_command.*Or install the detector: Run `make setup`"
    )
    with pytest.raises(RegistrationError, match=text):
        run(session, tmp_path / "out", TEMPLATE, PipelineConfig())
    assert not (tmp_path / "out").exists()


def test_a_store_is_replaced_only_when_told(tmp_path: Path, command: Callable[..., Any]) -> None:
    (tmp_path / "store").mkdir()
    for name, kind in (("build", "store"), ("publish", "published")):
        (tmp_path / "store" / "dataset.json").write_text(f'{{"kind": "{kind}"}}')
        done = command("dataset", name, tmp_path / "scan", "--out", tmp_path / "store")
        assert done.code == 2
        assert "pass --overwrite" in done.err
        assert kind in (tmp_path / "store" / "dataset.json").read_text()
