"""`python -m lightstage` for tests that need it as a process, without importing it a hundred times.

A server imports the program once and forks a process for each call: what it runs, its pipes, its
signals and its end are those of a process that Python started anew; only the imports are not its
own. `quickly` puts it in place of `subprocess.Popen` for these calls; all others stay as they are.
"""

from __future__ import annotations

import array
import contextlib
import importlib
import inspect
import json
import os
import selectors
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from typing import Any

IMPORTED = (
    "lightstage.__main__",
    "lightstage.capture.command",
    "lightstage.checks.kernels",
    "lightstage.checks.session",
)
STANDARD = (0, 1, 2)
LARGEST = 1 << 20
START_S = 60.0


class _Server:
    """The process that forks, and what it has reported of the ends of its children."""

    def __init__(self) -> None:
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._pid = os.getpid()
        self._lock = threading.Lock()
        self._ended: dict[int, int] = {}
        self._socket = ours
        self._process = _popen(
            [sys.executable, "-m", __name__, str(theirs.fileno())], pass_fds=(theirs.fileno(),)
        )
        theirs.close()

    def usable(self) -> bool:
        """Whether it lives, and is this process's own and not that of one that was forked."""
        return self._pid == os.getpid() and self._process.poll() is None

    def begin(self, call: dict[str, Any], files: tuple[int, ...]) -> int:
        """Fork a process with these files as its standard ones; returns its id."""
        with self._lock:
            rights = [(socket.SOL_SOCKET, socket.SCM_RIGHTS, array.array("i", files))]
            self._socket.sendmsg([json.dumps(call).encode()], rights)
            until = time.monotonic() + START_S
            while (pid := self._heard(until - time.monotonic())) is None:
                if time.monotonic() > until:
                    raise TimeoutError("the server of forks does not answer")
            return pid

    def status(self, pid: int) -> int | None:
        """The wait status of a process that has ended; None while it runs."""
        with self._lock:
            while pid not in self._ended and self._has_news():
                self._heard(0)
            return self._ended.pop(pid, None)

    def _has_news(self) -> bool:
        with selectors.DefaultSelector() as waiting:
            waiting.register(self._socket, selectors.EVENT_READ)
            return bool(waiting.select(0))

    def _heard(self, seconds: float) -> int | None:
        """Take one message; returns the id of a process that it says has begun."""
        self._socket.settimeout(max(seconds, 0.1))
        message = json.loads(self._socket.recv(LARGEST))
        if "status" in message:
            self._ended[message["pid"]] = message["status"]
            return None
        return int(message["pid"])


class _Forked(subprocess.Popen):  # type: ignore[type-arg]  # of text and of bytes alike
    """Popen whose process the server forks; the methods that it replaces are Python 3.11's."""

    def _execute_child(self, args: Any, *rest: Any) -> None:
        names = inspect.signature(super()._execute_child).parameters  # type: ignore[misc]
        given = dict(zip(list(names)[1:], rest, strict=True))
        own = (given["p2cread"], given["c2pwrite"], given["errwrite"])
        files = tuple(STANDARD[i] if file == -1 else file for i, file in enumerate(own))
        environment = given["env"]
        call = {
            "words": list(map(os.fspath, args[3:])),
            "environment": dict(os.environ if environment is None else environment),
            "folder": os.fspath(given["cwd"] or os.getcwd()),
            "session": bool(given["start_new_session"]),
            "group": given["process_group"],
        }
        self.pid = _server().begin(call, files)
        self._child_created = True
        self._close_pipe_fds(*(given[name] for name in PIPES))  # type: ignore[attr-defined]

    def _internal_poll(self, *_: Any, **__: Any) -> int | None:
        if self.returncode is None:
            status = _server().status(self.pid)
            if status is not None:
                self._handle_exitstatus(status)
        return self.returncode

    def _wait(self, timeout: float | None) -> int:
        until = None if timeout is None else time.monotonic() + timeout
        while self._internal_poll() is None:
            if until is not None and time.monotonic() > until:
                raise subprocess.TimeoutExpired(self.args, timeout or 0)
            time.sleep(0.005)
        return int(self.returncode)


