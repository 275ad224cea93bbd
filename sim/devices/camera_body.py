"""A camera's body without its driver: settings, card, events, and what goes wrong with them.

All that it remembers is in its folder (sim.devices.body_folder), so that it is the same camera
after its process was killed.
"""

from __future__ import annotations

import collections
import dataclasses
import json
import time
from pathlib import Path
from typing import Any

from lightstage.formats.files import read_json
from sim.camera.exposure import expose_again, preview_jpeg, with_exposure
from sim.devices.body_folder import NEXT, SCHEMA, put
from sim.devices.camera_settings import CameraSettings, changed
from sim.devices.faults import Due, FaultLog, Story

FOR_EVER_S = 1e9
UNDATED = "    :  :     :  :  "
"""EXIF's form of a time that is not known."""
RECHARGE = "Put in a full battery and switch it on."
LOST = (-7, "the connection was lost")
REFUSED: dict[str, tuple[int, str] | tuple[int, str, str]] = {
    "disconnect": (-7, "the camera was unplugged"),
    "port-changes": (-7, "the camera is gone from this port"),
    "battery-empty": (-7, "the camera switched itself off, its battery is empty", RECHARGE),
    "fill-up": (-3, "the card is full"),
    "fail": (-1, "no picture was taken"),
}
"""Faults with which no picture is taken: libgphoto2's error, its message, and what to do where the
error does not name it. The first wins."""
SETTINGS = {"wrong-iso": "iso", "owner-set": "owner"}
"""Faults that change one setting."""
IN_SETTINGS = ("duplicate-serial",)
"""Faults that show when the camera is opened and asked, not at a shot."""


@dataclasses.dataclass(frozen=True)
class Event:
    """What a body reports by itself.

    Attributes:
        kind: ``file``, ``done`` or ``other``.
        name: of the file.
        after_s: how long after the event before it.
    """

    kind: str
    name: str = ""
    after_s: float = 0.0


