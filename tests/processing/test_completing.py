"""A missing pattern is rebuilt from full and its complement, and said; two of an axis are not."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from lightstage.errors import LightstageError
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.session import load_session
from lightstage.formats.template import default_template_path
from lightstage.patterns import pattern_levels
from processing.decode.completing import missing_patterns, pairs_of, with_complements
from processing.frames.read import photographed_patterns, read_frames
from processing.pipeline import run
from processing.pipeline_config import PipelineConfig
from tests.processing import lit_ball
from tests.processing.lit_ball import Ball

TEMPLATE = default_template_path()
RIG = lit_ball.small_rig(2, 0.015)


@pytest.fixture
def session(tmp_path: Path) -> Path:
    return lit_ball.write_session(Ball(), RIG, tmp_path / "session")


def lose(session: Path, *photographs: str) -> None:
    for name in photographs:
        (session / "frames" / f"{name}.exr").unlink()


def forget(session: Path, pattern: str) -> None:
    """The pattern was never in the sequence."""
    value = json.loads((session / "session.json").read_text())
    value["sequence"].remove(pattern)
    value["frames"] = [frame for frame in value["frames"] if frame["pattern"] != pattern]
    (session / "session.json").write_text(json.dumps(value))


def separated(session: Path, out: Path) -> dict[str, list[str]]:
    report = run(session, out, TEMPLATE, PipelineConfig(), until="separate")
    return {"warnings": report["warnings"]}


@pytest.mark.parametrize("lost", ["x+", "z-", "full"])
def test_a_lost_photograph_is_rebuilt_and_reported(
    session: Path, tmp_path: Path, lost: str
) -> None:
    lose(session, f"{lost}/cam1")
    warnings = separated(session, tmp_path / "out")["warnings"]
    assert [line for line in warnings if f"{lost} has no photograph by cam1: rebuilt as" in line]
    frames = read_frames(tmp_path / "out", "cam1")
    sight = lit_ball.see(Ball(), RIG.cameras[1])
    known = lit_ball.photograph(Ball(), sight, RIG)[:, lit_ball.PATTERNS.index(lost)]
    found = frames.pixels(sight.mask)[:, frames.patterns.index(lost)]
    np.testing.assert_allclose(found, known, atol=3e-3)


def test_a_photograph_that_is_copied_back_takes_the_place_of_the_rebuilt_one(
    session: Path, tmp_path: Path
) -> None:
    out, path = tmp_path / "out", session / "frames" / "x+" / "cam1.exr"
    kept = path.rename(tmp_path / "x+.exr")
    assert separated(session, out)["warnings"]
    assert photographed_patterns(out, "cam1") == set(lit_ball.PATTERNS) - {"x+"}
    assert photographed_patterns(out, "cam0") == set(lit_ball.PATTERNS)
    kept.rename(path)
    report = run(session, out, TEMPLATE, PipelineConfig(), until="decode")
    assert report["ran"] == ["decode"]
    assert not [line for line in report["warnings"] if "rebuilt" in line]
    assert photographed_patterns(out, "cam1") == set(lit_ball.PATTERNS)


def test_maps_with_a_rebuilt_pattern_are_those_without_loss(session: Path, tmp_path: Path) -> None:
    separated(session, tmp_path / "whole")
    lose(session, "y-/cam0")
    separated(session, tmp_path / "mended")
    folders = [ProcessedFolder(tmp_path / name) for name in ("whole", "mended")]
    sure = folders[0].read_view("cam0", "confidence") > 0.5
    for name, within in (("diffuse_albedo", 0.01), ("diffuse_normal", 0.02)):
        first, second = (folder.read_view("cam0", name)[sure] for folder in folders)
        assert np.abs(first - second).mean() < within


def test_a_pattern_that_was_never_taken_joins_the_sequence(session: Path, tmp_path: Path) -> None:
    forget(session, "x-")
    joined = with_complements(load_session(session))
    assert joined.file.sequence == list(lit_ball.PATTERNS)
    np.testing.assert_array_equal(joined.levels("x-"), pattern_levels("x-", RIG))
    assert missing_patterns(joined)["cam0"] == {"x-": (("full", 1.0), ("x+", -1.0))}
    warnings = separated(session, tmp_path / "out")["warnings"]
    assert [line for line in warnings if "cam0, cam1: rebuilt as full - x+" in line]


def test_driven_levels_of_a_rebuilt_pattern_are_what_full_leaves(session: Path) -> None:
    forget(session, "x-")
    value = json.loads((session / "session.json").read_text())
    dimmed = {n: 0.5 * pattern_levels(n, RIG) for n in value["sequence"]}
    value["patterns"] = {name: {"levels": levels.tolist()} for name, levels in dimmed.items()}
    (session / "session.json").write_text(json.dumps(value))
    joined = with_complements(load_session(session))
    np.testing.assert_allclose(joined.levels("x-"), 0.5 * pattern_levels("x-", RIG))


@pytest.mark.parametrize("lost", [("x+", "x-"), ("full", "y+", "y-", "x+")])
def test_two_of_one_axis_are_an_error(session: Path, tmp_path: Path, lost: tuple[str, ...]) -> None:
    lose(session, *(f"{name}/cam1" for name in lost))
    with pytest.raises(LightstageError, match=rf"{lost[1][0]}\+ by cam1") as error:
        separated(session, tmp_path / "out")
    assert "cam0" not in str(error.value)
    assert not (tmp_path / "out").exists()


def test_full_and_one_gradient_follow_from_the_other_pairs(session: Path) -> None:
    lose(session, "full/cam0", "x+/cam0")
    recipes = missing_patterns(load_session(session))["cam0"]
    assert set(recipes) == {"full", "x+"}
    whole = sum(factor * pattern_levels(name, RIG) for name, factor in recipes["x+"])
    np.testing.assert_allclose(whole, pattern_levels("x+", RIG), atol=1e-12)


def test_pairs_are_those_that_were_driven_to_sum_to_full(session: Path) -> None:
    value = json.loads((session / "session.json").read_text())
    value["patterns"] = {"x+": {"levels": [1.0] * len(RIG.lights)}}
    (session / "session.json").write_text(json.dumps(value))
    assert [pair.axis for pair in pairs_of(load_session(session))] == ["y", "z"]
