"""Messages of ICL's lsserver as bytes, and which emitters a light is."""

import cbor2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.errors import ConfigError
from lightstage.leds import lsserver
from lightstage.leds.address import IclOptions
from lightstage.leds.icl_lights import IclLights, channel_emitters

GRID = (12, 14)


def test_a_request_is_the_map_of_an_id_and_a_command_in_the_bytes_of_rfc_8949():
    assert lsserver.encode_request(7, "GetMode").hex() == (
        "a2" "626964" "07" "67636f6d6d616e64" "67476574" "4d6f6465"
    )  # fmt: skip
    assert lsserver.encode_ok(300).hex() == (
        "a1" "68526573706f6e7365" "a2" "626964" "19012c" "68726573706f6e7365" "624f6b"
    )  # fmt: skip


def test_one_command_sets_every_fixture_in_both_groups():
    counts = np.arange(2 * 3 * 6).reshape(2, 3, 6)
    fixtures = lsserver.set_fixtures(counts)["SetFixtures"]
    assert [(f["arc_idx"], f["light_idx"]) for f in fixtures] == [
        (0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2),
    ]  # fmt: skip
    assert fixtures[4]["colour"] == {"rgb": [24, 25, 26], "white": [27, 28, 29]}


@pytest.mark.parametrize(
    ("message", "expected"),
    [
        (3, "a message that is 3"),
        ([], r"a message that is \[\]"),
        ({}, "a message that is an empty map"),
        ({"result": 1}, "a message that is a map of result"),
        ({"Response": 1}, "a message that is a map of Response"),
        ({"Response": {"id": 1}}, "a map of Response"),
        ({"Response": {"id": "a", "response": "Ok"}}, "an answer with the id 'a'"),
        ({"Response": {"id": True, "response": "Ok"}}, "an answer with the id True"),
        ({"Response": {}, "Event": {}}, "a map of Response, Event"),
    ],
)
def test_a_message_that_is_none_of_lsservers_is_reported_in_words(message, expected):
    with pytest.raises(lsserver.LsserverError, match=expected):
        lsserver.read_message(cbor2.dumps(message))


@given(st.binary(max_size=200))
def test_any_bytes_are_read_or_refused(data):
    try:
        message = lsserver.read_message(data)
    except lsserver.LsserverError:
        return
    assert isinstance(message, (lsserver.Reply, lsserver.Event))


SIMPLE = st.none() | st.booleans() | st.integers(-5, 1 << 70) | st.text(max_size=8) | st.floats()
TREES = st.recursive(
    SIMPLE,
    lambda below: st.lists(below, max_size=3) | st.dictionaries(st.text(), below, max_size=3),
)


@given(TREES)
def test_any_config_is_a_grid_or_is_refused(tree):
    for response in (tree, {"Config": tree}, {"Config": {"num_arcs": tree, "lights_per_arc": 14}}):
        try:
            arcs, lights = lsserver.read_grid(response)
        except lsserver.LsserverError:
            continue
        assert 1 <= arcs <= 64
        assert 1 <= lights <= 64


def test_a_grid_and_an_error_are_read():
    config = {"num_arcs": 12, "lights_per_arc": 14, "kinet_port": 6038}
    assert lsserver.read_grid({"Config": config}) == GRID
    with pytest.raises(lsserver.LsserverError, match="a grid of 0 x 14 lights"):
        lsserver.read_grid({"Config": config | {"num_arcs": 0}})
    error = {"Error": {"code": "CommandFailed", "message": "no\x1b[2J"}}
    assert lsserver.Reply(1, error).error == r"CommandFailed: no\x1b[2J"
    assert lsserver.Reply(1, "Ok").error is None
    assert lsserver.Reply(1, {"Error": 5}).error == "?: ?"


def emitters_twin(channel, lights):
    """(arc, light, emitter) of a channel, written down from the stage's description."""
    if lights == "emitters":
        place, emitter = divmod(channel, 6)
        return {(place // 14, place % 14, emitter)}
    lying, place = divmod(channel, 168)
    arc, light = place // 14, place % 14
    groups = {"rgb": {0, 1, 2}, "white": {3, 4, 5}, "both": {0, 1, 2, 3, 4, 5}}
    if lights == "polarised":
        # lscli's "pp" is what cameras with upright polarisers see directly.
        rgb = (arc % 2 == 0) == (light in {0, 2, 4, 6, 7, 9, 11, 13})
        lights = "rgb" if rgb != bool(lying) else "white"
    return {(arc, light, emitter) for emitter in groups[lights]}


@pytest.mark.parametrize(
    ("lights", "count"),
    [("white", 168), ("rgb", 168), ("both", 168), ("polarised", 336), ("emitters", 1008)],
)
def test_a_channel_is_the_emitters_that_the_stage_has_there(lights, count):
    members = channel_emitters(GRID, lights)
    assert members.shape == (count, 1008)
    assert members.sum(axis=0).max() == 1  # no emitter is of two channels
    for channel in range(count):
        places = np.argwhere(members[channel].reshape(12, 14, 6))
        assert set(map(tuple, places.tolist())) == emitters_twin(channel, lights)


@given(
    lights=st.sampled_from(["white", "rgb", "both", "polarised", "emitters"]),
    rgb=st.integers(1, 0xFFFFFF),
    white=st.integers(1, 0xFFFFFF),
    data=st.data(),
)
def test_values_are_a_channels_share_of_each_of_its_emitters(lights, rgb, white, data):
    options = IclOptions(lights=lights, rgb=f"{rgb:06x}", white=f"{white:06x}")
    most = {"polarised": 336, "emitters": 1008}.get(lights, 168)
    count = data.draw(st.sampled_from([1, 5, 168, most]))
    steps = np.zeros(count)
    for channel in data.draw(st.lists(st.integers(0, count - 1), max_size=9)):
        steps[channel] = data.draw(st.sampled_from([0, 1, 257, 32768, 65534, 65535]))
    found = IclLights(GRID, count, options).counts(steps)
    wanted = np.zeros((12, 14, 6))
    colour = [*bytes.fromhex(options.rgb), *bytes.fromhex(options.white)]
    for channel, step in enumerate(steps):
        for arc, light, emitter in emitters_twin(channel, lights):
            wanted[arc, light, emitter] = step * colour[emitter] / 255
    assert np.abs(found - wanted).max() <= 0.5 + 1e-6
    assert found.dtype == int
    assert 0 <= found.min() <= found.max() <= 65535


def test_a_channel_that_the_stage_does_not_have_is_refused_with_what_it_has():
    text = (
        r"lights=white: found a rig with a lamp at channel 168, expected channels 0 to 167: the "
        r"stage has 12 arcs of 14 lamps"
    )
    with pytest.raises(ConfigError, match=text):
        IclLights(GRID, 169, IclOptions())
    IclLights(GRID, 336, IclOptions(lights="polarised"))
