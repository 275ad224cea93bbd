"""The server that plays ICL's lsserver: commands, modes, time, faults, and its record."""

import json
import re
import signal
import subprocess
import sys
import threading

import cbor2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from websockets.sync.client import connect

from sim.devices.faults import Fault, Story
from sim.devices.icl_record import drawn, record
from sim.devices.icl_server import IclServer
from sim.devices.icl_stage import ARCS, LIGHTS, IclStage
from sim.devices.led_device import LedDevice
from sim.errors import SimError


def ask(stage, command, number=1):
    """What a stage answers to a command."""
    answer = cbor2.loads(stage.answer(cbor2.dumps({"id": number, "command": command})))["Response"]
    assert answer["id"] == number
    return answer["response"]


def error(stage, command):
    answer = ask(stage, command)["Error"]
    return answer["code"], answer["message"]


BLACK = {"rgb": [0, 0, 0], "white": [0, 0, 0]}


def test_it_begins_in_demo_with_an_animation_that_never_stands_still():
    stage = IclStage()
    assert ask(stage, "GetMode") == {"Mode": "Demo"}
    seen = []
    for _ in range(3):
        stage.tick()
        seen.append(stage.emitters)
        assert stage.emitters.max() <= 0.2 * 65535 + 1
    assert not np.array_equal(seen[0], seen[1])
    assert stage.events == []


@pytest.mark.parametrize(
    "command",
    [
        {"SetLightstage": BLACK},
        {"SetArc": {"arc_idx": 0, "colour": BLACK}},
        {"SetFixture": {"arc_idx": 0, "light_idx": 0, "colour": BLACK}},
        {"SetFixtures": []},
    ],
)
def test_whatever_sets_something_forces_manual_and_tells_it_once(command):
    stage = IclStage()
    assert ask(stage, command) == "Ok"
    assert stage.mode == "Manual"
    assert stage.events == [{"ModeChanged": "Manual"}]
    assert ask(stage, command) == "Ok"
    assert len(stage.events) == 1


def test_a_group_that_is_absent_stays_as_it_is():
    stage = IclStage()
    ask(stage, {"SetLightstage": {"rgb": [1, 2, 3], "white": [4, 5, 6]}})
    ask(stage, {"SetArc": {"arc_idx": 2, "colour": {"rgb": [7, 8, 9]}}})
    ask(stage, {"SetFixture": {"arc_idx": 2, "light_idx": 1, "colour": {"white": [10, 11, 12]}}})
    ask(stage, {"SetFixture": {"arc_idx": 2, "light_idx": 0, "colour": {"rgb": None}}})
    found = stage.emitters.reshape(ARCS, LIGHTS, 6)
    assert found[0, 0].tolist() == [1, 2, 3, 4, 5, 6]
    assert found[2, 0].tolist() == [7, 8, 9, 4, 5, 6]
    assert found[2, 1].tolist() == [7, 8, 9, 10, 11, 12]


@pytest.mark.parametrize(
    ("command", "expected"),
    [
        (None, "Missing 'command' field in payload"),
        ("GetMod", "unknown variant `GetMod`"),
        (3, "expected a command's name"),
        ({"GetMode": None, "GetConfig": None}, "expected a command's name"),
        ({"SetMode": "Demo"}, "missing field `type`"),
        ({"SetMode": {"type": "Off"}}, "unknown variant `Off`"),
        ({"SetMode": {"type": "OLAT"}}, "missing field `config`"),
        ({"SetMode": {"type": "OLAT", "config": {"capture_hz": 0.0}}}, "positive finite number"),
        ({"SetMode": {"type": "OLAT", "config": {"capture_hz": 31.0}}}, r"31.0 Hz.*30.3 Hz"),
        ({"SetMode": {"type": "Playback", "id": "x"}}, "invalid ULID"),
        ({"SetLightstage": {"rgb": [0, 0]}}, "three values"),
        ({"SetLightstage": {"rgb": [0, 0, 65536]}}, "expected u16"),
        ({"SetLightstage": {"white": [0, 0, 0.5]}}, "expected u16"),
        ({"SetArc": {"arc_idx": 12, "colour": BLACK}}, r"Arc index 12 out of bounds \(max: 11\)"),
        ({"SetArc": {"arc_idx": -1, "colour": BLACK}}, "expected usize"),
        ({"SetFixture": {"arc_idx": 0, "light_idx": 14, "colour": BLACK}}, "Light index 14 out of"),
        ("ManualTrigger", "Manual trigger only available in manual mode"),
        ({"UploadSequence": {"name": "a", "capture_hz": 3.0}}, "missing field `frames`"),
    ],
)
def test_what_cannot_be_done_is_an_error_and_changes_nothing(command, expected):
    stage = IclStage()
    code, message = error(stage, command)
    assert code == "InvalidPayload"
    assert re.search(expected, message)
    assert stage.mode == "Demo"
    assert not stage.emitters.any()


