"""What `full` was in a session, and what that makes of the scale."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lightstage.errors import FormatError
from lightstage.formats.environment import stage_lights
from lightstage.formats.files import write_json
from lightstage.formats.scale import full_levels, raw_scale
from lightstage.formats.session import Calibration, Driven, Session, SessionFile
from lightstage.patterns import drive_levels
from lightstage.rig import Rig, default_rig
from lightstage.session.colour import read_colour

COLOUR = "calibration/colour.json"


def bare(
    rig: Rig, driven: dict[str, np.ndarray], root: Path = Path(), colour: object = None
) -> Session:
    if colour is not None:
        write_json(root / COLOUR, {"schema": "lightstage.colour/1", "full_levels": colour})
    file = SessionFile(
        id="s",
        created_utc="",
        subject="p",
        expression="neutral",
        sequence=list(driven),
        frames=[],
        patterns={name: Driven(levels=list(level)) for name, level in driven.items()},
        calibration=Calibration(colour=None if colour is None else COLOUR),
    )
    return Session(root, file, rig)


@pytest.mark.parametrize(
    "names",
    [
        ("full", "x+"),
        ("x+", "x-"),
        ("y+", "lin-z-", "lin-z+"),
        ("mux-1", "mux-2"),
        ("full@cross", "full@parallel"),
        ("y-@cross", "y+@parallel", "y-@parallel", "y+@cross"),
    ],
)
@pytest.mark.parametrize("drive", ["solid-angle", "on-off"])
def test_full_is_found_from_what_was_driven(names, drive):
    rig = default_rig()
    session = bare(rig, {name: drive_levels(name, rig, drive) for name in names})
    known = drive_levels("full", rig, drive)
    np.testing.assert_allclose(full_levels(session), known, rtol=0, atol=1e-12)


def test_where_full_cannot_be_told_the_chart_says_it_and_else_it_is_level_1(tmp_path):
    rig = default_rig()
    driven = {"x+": drive_levels("x+", rig), "olat-004": drive_levels("olat-004", rig)}
    assert np.array_equal(full_levels(bare(rig, driven)), np.ones(168))
    weighted = drive_levels("full", rig)
    session = bare(rig, driven, tmp_path, weighted.tolist())
    assert np.array_equal(full_levels(session), weighted)
    assert raw_scale(session) == 1


def test_a_chart_lit_half_as_brightly_halves_the_scale(tmp_path):
    rig = default_rig()
    session = bare(rig, {"full": np.ones(168)}, tmp_path, [0.5] * 168)
    assert raw_scale(session) == pytest.approx(0.5)


@pytest.mark.parametrize(
    "levels", [[1.0] * 3, [2.0] * 168, [None] * 168, [0.0] * 168, "bright", [["a"]]]
)
def test_a_charts_levels_that_do_not_fit_are_refused(tmp_path, levels):
    with pytest.raises(FormatError, match=r"colour.json, full_levels: .*expected 168 levels"):
        raw_scale(bare(default_rig(), {}, tmp_path, levels))


def test_white_reads_one_under_what_full_was_and_a_dark_full_is_refused():
    rig = default_rig()
    full = drive_levels("full", rig)
    lights = stage_lights(rig, full, "full", full)
    away = lights.position_mm / np.linalg.norm(lights.position_mm, axis=1, keepdims=True)
    assert np.allclose(np.clip(away[:, 2], 0, None) @ lights.rgb, 1)
    behind = (rig.positions_mm[:, 2] < 0).astype(float)
    with pytest.raises(FormatError, match="no light in front"):
        stage_lights(rig, full, "full", behind)


def test_a_capture_refuses_a_calibration_made_with_another_rig(tmp_path):
    rig = default_rig()
    cameras = {camera.id: {"linear_from_raw": np.eye(3).tolist()} for camera in rig.cameras}
    value = {"schema": "lightstage.colour/1", "cameras": cameras, "full_levels": [1.0] * 168}
    path = write_json(tmp_path / "colour.json", value)
    assert read_colour(path, rig) == value
    write_json(path, value | {"full_levels": [1.0] * 12})
    with pytest.raises(FormatError, match="full_levels: found 12 values, expected 168 levels"):
        read_colour(path, rig)
