"""A real headless Chromium, driven over its own pipe (Chrome DevTools Protocol).

It stands for a person at a page of ours: tests and benchmarks press its keys and read what it
shows.
"""

from __future__ import annotations

import base64
import json
import os
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any

from lightstage.formats.values import LINE, parse_json
from sim.errors import SimError

QUIET = [
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--hide-scrollbars", "--disable-background-networking", "--disable-component-update",
    "--disable-sync", "--disable-dev-shm-usage", "--mute-audio", "--remote-debugging-pipe",
]  # fmt: skip
ANSWER_S = 60.0


class BrowserError(SimError):
    """A page that does not do what was expected, or a browser that is gone."""


def chromium() -> str | None:
    """The program; None where it is not installed."""
    return shutil.which("chromium") or shutil.which("chromium-browser")


class Browser:
    """One window. Use as a context manager.

    Args:
        folder: for its profile; a new one.
        width: of the window, pixels.
        height: the same.
        more: options for it, beside `QUIET`.

    Raises:
        BrowserError: Chromium is not installed.
    """

    def __init__(
        self, folder: Path, width: int = 1280, height: int = 900, more: tuple[str, ...] = ()
    ) -> None:
        program = chromium()
        if program is None:
            raise BrowserError(
                "chromium",
                found="no such program",
                expected="a browser",
                hint="Install Debian's package chromium.",
            )
        to_read, self._write = os.pipe()
        self._read, to_write = os.pipe()
        # Chromium reads commands from 3 and writes answers to 4, which this process may have open.
        start = 'exec "$@" 3<&"$IN" 4>&"$OUT"'
        self._process = subprocess.Popen(
            ["bash", "-c", start, "chromium", program, *QUIET, *more, f"--user-data-dir={folder}",
             f"--window-size={width},{height}", "about:blank"],
            pass_fds=(to_read, to_write),
            env={**os.environ, "IN": str(to_read), "OUT": str(to_write)},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )  # fmt: skip
        os.close(to_read)
        os.close(to_write)
        self._number, self._pending, self._session = 0, b"", ""
        self.errors: list[str] = []
        """Errors of the page's code and in the browser's console."""
        targets = self._ask("Target.getTargets")["targetInfos"]
        page = next(each for each in targets if each["type"] == "page")
        attached = self._ask("Target.attachToTarget", targetId=page["targetId"], flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log"):
            self._ask(f"{domain}.enable")
        self.resize(width, height)

    def __enter__(self) -> Browser:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        self._process.wait(20)
        os.close(self._write)
        os.close(self._read)

    def resize(self, width: int, height: int) -> None:
        """Another size of the page."""
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self._ask("Emulation.setDeviceMetricsOverride", **size)

    def go(self, url: str) -> None:
        """Open an address."""
        self._ask("Page.navigate", url=url)
        self.wait('document.readyState === "complete"')

    def js(self, code: str) -> Any:
        """The value of an expression in the page."""
        answer = self._ask("Runtime.evaluate", expression=code, returnByValue=True)
        if "exceptionDetails" in answer:
            raise BrowserError(f"{code}: {answer['exceptionDetails']}")
        return answer["result"].get("value")

    def wait(self, code: str, seconds: float = ANSWER_S) -> None:
        """Wait until an expression is true."""
        until = time.monotonic() + seconds
        while True:
            try:
                if self.js(f"Boolean({code})"):
                    return
            except BrowserError:  # between two pages
                pass
            if time.monotonic() > until:
                text = self.js("document.body.innerText")
                raise BrowserError(f"not so within {seconds:g} s: {code}\n{text}\n{self.errors}")
            time.sleep(0.05)

    def drag(self, start: tuple[int, int], end: tuple[int, int]) -> None:
        """Press the left button at one place of the window and let it go at another."""
        for kind, (x, y) in (
            ("mousePressed", start), ("mouseMoved", end), ("mouseReleased", end)
        ):  # fmt: skip
            held = {"button": "left", "buttons": 1, "clickCount": 1}
            self._ask("Input.dispatchMouseEvent", type=kind, x=x, y=y, **held)

    def press(self, key: str) -> None:
        """Press a key, as a person does."""
        for kind in ("keyDown", "keyUp"):
            text = {"text": key} if kind == "keyDown" else {}
            self._ask("Input.dispatchKeyEvent", type=kind, key=key, **text)

    def forget_cookies(self) -> None:
        """Make the page's session unknown to its server, as after the server was started again."""
        self._ask("Network.clearBrowserCookies")

    def picture(self, path: Path) -> Path:
        """A PNG of the window."""
        data = self._ask("Page.captureScreenshot", format="png")["data"]
        path.write_bytes(base64.b64decode(data))
        return path

    def _ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._write, json.dumps(message).encode() + b"\0")
        while True:
            message = self._next()
            if message.get("id") == self._number:
                if "error" in message:
                    raise BrowserError(f"{method}: {message['error']}")
                result: dict[str, Any] = message["result"]
                return result
            self._notice(message)

    def _next(self) -> dict[str, Any]:
        while b"\0" not in self._pending:
            piece = os.read(self._read, 1 << 16)
            if not piece:
                raise BrowserError("the browser is gone")
            self._pending += piece
        raw, self._pending = self._pending.split(b"\0", 1)
        message: dict[str, Any] = parse_json(raw, "the browser", LINE)
        return message

    def _notice(self, message: dict[str, Any]) -> None:
        if message.get("method") == "Runtime.exceptionThrown":
            self.errors.append(json.dumps(message["params"]["exceptionDetails"])[:500])
        if (
            message.get("method") == "Runtime.consoleAPICalled"
            and message["params"]["type"] == "error"
        ):
            self.errors.append(json.dumps(message["params"]["args"])[:500])
        if message.get("method") == "Log.entryAdded":
            entry = message["params"]["entry"]
            if entry["level"] == "error":
                self.errors.append(f"{entry['text']} {entry.get('url', '')}")