def test_a_batch_with_one_wrong_place_sets_none_of_them():
    stage = IclStage()
    good = {"arc_idx": 0, "light_idx": 0, "colour": {"rgb": [9, 9, 9]}}
    error(stage, {"SetFixtures": [good, good | {"arc_idx": 12}]})
    assert not stage.emitters.any()
    assert stage.mode == "Demo"


@given(st.binary(max_size=100))
def test_any_bytes_are_answered_and_what_is_no_request_with_a_null_id(data):
    answer = cbor2.loads(IclStage().answer(data))["Response"]
    if answer["id"] is None:
        assert answer["response"]["Error"]["code"] == "InvalidPayload"


def test_a_trigger_waits_for_the_next_packet_and_only_one_may():
    stage = IclStage()
    ask(stage, {"SetMode": {"type": "Manual"}})
    assert ask(stage, "ManualTrigger") == "Ok"
    assert error(stage, "ManualTrigger") == ("InvalidPayload", "Manual trigger already pending")
    stage.tick()
    assert stage.triggers == 1
    assert ask(stage, "ManualTrigger") == "Ok"


def test_olat_is_each_white_light_held_for_its_packets_then_dark_then_demo():
    stage = IclStage()
    ask(stage, {"SetMode": {"type": "OLAT", "config": {"capture_hz": 10.0}}})
    held = 3  # floor(30.3 / 10)
    for place in range(168):
        for _ in range(held):
            stage.tick()
            assert np.flatnonzero(stage.emitters.any(axis=1)).tolist() == [place]
            assert stage.emitters[place].tolist() == [0, 0, 0, 65535, 65535, 65535]
    assert stage.triggers == 168
    stage.tick()
    assert not stage.emitters.any()
    assert stage.events[1:] == ["CaptureFinished", {"ModeChanged": "Demo"}]
    stage.tick()
    assert stage.emitters.any()  # the animation again


def test_a_playback_sends_its_last_frame_once_more():
    stage = IclStage()
    grid = [[[0, 0, 0]] * 14] * 12
    bright = [[[7, 7, 7]] * 14] * 12
    frames = [{"white_fixtures": grid, "rgb_fixtures": each} for each in (grid, bright)]
    answer = ask(stage, {"UploadSequence": {"name": "n", "capture_hz": 30.0, "frames": frames}})
    assert list(answer["Sequence"]) == ["id", "name", "capture_hz", "total_frames", "duration_secs"]
    ask(stage, {"SetMode": {"type": "Playback", "id": answer["Sequence"]["id"]}})
    seen = []
    while stage.mode == "Playback":
        stage.tick()
        seen.append(int(stage.emitters.max()))
    assert seen == [0, 7, 7]
    assert stage.triggers == 2


def test_events_go_to_every_client_and_texts_are_passed_over():
    with IclServer(lambda _: None) as server:
        where = server.url()
        with connect(where, compression=None) as one, connect(where, compression=None) as two:
            one.send("a text")
            one.send(["a text ", "in parts"])
            one.send(cbor2.dumps({"id": 5, "command": {"SetMode": {"type": "Manual"}}}))
            for line, count in ((one, 2), (two, 1)):
                answer = [cbor2.loads(line.recv(5)) for _ in range(count)]
                assert {"Event": {"ModeChanged": "Manual"}} in answer
                if count == 2:
                    assert {"Response": {"id": 5, "response": "Ok"}} in answer
    assert server.failure is None


