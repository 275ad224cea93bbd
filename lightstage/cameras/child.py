"""A camera's process seen from the capture: one command at a time, each with a hard deadline."""

from __future__ import annotations

import contextlib
import os
import selectors
import signal
import subprocess
import sys
import tempfile
import threading
import time
from typing import Any

from lightstage.cameras import messages
from lightstage.errors import CaptureError, DeviceError
from lightstage.printable import printable

STDERR_BYTES = 1 << 16
LONGEST_SAID = 2000
"""Characters of each part of an error that a driver reports."""
GRACE_S = 2.0
"""So long a child may take to let go of its camera when it is closed."""
DEATH_S = 0.5
"""So long a child may take to end after it closed its answers, so that its status is its own."""
KILL_S = 2.0
"""So long the kernel may take to end a killed process; one that is stuck in it is left behind."""


class Child:
    """A child that answers one command at a time, or is killed.

    It has a session of its own, so that Ctrl-C reaches only the capture, which ends it after the
    lights are dark. Methods may be called from any thread.

    Args:
        camera_id: whose camera it serves.
        name: what to call it in errors.
    """

    def __init__(self, camera_id: str, name: str) -> None:
        self.name = name
        self._last_words = ""
        self._turn = threading.Lock()  # held while a command is under way; it guards the files
        self._open = True
        try:
            self._stderr, name_on_disk = tempfile.mkstemp()
            os.unlink(name_on_disk)
            theirs, self._lifeline = os.pipe()
            try:
                self._child = subprocess.Popen(
                    [sys.executable, "-m", "lightstage.cameras.worker", camera_id, str(theirs)],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=self._stderr,
                    bufsize=0,
                    start_new_session=True,
                    pass_fds=(theirs,),
                )
            finally:
                os.close(theirs)
        except OSError as error:
            raise DeviceError(
                name,
                field="process",
                found=error.strerror or str(error),
                expected="a process of its own",
                hint="Is this computer out of memory, files or processes?",
            ) from None

    @property
    def pid(self) -> int:
        """The child's process id."""
        return self._child.pid

    @property
    def alive(self) -> bool:
        """Whether it can be asked."""
        return self._open and not self._ended_within(0.0)

    def ask(self, command: dict[str, Any], deadline_s: float) -> dict[str, Any]:
        """Send one command and wait for its answer.

        Args:
            command: JSON-ready, with ``command``.
            deadline_s: seconds after which the child is killed.

        Raises:
            DeviceError: an error of the camera that the child reports, its death, or the deadline.
            CaptureError: an error of this computer's disk that the child reports.
        """
        doing = str(command["command"])
        until = time.monotonic() + deadline_s
        with self._turn:
            if not self._open:
                raise self._died(doing, "its process was ended")
            assert self._child.stdin is not None
            try:
                self._child.stdin.write(messages.pack(command))
                reply = messages.read(lambda size: self._take(size, until))
            except TimeoutError:
                self._end()
                raise DeviceError(
                    self.name,
                    field=doing,
                    found=f"no answer within {deadline_s:.3g} s",
                    expected="an answer",
                    hint="Its process was ended. If it hangs again, switch the camera off and on.",
                ) from None
            except OSError:  # nobody reads what it is asked, or answers
                raise self._died(doing, "its process ended") from None
            except ValueError as error:
                raise self._died(doing, str(error)) from None
            if reply is None:
                raise self._died(doing, "its process ended")
        if "error" in reply:
            fields = {name: printable(text, LONGEST_SAID) for name, text in reply["error"].items()}
            kind = CaptureError if fields.pop("kind") == "disk" else DeviceError
            raise kind(f"{self.name} ({fields.pop('where')})", **fields)
        return reply

    def kill(self) -> None:
        """End the child now, whatever it is doing; a command under way fails."""
        self._kill()
        # Its files are closed by whoever waits for its answer, never under their hands.
        if self._turn.acquire(timeout=KILL_S):
            try:
                self._end()
            finally:
                self._turn.release()

    def close(self) -> None:
        """Let the child end by itself; kill it where that takes too long."""
        if self._turn.acquire(timeout=GRACE_S):
            try:
                if self._open:
                    with contextlib.suppress(OSError):
                        assert self._child.stdin is not None
                        self._child.stdin.close()  # its commands end, and it with them
                    self._ended_within(GRACE_S)
                    self._end()
            finally:
                self._turn.release()
        else:
            self.kill()

    def _take(self, size: int, until: float) -> bytes:
        """Exactly `size` bytes of the child's answers, fewer only if it ended."""
        assert self._child.stdout is not None
        taken = bytearray()
        with selectors.DefaultSelector() as selector:
            selector.register(self._child.stdout, selectors.EVENT_READ)
            while len(taken) < size:
                if not selector.select(max(0.0, until - time.monotonic())):
                    raise TimeoutError
                piece = os.read(self._child.stdout.fileno(), size - len(taken))
                if not piece:
                    break
                taken += piece
        return bytes(taken)

    def _died(self, doing: str, state: str) -> DeviceError:
        """Its death as an error; `_turn` is held."""
        self._ended_within(DEATH_S)
        self._end()
        lines = self._last_words.splitlines()[-1:]
        return DeviceError(
            self.name,
            field=doing,
            found=f"{state}, exit status {self._child.returncode}"
            + (f", {printable(lines[0])}" if lines else ""),
            expected="an answer",
            hint="Switch the camera off and on, then try again.",
        )

    def _ended_within(self, seconds: float) -> bool:
        """Whether it ends by itself; it stays a zombie, so that its number is nobody else's."""
        until = time.monotonic() + seconds
        while self._child.returncode is None:
            try:
                if os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None:
                    return True
            except ChildProcessError:  # another thread has just seen to it
                return True
            if time.monotonic() >= until:
                return False
            time.sleep(0.005)
        return True

    def _kill(self) -> None:
        """SIGKILL for it and whatever it started, also where it has ended already."""
        if self._child.returncode is None:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(self.pid, signal.SIGKILL)

    def _end(self) -> None:
        """Kill it, wait for that, and close what led to it; `_turn` is held. Once is enough."""
        if not self._open:
            return
        self._open = False
        self._kill()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._child.wait(KILL_S)
        self._last_words = os.pread(self._stderr, STDERR_BYTES, 0).decode(errors="replace").strip()
        os.close(self._stderr)
        os.close(self._lifeline)
        for pipe in (self._child.stdin, self._child.stdout):
            with contextlib.suppress(OSError):
                if pipe is not None:
                    pipe.close()
