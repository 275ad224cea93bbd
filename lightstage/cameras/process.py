"""One supervised process a camera: a hard deadline on every command, killed when it is over."""

from __future__ import annotations

import contextlib
import fcntl
import os
import selectors
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

from lightstage.cameras import messages
from lightstage.cameras.camera import Photograph, Summary
from lightstage.errors import DeviceError

PIPE_BYTES = 1 << 20
"""Room in the pipe of answers: a photograph passes in few large steps."""
STDERR_BYTES = 1 << 16


class Worker:
    """A child that answers one command at a time, or is killed.

    The child has a session of its own, so that Ctrl-C reaches only the capture, which ends it
    after the lights are dark.

    Args:
        name: what to call it in errors.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self._last_words = ""
        self._closing = threading.Lock()
        self._stderr, name_on_disk = tempfile.mkstemp()
        os.unlink(name_on_disk)
        self._child = subprocess.Popen(
            [sys.executable, "-m", "lightstage.cameras.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._stderr,
            bufsize=0,
            start_new_session=True,
        )
        if hasattr(fcntl, "F_SETPIPE_SZ") and self._child.stdout is not None:
            with contextlib.suppress(OSError):  # a user's pipes may have a limit
                fcntl.fcntl(self._child.stdout, fcntl.F_SETPIPE_SZ, PIPE_BYTES)

    @property
    def pid(self) -> int:
        """The child's process id."""
        return self._child.pid

    def ask(self, command: dict[str, Any], deadline_s: float) -> tuple[dict[str, Any], bytes]:
        """Send one command and wait for its answer.

        Args:
            command: JSON-ready, with ``command``.
            deadline_s: seconds after which the child is killed.

        Raises:
            DeviceError: an error that the child tells, its death, or the deadline.
        """
        doing = str(command["command"])
        until = time.monotonic() + deadline_s
        assert self._child.stdin is not None
        try:
            self._child.stdin.write(messages.head(command))
            message = messages.read(lambda size: self._take(size, until))
        except TimeoutError:
            self.kill()
            raise DeviceError(
                self.name,
                field=doing,
                found=f"no answer within {deadline_s:g} s",
                expected="an answer",
                hint="Its process was ended; switch the camera off and on.",
            ) from None
        except (OSError, ValueError) as error:
            raise self._died(doing, str(error)) from None
        if message is None:
            raise self._died(doing, "its process ended")
        reply, data = message
        if "error" in reply:
            told = reply["error"]
            where = f"{self.name} ({told.pop('where')})"
            raise DeviceError(where, **told)
        return reply, data

    def kill(self) -> None:
        """End the child now, whatever it is doing."""
        with contextlib.suppress(ProcessLookupError):
            self._child.kill()
        self._child.wait()
        self._close_files()

    def close(self) -> None:
        """Let the child end by itself (its commands' stream ends); kill it if it takes over 2 s."""
        with contextlib.suppress(OSError):
            if self._child.stdin is not None:
                self._child.stdin.close()
        try:
            self._child.wait(2.0)
        except subprocess.TimeoutExpired:
            self.kill()
        self._close_files()

    def _take(self, size: int, until: float) -> bytes:
        """Exactly `size` bytes of the child's answers, fewer only if it ended."""
        assert self._child.stdout is not None
        taken = bytearray(size)
        done = 0
        with memoryview(taken) as view, selectors.DefaultSelector() as selector:
            selector.register(self._child.stdout, selectors.EVENT_READ)
            while done < size:
                if not selector.select(max(0.0, until - time.monotonic())):
                    raise TimeoutError
                count = os.readv(self._child.stdout.fileno(), [view[done:]])
                if count == 0:
                    break
                done += count
            return bytes(view[:done])

    def _died(self, doing: str, said: str) -> DeviceError:
        self.kill()
        lines = self._last_words.splitlines()
        return DeviceError(
            self.name,
            field=doing,
            found=f"{said}, exit status {self._child.returncode}"
            + (f", {lines[-1]}" if lines else ""),
            expected="an answer",
            hint="Switch the camera off and on, then try again.",
        )

    def _close_files(self) -> None:
        # A capture that gives up closes cameras while their threads may be doing the same.
        with self._closing:
            if self._stderr >= 0:
                words = os.pread(self._stderr, STDERR_BYTES, 0)
                self._last_words = words.decode(errors="replace").strip()
                os.close(self._stderr)
                self._stderr = -1
            for pipe in (self._child.stdin, self._child.stdout):
                with contextlib.suppress(OSError):
                    if pipe is not None:
                        pipe.close()


class CameraProcess:
    """A camera in a process of its own (CameraDevice).

    Args:
        camera_id: the rig's name for it.
        port: libgphoto2's name of the port, or what the driver calls it.
        virtual_folder: folder of libgphoto2's virtual camera, None for a real one.
        deadline_s: of every command.
        driver: ``package.module:name`` of a driver that is not libgphoto2's.
    """

    def __init__(
        self,
        camera_id: str,
        port: str,
        virtual_folder: Path | None,
        deadline_s: float,
        driver: str | None = None,
    ) -> None:
        self.id = camera_id
        self.port = port
        self.virtual_folder = virtual_folder
        self.deadline_s = deadline_s
        self.driver = driver
        self._worker: Worker | None = None

    @property
    def pid(self) -> int | None:
        """The process id, None before open() and after close()."""
        return None if self._worker is None else self._worker.pid

    def open(self) -> Summary:
        """Start the process and connect."""
        self.close()
        self._worker = Worker(f"camera {self.id}")
        folder = None if self.virtual_folder is None else str(self.virtual_folder)
        command = {
            "command": "open",
            "port": self.port,
            "virtual_folder": folder,
            "driver": self.driver,
        }
        reply, _ = self._worker.ask(command, self.deadline_s)
        return Summary(**reply)

    def capture(self, at_s: float) -> Photograph:
        """Trigger at a time of time.monotonic() and download, within the deadline."""
        if self._worker is None:
            raise DeviceError(f"camera {self.id}", found="not open", expected="open() first")
        command = {"command": "capture", "at_s": at_s}
        reply, data = self._worker.ask(command, self.deadline_s)
        return Photograph(data=data, **reply)

    def close(self) -> None:
        """End the process."""
        if self._worker is not None:
            self._worker.close()
            self._worker = None


def detect_ports(deadline_s: float) -> list[tuple[str, str]]:
    """Model and port of every connected camera, asked in a process that can be killed."""
    worker = Worker("camera detection")
    try:
        reply, _ = worker.ask({"command": "detect"}, deadline_s)
    finally:
        worker.close()
    return [(str(model), str(port)) for model, port in reply["found"]]
