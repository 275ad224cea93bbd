"""A user's own patterns: what each kind lights, and every fault told at once."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage.errors import ConfigError, LightstageError, PatternError
from lightstage.formats.exr import write_exr
from lightstage.patterns import drive_levels, light_weights, read_patterns
from lightstage.patterns.own import PatternConfig, make_pattern
from lightstage.rig import default_rig

RIG = default_rig()
TOWARD = RIG.positions_mm / 1250.0


def read(tmp_path, text):
    path = tmp_path / "own.toml"
    path.write_text(text)
    return read_patterns(path, RIG)


def one(tmp_path, text):
    return read(tmp_path, f"[patterns.mine]\n{text}")["mine"]


def test_levels_are_taken_as_they_stand(tmp_path):
    ramp = (np.arange(168) / 167).tolist()
    mine = one(tmp_path, f"levels = {ramp}")
    assert mine.levels.tolist() == ramp
    assert not mine.is_field
    assert mine.summary == "167 of 168 lamps"


def test_lights_are_chosen_by_id_and_by_name(tmp_path):
    mine = one(tmp_path, 'lights = [3, 20]\nnames = ["arc02/*", "arc?5/light00"]\nlevel = 0.25')
    lit = {light.name for light, x in zip(RIG.lights, mine.levels, strict=True) if x}
    arc = {f"arc02/light{k:02d}" for k in range(14)}
    assert lit == {*arc, "arc00/light03", "arc01/light06", "arc05/light00"}
    assert set(mine.levels) == {0.0, 0.25}
    assert not mine.is_field


def test_a_cap_is_lit_up_to_its_rim(tmp_path):
    mine = one(tmp_path, "direction = [2, 0, 2]\ncap_deg = 40.0")
    angle = np.degrees(np.arccos((TOWARD @ [1, 0, 1]) / np.sqrt(2)))
    assert np.array_equal(mine.levels, (angle <= 40).astype(float))
    assert mine.is_field


def test_a_cosine_falls_off_to_its_power_and_ends_at_the_side(tmp_path):
    mine = one(tmp_path, "direction = [0, 3, 0]\ncosine = 2\nlevel = 0.5")
    assert np.allclose(mine.levels, 0.5 * np.maximum(TOWARD[:, 1], 0) ** 2)
    driven = drive_levels("mine", RIG, own={"mine": mine})
    assert np.allclose(driven, mine.levels * light_weights(RIG), atol=1e-5)


def test_an_environment_stands_beside_the_file(tmp_path):
    write_exr(tmp_path / "even.exr", np.full((8, 16, 3), 2.0))
    mine = one(tmp_path, 'environment = "even.exr"\nexposure_stops = -1')
    # Light from everywhere is `full` by solid angle.
    assert np.allclose(mine.levels, 0.5 * light_weights(RIG), rtol=0.05)
    assert mine.levels.max() == pytest.approx(0.5)
    assert mine.scale == pytest.approx(0.5 / (2.0 * 4 * np.pi / light_weights(RIG).sum()), rel=0.03)
    assert f"level {mine.scale:.4g} for one unit" in mine.summary
    assert not mine.is_field  # it is summed over solid angles already


def test_lights_too_faint_for_the_wire_are_reported(tmp_path):
    picture = np.full((16, 32, 3), 1e-4)
    picture[8, 16] = 6e4
    write_exr(tmp_path / "sun.exr", picture)
    mine = one(tmp_path, 'environment = "sun.exr"')
    assert "of them too faint for the wire's steps, so dark" in mine.summary
    assert drive_levels("mine", RIG, own={"mine": mine}).max() == 1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "found none of them, expected one of levels"),
        ("levels = [1, 0]", "levels: found 2 values, expected 168 numbers"),
        ("levels = [true]", r"levels\[0\]: found True, expected a number"),
        (f"levels = {[0.5] * 167 + [1.5]}", r"levels\[167\]: found 1.5, expected 0..1"),
        (f"levels = {[0.5] * 167} ".replace("]", ", nan]"), r"levels\[167\]: found nan"),
        ("lights = [168]", "lights: found 168, expected ids of the rig"),
        ('lights = ["3"]', r"lights\[0\]: found '3', expected a whole number"),
        ('names = ["ring*"]', "names: found no lamp named 'ring.'"),
        ("lights = [1]\nlevel = -0.1", "level: found -0.1, expected 0..1"),
        ("lights = [1]\ncap_deg = 3.0", "cap_deg: found it beside lights"),
        ("lights = [1]\ndirection = [1,0,0]", "found lights and direction"),
        (
            "direction = [0, 0, 0]\ncap_deg = 3.0",
            "direction: found .0.0, 0.0, 0.0., expected finite",
        ),
        ("direction = [1, inf, 0]\ncap_deg = 3.0", r"direction\[1\]: found inf"),
        ("direction = [1, 0]\ncap_deg = 3.0", "direction: found 2 values, expected 3 numbers"),
        ("direction = [1, 0, 0]", "found no shape, expected cap_deg or cosine"),
        ("direction = [1, 0, 0]\ncap_deg = 3.0\ncosine = 1.0", "found both"),
        ("direction = [0, 1, 0]\ncap_deg = 1.0", "found no lamp there"),
        ("direction = [0, 1, 0]\ncap_deg = 181", "cap_deg: found 181"),
        ("direction = [0, 1, 0]\ncosine = -1.0", "cosine: found -1.0, expected above 0"),
        ("direction = [0, 1, 0]\ncosine = nan", "cosine: found nan"),
        ('environment = "none.exr"', "none.exr: found no such file"),
        (
            'environment = "none.exr"\nexposure_stops = 1.0',
            "exposure_stops: found 1.0, expected at",
        ),
        ('environment = "none.exr"\nrotate_deg = inf', "rotate_deg: found inf"),
        ('environment = "sky.jpg"', "sky.jpg: found .jpg, expected .exr, .hdr or .json"),
        ("lights = []", "lights: found no lamp"),
        ("level = 1" + "0" * 400, "level: found a number too large"),
        (f"levels = [1{'0' * 400}]", r"levels\[0\]: found a number too large"),
        ('environment = "' + "a" * 300 + '.exr"', "environment: found"),
        ("brightness = 1", "brightness: found an unknown key"),
        ('level = "high"', "level: found 'high', expected a number"),
    ],
)
def test_a_fault_is_reported_with_its_place(tmp_path, text, message):
    with pytest.raises(LightstageError, match=message):
        one(tmp_path, text)


@pytest.mark.parametrize("name", ["full", "dark", "binary", "olat", "lin-mine", "mux-3", "olat-7"])
def test_a_name_of_the_stage_is_refused(tmp_path, name):
    with pytest.raises(PatternError, match="a name that the stage uses itself"):
        read(tmp_path, f"[patterns.{name}]\nlights = [1]")


@pytest.mark.parametrize("name", ["x+", "Rim", "a@cross", "a,b", "../up", "é", "", "a" * 33, "1st"])
def test_a_name_that_makes_no_good_folder_is_refused(tmp_path, name):
    with pytest.raises(PatternError, match="expected a small letter"):
        read(tmp_path, f'[patterns."{name}"]\nlights = [1]')


def test_all_faults_of_a_file_are_one_message(tmp_path):
    text = "[patterns.full]\nlights=[1]\n[patterns.a]\nlights=[999]\n[patterns.b]\nlights=[2]\n"
    with pytest.raises(PatternError, match=r"(?s)2 problems.*patterns.full.*patterns.a.*999"):
        read(tmp_path, text)


def test_a_file_without_patterns_or_with_other_tables_is_refused(tmp_path):
    with pytest.raises(PatternError, match="found no pattern"):
        read(tmp_path, "")
    with pytest.raises(ConfigError, match="lights: found an unknown key"):
        read(tmp_path, "[lights.a]\nlevel = 1")
    with pytest.raises(PatternError, match="found int, expected a table"):
        read(tmp_path, "[patterns]\na = 1")
    with pytest.raises(ConfigError, match="no such file"):
        read_patterns(tmp_path / "none.toml", RIG)


plain = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5)
values = (
    plain | st.lists(plain, max_size=4) | st.just([1, 0.5, 0]) | st.dictionaries(st.text(), plain)
)


@settings(max_examples=300)
@given(st.dictionaries(st.sampled_from(list(PatternConfig.__dataclass_fields__)), values))
def test_whatever_a_table_holds_it_is_a_pattern_or_one_clear_error(table):
    try:
        made = make_pattern("mine", table, "own.toml", Path("/nowhere"), RIG)
    except LightstageError:
        return
    assert made.levels.shape == (168,)
    assert ((made.levels >= 0) & (made.levels <= 1)).all()
