"""The contact sheet of people."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lightstage.formats.exr import read_exr
from lightstage.rig import default_rig
from sim.errors import SimError
from sim.people.dataset import make_plan
from sim.people.gallery import write_gallery
from sim.people.table import load_table


def test_a_sheet_has_a_row_a_person_and_a_column_an_expression_and_light(tmp_path: Path) -> None:
    """Every place shows somebody, and half the lamps show other pictures than all of them."""
    persons = make_plan(tmp_path, load_table("balanced"), 2, 1, 3, 96).persons
    rig = default_rig().scaled(30 / 4016)
    expressions, lights = ("neutral", "smile"), ("full", "x+")
    out = write_gallery(persons, expressions, lights, rig, 96, tmp_path / "sheet.exr")
    sheet = read_exr(out)
    rows = np.split(sheet, len(persons))
    places = [np.split(row, len(expressions) * len(lights), axis=1) for row in rows]
    for row in places:
        for place in row:
            assert place.max() > 0.1
            assert np.isfinite(place).all()
        assert np.abs(row[0] - row[2]).max() > 0.05
    assert not np.array_equal(places[0][0], places[1][0])


def test_a_sheet_of_another_kind_of_file_is_refused_before_anything_is_rendered(
    tmp_path: Path,
) -> None:
    with pytest.raises(SimError, match="png"):
        write_gallery((), ("neutral",), ("full",), default_rig(), 96, tmp_path / "sheet.tiff")
    assert list(tmp_path.iterdir()) == []
