"""A camera's body without its driver: settings, card, events, and what goes wrong with them.

All that it remembers lies in its folder, so that it is the same camera after its process was
killed:

    camera.json   who it is, its settings, its part of the story
    next.dng      what a shot gives now; replaced when the light changes
    state.json    shots so far, what is pending, whether it is gone or off
    card/         its files, DSC_0001.DNG and so on
"""

from __future__ import annotations

import collections
import dataclasses
import time
from pathlib import Path
from typing import Any

from lightstage.formats.files import read_json, write_bytes, write_json
from sim.camera.exposure import expose_again, preview_jpeg
from sim.devices.camera_settings import CameraSettings, changed
from sim.devices.faults import Due, FaultLog, Story

SCHEMA = "lightstage.simulated_camera/1"
NEXT = "next.dng"
FOR_EVER_S = 1e9
REFUSED = {
    "disconnect": (-7, "I/O problem: the camera is gone from the bus"),
    "battery-empty": (-7, "I/O problem: the camera switched itself off, its battery is empty"),
    "fill-up": (-3, "out of memory: the card is full"),
    "fail": (-1, "unspecified error: no picture was taken"),
}
"""Faults with which no picture is taken: libgphoto2's error and what is said. The first wins."""
IN_SETTINGS = ("duplicate-serial",)
"""Faults that show when the camera is opened and asked, not at a shot."""


@dataclasses.dataclass(frozen=True)
class Event:
    """What a body tells by itself.

    Attributes:
        kind: ``file``, ``done`` or ``other``.
        name: of the file.
        after_s: how long after the event before it.
    """

    kind: str
    name: str = ""
    after_s: float = 0.0


class BodyError(Exception):
    """What the body answers when it cannot; `code` as in libgphoto2."""

    def __init__(self, code: int, said: str) -> None:
        super().__init__(said)
        self.code = code


