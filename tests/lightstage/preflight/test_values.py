"""What the makers' spellings of settings mean."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.preflight import values


def words(text):
    return text.split()


# As libgphoto2 lists them for a Nikon D7000 (cut after four places), and as Canon marks them.
NIKON = words("""
0.0002s 0.0003s 0.0004s 0.0005s 0.0006s 0.0008s 0.0010s 0.0012s 0.0015s 0.0020s 0.0025s
0.0031s 0.0040s 0.0050s 0.0062s 0.0080s 0.0100s 0.0125s 0.0166s 0.0200s 0.0250s 0.0333s 0.0400s
0.0500s 0.0666s 0.0769s 0.1000s 0.1250s 0.1666s 0.2000s 0.2500s 0.3333s 0.4000s 0.5000s 0.6250s
0.7692s 1.0000s 1.3000s 1.6000s 2.0000s 2.5000s 3.0000s 4.0000s 5.0000s 6.0000s 8.0000s 10.0000s
13.0000s 15.0000s 20.0000s 25.0000s 30.0000s""")
CANON = words("""
1/5000 1/3200 1/2500 1/2000 1/1600 1/1250 1/1000 1/800 1/640 1/500 1/400 1/320 1/250
1/200 1/160 1/125 1/100 1/80 1/60 1/50 1/40 1/30 1/25 1/20 1/15 1/13 1/10 1/8 1/6 1/5 1/4 0.3 0.4
0.5 0.6 0.8 1 1.3 1.6 2 2.5 3.2 4 5 6 8 10 13 15 20 25 30""")


def test_each_shutter_time_of_one_maker_is_the_same_place_of_the_others_list():
    for mine, theirs in zip(NIKON, CANON, strict=True):
        assert values.same_value("shutter", mine, theirs), (mine, theirs)


@pytest.mark.parametrize("times", [CANON, NIKON[6:]])
def test_different_times_of_one_list_are_different(times):
    for one, other in itertools.combinations(times, 2):
        assert not values.same_value("shutter", one, other), (one, other)


@pytest.mark.parametrize(
    ("name", "one", "other"),
    [
        ("shutter", "1/60", "0.0167"),
        ("shutter", "1/60", "1/64"),
        ("shutter", "300/10", "30"),
        ("shutter", '2"', "2 s"),
        ("shutter", "bulb", "Bulb"),
        ("aperture", "f/8", "8"),
        ("aperture", "F8.0", "f/8"),
        ("aperture", "f/5.6", "5.657"),
        ("aperture", "f/11", "11.31"),
        ("iso", "100", "ISO 100"),
        ("iso", "Auto", "auto"),
        ("image_format", "RAW", "NEF (Raw)"),
        ("image_format", "RAW", "cRAW"),
        ("image_format", "NEF+Fine", "RAW + Large Fine JPEG"),
        ("mode", "M", "Manual"),
        ("focus", "MF (fixed)", "Manual"),
        ("white_balance", "Sunny", "Daylight"),
        ("white_balance", "Tungsten", "Incandescent"),
    ],
)
def test_spellings_of_one_setting_are_the_same(name, one, other):
    assert values.same_value(name, one, other)
    assert values.same_value(name, other, one)


@pytest.mark.parametrize(
    ("name", "one", "other"),
    [
        ("shutter", "1/60", "1/50"),
        ("shutter", "1/60", "1/80"),
        ("shutter", "1/350", "1/320"),
        ("shutter", "1/60", "60"),
        ("shutter", "1/60", "Bulb"),
        ("aperture", "f/8", "f/7.1"),
        ("aperture", "f/8", "f/9"),
        ("aperture", "f/11", "f/10"),
        ("iso", "100", "200"),
        ("iso", "100", "Auto"),
        ("image_format", "RAW", "JPEG Fine"),
        ("image_format", "RAW", "RAW+JPEG"),
        ("image_format", "RAW", "mRAW"),
        ("mode", "M", "A"),
        ("focus", "Manual", "AF-S"),
        ("focus", "MF (fixed)", "One Shot"),
        ("white_balance", "Daylight", "Cloudy"),
        ("firmware", "1.0", "1.1"),
    ],
)
def test_different_settings_are_different(name, one, other):
    assert not values.same_value(name, one, other)


@pytest.mark.parametrize(
    ("text", "kinds"),
    [
        ("RAW", {"raw"}),
        ("NEF (Raw)", {"raw"}),
        ("NEF+Basic", {"raw", "jpeg"}),
        ("NEF+Normal", {"raw", "jpeg"}),
        ("RAW+JPEG", {"raw", "jpeg"}),
        ("RAW + L", {"raw", "jpeg"}),
        ("RAW + Smooth Large JPEG", {"raw", "jpeg"}),
        ("cRAW + Large Fine JPEG", {"raw", "jpeg"}),
        ("JPEG Fine", {"jpeg"}),
        ("Large Fine JPEG", {"jpeg"}),
        ("S1", {"jpeg"}),
        ("mRAW", {"small raw"}),
        ("sRAW + Large Fine JPEG", {"small raw", "jpeg"}),
        ("RAW S", {"small raw"}),
        ("RAW (Medium)", {"small raw"}),
        ("TIFF (RGB)", {"tiff"}),
        ("TIF", {"tiff"}),
        ("HEIF", {"heif"}),
        ("Unknown value 0008", set()),
    ],
)
def test_a_picture_format_states_its_files(text, kinds):
    assert values.format_kinds(text) == kinds


@pytest.mark.parametrize(
    "text", ["Auto", "Automatic", "AUTO1", "Natural light auto", "AWB", "AWB White"]
)
def test_an_automatic_white_balance_is_reported(text):
    assert values.is_auto_balance(text)


@pytest.mark.parametrize("text", ["Daylight", "Manual", "Preset", "Color Temperature", "Flash"])
def test_a_fixed_white_balance_is_reported(text):
    assert not values.is_auto_balance(text)


def test_marked_times_stand_for_powers_of_two():
    for marked, true in ((60, 64), (30, 32), (15, 16), (125, 128), (250, 256), (1000, 1024)):
        assert any(abs(t * true - 1) < 1e-12 for t in values.true_exposures_s(1 / marked))
    assert values.true_exposures_s(30.0) == (32.0,)
    assert values.true_exposures_s(1 / 8) == (1 / 8,)


@given(st.text(max_size=30), st.text(max_size=30))
def test_any_two_texts_compare_the_same_both_ways(one, other):
    for name in (*values.SAME, "firmware"):
        assert values.same_value(name, one, other) == values.same_value(name, other, one)
        assert values.same_value(name, one, one)


@given(st.floats(1e-6, 1e6))
def test_true_times_lie_within_seven_percent(marked_s):
    for time_s in values.true_exposures_s(marked_s):
        assert abs(time_s / marked_s - 1) <= 0.07 + 1e-12
