"""The page's server: its sockets, its thread, its end."""

from __future__ import annotations

import contextlib
import ipaddress
import socket
import threading
import time
from collections.abc import Iterator, Sequence

import uvicorn
from starlette.types import ASGIApp

from lightstage.errors import ConfigError, DeviceError

LOOPBACK = "127.0.0.1"
START_S = 20.0
STOP_S = 3.0


def local_address(host: str) -> str:
    """This computer's own address on the network of another computer.

    Args:
        host: the other's numeric address.

    Raises:
        ConfigError: not a numeric address of one computer, or one that cannot be reached.
    """
    expected = "the numeric address of one other computer, such as 192.168.1.20"
    try:
        address = ipaddress.IPv4Address(host)
    except ValueError:
        raise ConfigError("--allow-from", found=ascii(host[:80]), expected=expected) from None
    if address.is_unspecified or address.is_multicast or address.is_loopback:
        raise ConfigError("--allow-from", found=host, expected=expected)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect((host, 9))  # sends nothing: the system only chooses a network
        except OSError as error:
            raise ConfigError(
                "--allow-from",
                found=f"{host}, {error.strerror or error}",
                expected="a computer on a network of this one",
            ) from None
        return str(probe.getsockname()[0])


def listen(addresses: Sequence[str], port: int) -> list[socket.socket]:
    """Listening sockets of one port on these addresses (port 0: the first address chooses).

    Raises:
        DeviceError: another program has the port.
    """
    sockets: list[socket.socket] = []
    try:
        for address in addresses:
            listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
            sockets.append(listener)
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind((address, port))
            port = int(listener.getsockname()[1])
    except OSError as error:
        for each in sockets:
            each.close()
        raise DeviceError(
            f"port {port} of {address}",
            found=error.strerror or str(error),
            expected="a free one",
            hint="Is a console running already? Else give another --port, or 0 for a free one.",
        ) from None
    return sockets


@contextlib.contextmanager
def serving(
    app: ASGIApp, sockets: Sequence[socket.socket], closing: threading.Event
) -> Iterator[threading.Thread]:
    """Serve in a thread as long as the block lasts; signals stay with the main thread.

    Args:
        app: what answers.
        sockets: that listen; they are closed at the end.
        closing: set when the block ends, so that streams of events end by themselves.

    Raises:
        DeviceError: the server does not start.
    """
    config = uvicorn.Config(
        app,
        log_level="error",
        access_log=False,  # the printed address has a token, which belongs into no log
        server_header=False,
        date_header=False,
        lifespan="off",
        timeout_graceful_shutdown=1,
        h11_max_incomplete_event_size=1 << 16,
        proxy_headers=False,
        ws="none",
    )
    server = uvicorn.Server(config)
    thread = threading.Thread(
        target=server.run, kwargs={"sockets": list(sockets)}, name="page", daemon=True
    )
    thread.start()
    until = time.monotonic() + START_S
    while not server.started and thread.is_alive() and time.monotonic() < until:
        time.sleep(0.02)
    if not server.started:
        raise DeviceError("the page's server", found="no start", expected="one that listens")
    try:
        yield thread
    finally:
        closing.set()
        server.should_exit = True
        thread.join(STOP_S)
        for each in sockets:
            each.close()