_popen = subprocess.Popen
_servers: list[_Server] = []
PIPES = ("p2cread", "p2cwrite", "c2pread", "c2pwrite", "errread", "errwrite")
UNKNOWN = ("preexec_fn", "pass_fds", "user", "group", "umask", "executable", "shell")


def _server() -> _Server:
    if not _servers or not _servers[-1].usable():
        _servers.append(_Server())
    return _servers[-1]


def _begun(args: Any, *rest: Any, **options: Any) -> Any:
    program = isinstance(args, list) and list(args[:3]) == [sys.executable, "-m", "lightstage"]
    fit = program and not rest and not any(options.get(name) for name in UNKNOWN)
    return (_Forked if fit else _popen)(args, *rest, **options)


@contextlib.contextmanager
def quickly() -> Iterator[None]:
    """Within it `python -m lightstage` is forked."""
    subprocess.Popen = _begun  # type: ignore[misc,assignment]
    try:
        yield
    finally:
        subprocess.Popen = _popen  # type: ignore[misc]


def _serve(connection: socket.socket) -> None:
    for name in IMPORTED:
        importlib.import_module(name)
    waking, wake = socket.socketpair()
    waking.setblocking(False)
    wake.setblocking(False)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C of a terminal is for the processes
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.set_wakeup_fd(wake.fileno())
    waiting = selectors.DefaultSelector()
    waiting.register(connection, selectors.EVENT_READ)
    waiting.register(waking, selectors.EVENT_READ)
    while True:
        for key, _ in waiting.select():
            if key.fileobj is waking:
                with contextlib.suppress(BlockingIOError):
                    waking.recv(4096)
                _report_ended(connection)
                continue
            call, rights, _, _ = connection.recvmsg(LARGEST, socket.CMSG_SPACE(4 * len(STANDARD)))
            if not call:
                return
            files = array.array("i")
            files.frombytes(rights[0][2])
            pid = os.fork()
            if pid == 0:
                for own in (connection, waking, wake, waiting):
                    own.close()
                _run(json.loads(call), files)
            for file in files:
                os.close(file)
            connection.send(json.dumps({"pid": pid}).encode())


def _report_ended(connection: socket.socket) -> None:
    with contextlib.suppress(ChildProcessError):
        while (ended := os.waitpid(-1, os.WNOHANG))[0]:
            connection.send(json.dumps({"pid": ended[0], "status": ended[1]}).encode())


def _run(call: dict[str, Any], files: array.array[int]) -> None:
    """Become the process that was asked for; does not return."""
    code = 1
    try:
        signal.set_wakeup_fd(-1)
        for number in (signal.SIGCHLD, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_DFL)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        if call["session"]:
            os.setsid()
        elif call["group"] is not None and call["group"] >= 0:
            os.setpgid(0, call["group"])
        for standard, file in zip(STANDARD, files, strict=True):
            os.dup2(file, standard)
        for file in files:
            if file not in STANDARD:
                os.close(file)
        os.environ.clear()
        os.environ.update(call["environment"])
        os.chdir(call["folder"])
        sys.argv = ["lightstage", *call["words"]]
        from lightstage.__main__ import app
        from lightstage.commands import run_app

        run_app(app)
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else 0
    except BaseException:
        sys.excepthook(*sys.exc_info())
    finally:
        _end(code)


def _end(code: int) -> None:
    """End as a process does: threads waited for, exit handlers called, streams flushed."""
    with contextlib.suppress(BaseException):
        threading._shutdown()  # type: ignore[attr-defined]
        import atexit

        atexit._run_exitfuncs()
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(code)


if __name__ == "__main__":
    _serve(socket.socket(fileno=int(sys.argv[1])))
