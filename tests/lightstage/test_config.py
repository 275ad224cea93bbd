"""Configuration: defaults, overrides, and unknown keys refused."""

import dataclasses
import datetime
import os
import types
import typing
from pathlib import Path
from typing import Any, Literal

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage.errors import ConfigError, PatternError
from lightstage.formats.config import as_dict, make_config, read_toml, require_bounds


@dataclasses.dataclass(frozen=True)
class Inner:
    size_px: int = 3
    gain: float = 1.0


@dataclasses.dataclass(frozen=True)
class Outer:
    mode: Literal["fast", "exact"] = "fast"
    limit_mm: float | None = None
    name: str = "a"
    on: bool = False
    path: Path = Path("x")
    sizes: tuple[int, ...] = (1, 2)
    inner: Inner = dataclasses.field(default_factory=Inner)


@dataclasses.dataclass(frozen=True)
class Lamp:
    name: str
    rgb: tuple[float, float, float] = (1.0, 1.0, 1.0)


@dataclasses.dataclass(frozen=True)
class Stage:
    lamp: Lamp | None = None
    lamps: tuple[Lamp, ...] = ()
    by_name: dict[str, Lamp] = dataclasses.field(default_factory=dict)
    texts: dict[str, str] = dataclasses.field(default_factory=dict)
    rows: tuple[tuple[int, int], ...] = ()
    outer: Outer = dataclasses.field(default_factory=Outer)


def test_defaults_stand_where_nothing_is_given():
    assert make_config(Outer, {}, "t") == Outer()


def test_values_override_defaults_nested_too():
    values = {
        "mode": "exact",
        "limit_mm": 2,
        "path": "y/z",
        "sizes": [4],
        "on": True,
        "inner": {"gain": 2},
    }
    got = make_config(Outer, values, "t")
    expected = Outer("exact", 2.0, "a", True, Path("y/z"), (4,), Inner(3, 2.0))
    assert got == expected
    assert isinstance(got.inner.gain, float)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"mod": "fast"}, "t, mod: found an unknown key, expected one of inner, limit_mm, mode"),
        (
            {"inner": {"size": 1}},
            r"t, inner\.size: found an unknown key, expected one of gain, size_px",
        ),
        ({"mode": "slow"}, "mode: found 'slow', expected 'fast' or 'exact'"),
        ({"name": 3}, 'name: found 3, expected a text. Write it in quotes: "3".'),
        ({"on": 1}, "on: found 1, expected true or false"),
        ({"inner": {"size_px": True}}, "inner.size_px: found True, expected a whole number"),
        ({"inner": {"size_px": 1.5}}, "inner.size_px: found 1.5, expected a whole number"),
        ({"inner": {"gain": "high"}}, "inner.gain: found 'high', expected a number"),
        ({"inner": 3}, "inner: found 3, expected a table"),
        ({"sizes": 3}, "sizes: found 3, expected a list"),
        ({"limit_mm": "far"}, "limit_mm: found 'far', expected a number"),
    ],
)
def test_unknown_keys_and_wrong_types_are_refused(values, message):
    with pytest.raises(ConfigError, match=message):
        make_config(Outer, values, "t")


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"rows": [[1, 2], [3]]}, r"t, rows\[1\]: found 1 value, expected 2 values"),
        ({"rows": [[1, 2, 3]]}, r"t, rows\[0\]: found 3 values, expected 2 values"),
        ({"lamp": {"name": "a", "rgb": [1]}}, r"t, lamp\.rgb: found 1 value, expected 3 values"),
        ({"lamp": {"rgb": [1, 1, 1]}}, r"t, lamp\.name: found no such field, expected it"),
        (
            {"lamp": {"name": "a", "x": 1}},
            r"lamp\.x: found an unknown key, expected one of name, rgb",
        ),
        ({"lamps": [{"name": "a", "x": 1}]}, r"lamps\[0\]\.x: .*, expected one of name, rgb"),
        ({"by_name": {"a": {"x": 1}}}, r"by_name\.a\.x: .*, expected one of name, rgb"),
        ({"by_name": {"name": {"x": 1}}}, r"by_name\.name\.x: .*, expected one of name, rgb"),
        ({"texts": {"iso": True}}, 't, texts.iso: found True, expected a text. .*"true"'),
        ({"rows": datetime.date(2026, 1, 1)}, "t, rows: found a date, expected text, a number"),
        ({"rows": 1 << 20_000}, "t, rows: found a number too large, expected whole numbers"),
        ([], r"t: found \[\], expected a table"),
    ],
)
def test_tables_and_lists_in_each_other_are_refused_by_their_place(values, message):
    with pytest.raises(ConfigError, match=message):
        make_config(Stage, values, "t")