def test_lamps_that_are_broken_shine_otherwise_than_they_are_set():
    story = Story([
        Fault("stuck-on", at=2, until=2, lights=[3]),
        Fault("dead-light", at=3, until=3, lights=[0]),
        Fault("swapped-bank", at=4, until=4),
    ])  # fmt: skip
    colour = {"rgb": [1, 1, 1], "white": [2, 2, 2]}
    seen = []
    with (
        IclServer(lambda _: None, story=story, at_once=True) as server,
        connect(server.url(), compression=None) as line,
    ):
        for number in range(5):
            line.send(cbor2.dumps({"id": number, "command": {"SetLightstage": colour}}))
            while "Response" not in cbor2.loads(line.recv(5)):
                pass
            seen.append(server.states[-1].counts)
    plain = [1, 1, 1, 2, 2, 2]
    assert (seen[0] == plain).all()
    assert seen[1][3].tolist() == [65535] * 6
    assert (np.delete(seen[1], 3, axis=0) == plain).all()
    assert not seen[2][0].any()
    assert (seen[3] == [2, 2, 2, 1, 1, 1]).all()
    assert (seen[4] == plain).all()


def test_a_story_of_another_device_or_of_lights_that_are_not_there_is_refused():
    with pytest.raises(SimError, match="lights: found 168, expected 0 to 167"):
        IclServer(lambda _: None, story=Story([Fault("stuck-on", lights=[168])]))
    for name in ("hang-up", "other-id"):
        with pytest.raises(SimError, match=r"expected ICL's server \(lightstage-sim icl\)"):
            LedDevice(8, lambda _: None, story=Story([Fault(name)]))


def test_what_show_raises_is_kept_and_the_server_is_gone():
    def broken(_):
        raise RuntimeError("no lamp")

    with IclServer(broken) as server:
        for _ in range(2000):
            if server.failure is not None:
                break
            threading.Event().wait(0.005)
    assert str(server.failure) == "no lamp"


def test_the_command_writes_what_was_lit_and_ends_with_ctrl_c(tmp_path):
    story = tmp_path / "story.toml"
    story.write_text('[[fault]]\nname = "other-id"\n')
    words = ["icl", "--port", "0", "--faults", str(story)]
    words += ["--out", str(tmp_path / "lit.json"), "--picture", str(tmp_path / "lit.png")]
    child = subprocess.Popen(
        [sys.executable, "-m", "sim", *words], stdout=subprocess.PIPE, text=True
    )
    try:
        where = re.search(r"ws://\S+/ws", child.stdout.readline())[0]
        with connect(where, compression=None) as line:
            command = {"SetArc": {"arc_idx": 4, "colour": {"rgb": [500, 0, 0], "white": [0, 0, 0]}}}
            line.send(cbor2.dumps({"id": 1, "command": command}))
            facts = [cbor2.loads(line.recv(5)) for _ in range(2)]
        assert {"Response": {"id": 1001, "response": "Ok"}} in facts
    finally:
        child.send_signal(signal.SIGTERM)
        assert child.wait(30) == 0
    facts = json.loads((tmp_path / "lit.json").read_text())
    last = facts["states"][-1]
    assert (facts["schema"], last["mode"]) == ("lightstage.simulated_icl/1", "Manual")
    assert last["rgb"][4] == [[500, 0, 0]] * 14
    assert (tmp_path / "lit.png").stat().st_size > 100
    assert "other-id" in (tmp_path / "story.jsonl").read_text()


def test_a_port_that_is_taken_or_an_address_that_is_not_here_is_reported(run_command):
    with IclServer(lambda _: None) as server:
        port = server.place.rpartition(":")[2]
        ended = run_command("sim", "icl", "--port", port)
        assert ended.code == 2
        assert "found address already in use" in ended.err
    ended = run_command("sim", "icl", "--port", "0", "--host", "no-such-host.invalid")
    assert ended.code == 2
    assert "expected an address of this machine, and a port of it that is free" in ended.err


def test_a_picture_shows_each_light_where_it_stands():
    counts = np.zeros((168, 6), np.uint16)
    counts[14 * 3 + 8, 0] = (
        65535  # arc 3, light 8: the fourth row from the top, since 7 is the second
    )
    states = [type("State", (), {"counts": counts, "mode": "Manual", "at_s": 1.0})()]
    found = drawn(states)
    red = np.argwhere((found[..., 0] == 255) & (found[..., 1] < 50))
    assert red.min(axis=0).tolist() == [4 + 6 * 3, 4 + 6 * 3]
    assert red.max(axis=0).tolist() == [4 + 6 * 4 - 1, 4 + 6 * 4 - 1]
    answer = record(states, 2, 0.0)
    assert np.array(answer["states"][0]["rgb"])[3, 8].tolist() == [65535, 0, 0]
    assert answer["triggers"] == 2
