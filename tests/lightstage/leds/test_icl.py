"""ICL's stage over its WebSocket: our own server, its faults, and servers that are others."""

import contextlib
import http.server
import json
import socket
import threading
import time

import cbor2
import numpy as np
import pytest
import websockets.sync.client
import websockets.sync.server

from lightstage.errors import ConfigError, DeviceError
from lightstage.leds.controller import LightLostError
from lightstage.leds.opening import open_leds
from lightstage.safety import SafeLights, SafetyConfig
from sim.devices.faults import Fault, Story
from sim.devices.icl_server import IclServer
from tests.waiting import until

QUICK = "settle_s=0&timeout_s=0.3"
CONFIG = {"Config": {"num_arcs": 12, "lights_per_arc": 14}}


def far_end(*faults):
    return IclServer(lambda _: None, story=Story(faults), at_once=True)


def white(server):
    """(168,) warm white of the last state; rgb is dark, and the three whites are alike."""
    counts = server.states[-1].counts
    assert not counts[:, :3].any()
    assert (counts[:, 3:] == counts[:, 3:4]).all()
    return counts[:, 3]


def test_what_is_driven_is_what_shines_and_the_end_is_manual_and_black():
    with far_end() as server:
        assert server.stage.mode == "Demo"
        with open_leds(server.url(QUICK), 168) as leds:
            assert not leds.acknowledged
            assert leds.hello.light_count == 168
            assert leds.hello.firmware == "lsserver, 12 x 14, white (does not report what is lit)"
            assert server.stage.mode == "Demo"  # a look changes nothing
            levels = np.random.default_rng(1).random(168)
            driven = leds.light(levels)
            assert np.abs(driven - levels).max() <= 0.5 / 65535
            assert (white(server) == np.round(driven * 65535)).all()
            leds.confirm()
            leds.dark()
        assert server.dark
        until(lambda: not server.connected.is_set())
        time.sleep(0.1)  # three of its packets: no animation begins
        assert server.dark
        assert server.failure is None


def test_a_light_that_another_program_left_on_is_out_with_the_first_state():
    with far_end() as server:
        server.stage.answer(cbor2.dumps({"id": 1, "command": {"SetLightstage": {
            "rgb": [9, 9, 9], "white": [9, 9, 9]}}}))  # fmt: skip
        with open_leds(server.url(QUICK + "&lights=rgb&rgb=ff8000"), 3) as leds:
            leds.light(np.array([0.0, 0.5, 1.0]))
        counts = server.states[-1].counts
        assert counts[:3].tolist() == [
            [0] * 6,
            [32768, 16448, 0, 0, 0, 0],
            [65535, 32896, 0, 0, 0, 0],
        ]
        assert not counts[3:].any()


@pytest.mark.parametrize(
    ("name", "fields"),
    [
        ("delay", {"seconds": 0.1}),
        ("delay", {"seconds": 0.1, "way": "answer"}),
        ("drop", {}),
        ("drop", {"way": "answer"}),
        ("corrupt", {}),
        ("corrupt", {"way": "answer"}),
        ("duplicate", {}),
        ("duplicate", {"way": "answer"}),
        ("reorder", {}),
        ("reorder", {"way": "answer"}),
        ("wrong-acknowledgement", {}),
        ("other-id", {}),
    ],
)
def test_one_wrong_late_or_lost_answer_is_asked_again(name, fields):
    for at in (2, 3, 4):  # of two lights and the dark
        with far_end(Fault(name, at=at, **fields)) as server:
            with open_leds(server.url(QUICK), 168) as leds:
                leds.light(np.full(168, 0.25))
                leds.light(np.full(168, 0.5))
                assert (white(server) == 32768).all()
                leds.dark()
            assert server.dark
            assert server.log.names() == [name]
            assert server.failure is None


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (Fault("delay", at=2, way="answer", seconds=9), "no answer in 0.3 s, asked 2 times"),
        (Fault("die", at=2), "no answer in 0.3 s, asked 2 times, expected an answer"),
        (Fault("wrong-acknowledgement", at=2, until=9), "found a map of Mode, expected 'Ok'"),
        (Fault("other-id", at=2, until=9), "found an answer to request 1003, which was never sent"),
        (Fault("hang-up", at=2), "found the device closed the connection"),
        (Fault("reset", at=2, seconds=0.2), "Did the server end"),
    ],
)  # fmt: skip
def test_a_server_that_stays_wrong_is_reported_and_the_light_is_lost(fault, message):
    with far_end(fault) as server, open_leds(server.url(QUICK), 168) as leds:
        with pytest.raises(LightLostError, match=message):
            leds.light(np.ones(168))
        assert server.failure is None


