"""ICL's lsserver on a TCP port of this machine, in a thread of its own, and how it misbehaves."""

from __future__ import annotations

import collections
import contextlib
import dataclasses
import os
import select
import socket
import threading
import time
from collections.abc import Callable, Sequence
from typing import Self

import cbor2
import numpy as np
from websockets.frames import Frame, Opcode
from websockets.http11 import Request
from websockets.protocol import State
from websockets.server import ServerProtocol

from sim.devices.fault_names import LEDS
from sim.devices.faults import Due, Fault, FaultLog, Story
from sim.devices.icl_stage import ARCS, DEMO, LIGHTS, MANUAL, MOST, REFRESH_MS, IclStage
from sim.devices.led_device import LitState
from sim.devices.led_faults import Line
from sim.errors import SimError

PATH = "/ws"
MOST_BYTES = 64 << 20
READ_BYTES = 1 << 16
MOST_STATES = 20_000
"""Number of states that are kept; of more the oldest are forgotten."""
ID_STEP = 1000
"""By so much an answer's id is off where a story has that fault."""
SEND_WAIT_S = 1.0
"""A client that does not take what is sent is left after that."""
DIES, RESTARTS, HANGS_UP = "die", "reset", "hang-up"
ANSWERS_WRONGLY, OTHER_ID = "wrong-acknowledgement", "other-id"
SWAPPED = [3, 4, 5, 0, 1, 2]
"""A place's emitters, its two fixtures exchanged: they stand behind crossed polarisers."""


@dataclasses.dataclass(frozen=True)
class IclState(LitState):
    """What was lit, and in which of the server's modes: (ARCS * LIGHTS, 6) counts."""

    mode: str = DEMO


@dataclasses.dataclass
class Client:
    """Who is connected.

    Attributes:
        line: the connection.
        protocol: its WebSocket.
        parts: of the message that comes, and whether it is a text.
        requests: whole messages that wait: from when on they are handled (monotonic), and what
            happens to them; None where the story has not decided it yet.
        answers: what is to be sent, and when at the earliest (monotonic).
    """

    line: socket.socket
    protocol: ServerProtocol
    parts: list[bytes] = dataclasses.field(default_factory=list)
    is_text: bool = False
    requests: collections.deque[tuple[float, bytes, Sequence[Due] | None]] = dataclasses.field(
        default_factory=collections.deque
    )
    answers: collections.deque[tuple[float, bytes]] = dataclasses.field(
        default_factory=collections.deque
    )


