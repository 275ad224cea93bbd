"""Pictures of patterns, measured: lights are bright where they are lit, and so is the ball."""

import cv2
import numpy as np
import pytest

from lightstage.formats.png import write_png
from lightstage.patterns import drive_levels, pattern_levels, sequence_patterns
from lightstage.patterns.picture import SheetConfig, pattern_sheet
from lightstage.patterns.weights import directions
from lightstage.rig import default_rig
from tests.lightstage.patterns.rigs import rig_at

SIDE, GAP, HEAD = 190, 13, 52


def parts(sheet):
    """Front view, view from behind and ball of a sheet's first pattern."""
    top, left = HEAD + 18 + GAP, 2 * GAP
    ball = int(SIDE * 0.72)
    front = sheet[top : top + SIDE, left : left + SIDE]
    behind = sheet[top : top + SIDE, left + SIDE + GAP :][:, :SIDE]
    x, y = GAP + 2 * SIDE + 3 * GAP, top + (SIDE - ball) // 2
    return front, behind, sheet[y : y + ball, x : x + ball]


def brightness(picture):
    left, right = np.array_split(picture.astype(float).mean(axis=2), 2, axis=1)
    upper, lower = np.array_split(picture.astype(float).mean(axis=2), 2, axis=0)
    return {"-x": left.mean(), "+x": right.mean(), "+y": upper.mean(), "-y": lower.mean()}


def of(name, rig=None):
    rig = rig or default_rig()
    return parts(pattern_sheet(rig, [(name, drive_levels(name, rig))], "title"))


def test_a_half_sphere_is_bright_at_its_side_and_mirrored_from_behind():
    front, behind, ball = (brightness(p) for p in of("x+"))
    assert front["+x"] > 2 * front["-x"]
    assert behind["-x"] > 2 * behind["+x"]
    assert ball["+x"] > 1.3 * ball["-x"]


def test_up_is_up_in_both_views_and_on_the_ball():
    for part in map(brightness, of("y+")):
        assert part["+y"] > 1.2 * part["-y"]


def test_light_from_behind_is_seen_from_behind_and_leaves_the_balls_middle_dark():
    front, behind, ball = of("z-")
    assert behind.mean() > 2 * front.mean()
    middle = ball[60:76, 60:76].mean()
    rim = ball[66:70, 8:14].mean()
    assert middle < 30 < 100 < rim


def test_the_ball_is_lambertian_under_one_light():
    rig = rig_at([(0, 0, 1000.0), (1000.0, 0, 0)])
    _, _, ball = of("olat-000", rig)
    size = len(ball)
    line = (np.arange(size) + 0.5) / size * 2 - 1
    x, y = np.meshgrid(line, line)
    inside = np.hypot(x, y) < 0.9
    value = ball[..., 0][inside] / 255.0
    linear = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    known = 0.95 * np.sqrt(1 - x**2 - y**2, where=inside, out=np.zeros_like(x))[inside]
    assert np.abs(linear - known).max() < 0.03


def test_a_brighter_level_is_a_brighter_disc():
    rig = rig_at([(0, 0, 1000.0), (1000.0, 0, 0), (-1000.0, 0, 0)])
    seen = []
    for level in (0.0, 0.1, 0.5, 1.0):
        front, _, _ = parts(pattern_sheet(rig, [("p", np.array([level, 0, 0]))], "t"))
        seen.append(front[SIDE // 2, SIDE // 2].mean())
    assert seen == sorted(seen)
    assert seen[-1] > 250
    assert np.diff(seen).min() > 20


def test_banks_have_colours_of_their_own():
    rig = rig_at([(0, 400.0, 1000.0), (0, -400.0, 1000.0)])  # vertical, horizontal
    front, _, _ = of("dark", rig)
    upper, lower = np.array_split(front.astype(float), 2)
    assert (upper[..., 2] - upper[..., 0]).sum() > (lower[..., 2] - lower[..., 0]).sum()


def test_a_coloured_light_lights_the_ball_in_its_colour():
    rig = rig_at([(0, 0, 1000.0), (0, 0, -1000.0)], gains=[(1.0, 0.0, 0.0), (1.0, 1.0, 1.0)])
    _, _, ball = of("olat-000", rig)
    middle = ball[len(ball) // 2, len(ball) // 2]
    assert middle[0] > 200
    assert middle[1] < 20


def test_all_the_lights_of_the_rig_fit_one_sheet():
    rig = default_rig()
    names = sequence_patterns("olat", rig)
    sheet = pattern_sheet(rig, [(n, pattern_levels(n, rig)) for n in names], "olat")
    assert sheet.shape[1] <= SheetConfig().width_px + 40
    assert sheet.shape[0] < 3000


def test_ten_thousand_lights_are_drawn():
    rig = rig_at(directions(10_000) * 1250)
    front, behind, _ = (brightness(p) for p in of("x+", rig))
    assert front["+x"] > 2.5 * front["-x"]
    assert behind["-x"] > 2.5 * behind["+x"]


def test_darkness_is_drawn_dark():
    _, _, ball = of("dark")
    assert ball.max() < 40


def test_a_sheet_comes_back_from_its_file(tmp_path):
    rig = default_rig()
    sheet = pattern_sheet(rig, [("full", drive_levels("full", rig))], "t")
    path = write_png(tmp_path / "s.png", sheet)
    assert np.array_equal(cv2.imread(str(path))[:, :, ::-1], sheet)
    assert [p.name for p in tmp_path.iterdir()] == ["s.png"]


@pytest.mark.parametrize("count", [1, 2, 7, 30])
def test_every_pattern_has_its_place(count):
    rig = rig_at(np.eye(3) * 1000)
    many = pattern_sheet(rig, [(f"p{k}", np.ones(3)) for k in range(count)], "t")
    balls = cv2.connectedComponents((many.min(axis=2) > 235).astype(np.uint8))[1]
    sizes = np.bincount(balls.ravel())[1:]
    assert (sizes > 0.4 * sizes.max()).sum() >= count
