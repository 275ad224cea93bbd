"""The page of an avatar: the head in its photograph's place, and what is guessed, a line each."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from learning.photo.avatar_page import guesses
from learning.photo.in_place import GREY, around_head, cut, photo_camera
from lightstage.formats.template import Template
from lightstage.rig import look_at

TAKEN = {
    "name": "one.jpg",
    "width_px": 900,
    "height_px": 1200,
    "focal_px": 2000.0,
    "focal_told": True,
    "black_and_white": False,
}
FIT: dict[str, Any] = {"photographs": [TAKEN], "shape_deviation_mm": 2.4, "lamps": 2}


def guessed(**changes: Any) -> dict[str, str]:
    """Lines for a head of which 3 of 4 texels of the surface were seen."""
    confidence = np.array([[0.9, 0.5, 0.1], [0.0, 0.0, 0.0]])
    covered = np.array([[True, True, True], [True, False, False]])
    source: Any = SimpleNamespace(covered=covered, maps={"confidence": confidence})
    lines = guesses({**FIT, **changes}, source)
    assert all(len(line) == 2 for line in lines)
    return dict(map(tuple, lines))


def test_what_a_photograph_does_not_show_is_a_line_each() -> None:
    lines = guessed()
    assert lines["what was not seen"].startswith("25 %")
    assert {"tone of the skin", "hair", "eyes", "teeth, inside of the mouth", "shape"} < set(lines)
    assert "2.4 mm" in lines["shape"]
    assert not any("one.jpg" in name or name == "light" for name in lines)


def test_what_a_photograph_lacks_is_named() -> None:
    taken = {**TAKEN, "focal_told": False, "black_and_white": True}
    lines = guessed(photographs=[taken], lamps=None)
    # 1500 px of diagonal are 43.27 mm of film.
    assert "58 mm" in lines["lens of one.jpg"]
    assert "colour of one.jpg" in lines
    assert "light" in lines


def test_a_tones_uncertainty_is_shown_where_the_fit_states_it() -> None:
    tone = {"ita_deg": 34.6, "span_deg": [12.2, 41.9], "cues": {"exposure": 0.1}}
    line = guessed(tone=tone)["tone of the skin"]
    assert all(number in line for number in ("35", "12", "42"))
    assert guessed()["tone of the skin"] != line


@pytest.mark.parametrize(("distance_mm", "larger"), [(400.0, False), (4000.0, True)])
def test_a_part_of_a_photograph_shows_a_head_where_its_camera_sees_it(
    template: Template, distance_mm: float, larger: bool
) -> None:
    pose = look_at(np.array([0.3 * distance_mm, 20.0, distance_mm]), np.zeros(3))
    camera = photo_camera({**TAKEN, "cam_from_head": pose.tolist()})
    vertices = template.mesh.vertices
    part = around_head(camera, vertices, (300, 400))
    assert (part.fx_px > camera.fx_px) == larger
    inside, _ = part.project(vertices)
    assert inside.min() > 0
    assert (inside < [300, 400]).all()
    # The head fills the part but for its margin.
    assert (np.ptp(inside, axis=0) / [300, 400]).max() == pytest.approx(1 / 1.16)
    nose = vertices[template.landmarks[30]]
    (seen,), (expected,) = camera.project(nose)[0], part.project(nose)[0]
    x, y = np.meshgrid(np.arange(900) + 0.5, np.arange(1200) + 0.5)
    width = max(2.0, 2 * camera.fx_px / part.fx_px)
    spot = np.exp(-((x - seen[0]) ** 2 + (y - seen[1]) ** 2) / (2 * width**2))
    image = np.repeat(spot[..., None], 3, axis=2).astype(np.float32)
    shown = cut(image, camera, part)[..., 0].astype(float)
    x, y = np.meshgrid(np.arange(300) + 0.5, np.arange(400) + 0.5)
    near = np.hypot(x - expected[0], y - expected[1]) < 40
    weight = shown[near] / shown[near].sum()
    found = np.array([(weight * x[near]).sum(), (weight * y[near]).sum()])
    np.testing.assert_allclose(found, expected, atol=0.3)
    aside = vertices + np.array([0.6 * distance_mm, 0, 0])
    np.testing.assert_allclose(cut(image, camera, around_head(camera, aside, (30, 40))), GREY)