@pytest.mark.parametrize("name", ["hang-up", "reset"])
def test_a_server_that_goes_away_between_frames_is_greeted_again_dark(name):
    fields = {"seconds": 0.3} if name == "reset" else {}
    with far_end(Fault(name, at=3, **fields)) as server, open_leds(server.url(QUICK), 168) as leds:
        leds.light(np.ones(168))
        with pytest.raises(LightLostError, match="a connection that stays open"):
            leds.confirm()
        assert leds.recover().light_count == 168
        assert server.dark
        leds.light(np.full(168, 0.5))
        assert (white(server) == 32768).all()
        leds.dark()
        assert server.dark


@pytest.mark.parametrize("fault", [Fault("hang-up", at=3), Fault("reset", at=3, seconds=0.3)])
def test_dark_opens_a_connection_that_broke_once_more(fault):
    with far_end(fault) as server, open_leds(server.url(QUICK), 168) as leds:
        leds.light(np.ones(168))
        with pytest.raises(LightLostError):
            leds.confirm()
        assert not server.dark
        leds.dark()
        assert server.dark


def test_the_watch_over_the_lights_leaves_a_server_that_hung_up_dark(default_rig_168):
    config = SafetyConfig(light_interval_s=0, max_flashes_per_s=30)
    with far_end(Fault("hang-up", at=4)) as server, open_leds(server.url(QUICK), 168) as leds:
        with SafeLights(leds, config, default_rig_168) as lights:
            lights.light(np.ones(168))
            lights.confirm()
            with pytest.raises(LightLostError):
                lights.confirm()
        assert server.dark


@pytest.fixture(scope="module")
def default_rig_168():
    from lightstage.rig import default_rig

    return default_rig()


def test_dark_does_not_wait_for_another_threads_answer():
    url = "settle_s=0&timeout_s=60"
    lost = []

    def light(leds):
        try:
            leds.light(np.ones(168))
        except LightLostError as error:
            lost.append(str(error))

    with (
        far_end(Fault("drop", at=2, way="answer")) as server,
        open_leds(server.url(url), 168) as leds,
    ):
        thread = threading.Thread(target=light, args=(leds,))
        thread.start()
        until(lambda: (server.states[-1].counts[:, 3] == 65535).all())
        leds.dark()
        thread.join()
        assert server.dark
        assert "given up after another thread put the lights out" in lost[0]


def test_another_programs_mode_is_reported_and_the_light_is_lost():
    with far_end() as server, open_leds(server.url(QUICK), 168) as leds:
        leds.light(np.ones(168))
        with open_socket(server) as other:
            other.send(cbor2.dumps({"id": 1, "command": {"SetMode": {"type": "Demo"}}}))
            other.recv()
        with pytest.raises(LightLostError, match="mode: found Demo, which another program has set"):
            leds.confirm()
        leds.recover()
        leds.light(np.ones(168))
        leds.confirm()


@contextlib.contextmanager
def open_socket(server):
    with websockets.sync.client.connect(server.url(), compression=None) as line:
        yield line


def test_a_second_program_of_this_machine_is_refused():
    with (
        far_end() as server,
        open_leds(server.url(QUICK), 168),
        pytest.raises(DeviceError, match="another program that is using it"),
    ):
        open_leds(server.url(QUICK), 168)


def test_a_rig_of_more_lights_than_the_stage_has_is_refused_and_the_stage_is_free_again():
    with far_end() as server:
        with pytest.raises(ConfigError, match="a lamp at channel 168, expected channels 0 to 167"):
            open_leds(server.url(QUICK), 169)
        open_leds(server.url(QUICK), 168).close()


@pytest.mark.parametrize("wrong", [np.ones(7), np.full(168, 1.1), np.full(168, np.nan)])
def test_a_wrong_count_or_level_sends_nothing(wrong):
    with far_end() as server, open_leds(server.url(QUICK), 168) as leds:
        before = server.commands
        with pytest.raises(DeviceError, match="levels"):
            leds.light(wrong)
        assert server.commands == before


# Servers that are none, or not quite.


def test_a_wrong_path_is_reported():
    with far_end() as server:
        url = server.url(QUICK).replace("/ws?", "/stage?")
        with pytest.raises(
            DeviceError, match=r"HTTP 404 at /stage, .*Is the path that of lsserver"
        ):
            open_leds(url, 168)


def test_a_host_or_port_that_is_not_there_is_reported():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    with pytest.raises(DeviceError, match="refused, expected a port that opens"):
        open_leds(f"ws://127.0.0.1:{port}/ws", 168)
    with pytest.raises(DeviceError, match=r"found no such host, expected a name .*spelled right"):
        open_leds("ws://no-such-host.invalid:8080/ws", 168)


