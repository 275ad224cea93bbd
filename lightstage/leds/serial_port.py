"""A serial port or a pseudo-terminal as a line. The only file with pyserial."""

from __future__ import annotations

import errno
import select
import time

import serial

from lightstage.leds.connection import BUSY_POLL_S, BUSY_WAIT_S, in_use

DEFAULT_BAUD = 115200
"""Without meaning on a pseudo-terminal."""


class SerialPort:
    """An open port, for this process alone (Line).

    Opening it may reset a board (DTR): who talks first waits for its hello.

    Args:
        path: device file.
        baud: line speed, bits a second.
        timeout_s: for each write.

    Raises:
        DeviceError: another program uses it.
        OSError: it cannot be opened.
    """

    def __init__(self, path: str, baud: int = DEFAULT_BAUD, timeout_s: float = 5.0) -> None:
        until = time.monotonic() + BUSY_WAIT_S
        while True:
            try:
                # Reading never waits: what `select` saw may be read by now, or less than was
                # counted.
                self._port = serial.Serial(
                    path, baud, timeout=0, write_timeout=timeout_s, exclusive=True
                )
                return
            except ValueError as error:
                raise OSError(str(error)) from None
            except serial.SerialException as error:
                # EBUSY: taken by a program that asked the kernel for it (TIOCEXCL).
                if error.errno not in (errno.EAGAIN, errno.EBUSY):
                    raise
            if time.monotonic() > until:
                raise in_use(f"LED device at {path}")
            time.sleep(BUSY_POLL_S)

    @property
    def handles(self) -> tuple[int, ...]:
        """The port; its lock (flock) lives as long."""
        return (self._port.fileno(),)

    def write(self, data: bytes) -> None:
        """Hand all of it to the kernel."""
        self._port.write(data)

    def read(self, wait_s: float) -> bytes:
        """What has come within `wait_s`."""
        if not select.select([self._port.fileno()], [], [], wait_s)[0]:
            return b""
        return bytes(self._port.read(max(1, self._port.in_waiting)))

    def drain(self) -> None:
        """Wait until the last byte is on the line."""
        self._port.flush()

    def close(self) -> None:
        """Close the port."""
        self._port.close()
