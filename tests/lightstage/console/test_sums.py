"""Pictures of light that should add up: what agrees is grey, what does not has its colour."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.console.following import Followed
from lightstage.console.sums import FULL_COLOUR, LEAST_SHOWN, difference, sum_picture
from lightstage.errors import FormatError
from lightstage.formats.exr import write_exr

SIZE = (96, 64)


def face(shift: int = 0) -> np.ndarray:
    """(96, 64) an even disc with detail, moved to the right."""
    rows, columns = np.indices(SIZE)
    off = np.hypot(rows - 48, columns - 32 - shift)
    return np.where(off < 25, 0.5 + 0.1 * np.sin(off / 2 + (columns - shift) / 3), 0.001)


def coloured(picture: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels that are orange, and that are blue."""
    blue, _, red = np.moveaxis(picture.astype(int), 2, 0)
    return red - blue > 20, blue - red > 20


def test_what_adds_up_is_grey_and_what_does_not_is_orange_or_striped_blue() -> None:
    whole = face()
    orange, blue = coloured(difference(whole * (1 + 0.5 * LEAST_SHOWN), whole))
    assert not orange.any()
    assert not blue.any()
    lit = whole > 0.1
    orange, blue = coloured(difference(whole * (1 + FULL_COLOUR), whole))
    assert np.array_equal(orange, lit)
    orange, blue = coloured(difference(whole * (1 - FULL_COLOUR), whole))
    assert not orange.any()
    assert 0.3 < blue[lit].mean() < 0.7  # in stripes, so that the colour is not the only sign


def test_a_subject_that_moved_has_edges_of_both_colours() -> None:
    whole = face()
    orange, blue = coloured(difference(0.5 * face(3) + 0.5 * whole, whole))
    assert orange.any()
    assert blue.any()
    assert (orange | blue).sum() < 0.6 * (whole > 0.1).sum()


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 1e-30, 1.0, 1e30]))
def test_any_light_makes_a_picture(seed: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    together, whole = scale * rng.normal(size=(2, 8, 9))
    together[rng.random((8, 9)) < 0.2] = rng.choice([np.nan, np.inf, -np.inf, 0.0])
    assert difference(together, whole).shape == (8, 9, 3)


def written(folder: Path, name: str, light: np.ndarray) -> Path:
    return write_exr(folder / f"{name}.exr", np.repeat(light[..., None], 3, axis=2))


def test_figures_are_the_checks_own(tmp_path) -> None:
    columns = np.indices((192, 128))[1]
    whole = cv2.resize(face(), (128, 192), interpolation=cv2.INTER_CUBIC)
    left = np.clip(columns / 128, 0, 1) * whole
    paths = [written(tmp_path, n, v) for n, v in (("a", left), ("b", whole - left), ("w", whole))]
    data, facts = sum_picture(*paths, 64)
    assert max(cv2.imdecode(np.frombuffer(data, np.uint8), 1).shape) <= 64
    assert facts.off is not None
    assert facts.off < 0.01
    moved = [paths[0], written(tmp_path, "c", np.roll(whole - left, 2, axis=1)), paths[2]]
    _, facts = sum_picture(*moved, 64)
    assert facts.moved_px == pytest.approx(2.0, abs=0.7)
    brighter = [paths[0], written(tmp_path, "d", 1.3 * (whole - left)), paths[2]]
    _, facts = sum_picture(*brighter, 64)
    assert facts.off is not None
    assert facts.misfit is not None
    assert facts.off > 0.1 > 0.03 > facts.misfit
    with pytest.raises(FormatError, match="shape"):
        sum_picture(paths[0], written(tmp_path, "e", whole[::2]), paths[2], 64)


def test_a_sum_is_found_as_soon_as_all_three_are_photographed(tmp_path) -> None:
    root = tmp_path / "S"
    root.mkdir()
    lines = [
        {"event": "begin", "session": "s", "subject": "P1", "expression": "e", "cameras": ["cam0"],
         "sequence": ["full", "x+", "x-"], "created_utc": "2031-05-06T10:00:00+00:00"},
    ]  # fmt: skip
    for name, levels in (("full", [1.0, 1.0]), ("x+", [1.0, 0.0]), ("x-", [0.0, 1.0])):
        lines.append({"event": "lit", "pattern": name, "levels": levels})
        lines.append({"event": "frame", "pattern": name, "camera": "cam0", "take": 1,
                      "sha256": name, "path": f"frames/{name}/cam0.dng"})  # fmt: skip

    def followed(count: int) -> Followed:
        text = "".join(json.dumps({"id": n, **each}) + "\n" for n, each in enumerate(lines[:count]))
        (root / "journal.jsonl").write_text(text)
        found = Followed(root, 10)
        found.update()
        return found

    assert followed(5).sum_of("full", "cam0") is None
    found = followed(7).sum_of("full", "cam0")
    assert found is not None
    assert found[0].patterns == ("x+", "x-", "full")
    assert [each.sha256 for each in found[1]] == ["x+", "x-", "full"]
    assert followed(7).sum_of("full", "cam1") is None
    lines[-2] = {"event": "lit", "pattern": "x-", "levels": [0.0, 1.0, 0.0]}
    assert followed(7).sum_of("full", "cam0") is None
