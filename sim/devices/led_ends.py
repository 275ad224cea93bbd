"""Where a device's line ends: the master of a pseudo-terminal, a TCP port, a UDP port."""

from __future__ import annotations

import contextlib
import os
import select
import socket
import tty
from typing import Literal, Protocol

OPEN_POLL_S = 0.005
"""While nobody has a terminal open, the kernel reports an opening only to those who ask."""
READ_BYTES = 65536

Event = Literal["opened", "closed", "data", "stop"]


class End(Protocol):
    """The device's end of a line. One host at a time."""

    place: str
    """What is in a URL behind the scheme's two slashes."""

    def wait(self, stop: int, timeout_s: float | None) -> Event | None:
        """The next thing that happens; "stop" when that handle can be read; None after a time."""

    def read(self) -> bytes:
        """What has come."""

    def send(self, data: bytes) -> None:
        """Send something; into the void where nobody is there."""

    def close(self) -> None:
        """Take the line down."""


class PtyEnd:
    """A pseudo-terminal, whose other end a host opens like a serial port."""

    def __init__(self) -> None:
        self._master, slave = os.openpty()
        tty.setraw(slave)
        self.place = os.ttyname(slave)
        # Not kept open here: only so does the master learn when a host opens it.
        os.close(slave)
        self._connected = False

    def wait(self, stop: int, timeout_s: float | None) -> Event | None:
        """Unconnected, that the port is open shows only as the absence of POLLHUP."""
        poll = select.poll()
        poll.register(stop, select.POLLIN)
        poll.register(self._master, select.POLLIN)
        wait_ms = None if timeout_s is None else max(0.0, 1e3 * timeout_s)
        found = dict(poll.poll(wait_ms if self._connected else 0))
        if stop in found:
            return "stop"
        ready = found.get(self._master, 0)
        if not self._connected:
            if ready & select.POLLHUP:
                pause_s = OPEN_POLL_S if timeout_s is None else min(OPEN_POLL_S, timeout_s)
                return "stop" if select.select([stop], [], [], max(0.0, pause_s))[0] else None
            self._connected = True
            return "opened"
        if ready & select.POLLIN:
            return "data"
        if ready & select.POLLHUP:
            self._connected = False
            return "closed"
        return None

    def read(self) -> bytes:
        """What has come."""
        return os.read(self._master, READ_BYTES)

    def send(self, data: bytes) -> None:
        """Send something."""
        with contextlib.suppress(OSError):  # nobody has the port open
            while data:
                data = data[os.write(self._master, data) :]

    def close(self) -> None:
        """Take the terminal down."""
        os.close(self._master)


class TcpEnd:
    """A TCP port of this machine; a second host is turned away."""

    def __init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.place = f"127.0.0.1:{self._listener.getsockname()[1]}"
        self._host: socket.socket | None = None
        self._data = b""

    def wait(self, stop: int, timeout_s: float | None) -> Event | None:
        """The next opening, closing or bytes."""
        ends: list[int | socket.socket] = [stop, self._listener]
        ends += [self._host] if self._host else []
        ready = select.select(ends, [], [], None if timeout_s is None else max(0.0, timeout_s))[0]
        if stop in ready:
            return "stop"
        # First the one who is there: the next may have waited for it to go.
        if self._host in ready and self._host is not None:
            with contextlib.suppress(OSError):
                self._data = self._host.recv(READ_BYTES)
                if self._data:
                    return "data"
            self._host.close()
            self._host = None
            return "closed"
        if self._listener in ready:
            host, _ = self._listener.accept()
            if self._host is not None:
                host.close()
                return None
            host.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._host = host
            return "opened"
        return None

    def read(self) -> bytes:
        """What has come."""
        data, self._data = self._data, b""
        return data

    def send(self, data: bytes) -> None:
        """Send something."""
        with contextlib.suppress(OSError):
            if self._host is not None:
                self._host.sendall(data)

    def close(self) -> None:
        """Close the port."""
        self._listener.close()
        if self._host is not None:
            self._host.close()


class UdpEnd:
    """A UDP port of this machine: each read is one datagram; nobody opens or closes it."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        self._socket.bind(("127.0.0.1", 0))
        self.place = f"127.0.0.1:{self._socket.getsockname()[1]}"

    def wait(self, stop: int, timeout_s: float | None) -> Event | None:
        """The next datagram."""
        limit_s = None if timeout_s is None else max(0.0, timeout_s)
        ends: list[int | socket.socket] = [stop, self._socket]
        ready = select.select(ends, [], [], limit_s)[0]
        if stop in ready:
            return "stop"
        return "data" if ready else None

    def read(self) -> bytes:
        """One datagram."""
        return self._socket.recv(READ_BYTES)

    def send(self, data: bytes) -> None:
        """Nothing is ever sent."""

    def close(self) -> None:
        """Close the port."""
        self._socket.close()