class Page(http.server.BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    def do_GET(self):
        self.send_response(200)
        self.send_header("Content-Length", "2")
        self.end_headers()
        self.wfile.write(b"hi")

    def log_message(self, *_):
        pass


def test_a_server_of_pages_is_reported():
    with http.server.HTTPServer(("127.0.0.1", 0), Page) as pages:
        threading.Thread(target=pages.serve_forever, daemon=True).start()
        url = f"ws://127.0.0.1:{pages.server_port}/ws?{QUICK}"
        with pytest.raises(DeviceError, match="found HTTP 200 at /ws, expected a WebSocket"):
            open_leds(url, 168)
        pages.shutdown()


@pytest.mark.parametrize(
    ("says", "message"),
    [
        (b"", "found a connection that was closed at once, expected a WebSocket"),
        (b"SSH-2.0-OpenSSH_9.2\r\n", "found an answer that is no HTTP"),
        (None, "found a connection, and no answer in 0.3 s"),
    ],
)
def test_a_server_that_is_no_http_is_reported(says, message):
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def serve():
            line, _ = listener.accept()
            with line:
                if says is not None:
                    line.recv(4096)
                    line.sendall(says)
                    line.shutdown(socket.SHUT_WR)
                while line.recv(4096):
                    pass

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        url = f"ws://127.0.0.1:{listener.getsockname()[1]}/ws?{QUICK}"
        with pytest.raises(DeviceError, match=message):
            open_leds(url, 168)
        thread.join()


@contextlib.contextmanager
def other_server(answer):
    """A WebSocket server that answers each message with what `answer` makes of it."""

    def handler(line):
        for message in line:
            for each in answer(message):
                line.send(each)

    with websockets.sync.server.serve(handler, "127.0.0.1", 0, compression=None) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"ws://127.0.0.1:{server.socket.getsockname()[1]}/ws?{QUICK}"


def as_lsserver(response):
    return lambda data: [
        cbor2.dumps({"Response": {"id": cbor2.loads(data)["id"], "response": response}})
    ]


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (lambda data: [data], "found a message that is a map of id, command"),
        (lambda _: [json.dumps({"result": None})], "a message of 16 bytes that is no CBOR"),
        (lambda _: [b"\xff\xff"], "a message of 2 bytes that is no CBOR"),
        (lambda _: [], "found no answer in 0.3 s, asked 2 times, expected lsserver's answer"),
        (lambda _: [bytes(2 << 20)], "no WebSocket any more"),
        (as_lsserver("Ok"), "an answer to GetConfig that is 'Ok'"),
        (as_lsserver({"Config": {}}), "a grid of None x None lights"),
        (as_lsserver({"Config": {"num_arcs": 1000, "lights_per_arc": 14}}), "a grid of 1000 x 14"),
        (
            lambda _: [cbor2.dumps({"Response": {"id": 5, "response": CONFIG}})],
            "an answer to request 5, which was never sent",
        ),
        (
            lambda _: [cbor2.dumps({"Response": {"id": None, "response": {"Error": {
                "code": "InvalidPayload", "message": "what?"}}}})],
            r"could not read \(InvalidPayload: what\?\)",
        ),
    ],
)  # fmt: skip
def test_a_websocket_server_that_is_not_lsserver_is_reported(answer, message):
    with other_server(answer) as url, pytest.raises(DeviceError, match=message):
        open_leds(url, 168)


def test_what_the_server_refuses_is_reported_in_its_words():
    error = {"Error": {"code": "CommandFailed", "message": "no power supply"}}

    def answer(data):
        asked = cbor2.loads(data)["command"]
        return as_lsserver(CONFIG if asked == "GetConfig" else error)(data)

    with other_server(answer) as url, open_leds(url, 168) as leds:
        text = r"SetFixtures: found refused \(CommandFailed: no power supply\), expected 'Ok'"
        with pytest.raises(LightLostError, match=text):
            leds.light(np.ones(168))


def test_a_stage_of_another_grid_after_a_break_is_refused():
    grids = [(12, 14), (6, 14)]

    def answer(data):
        if cbor2.loads(data)["command"] != "GetConfig":
            return [b"\xff", b""]
        arcs, lights = grids.pop(0)
        return as_lsserver({"Config": {"num_arcs": arcs, "lights_per_arc": lights}})(data)

    with other_server(answer) as url, open_leds(url, 84) as leds:
        leds._line._line._socket.shutdown(socket.SHUT_RDWR)
        with pytest.raises(LightLostError):
            leds.light(np.ones(84))
        with pytest.raises(DeviceError, match="grid: found 6 x 14, expected 12 x 14, as before"):
            leds.recover()
