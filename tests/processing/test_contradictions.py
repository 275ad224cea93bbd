"""Photographs that do not add up as their patterns do are refused alike by `check` and `decode`."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from lightstage.checks import check_session
from lightstage.errors import FormatError
from lightstage.formats.session import load_session
from lightstage.formats.sums import UNCHECKED, axes_alike, sum_fault
from lightstage.patterns import pattern_levels
from processing.__main__ import app
from processing.decode.config import DecodeConfig, PrepareConfig
from processing.decode.preparation import prepare_warnings
from processing.decode.stage import decode
from processing.errors import ProcessingError
from processing.separation.config import SeparateConfig
from processing.separation.stage import separate
from tests.processing import lit_ball
from tests.processing.made_raw import write_raw_session
from tests.processing.test_decode import COLOUR, PATTERNS, RIG, photographs

FORCED = DecodeConfig(prepare=PrepareConfig(forced=True))
AXES = tuple(name for name in PATTERNS if name != "full")


def session_of(root: Path, patterns: tuple[str, ...] = PATTERNS, **factors: float) -> Path:
    """Photographs of a disc; some are multiplied by a factor, named such as x_minus."""
    shots = photographs(PATTERNS)
    for name, factor in factors.items():
        pattern = name.replace("_plus", "+").replace("_minus", "-")
        shots[pattern] = {"cam0": factor * shots[pattern]["cam0"]}
    return write_raw_session(root, RIG, {name: shots[name] for name in patterns}, COLOUR)


def both_say(root: Path, out: Path, said: str) -> None:
    for call in (lambda: check_session(root), lambda: decode(load_session(root), out, FORCED_NOT)):
        with pytest.raises(FormatError, match=said):
            call()


FORCED_NOT = DecodeConfig()


@pytest.mark.parametrize(
    ("patterns", "factors", "message"),
    [
        (PATTERNS, {"x_minus": 0.1}, r"patterns of cam0: found x\+ \+ x- = .* full = "),
        (PATTERNS, {"full": 0.4}, r"3 problems"),
        (AXES, {"y_plus": 0.2, "y_minus": 0.2}, r"x\+ \+ x- = .* y\+ \+ y- = "),
    ],
)
def test_what_does_not_add_up_is_refused_by_both(tmp_path, patterns, factors, message):
    root = session_of(tmp_path / "S", patterns, **factors)
    both_say(root, tmp_path / "OUT", message)
    facts = decode(load_session(root), tmp_path / "OUT2", FORCED)
    assert any(warning.startswith("forced: ") for warning in facts["warnings"])


@pytest.mark.parametrize("patterns", [PATTERNS, AXES])
def test_what_adds_up_passes_both(tmp_path, patterns):
    root = session_of(tmp_path / "S", patterns)
    assert check_session(root).sums == 3
    facts = decode(load_session(root), tmp_path / "OUT", FORCED_NOT)
    assert facts["sums"]["cam0"]["sums_compared"] == 3
    assert not any("could not be checked" in warning for warning in facts["warnings"])


def test_where_nothing_can_be_compared_both_warn(tmp_path):
    root = session_of(tmp_path / "S", ("x+", "x-", "y+"))
    assert any(finding.found == UNCHECKED for finding in check_session(root).findings)
    assert UNCHECKED in decode(load_session(root), tmp_path / "OUT", FORCED_NOT)["warnings"]


def test_room_light_that_a_dark_frame_shows_contradicts_nothing(tmp_path):
    room = np.full_like(photographs()["full"]["cam0"], 0.05)
    shots = {name: {"cam0": shot["cam0"] + room} for name, shot in photographs().items()}
    root = write_raw_session(tmp_path / "S", RIG, shots | {"dark": {"cam0": room}}, COLOUR)
    assert check_session(root).sums == 3
    assert decode(load_session(root), tmp_path / "OUT", FORCED_NOT)["sums"]["cam0"]["ambient"]


def test_less_than_no_light_is_not_called_light():
    facts = {"looks_like": {}, "aligned": [], "flicker": {}, "pairs_apart": 0.0}
    warnings = prepare_warnings({"cam0": {**facts, "ambient": [-0.955] * 3}})
    assert warnings == ["cam0: gradients and their complements together lack 95.5 % of full"]


def test_a_face_that_is_mostly_ill_posed_is_an_error(tmp_path):
    """Each gradient shows noise alone: sums cannot tell, maps can."""
    rng = np.random.default_rng(0)
    shots = photographs()
    full = shots["full"]["cam0"]
    for axis in "xyz":
        share = rng.uniform(0, 1, full.shape)
        shots[f"{axis}+"] = {"cam0": full * share}
        shots[f"{axis}-"] = {"cam0": full * (1 - share)}
    root = write_raw_session(tmp_path / "S", RIG, shots, COLOUR)
    assert check_session(root).sums == 3
    session, out = load_session(root), tmp_path / "OUT"
    decode(session, out, FORCED_NOT)
    with pytest.raises(ProcessingError, match=r"confidence: found \d+ % of the face ill-posed"):
        separate(session, out, SeparateConfig())
    facts = separate(session, out, SeparateConfig(forced=True))
    assert any("ill-posed" in warning for warning in facts["warnings"])


def test_a_dark_face_that_noise_hides_is_a_warning_that_asks_for_light(tmp_path):
    """The same photographs, of a face so dark that patterns are not what is wrong with it."""
    rng = np.random.default_rng(0)
    shots = photographs()
    full = shots["full"]["cam0"]
    scale = 0.07 / float(np.median(full[full > 0]))
    for axis in "xyz":
        share = rng.uniform(0, 1, full.shape)
        shots[f"{axis}+"] = {"cam0": scale * full * share}
        shots[f"{axis}-"] = {"cam0": scale * full * (1 - share)}
    shots["full"] = {"cam0": scale * full}
    session, out = load_session(write_raw_session(tmp_path / "S", RIG, shots, COLOUR)), tmp_path
    decode(session, out, FORCED_NOT)
    warnings = separate(session, out, SeparateConfig())["warnings"]
    assert any("of white under its brightest pattern" in warning for warning in warnings)
    assert any("give more light or longer exposures" in warning for warning in warnings)


def test_a_face_that_is_clipped_is_asked_for_less_exposure(tmp_path):
    shots = photographs()
    peak = max(float(shot["cam0"].max()) for shot in shots.values())
    bright = {
        name: {"cam0": np.minimum(2 * shot["cam0"] / peak, 1)} for name, shot in shots.items()
    }
    session, out = load_session(write_raw_session(tmp_path / "S", RIG, bright, COLOUR)), tmp_path
    warnings = decode(session, out, FORCED_NOT)["warnings"]
    assert [w for w in warnings if w.startswith("cam0: 100% of the face is clipped")]
    with pytest.raises(ProcessingError, match=r"100% of the face is clipped .* expose less"):
        separate(session, out, SeparateConfig())


def test_photographs_in_another_unit_than_white_are_a_warning(tmp_path):
    warnings = {}
    for times in (0.005, 1, 12):
        skin = lit_ball.Ball()
        red, green, blue = (times * channel for channel in skin.albedo)
        ball = dataclasses.replace(skin, albedo=(red, green, blue), specular=times * skin.specular)
        session = load_session(lit_ball.write_session(ball, RIG, tmp_path / f"{times}"))
        out = tmp_path / f"out{times}"
        decode(session, out, FORCED_NOT)
        warnings[times] = separate(session, out, SeparateConfig())["warnings"]
    assert not warnings[1]
    assert "the face reads 0.0022 of white" in warnings[0.005][0]
    assert [each for each in warnings[12] if "cam0: the median diffuse albedo is 4" in each]


def test_force_is_an_option_of_run_and_separate(tmp_path):
    root = session_of(tmp_path / "S", PATTERNS, x_minus=0.5)
    runner, args = CliRunner(), [str(root), "--out", str(tmp_path / "OUT")]
    for command in (["run", *args, "--until", "decode"], ["separate", *args]):
        refused = runner.invoke(app, command)
        assert isinstance(refused.exception, FormatError), refused.output
        assert "--force continues" in str(refused.exception)
    done = runner.invoke(app, ["run", *args, "--until", "decode", "--force"])
    assert done.exit_code == 0, done.output
    report = json.loads((tmp_path / "OUT" / "report.json").read_text())
    assert any("forced" in warning for warning in report["warnings"])


def test_axes_are_compared_only_where_no_pattern_has_their_sum():
    levels = {name: pattern_levels(name, RIG) for name in AXES}
    found = axes_alike(levels)
    assert [balance.patterns for balance in found] == [
        ("x+", "x-", "y+", "y-"),
        ("x+", "x-", "z+", "z-"),
        ("y+", "y-", "z+", "z-"),
    ]
    assert axes_alike(levels | {"full": pattern_levels("full", RIG)}) == []
    levels["y+"] = 0.5 * levels["y+"]
    assert len(axes_alike(levels)) == 1
    assert sum_fault(Path("S"), "cam0", found[0], 1.0, 1.09) is None
    assert sum_fault(Path("S"), "cam0", found[0], 1.0, 1.2) is not None
