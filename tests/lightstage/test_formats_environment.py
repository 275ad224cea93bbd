"""Light sets and the common scale: a white diffuser at the origin under `full` reads 1."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage.errors import FormatError
from lightstage.formats.environment import LightSet, read_lights, stage_lights, write_lights
from lightstage.rig import Light, Rig, default_rig


def read_of_white(lights, normal, at=(0, 0, 0)):
    """Plain: what a perfect white diffuser reads, by Lambert and the inverse square."""
    total = np.zeros(3)
    for place, rgb in zip(lights.position_mm, lights.rgb, strict=True):
        away = place - np.array(at, float)
        distance = np.linalg.norm(away)
        cosine = max(0.0, float(np.dot(normal, away / distance)))
        total += rgb * cosine * (np.linalg.norm(place) / distance) ** 2
    return total


def test_the_manual_s_light_set_is_one(tmp_path):
    manual = Path(__file__).resolve().parents[2] / "docs" / "renderer.md"
    path = tmp_path / "key.json"
    path.write_text(manual.read_text().split("```json\n")[1].split("```")[0])
    lights = read_lights(path)
    assert (lights.name, len(lights.rgb)) == ("key", 2)
    assert np.allclose(read_of_white(lights, [0, 0, 1])[0] + lights.ambient_rgb[0], 0.76, atol=0.01)


def test_white_at_the_origin_under_full_reads_one():
    rig = default_rig()
    lights = stage_lights(rig, np.ones(168), "full")
    assert np.allclose(read_of_white(lights, [0, 0, 1]), 1)


@settings(max_examples=25)
@given(st.lists(st.floats(0, 1), min_size=168, max_size=168))
def test_light_is_linear_in_the_levels(levels):
    rig = default_rig()
    level = np.array(levels)
    normal = np.array([0.2, 0.3, 0.9])
    parts = read_of_white(stage_lights(rig, level, "a"), normal) + read_of_white(
        stage_lights(rig, 1 - level, "b"), normal
    )
    assert np.allclose(parts, read_of_white(stage_lights(rig, np.ones(168), "c"), normal))


def test_nearer_lights_are_stronger_and_gains_count():
    lights = tuple(
        Light(i, f"l{i}", (0.0, 0.0, z), "horizontal", gain)
        for i, (z, gain) in enumerate(
            [(1000.0, (1, 1, 1)), (2000.0, (1, 1, 1)), (1000.0, (2, 1, 0.5))]
        )
    )
    one = [stage_lights(Rig(lights, ()), np.eye(3)[i], "x").rgb[0] for i in range(3)]
    assert np.allclose(one[0], 4 * one[1])
    assert np.allclose(one[2], one[0] * [2, 1, 0.5])


def test_unlit_lights_are_left_out_and_colours_may_differ():
    levels = np.zeros((168, 3))
    levels[7] = [1, 0.5, 0]
    lights = stage_lights(default_rig(), levels, "one")
    assert lights.position_mm.shape == (1, 3)
    assert lights.rgb[0, 1] == pytest.approx(lights.rgb[0, 0] / 2)


def test_a_light_set_survives_its_file(tmp_path):
    lights = stage_lights(default_rig(), np.linspace(0, 1, 168), "ramp")
    read = read_lights(write_lights(lights, tmp_path / "e.json"))
    assert read.name == "ramp"
    assert np.array_equal(read.position_mm, lights.position_mm)
    assert np.array_equal(read.rgb, lights.rgb)


@pytest.mark.parametrize(
    ("lights", "message"),
    [
        ([{"position_mm": [0, 0, 0], "rgb": [1, 1, 1]}], "a light at the origin"),
        ([{"position_mm": [0, 0, 900], "rgb": [1, -1, 1]}], "NaN or negative"),
        ([{"position_mm": [0, 0, 900]}], "found no rgb, expected both"),
        ([{"position": [0, 0, 900], "rgb": [1, 1, 1]}], "found no position_mm, expected both"),
        ([{"position_mm": [0, 900], "rgb": [1, 1, 1]}], "position_mm and rgb"),
        ([{"position_mm": [[0, 0, 9], [9, 0, 9]], "rgb": [1, 1, 1]}], "of entry 0"),
        ([{"position_mm": [0, 0, 9] * 2, "rgb": [1, 1, 1] * 2}], "of entry 0"),
        ([{"position_mm": ["1", "2", "300"], "rgb": [1, 1, 1]}], "of entry 0"),
        ([{"position_mm": [0, 0, 900], "rgb": [True, 1, 1]}], "rgb .* of entry 0"),
        (
            {"position_mm": [0, 0, 900], "rgb": [1, 1, 1]},
            "lights: found .*expected a list",
        ),
        ([[0, 0, 900]], "lights: found .*expected a list"),
        (None, "lights: found none, expected a list of lights"),
    ],
)
def test_a_malformed_light_set_is_refused(tmp_path, lights, message):
    path = tmp_path / "e.json"
    path.write_text(json.dumps({"schema": "lightstage.environment/1", "lights": lights}))
    with pytest.raises(FormatError, match=message):
        read_lights(path)


def test_an_ambient_term_alone_is_a_light_set(tmp_path):
    empty = LightSet("grey", np.zeros((0, 3)), np.zeros((0, 3)), np.full(3, 0.4))
    read = read_lights(write_lights(empty, tmp_path / "e.json"))
    assert read.ambient_rgb.tolist() == [0.4] * 3