class BodyError(Exception):
    """What the body answers when it cannot.

    Attributes:
        code: as in libgphoto2.
        hint: what to do; empty where the code implies it.
    """

    def __init__(self, code: int, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.code = code
        self.hint = hint


class CameraBody:
    """One body.

    Args:
        port: its folder, written by `write_body`, or a link to it.

    Raises:
        SimError, FormatError: a folder that is none.
    """

    def __init__(self, port: Path) -> None:
        self.port = port
        self.folder = port.resolve()
        value = read_json(self.folder / "camera.json", SCHEMA)
        self.id = str(value["id"])
        self._nominal = CameraSettings(**value["settings"])
        self._story = Story.from_dict(value["story"], self.folder / "camera.json")
        self._log = FaultLog(None if value["log"] is None else Path(value["log"]))
        self._events: collections.deque[Event] = collections.deque()
        self._lost = False

    def plugged(self) -> str | None:
        """Name of the port at which it is found on the bus now; None where it is absent or off."""
        state = self._state()
        here = time.monotonic() >= state["gone_until_s"] and not state["off"]
        return str(state["plug"]) if here else None

    def connect(self) -> None:
        """Be found on the bus; BodyError where it is absent, off, or another program's."""
        state = self._state()
        state["opens"] += 1
        if state["off"]:
            raise BodyError(-105, "its battery is empty", RECHARGE)
        if self.plugged() != self.port.name:
            raise BodyError(-105, "no camera is connected")
        for due in self._story.due(self.id, "open", state["opens"]):
            self._log.write(self.id, due, state["opens"])
            state["claimed_until_s"] = time.monotonic() + float(due.fault["seconds"])
        self._save(state)
        if time.monotonic() < state["claimed_until_s"]:
            raise BodyError(-53, "could not claim the USB device")
        self._events.clear()
        self._lost = False
        for due in self._due_in_settings(state, "duplicate-serial"):
            self._log.write(self.id, due, state["shots"] + 1, f"serial {due.fault['value']}")

    def settings(self) -> CameraSettings:
        """What it reports when it is read now."""
        state = self._state()
        settings = dataclasses.replace(self._nominal, **state["changed"])
        for due in self._due_in_settings(state, "duplicate-serial"):
            settings = dataclasses.replace(settings, serial=due.fault["value"])
        return settings

    def card_free_bytes(self) -> int:
        """What still fits on its card; nothing where it is full by its files or by the story."""
        full = self._due_in_settings(self._state(), "fill-up")
        return 0 if full else self._room()

    def card(self) -> list[str]:
        """Names of the files on its card, oldest first."""
        self._linked()
        names = (path.name for path in (self.folder / "card").iterdir())
        seen = (name for name in names if not name.startswith("."))
        return sorted(seen, key=lambda name: (len(name), name))

    def size(self, name: str) -> int:
        """A file's bytes, counted; BodyError where there is none."""
        return self._path(name).stat().st_size

    def file(self, name: str) -> bytes:
        """What a download gives; BodyError where there is no such file, or the connection ends."""
        data = self._path(name).read_bytes()
        state = self._state()
        trouble = state["trouble"].pop(name, None)
        if trouble is None:
            return data
        self._save(state)
        if trouble["name"] == "hang":
            time.sleep(FOR_EVER_S)
        if trouble["name"] == "io":
            self._lost = True
            raise BodyError(*LOST)
        return data[: round(len(data) * float(trouble["share"]))]

    def delete(self, name: str) -> None:
        """Remove a file from its card; BodyError where there is none."""
        self._path(name).unlink()

    def change(self, name: str, value: Any) -> None:
        """Turn one of the camera's wheels; SimError: no such setting, or no such value."""
        settings = changed(self.settings(), name, value)
        state = self._state()
        state["changed"][name] = getattr(settings, name)
        self._save(state)

    def trigger(self) -> None:
        """Take a picture; its events follow. BodyError where none is taken, or nobody knows."""
        self._linked()
        state = self._state()
        shot = state["shots"] + 1
        due = {each.name: each for each in self._story.due(self.id, "shot", shot)}
        if "busy" in due and state["busy_at"] != shot:
            self._log.write(self.id, due["busy"], shot)
            busy_until_s = time.monotonic() + float(due["busy"].fault["seconds"])
            state |= {"busy_at": shot, "busy_until_s": busy_until_s}
            self._save(state)
        if time.monotonic() < state["busy_until_s"]:
            raise BodyError(-110, "the camera is busy")
        state["shots"] = shot
        self._save(state)  # before anything can hang: a shot that was begun has happened
        for each in due.values():
            if each.name in ("busy", *IN_SETTINGS) or (each.name == "stale" and not self._raws()):
                continue  # reported already, or there is nothing old to give
            fields = ", ".join(f"{key} {each.fault[key]}" for key in each.fault.kind.fields)
            self._log.write(self.id, each, shot, fields)
        for name, setting in SETTINGS.items():
            if name in due:
                self.change(setting, due[name].fault["value"])
        if "drift" in due:
            self.change(due["drift"].fault["setting"], due["drift"].fault["value"])
        self._refuse(due)
        self._expose(self._state(), due)

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

    def _refuse(self, due: dict[str, Due]) -> None:
        """Raise what keeps a picture from being taken, and remember what follows from it."""
        full = self._room() < len(self._light())
        for name, (code, *texts) in REFUSED.items():
            if name not in due and not (name == "fill-up" and full):
                continue
            state = self._state()
            if name == "disconnect":
                gone_s = float(due[name].fault["seconds"])
                self._save({**state, "gone_until_s": time.monotonic() + gone_s})
            elif name == "battery-empty":
                self._save({**state, "off": True})
            elif name == "port-changes":
                plug = f"{self.folder.name}-port{state['shots']}"
                (self.folder.parent / plug).symlink_to(self.folder)
                self._save({**state, "plug": plug})
            self._lost = code == LOST[0]
            raise BodyError(code, *texts)

    def _expose(self, state: dict[str, Any], due: dict[str, Due]) -> None:
        """Put the picture on the card and queue its events."""
        light = self._light()
        names = []
        for suffix in self.settings().suffixes():
            data = preview_jpeg(light)
            if suffix == ".DNG":
                data = self._raw(light, state["shots"], "stale" in due)
            names.append(f"DSC_{state['shots']:04d}{suffix}")
            put(self.folder / "card" / names[-1], data)
        for name in ("truncated", "hang", "io"):
            if name in due and due[name].fault.kind.fields.get("during") is None:
                trouble = {"name": name, "share": due[name].fault["share"]}
            elif name in due and due[name].fault["during"] == "download":
                trouble = {"name": name}
            else:
                continue
            state["trouble"] |= dict.fromkeys(names, trouble)
        arrived = [*state["pending"], *names] if "late-file" not in due else []
        pending = [*state["pending"], *names] if "late-file" in due else []
        self._save({**state, "pending": pending})
        if "io" in due and due["io"].fault["during"] == "trigger":
            self._lost = True
            raise BodyError(*LOST)
        events = [*(Event("file", name) for name in arrived), Event("done")]
        if "other-order" in due:
            events.reverse()
        if "slow" in due:
            events[0] = dataclasses.replace(events[0], after_s=due["slow"].fault["seconds"])
        if "event-storm" in due:
            events = [Event("other")] * due["event-storm"].fault["count"] + events
        if "hang" in due and due["hang"].fault["during"] == "trigger":
            events = [Event("other", after_s=FOR_EVER_S)]
        self._events.extend(events)

    def _raw(self, light: bytes, shot: int, stale: bool) -> bytes:
        """A RAW's bytes under the settings as they are; where stale, those of the one before."""
        if stale and self._raws():
            return self._path(self._raws()[-1]).read_bytes()
        settings = self.settings()
        gain = settings.gain() / self._nominal.gain()
        exposed = light if gain == 1.0 else expose_again(light, gain, settings.iso)
        taken = UNDATED
        if settings.clock_offset_s is not None:
            now_s = time.time() + settings.clock_offset_s
            taken = time.strftime("%Y:%m:%d %H:%M:%S", time.gmtime(now_s))
        return with_exposure(
            exposed,
            settings.iso,
            settings.shutter,
            settings.aperture,
            taken=taken,
            shot=shot,
        )

    def _room(self) -> int:
        """Bytes that its card can still take; none where it has as many files as it can hold."""
        settings, files = self.settings(), self.card()
        if len(files) + len(settings.suffixes()) > settings.card_files:
            return 0
        return max(0, settings.card_bytes - sum(self.size(name) for name in files))

    def _linked(self) -> None:
        """BodyError where the connection is lost."""
        if self._lost or self.plugged() != self.port.name:
            raise BodyError(*LOST)

    def _due_in_settings(self, state: dict[str, Any], name: str) -> list[Due]:
        """What shows before its next shot."""
        due = self._story.due(self.id, "shot", state["shots"] + 1)
        return [each for each in due if each.name == name]

    def _raws(self) -> list[str]:
        return [name for name in self.card() if name.endswith(".DNG")]

    def _path(self, name: str) -> Path:
        self._linked()
        path = self.folder / "card" / name
        if not path.is_file():
            raise BodyError(-108, f"no file {name}")
        return path

    def _light(self) -> bytes:
        path = self.folder / NEXT
        if not path.is_file():
            raise BodyError(-1, "nothing before the lens")
        return path.read_bytes()

    def _state(self) -> dict[str, Any]:
        value: dict[str, Any] = read_json(self.folder / "state.json")
        return value

    def _save(self, state: dict[str, Any]) -> None:
        put(self.folder / "state.json", json.dumps(state).encode())