class IclServer:
    """Use as a context manager; as the real one, it begins with its animation.

    Args:
        show: called with (ARCS * LIGHTS, 6) levels in 0..1 of red, green, blue, warm, neutral and
            cool, whenever what shines changes.
        port: on which it listens; any free one by default.
        host: address of the network card.
        story: what goes wrong.
        log: where that is noted.
        at_once: fixtures take what is set before the answer, not with the next packet: for tests
            whose cameras must see it then.

    Attributes:
        place: host and port.
        stage: what it is set to; other threads only look.
        states: what was lit, in order, the dark start included; of the animation the last state
            alone, and MOST_STATES at most.
        log: what went wrong.
        failure: what `show` raised.
        connected: set while somebody is connected.
        commands: how many requests were answered.
    """

    def __init__(
        self,
        show: Callable[[np.ndarray], None],
        port: int = 0,
        host: str = "127.0.0.1",
        story: Story | None = None,
        log: FaultLog | None = None,
        at_once: bool = False,
    ) -> None:
        self._show = show
        self._story = story or Story()
        self.log = FaultLog() if log is None else log
        _require(self._story)
        self._at_once = at_once
        self._listener: socket.socket | None = _listen(host, port)
        self._host, self._port = self._listener.getsockname()[:2]
        self.place = f"{self._host}:{self._port}"
        self.stage = IclStage()
        self.states = [IclState(time.monotonic(), self.stage.emitters)]
        self.failure: BaseException | None = None
        self.connected = threading.Event()
        self.commands = 0
        self._clients: list[Client] = []
        self._packets = self._opens = 0
        self._broken: list[Fault] = []
        self._dead = False
        self._request, self._answer = Line("request", self.log), Line("answer", self.log)
        self._back_s = np.inf
        self._shown_mode = ""
        self._stop_read, self._stop_write = os.pipe()
        self._thread = threading.Thread(target=self._serve, name="lsserver", daemon=True)

    def url(self, options: str = "") -> str:
        """The stage's address for `lightstage capture --leds`; options as ``name=value&..``."""
        return f"ws://{self.place}{PATH}?{options}".rstrip("?")

    @property
    def dark(self) -> bool:
        """Whether no light shines, and none will by itself."""
        return not self.states[-1].counts.any() and self.stage.mode == MANUAL

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        os.write(self._stop_write, b"x")
        self._thread.join()
        for handle in (self._stop_read, self._stop_write):
            os.close(handle)

    def _serve(self) -> None:
        try:
            with contextlib.closing(self):
                next_s = time.monotonic()
                while self._wait(next_s):
                    now_s = time.monotonic()
                    if now_s >= self._back_s:
                        self._listener, self._back_s = _listen(self._host, self._port), np.inf
                    if now_s >= next_s and self._listener is not None:
                        self.stage.tick()
                        self._output()
                        next_s = max(next_s + REFRESH_MS / 1000, now_s)
                    for client in list(self._clients):
                        self._work(client)
                self._output()  # the last packet: what was set is sent, however soon it ends
        except BaseException as failure:  # whatever it is, the owner must learn of it
            self.failure = failure

    def close(self) -> None:
        """End all connections and stop listening."""
        for client in list(self._clients):
            self._drop(client)
        if self._listener is not None:
            self._listener.close()
            self._listener = None

    def _wait(self, until_s: float) -> bool:
        """Take what comes until that time; False when the server is to end."""
        dues = [until_s if self._listener is not None else self._back_s]
        for client in self._clients:
            dues += [queue[0][0] for queue in (client.requests, client.answers) if queue]
        ends: list[int | socket.socket] = [self._stop_read, *(c.line for c in self._clients)]
        ends += [self._listener] if self._listener is not None else []
        ready = select.select(ends, [], [], max(0.0, min(dues) - time.monotonic()))[0]
        if self._stop_read in ready:
            return False
        if self._listener is not None and self._listener in ready:
            self._accept(self._listener)
        for client in list(self._clients):
            if client.line in ready:
                self._read(client)
        return True

    def _accept(self, listener: socket.socket) -> None:
        line, _ = listener.accept()
        line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        line.settimeout(SEND_WAIT_S)
        self._clients.append(Client(line, ServerProtocol(max_size=MOST_BYTES)))
        self.connected.set()
        self._opens += 1
        self._dead = False
        for due in self._story.due(LEDS, "open", self._opens):
            self.log.write(LEDS, due, self._opens)
            self.stage = IclStage()
            self._output()

    def _read(self, client: Client) -> None:
        try:
            data = client.line.recv(READ_BYTES)
        except OSError:
            data = b""
        if not data:
            self._drop(client)
            return
        client.protocol.receive_data(data)
        for event in client.protocol.events_received():
            if isinstance(event, Request):
                self._shake_hands(client, event)
            elif isinstance(event, Frame) and event.opcode in (
                Opcode.TEXT, Opcode.BINARY, Opcode.CONT,
            ):  # fmt: skip
                self._take(client, event)
        self._flush(client)

    def _shake_hands(self, client: Client, request: Request) -> None:
        # The real one has more paths, of its REST interface; they are not played.
        if request.path.partition("?")[0] == PATH:
            response = client.protocol.accept(request)
        else:
            response = client.protocol.reject(404, "")
        client.protocol.send_response(response)

    def _take(self, client: Client, frame: Frame) -> None:
        """Join a message's frames; texts are passed over."""
        if frame.opcode is not Opcode.CONT:
            client.is_text, client.parts = frame.opcode is Opcode.TEXT, []
        client.parts.append(bytes(frame.data))
        if frame.fin and not client.is_text:
            client.requests.append((0.0, b"".join(client.parts), None))

    def _flush(self, client: Client) -> None:
        try:
            for data in client.protocol.data_to_send():
                if data:
                    client.line.sendall(data)
                else:
                    self._drop(client)
        except OSError:
            self._drop(client)

    def _drop(self, client: Client) -> None:
        if client in self._clients:
            self._clients.remove(client)
        client.line.close()
        client.requests.clear()
        client.answers.clear()
        if not self._clients:
            self.connected.clear()

    def _work(self, client: Client) -> None:
        """Handle a client's waiting requests, and send what is due."""
        while client.requests and time.monotonic() >= client.requests[0][0]:
            _, request, due = client.requests.popleft()
            self._handle(client, request, due)
        while client.answers and time.monotonic() >= client.answers[0][0]:
            _, data = client.answers.popleft()
            if client.protocol.state is State.OPEN:
                client.protocol.send_binary(data)
        if client in self._clients:
            self._flush(client)

    def _handle(self, client: Client, request: bytes, due: Sequence[Due] | None) -> None:
        if due is None:
            self._packets += 1
            due = self._story.due(LEDS, "packet", self._packets)
            self._break_lamps(due)
            named = {each.name: each for each in due}
            for name in (DIES, RESTARTS, HANGS_UP, ANSWERS_WRONGLY, OTHER_ID):
                if name in named:
                    self.log.write(LEDS, named[name], self._packets)
            self._dead = self._dead or DIES in named
            if RESTARTS in named:
                self._restart(float(named[RESTARTS].fault["seconds"]))
                return
            if HANGS_UP in named:
                self._drop(client)
                return
            wait_s, arrived = self._request.carry(request, due, self._packets)
            at_s = time.monotonic() + wait_s
            client.requests.extendleft((at_s, each, due) for each in reversed(arrived))
        elif not self._dead:
            self._reply(client, request, due)

    def _reply(self, client: Client, request: bytes, due: Sequence[Due]) -> None:
        answer = self.stage.answer(request)
        self.commands += 1
        if self._at_once and self.stage.mode == MANUAL:
            self._output()
        self._tell_events()
        names = [each.name for each in due]
        response = cbor2.loads(answer)["Response"]
        if ANSWERS_WRONGLY in names:
            response["response"] = {"Mode": self.stage.mode}
        if OTHER_ID in names:
            response["id"] = (response["id"] or 0) + ID_STEP
        wait_s, left = self._answer.carry(cbor2.dumps({"Response": response}), due, self._packets)
        at_s = time.monotonic() + wait_s
        if client.answers:
            at_s = max(at_s, client.answers[-1][0])
        client.answers.extend((at_s, each) for each in left)

    def _tell_events(self) -> None:
        events, self.stage.events = self.stage.events, []
        for event in events:
            data = cbor2.dumps({"Event": event})
            for client in self._clients:
                client.answers.append((0.0, data))

    def _restart(self, seconds: float) -> None:
        """End as a process does that is killed; after a time another one begins."""
        self.close()
        self.stage = IclStage()
        self._dead = False
        self._output()
        self._back_s = time.monotonic() + seconds

    def _break_lamps(self, due: Sequence[Due]) -> None:
        lasting = [each for each in due if each.fault.kind.lasts]
        for each in lasting:
            if each.fault not in self._broken:
                self.log.write(LEDS, each, self._packets)
        self._broken = [each.fault for each in lasting]

    def _shining(self) -> np.ndarray:
        counts = self.stage.emitters
        for fault in self._broken:
            if fault.name == "swapped-bank":
                counts = counts[:, SWAPPED]
            else:
                counts[np.array(fault["lights"])] = MOST if "on" in fault.name.split("-") else 0
        return counts

    def _output(self) -> None:
        """Send a packet to the fixtures, and to everybody what has happened."""
        counts = self._shining()
        mode = self.stage.mode
        if not np.array_equal(counts, self.states[-1].counts) or mode != self._shown_mode:
            self._show(counts / MOST)
            state = IclState(time.monotonic(), counts, mode)
            if mode == self._shown_mode == DEMO:
                self.states[-1] = state
            else:
                self.states.append(state)
                del self.states[:-MOST_STATES]
            self._shown_mode = mode
        self._tell_events()


def _listen(host: str, port: int) -> socket.socket:
    try:
        return socket.create_server((host, port))
    except OSError as error:
        raise SimError(
            f"{host}:{port}",
            found=(error.strerror or str(error)).lower(),
            expected="an address of this machine, and a port of it that is free",
        ) from None


def _require(story: Story) -> None:
    """SimError when a story is of lights that are not there."""
    for fault in story.faults:
        lights = fault["lights"] if "lights" in fault.kind.fields else ()
        beyond = [light for light in lights if light >= ARCS * LIGHTS]
        if beyond:
            raise SimError(
                f"fault {fault.name}",
                field="lights",
                found=str(beyond[0]),
                expected=f"0 to {ARCS * LIGHTS - 1}",
            )