def test_all_that_is_wrong_in_a_file_is_in_one_message():
    values = {"texts": {"iso": 100}, "outer": {"mod": 1, "on": "yes"}, "lamps": 3}
    with pytest.raises(ConfigError, match=r"(?s)4 problems.*lamps.*texts\.iso.*outer\.") as caught:
        make_config(Stage, values, "t")
    assert all(line.startswith("  t, ") for line in str(caught.value).split("\n")[1:])


def test_a_message_lists_fifty_problems_and_counts_the_others():
    with pytest.raises(
        ConfigError, match=r"(?s)51 problems.*sizes\[49\]: .*  t: found 9 more prob"
    ):
        make_config(Outer, {"sizes": ["a"] * 59}, "t")


def test_what_a_dataclass_refuses_has_its_own_class_and_names_the_file():
    @dataclasses.dataclass(frozen=True)
    class Refusing:
        pattern: str = "x+"

        def __post_init__(self):
            if self.pattern == "q":
                raise PatternError("patterns", found=self.pattern)

    @dataclasses.dataclass(frozen=True)
    class Holder:
        inner: Refusing = dataclasses.field(default_factory=Refusing)

    with pytest.raises(PatternError, match=r"lab\.toml: patterns: found q"):
        make_config(Holder, {"inner": {"pattern": "q"}}, Path("lab.toml"))


NAMES = [field.name for cls in (Inner, Outer, Lamp, Stage) for field in dataclasses.fields(cls)]
SINGLE = (
    st.sampled_from([None, True, False, "5", "true", "fast", "\0", "\ud800", b"x", Path("x")])
    | st.sampled_from([0, 1, 1.0, -1.5, 2**63, 10**400, 1e308, float("nan"), float("inf")])
    | st.sampled_from([datetime.datetime(2026, 1, 1), datetime.date(2026, 1, 1), datetime.time(1)])
    | st.text()
    | st.integers()
    | st.floats()
)
HOSTILE = st.recursive(
    SINGLE,
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.lists(inner, max_size=4).map(tuple)
        | st.dictionaries(st.sampled_from(NAMES) | st.text(max_size=3), inner, max_size=4)
    ),
    max_leaves=8,
)


def fits(value: Any, hint: Any) -> bool:
    """Whether a value has an annotated type, exactly."""
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if origin is types.UnionType:
        return any(fits(value, each) for each in args)
    if origin is Literal:
        return value in args
    if dataclasses.is_dataclass(hint):
        hints = typing.get_type_hints(hint)
        return type(value) is hint and all(fits(getattr(value, n), h) for n, h in hints.items())
    if origin is tuple:
        kinds = args[:1] * len(value) if args[-1] is ... else args
        return type(value) is tuple and all(map(fits, value, kinds)) and len(value) == len(kinds)
    if origin is dict:
        return (
            type(value) is dict
            and all(type(k) is str for k in value)
            and all(fits(each, args[1]) for each in value.values())
        )
    return isinstance(value, hint) and (hint is Path or type(value) is hint)


def same(given: Any, got: Any) -> bool:
    """Whether a field is what was given for it, so that no text became a number."""
    if isinstance(given, dict):
        inside = got if isinstance(got, dict) else vars(got)
        return all(same(value, inside[name]) for name, value in given.items())
    if isinstance(given, list | tuple):
        return len(given) == len(got) and all(map(same, given, got))
    if isinstance(got, Path):
        return Path(given) == got
    if isinstance(got, float) and type(given) is int:
        return float(given) == got
    return given == got and isinstance(given, bool) == isinstance(got, bool)


def hostile_to(cls: type[Any]) -> st.SearchStrategy[tuple[type[Any], Any]]:
    """A dataclass and hostile values of its fields, or in their place."""
    names = st.sampled_from([field.name for field in dataclasses.fields(cls)])
    one = st.dictionaries(names, SINGLE | st.lists(SINGLE, max_size=3), min_size=1, max_size=1)
    return st.tuples(st.just(cls), one | st.dictionaries(names, HOSTILE, max_size=3) | HOSTILE)


