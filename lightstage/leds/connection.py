"""A line to a device: bytes out, bytes in. TCP here; the serial port has a file of its own."""

from __future__ import annotations

import fcntl
import hashlib
import os
import select
import socket
import time
from collections.abc import Callable
from pathlib import Path
from typing import IO, Protocol, TypeVar

from lightstage.errors import DeviceError
from lightstage.user_folder import own_folder, user_folder

BUSY_WAIT_S = 2.0
"""A port in use is tried for so long: a guardian may just be making it dark."""
BUSY_POLL_S = 0.05


class Line(Protocol):
    """An open line. Its methods raise OSError when it breaks."""

    def write(self, data: bytes) -> None:
        """Send all of it."""

    def read(self, wait_s: float) -> bytes:
        """What has come, at the latest after `wait_s`; nothing when nothing came."""

    @property
    def handles(self) -> tuple[int, ...]:
        """File descriptors that keep the line and its lock alive; the first carries the bytes."""

    def close(self) -> None:
        """Give the line back."""


AnyLine = TypeVar("AnyLine")


def _why(error: OSError) -> str:
    """Why a port does not open; pyserial prints the system's words twice, with their number."""
    return (os.strerror(error.errno) if error.errno else str(error)).lower()


def opened(connect: Callable[[], AnyLine], where: str) -> AnyLine:
    """What `connect` opens.

    Args:
        connect: opens a line.
        where: the device's name in messages.

    Raises:
        DeviceError: it cannot be opened.
    """
    try:
        return connect()
    except socket.gaierror:
        raise DeviceError(
            where,
            found="no such host",
            expected="a name that the network knows, or an address such as 192.168.1.20",
            hint="Is it spelled right, and is this computer on the stage's network?",
        ) from None
    except OSError as error:
        raise DeviceError(
            where,
            found=_why(error),
            expected="a port that opens",
            hint="Is the device plugged in and switched on?",
        ) from None


class SocketLine:
    """A TCP connection, one at a time from this machine.

    Args:
        host: name or address.
        port: of the device.
        timeout_s: for connecting and for each write.
        lock: of the address, where whoever connects again holds it (`lock_address`).

    Raises:
        DeviceError: another program of this machine is connected.
        OSError: nobody there.
    """

    def __init__(
        self, host: str, port: int, timeout_s: float, lock: IO[bytes] | None = None
    ) -> None:
        self._own_lock = lock_address(f"tcp {host}:{port}") if lock is None else None
        self._lock = lock or self._own_lock
        try:
            self._socket = socket.create_connection((host, port), timeout_s)
        except BaseException:
            self._give_lock_back()
            raise
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    @property
    def handles(self) -> tuple[int, ...]:
        """The connection, and the lock."""
        assert self._lock is not None
        return self._socket.fileno(), self._lock.fileno()

    @property
    def peer(self) -> tuple[str, int]:
        """Address and port at the other end."""
        host, port = self._socket.getpeername()[:2]
        return host, port

    def write(self, data: bytes) -> None:
        """Send all of it."""
        self._socket.sendall(data)

    def read(self, wait_s: float) -> bytes:
        """What has come within `wait_s`."""
        if not select.select([self._socket], [], [], wait_s)[0]:
            return b""
        data = self._socket.recv(65536)
        if not data:
            raise ConnectionResetError("the device closed the connection")
        return data

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()
        self._give_lock_back()

    def end(self, wait_s: float) -> None:
        """Close it when the other end has read everything and closed it too, or after so long."""
        until = time.monotonic() + wait_s
        try:
            self._socket.shutdown(socket.SHUT_WR)
            while (left_s := until - time.monotonic()) > 0:
                self._socket.settimeout(left_s)
                if not self._socket.recv(65536):
                    break
        except OSError:
            pass  # it is closed, or is not read
        self.close()

    def _give_lock_back(self) -> None:
        if self._own_lock is not None:
            self._own_lock.close()


def lock_address(name: str) -> IO[bytes]:
    """Take an address for this process and the children to which it hands the file.

    The lock ends with the last process that has it open, however that one ends. Its empty file
    stays: if it were removed, one process could hold the removed file, another one a new file.

    Raises:
        DeviceError: another one of this machine has it, or the files have no safe folder.
    """
    digest = hashlib.sha256(name.encode()).hexdigest()[:16]
    path = _locks_folder() / f"{digest}.lock"
    handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)
    file = os.fdopen(handle, "r+b")
    # Systems remove files from their temporary folder that nobody has changed for days.
    os.utime(handle)
    until = time.monotonic() + BUSY_WAIT_S
    while True:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return file
        except OSError:
            if time.monotonic() > until:
                file.close()
                raise in_use(f"LED device at {name}") from None
        time.sleep(BUSY_POLL_S)


def _locks_folder() -> Path:
    """The one folder of the locks of all this user's programs: another one would not exclude them.

    Raises:
        DeviceError: it is another user's, others may enter it, or it cannot be made.
    """
    folder = user_folder()
    if not own_folder(folder):
        raise DeviceError(
            f"the locks of LED devices, {folder}",
            found="no folder that is this user's alone",
            expected="a folder of this user with mode 0700, or a place where one can be made",
            hint="Remove it or correct its mode (chmod 700), or set TMPDIR to a folder of your own "
            "for all programs of this stage.",
        )
    return folder


def in_use(where: str) -> DeviceError:
    """The message for a second capture on one device."""
    return DeviceError(
        where,
        found="another program that is using it",
        expected="no other program",
        hint="Is a capture running already? Two on one device would light each other's patterns.",
    )
