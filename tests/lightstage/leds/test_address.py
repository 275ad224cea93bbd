"""URLs of LED devices."""

import dataclasses

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.errors import ConfigError
from lightstage.leds.address import (
    LEDS_HELP,
    OPTIONS,
    AdalightOptions,
    IclOptions,
    Options,
    SacnOptions,
    SerialOptions,
    UnansweredOptions,
    parse_url,
)
from tests.documents import ROOT


def test_each_scheme_has_its_place_its_options_and_its_defaults():
    serial = parse_url("serial:///dev/ttyACM0?baud=1000000&timeout_s=0.5&attempts=2")
    assert serial.place == "/dev/ttyACM0"
    assert serial.options == SerialOptions(timeout_s=0.5, attempts=2, baud=1_000_000)
    assert serial.worst_s == 1.0
    pty = parse_url("pty:///dev/pts/3?timeout_s=30")
    assert (pty.place, pty.options) == ("/dev/pts/3", Options(timeout_s=30))
    tcp = parse_url("socket://stage.local:7000?pulse_hz=25000")
    assert (tcp.place, tcp.port, tcp.options.pulse_hz) == ("stage.local", 7000, 25000)
    strip = parse_url("adalight:///dev/ttyUSB0?order=grb&colour=ff8040&gamma=2.2&settle_s=0")
    assert strip.options == AdalightOptions(order="grb", colour="ff8040", gamma=2.2, settle_s=0)
    dmx = parse_url("sacn://multicast?universe=7&channels=3&bits=16&priority=150")
    assert (dmx.place, dmx.port) == ("multicast", 5568)
    assert dmx.options == SacnOptions(universe=7, channels=3, bits=16, priority=150)
    assert parse_url("sacn://10.0.0.7:5000").port == 5000
    icl = parse_url(
        "ws://stage.local:8080/ws?lights=polarised&white=ff8000&settle_s=0.2&attempts=3"
    )
    assert (icl.place, icl.port, icl.path, str(icl)) == (
        "stage.local",
        8080,
        "/ws",
        "stage.local:8080",
    )
    assert icl.options == IclOptions(lights="polarised", white="ff8000", settle_s=0.2, attempts=3)
    assert icl.worst_s == 15.2


@pytest.mark.parametrize("scheme", OPTIONS)
def test_the_longest_answer_of_every_kind_counts_the_time_in_which_its_light_settles(scheme):
    options = OPTIONS[scheme](timeout_s=3.0, attempts=4)
    settles = "settle_s" in {field.name for field in dataclasses.fields(options)}
    assert settles == isinstance(options, UnansweredOptions)
    if settles:
        options = dataclasses.replace(options, settle_s=50.0)
    assert options.worst_s == 12.0 + 50.0 * settles


def test_help_and_the_page_of_the_wires_name_every_kind():
    page = (ROOT / "docs" / "led_wire.md").read_text()
    for scheme in OPTIONS:
        assert f"{scheme}://" in LEDS_HELP
        assert f"| `{scheme}://" in page


@pytest.mark.parametrize(
    ("url", "message"),
    [
        ("http://x/y", "http"),
        ("serial://", "expected serial:///dev"),
        ("serial://host/dev/x", "expected serial:///dev"),
        ("pty:///", "expected serial:///dev"),
        ("socket://host", "socket://HOST:PORT"),
        ("socket://host:70000", "70000|[Pp]ort"),
        ("socket://host:7/path", "socket://HOST:PORT"),
        ("socket://user@host:7", "socket://HOST:PORT"),
        ("sacn://", "sacn://HOST"),
        ("serial:///dev/x?speed=9", "speed: found an unknown key, expected one of attempts, baud"),
        ("pty:///dev/x?baud=9600", "baud: found an unknown key"),
        ("serial:///dev/x?timeout_s=soon", "timeout_s: found 'soon'"),
        ("serial:///dev/x?timeout_s=-1", "a number from"),
        ("serial:///dev/x?timeout_s=nan", "a number from"),
        ("serial:///dev/x?attempts=2.5", "a whole number from 1"),
        ("serial:///dev/x?attempts=2&attempts=3", "two values"),
        ("serial:///dev/x?baud=", "baud: found ''"),
        ("adalight:///dev/x?order=rgg", "rgb in any order"),
        ("adalight:///dev/x?colour=white", "RRGGBB"),
        ("adalight:///dev/x?colour=000000", "not black"),
        ("socket://lab..local:5", r"socket://lab\.\.local:5.*socket://HOST:PORT"),
        (f"sacn://{'a' * 64}", "sacn://HOST"),
        ("ws://h:8080", "ws://HOST:8080/ws"),
        ("ws://h/ws", "ws://HOST:8080/ws"),
        ("ws://:8080/ws", "ws://HOST:8080/ws"),
        ("ws://u@h:8080/ws", "ws://HOST:8080/ws"),
        ("wss://h:8080/ws", "ws://HOST:8080/ws"),
        ("ws://h:8080/w s", "ws://HOST:8080/ws"),
        ("ws://h:1/ws?lights=green", "lights: found 'green', expected one of white, rgb, both"),
        ("ws://h:1/ws?rgb=000000", "rgb: found '000000', expected RRGGBB, hexadecimal, not black"),
        ("ws://h:1/ws?white=warm", "white: found 'warm', expected RRGGBB"),
        ("ws://h:1/ws?gamma=2", "gamma: found an unknown key, expected one of attempts, lights"),
        ("sacn://h?universe=0", "universe: found '0', expected a whole number from 1 to 63999"),
        ("sacn://h?bits=12", "8 or 16"),
        ("sacn://h?priority=201", "from 0 to 200"),
        ("sacn://multicast?interface=eth0", "an IPv4 address"),
        ("sacn://h?interface=10.0.0.1", "interface: found a host, h, expected multicast"),
    ],
)
def test_a_malformed_url_is_refused(url, message):
    with pytest.raises(ConfigError, match=message):
        parse_url(url)


def test_all_faults_of_a_url_are_reported_at_once():
    with pytest.raises(ConfigError, match=r"(?s)3 problems.*speed.*attempts.*gamma"):
        parse_url("adalight:///dev/x?speed=1&attempts=0&gamma=many")


@given(
    st.text(max_size=60),
    st.sampled_from(["", "serial://", "sacn://", "socket://h:1?", "ws://h:1/", "ws://h:1/ws?"]),
)
def test_any_text_is_read_or_refused(text, head):
    try:
        address = parse_url(head + text)
    except ConfigError:
        return
    assert address.worst_s > 0