@settings(max_examples=500)
@given(hostile_to(Inner) | hostile_to(Outer) | hostile_to(Lamp) | hostile_to(Stage))
def test_hostile_values_are_a_configuration_of_the_given_values_or_one_error(case):
    cls, values = case
    try:
        config = make_config(cls, values, "t")
    except ConfigError:
        return
    assert fits(config, cls)
    assert same(values, config)


def test_a_toml_file_is_read_or_refused_with_its_name(tmp_path):
    path = tmp_path / "c.toml"
    with pytest.raises(ConfigError, match="no such file"):
        read_toml(path)
    path.write_text("[inner]\ngain = 2\n")
    assert read_toml(path) == {"inner": {"gain": 2}}
    path.write_bytes(b"\xff\xfe = [")
    with pytest.raises(ConfigError, match="UTF-8"):
        read_toml(path)


def test_a_resolved_configuration_is_json_ready():
    assert as_dict(Outer())["path"] == "x"
    assert as_dict(Outer())["inner"] == {"size_px": 3, "gain": 1.0}


@dataclasses.dataclass(frozen=True)
class Bounded:
    size_px: int = 10
    share: float = 0.5
    on: bool = False

    def __post_init__(self):
        require_bounds(self, "bounded", {"size_px": (1, 100)})


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"size_px": 0}, "size_px: found 0, expected from 1 to 100"),
        ({"size_px": 101}, "size_px: found 101"),
        ({"share": -0.1}, "share: found -0.1, expected 0 or more"),
        ({"share": float("nan")}, "share: found nan, expected"),
        ({"share": float("inf")}, "share: found inf, expected"),
        ({"share": -1.0, "size_px": -1}, "2 problems"),
    ],
)
def test_a_number_outside_its_bounds_is_refused(values, message):
    with pytest.raises(ConfigError, match=message):
        make_config(Bounded, values, "t")
    with pytest.raises(ConfigError, match=message):
        Bounded(**values)
    assert make_config(Bounded, {"size_px": 100, "share": 0, "on": True}, "t").share == 0


@pytest.mark.parametrize("values", [{"sizes": [1, "a"]}, {"sizes": [True]}, {"sizes": [[1]]}])
def test_each_value_of_a_list_has_its_type(values):
    with pytest.raises(ConfigError, match=r"sizes\[\d\]: found .*, expected a whole number"):
        make_config(Outer, values, "t")


OF_A_CAPTURE = [
    "[checks]\nthumbnail_px = 0",
    "[checks]\nthumbnail_px = 1000000000",
    "[checks]\nkept_photographs = -1",
    "[checks]\nmin_snr = -1.0",
    "[operator]\nretakes = -1",
    "[calibration]\nretakes_per_pose = -1",
    "[calibration]\nclock_slack_s = -5.0",
    "[calibration]\ndark_poses = 0",
    "[calibration.look]\nlooked_at_px = 0",
    "[calibration.look]\nmin_board_cameras = 0",
    "[deadlines]\nopen_s = 0.0",
    "[preflight]\nspace_margin = -0.5",
    "trigger_lead_s = -1.0",
    "downloads = 0",
    "downloads = 1000000",
]


@pytest.mark.parametrize("text", OF_A_CAPTURE)
def test_a_capture_refuses_a_number_out_of_bounds_before_any_device_is_opened(tmp_path, text):
    from lightstage.capture.command import read_config

    path = tmp_path / "capture.toml"
    path.write_text(text)
    name = text.split("\n")[-1].split(" ")[0]
    with pytest.raises(ConfigError, match=f"{name}: found"):
        read_config(path)


def test_a_table_of_names_in_a_folder_that_no_journal_can_name_is_refused(tmp_path):
    from lightstage.capture.command import read_config

    folder = tmp_path / os.fsdecode(b"caf\xe9")
    folder.mkdir()
    path = folder / "capture.toml"
    path.write_text('[session]\npseudonyms = "names.csv"')
    with pytest.raises(ConfigError, match=r"session\.pseudonyms: found text with half a character"):
        read_config(path)
