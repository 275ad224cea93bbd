"""Whole messages over TCP: the client's end of a WebSocket. The only file with websockets."""

from __future__ import annotations

import contextlib
import time
from typing import IO

from websockets.client import ClientProtocol
from websockets.exceptions import InvalidHandshake, InvalidMessage, InvalidStatus
from websockets.frames import Frame, Opcode
from websockets.protocol import State
from websockets.uri import parse_uri

from lightstage.errors import DeviceError
from lightstage.leds.connection import SocketLine

MOST_BYTES = 1 << 20
"""No message of a stage is longer: of a longer one the connection is ended."""
END_WAIT_S = 0.25
"""For a server to read what is left and to close its end."""
EXPECTED = "a WebSocket, as lsserver has at /ws"


class WebSocketLine:
    """A WebSocket on a TCP connection [RFC6455-2011].

    Args:
        where: its name in messages.
        host: name or address.
        port: of the server.
        path: on it, such as ``/ws``.
        timeout_s: for connecting, for the server's first answer, and for each write.
        lock: of the address, held by the caller.

    Raises:
        DeviceError: who answers is no WebSocket.
        OSError: nobody there.
    """

    def __init__(
        self, where: str, host: str, port: int, path: str, timeout_s: float, lock: IO[bytes]
    ) -> None:
        self._protocol = _client(host, port, path)
        self._parts: list[bytes] = []
        self._line = SocketLine(host, port, timeout_s, lock)
        try:
            self._protocol.send_request(self._protocol.connect())
            self._flush()
            until = time.monotonic() + timeout_s
            while self._protocol.state is State.CONNECTING:
                left_s = until - time.monotonic()
                if left_s <= 0:
                    found = f"a connection, and no answer in {timeout_s:g} s"
                    raise DeviceError(where, found=found, expected=EXPECTED, hint=_HINT)
                self._take(left_s, where, path)
        except BaseException:
            self.close()
            raise

    @property
    def handles(self) -> tuple[int, ...]:
        """The connection, and the lock."""
        return self._line.handles

    @property
    def peer(self) -> tuple[str, int]:
        """Address and port of the server."""
        return self._line.peer

    def send(self, data: bytes) -> None:
        """Send one binary message; OSError where the connection has ended."""
        if self._protocol.state is not State.OPEN:
            raise ConnectionResetError("the server closed the connection")
        self._protocol.send_binary(data)
        self._flush()

    def receive(self, wait_s: float) -> list[bytes]:
        """Whole messages that have come within `wait_s`; OSError where the connection has ended."""
        data = self._line.read(wait_s)
        self._protocol.receive_data(data)
        self._flush()
        messages = []
        for event in self._protocol.events_received():
            if not isinstance(event, Frame) or event.opcode in (Opcode.PING, Opcode.PONG):
                continue
            if event.opcode is Opcode.CLOSE:
                raise ConnectionResetError("the server closed the connection")
            self._parts.append(bytes(event.data))
            if event.fin:
                messages.append(b"".join(self._parts))
                self._parts = []
        if self._protocol.parser_exc is not None:
            raise ConnectionResetError(f"no WebSocket any more ({self._protocol.parser_exc})")
        return messages

    def close(self) -> None:
        """End the connection, once what was sent is read; the server keeps its state."""
        if self._protocol.state is State.OPEN:
            self._protocol.send_close()
            with contextlib.suppress(OSError):  # nobody hears it
                self._flush()
        self._line.end(END_WAIT_S)

    def _flush(self) -> None:
        for data in self._protocol.data_to_send():
            if data:
                self._line.write(data)

    def _take(self, wait_s: float, where: str, path: str) -> None:
        """Take what answers the handshake; DeviceError where that is no WebSocket's."""
        heard = True
        try:
            data = self._line.read(wait_s)
        except ConnectionResetError:
            self._protocol.receive_eof()
            heard = False
        else:
            self._protocol.receive_data(data)
        error = self._protocol.handshake_exc
        if error is None:
            return
        hint = _HINT
        if isinstance(error, InvalidStatus):
            status = error.response.status_code
            found = f"HTTP {status} at {path}"
            hint = "Is the path that of lsserver, /ws?" if status == 404 else _HINT
        elif not heard:
            found = "a connection that was closed at once"
        elif isinstance(error, InvalidMessage) or not isinstance(error, InvalidHandshake):
            found = "an answer that is no HTTP"
        else:
            found = f"a wrong handshake ({error})"
        raise DeviceError(where, found=found, expected=EXPECTED, hint=hint)


_HINT = "Is it lsserver that answers at this host and port (8080 unless set otherwise)?"


def greeting(host: str, port: int, path: str) -> bytes:
    """The request that opens a WebSocket, for a caller that sends prepared messages itself."""
    protocol = _client(host, port, path)
    protocol.send_request(protocol.connect())
    return b"".join(protocol.data_to_send())


def masked(data: bytes) -> bytes:
    """A binary message as a client's bytes on the line."""
    return Frame(Opcode.BINARY, data).serialize(mask=True)


def _client(host: str, port: int, path: str) -> ClientProtocol:
    name = f"[{host}]" if ":" in host else host
    # No extension is offered: an answer is on the line as it is.
    return ClientProtocol(parse_uri(f"ws://{name}:{port}{path}"), max_size=MOST_BYTES)