class CameraBody:
    """One body.

    Args:
        folder: its own, written by `write_body`.

    Raises:
        SimError, FormatError: a folder that is none.
    """

    def __init__(self, folder: Path) -> None:
        value = read_json(folder / "camera.json", SCHEMA)
        self.folder = folder
        self.id = str(value["id"])
        self._nominal = CameraSettings(**value["settings"])
        self._story = Story.from_dict(value["story"], folder / "camera.json")
        self._log = FaultLog(None if value["log"] is None else Path(value["log"]))
        self._events: collections.deque[Event] = collections.deque()

    def connect(self) -> None:
        """Be found on the bus; BodyError where it is gone or off."""
        state = self._state()
        if time.monotonic() < state["gone_until_s"]:
            raise BodyError(-105, "no camera on the bus")
        if state["off"]:
            raise BodyError(-105, "no camera on the bus: its battery is empty")
        self._events.clear()
        for due in self._serial_lies(state):
            self._log.write(self.id, due, state["shots"] + 1, f"serial {due.fault['value']}")

    def settings(self) -> CameraSettings:
        """What it tells when it is asked now."""
        state = self._state()
        settings = dataclasses.replace(self._nominal, **state["changed"])
        for due in self._serial_lies(state):
            settings = dataclasses.replace(settings, serial=due.fault["value"])
        return settings

    def card_free(self) -> int:
        """How many more files its card can hold."""
        return max(0, self.settings().card_files - len(self.card()))

    def card(self) -> list[str]:
        """Names of the files on its card, oldest first."""
        names = (path.name for path in (self.folder / "card").iterdir())
        return sorted(name for name in names if not name.startswith("."))

    def file(self, name: str) -> bytes:
        """A file's bytes; BodyError where there is none."""
        path = self.folder / "card" / name
        if not path.is_file():
            raise BodyError(-108, f"no file {name}")
        return path.read_bytes()

    def delete(self, name: str) -> None:
        """Remove a file from its card; BodyError where there is none."""
        self.file(name)
        (self.folder / "card" / name).unlink()

    def change(self, name: str, value: Any) -> None:
        """Turn one of the camera's wheels; SimError: no such setting, or no such value."""
        settings = changed(self.settings(), name, value)
        state = self._state()
        state["changed"][name] = getattr(settings, name)
        self._save(state)

    def trigger(self) -> None:
        """Take a picture; its events follow. BodyError where none is taken."""
        state = self._state()
        state["shots"] += 1
        self._save(state)  # before anything can hang: a shot that was begun has happened
        shot = state["shots"]
        due = {each.name: each for each in self._story.due(self.id, "shot", shot)}
        for each in due.values():
            if each.name == "stale" and not self._raws():
                continue  # there is nothing old to give
            if each.name not in IN_SETTINGS:
                fields = ", ".join(f"{key} {each.fault[key]}" for key in each.fault.kind.fields)
                self._log.write(self.id, each, shot, fields)
        if "wrong-iso" in due:
            self.change("iso", due["wrong-iso"].fault["value"])
        if "drift" in due:
            self.change(due["drift"].fault["setting"], due["drift"].fault["value"])
        state = self._state()
        full = self.card_free() < len(self.settings().suffixes())
        for name, (code, said) in REFUSED.items():
            if name in due or (name == "fill-up" and full):
                if name == "disconnect":
                    gone_s = float(due[name].fault["seconds"])
                    self._save({**state, "gone_until_s": time.monotonic() + gone_s})
                elif name == "battery-empty":
                    self._save({**state, "off": True})
                raise BodyError(code, said)
        self._expose(state, due)

    def next_event(self, timeout_s: float) -> Event | None:
        """The next event, None where none comes within the time; never returns while it hangs."""
        if not self._events:
            time.sleep(timeout_s)
            return None
        event = self._events[0]
        if event.after_s > timeout_s:
            self._events[0] = dataclasses.replace(event, after_s=event.after_s - timeout_s)
            time.sleep(timeout_s)
            return None
        time.sleep(event.after_s)
        return self._events.popleft()

    def _expose(self, state: dict[str, Any], due: dict[str, Due]) -> None:
        """Put the picture on the card and queue its events."""
        light = self._light()
        share = due["truncated"].fault["share"] if "truncated" in due else 1.0
        names = []
        for suffix in self.settings().suffixes():
            whole = self._raw(light, "stale" in due) if suffix == ".DNG" else preview_jpeg(light)
            names.append(f"DSC_{state['shots']:04d}{suffix}")
            write_bytes(self.folder / "card" / names[-1], whole[: round(len(whole) * share)])
        arrived = [*state["pending"], *names] if "late-file" not in due else []
        pending = [*state["pending"], *names] if "late-file" in due else []
        self._save({**state, "pending": pending})
        events = [*(Event("file", name) for name in arrived), Event("done")]
        if "other-order" in due:
            events.reverse()
        if "slow" in due:
            events[0] = dataclasses.replace(events[0], after_s=due["slow"].fault["seconds"])
        if "event-storm" in due:
            events = [Event("other")] * due["event-storm"].fault["count"] + events
        if "hang" in due:
            events = [Event("other", after_s=FOR_EVER_S)]
        self._events.extend(events)

    def _raw(self, light: bytes, stale: bool) -> bytes:
        """A RAW's bytes under the settings as they are; where stale, those of the one before."""
        if stale and self._raws():
            return self.file(self._raws()[-1])
        settings = self.settings()
        gain = settings.gain() / self._nominal.gain()
        return light if gain == 1.0 else expose_again(light, gain, settings.iso)

    def _serial_lies(self, state: dict[str, Any]) -> list[Due]:
        """What makes it tell another serial number before its next shot."""
        due = self._story.due(self.id, "shot", state["shots"] + 1)
        return [each for each in due if each.name == "duplicate-serial"]

    def _raws(self) -> list[str]:
        return [name for name in self.card() if name.endswith(".DNG")]

    def _light(self) -> bytes:
        path = self.folder / NEXT
        if not path.is_file():
            raise BodyError(-1, "unspecified error: nothing before the lens")
        return path.read_bytes()

    def _state(self) -> dict[str, Any]:
        value: dict[str, Any] = read_json(self.folder / "state.json")
        return value

    def _save(self, state: dict[str, Any]) -> None:
        write_json(self.folder / "state.json", state)


def write_body(
    folder: Path,
    camera_id: str,
    settings: CameraSettings,
    story: Story,
    log: FaultLog,
) -> Path:
    """Make a new camera's folder, with an empty card and nothing before its lens.

    Args:
        folder: that is not there yet.
        camera_id: its name in the story.
        settings: as it is switched on.
        story: what goes wrong; other devices' faults may be in it.
        log: whose file is written to.
    """
    (folder / "card").mkdir(parents=True)
    write_json(
        folder / "camera.json",
        {
            "schema": SCHEMA,
            "id": camera_id,
            "settings": dataclasses.asdict(settings),
            "story": story.as_dict(),
            "log": None if log.path is None else str(log.path),
        },
    )
    state = {"shots": 0, "changed": {}, "pending": [], "gone_until_s": 0.0, "off": False}
    write_json(folder / "state.json", state)
    return folder
