"""Devices that record what is asked of them and fail when they are told to."""

import hashlib
import threading
import time
from pathlib import Path

import numpy as np

from lightstage.cameras.camera import CardFile, Download, Exposure, Summary
from lightstage.errors import DeviceError
from lightstage.leds.controller import Hello
from lightstage.operator import Wish

TOLD = Summary(
    serial="600", model="Nikon DSC D750", firmware="1.0", mode="Manual", iso="100",
    shutter="1/60", aperture="8", white_balance="Daylight", image_format="RAW", focus="Manual",
    battery_percent=90.0, card_free_bytes=10**10, clock_offset_s=0.0, owner="", artist="",
    copyright="", place="off",
)  # fmt: skip


class Lights:
    """Lights that acknowledge, or fail at the n-th request of a kind.

    Attributes:
        levels: what shines.
        fail: kind of request -> (from which one on, until which one, error).
    """

    def __init__(self, log: list[str], count: int = 8) -> None:
        self.log = log
        self.hello = Hello(1, count, "fake")
        self.acknowledged = True
        self.pulse_hz = None
        self.fail: dict[str, tuple[int, int, Exception]] = {}
        self.levels = np.zeros(count)
        self.state = self.lit_state = 0
        self._counts: dict[str, int] = {}
        self._lock = threading.Lock()

    def light(self, levels: np.ndarray) -> np.ndarray:
        self._did("light")
        self.lit_state = self.state
        self.levels = np.round(levels * 65535) / 65535
        return self.levels

    def confirm(self) -> None:
        self._did("confirm")

    def dark(self) -> None:
        self._did("dark")
        self.levels = np.zeros_like(self.levels)

    def recover(self) -> None:
        self._did("recover")
        self.levels = np.zeros_like(self.levels)

    def close(self) -> None:
        pass

    def _did(self, what: str) -> None:
        with self._lock:
            self.log.append(what)
            self.state += what in ("light", "dark")
            count = self._counts[what] = self._counts.get(what, 0) + 1
        first, last, error = self.fail.get(what, (0, -1, Exception()))
        if first <= count <= last:
            raise error


class FakeCamera:
    """A camera whose pictures tell the levels they were taken under.

    Attributes:
        faults: shot (from 1) -> what goes wrong: ``fail``, ``after`` (the picture is on the card,
            but the camera answers no more), ``two`` (two pictures, no answer), ``stale``,
            ``late`` (the picture takes a second), ``hangs`` (no picture and no answer, until
            `answer` is set or some seconds are over), ``tardy`` (none, until after the next trigger
            was asked for).
        cut: the next so many downloads bring half a file.
        on_card: name -> bytes.
    """

    def __init__(self, camera_id: str, log: list[str], lights: Lights, make_dng) -> None:
        self.id = camera_id
        self.log = log
        self.lights = lights
        self.make_dng = make_dng
        self.faults: dict[int, str] = {}
        self.cut = 0
        self.on_card: dict[str, bytes] = {}
        self.shots = 0
        self.dead = self.tardy = False
        self.restarts = 0
        self.gone = self.hanging = False
        self.answer = threading.Event()

    def open(self) -> Summary:
        return TOLD

    def restart(self) -> Summary:
        self.log.append(f"restart {self.id}")
        self.restarts += 1
        if self.gone:
            raise DeviceError(f"camera {self.id}", found="gone")
        self.dead = False
        return TOLD

    def summary(self) -> Summary:
        return TOLD

    def change(self, *_: str) -> None:
        self._alive()

    def card(self) -> tuple[CardFile, ...]:
        self._alive()
        return tuple(CardFile(name, len(data)) for name, data in self.on_card.items())

    def trigger(self, *_: object) -> Exposure:
        self._alive()
        self.log.append(f"trigger {self.id}")
        triggered_s = time.monotonic()
        self.shots += 1
        fault = self.faults.get(self.shots)
        if self.tardy:
            self._expose()
            self.tardy = False
        if fault == "tardy":
            self.tardy = True
        if fault in ("fail", "tardy"):
            raise DeviceError(f"camera {self.id}", found="no picture was taken")
        if fault == "late":
            time.sleep(1.0)
        if fault == "hangs":
            self.hanging = True
            self.answer.wait(10.0)
            self.hanging, self.dead = False, True
            raise DeviceError(f"camera {self.id}", found="no answer within 10 s")
        files = [self._expose() for _ in range(2 if fault == "two" else 1)]
        if fault == "stale":
            self.on_card[files[-1].name] = next(iter(self.on_card.values()))
        if fault in ("after", "two"):
            self.dead = True
            raise DeviceError(f"camera {self.id}", found="its process ended")
        return Exposure(tuple(files), triggered_s, time.monotonic())

    def download(self, name: str, path: Path, *_: str) -> Download:
        self._alive()
        self.log.append(f"download {self.id}")
        data = self.on_card[name]
        if self.cut:
            self.cut -= 1
            data = data[: len(data) // 2]
        path.write_bytes(data)
        return Download(len(data), hashlib.sha256(data).hexdigest(), 0.001)

    def delete(self, name: str) -> None:
        self.log.append(f"delete {self.id}")
        del self.on_card[name]

    def close(self) -> None:
        self.log.append(f"close {self.id}")

    def _alive(self) -> None:
        if self.dead or self.gone:
            raise DeviceError(f"camera {self.id}", found="no answer")

    def _expose(self) -> CardFile:
        name = f"/DCIM/DSC_{len(self.on_card) + 1:04d}.DNG"
        noise = 100 * self.shots + 10 * len(self.on_card) + int(self.id[-1])
        data = self.make_dng(512 + int(1000 * self.lights.levels.mean()), seed=noise)
        self.on_card[name] = data
        return CardFile(name, len(data))


class ScriptedOperator:
    """Says what a test wants.

    Attributes:
        wishes: given one by one when polled, such as ``retake x+``; None is nothing.
        answers: to questions, in order; ``retake`` when they are used up.
        asked: findings of each question.
    """

    def __init__(self) -> None:
        self.wishes: list[str | None] = []
        self.answers: list[str] = []
        self.asked: list[list] = []

    def command(self):
        wish = self.wishes.pop(0) if self.wishes else None
        return None if wish is None else Wish(*wish.split())

    def decide(self, findings, retakes_left):
        self.asked.append(list(findings))
        if self.answers:
            return self.answers.pop(0)
        return "retake" if retakes_left > 0 else "abort"

    def receive(self, line) -> None:
        pass


class ScriptedChecks:
    """Finds what a test wants it to find, once.

    Attributes:
        of_shots: pattern -> findings of its next shot.
        forgotten: (pattern, camera) in order.
    """

    def __init__(self) -> None:
        self.of_shots: dict[str, list[list]] = {}
        self.forgotten: list[tuple[str, str]] = []

    def photograph(self, *_):
        return []

    def shot(self, pattern):
        waiting = self.of_shots.get(pattern, [])
        return waiting.pop(0) if waiting else []

    def forget(self, pattern, camera_id):
        self.forgotten.append((pattern, camera_id))
