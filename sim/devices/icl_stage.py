"""ICL's stage: what its lsserver makes of commands and of time. No socket, no clock.

Played after lsserver 0.4 [Lsserver2026], so that its clients and ours can be tried on it. What is
set is sent to the fixtures packet by packet, every 33 ms; nothing reports whether they lit.
"""

from __future__ import annotations

import math
import secrets
import time
from collections.abc import Callable, Iterator
from typing import Any

import cbor2
import numpy as np

ARCS, LIGHTS = 12, 14
REFRESH_MS = 33
MAX_HZ = 1000 / REFRESH_MS
MOST = 65535
MOST_ID = (1 << 64) - 1
DEMO_SHARE = 0.2
"""Brightness of the idle animation, of full level."""
DEMO, MANUAL, PLAYBACK, OLAT = "Demo", "Manual", "Playback", "OLAT"
GROUPS = ("rgb", "white")
CROCKFORD = "0123456789ABCDEFGHJKMNPQRSTVWXYZ"
"""Letters of a ULID."""
ULID_LETTERS = 26

Grid = np.ndarray
"""(ARCS, LIGHTS, 3) uint16."""


class UnreadableError(Exception):
    """A command that is none: "InvalidPayload"."""


class RefusedError(Exception):
    """A command that cannot be done.

    Attributes:
        code: "InvalidPayload" or "CommandFailed".
    """

    def __init__(self, code: str, message: str) -> None:
        super().__init__(message)
        self.code = code


class IclStage:
    """Twelve arcs of fourteen lights, each of a coloured and a white fixture.

    Attributes:
        mode: "Demo", "Manual", "Playback" or "OLAT".
        fixtures: of each group (``rgb``: red, green, blue; ``white``: warm, neutral, cool) what the
            next packets hold.
        triggers: how often the cameras' line rose.
        events: what is still to be sent to every client, in order.
        sequences: uploaded ones by their id.
    """

    def __init__(self) -> None:
        self.mode = DEMO
        self.fixtures: dict[str, Grid] = {
            name: np.zeros((ARCS, LIGHTS, 3), np.uint16) for name in GROUPS
        }
        self.triggers = 0
        self.events: list[Any] = []
        self.sequences: dict[str, dict[str, Any]] = {}
        self._ticks = 0
        self._trigger_waits = False
        self._frames: Iterator[dict[str, Grid]] = iter(())
        self._hold = self._held = 0

    @property
    def emitters(self) -> np.ndarray:
        """(ARCS * LIGHTS, 6) uint16 red, green, blue, warm, neutral, cool, arc by arc."""
        grids = [self.fixtures[name].reshape(-1, 3) for name in GROUPS]
        return np.concatenate(grids, axis=1)

    def answer(self, data: bytes) -> bytes:
        """Do what a client's binary message asks; returns the answer to it."""
        number, response = self._respond(data)
        return cbor2.dumps({"Response": {"id": number, "response": response}})

    def tick(self) -> None:
        """Go on to the next packet of DMX."""
        self._ticks += 1
        if self.mode == MANUAL:
            self.triggers += self._trigger_waits
            self._trigger_waits = False
        elif self.mode == DEMO:
            self._animate()
        elif self._held > 1:
            self._held -= 1
        else:
            self._next_frame()

    def _respond(self, data: bytes) -> tuple[int | None, Any]:
        try:
            request = cbor2.loads(data)
        except Exception as error:
            return None, _error("InvalidPayload", f"Invalid CBOR payload: {error}")
        number = request.get("id") if isinstance(request, dict) else -1
        if number is not None and not _is_whole(number, 0, MOST_ID):
            return None, _error("InvalidPayload", "Invalid CBOR payload: no request")
        command = request.get("command")
        if command is None:
            return number, _error("InvalidPayload", "Missing 'command' field in payload")
        try:
            return number, self._do(command)
        except UnreadableError as error:
            return number, _error("InvalidPayload", f"Invalid command payload: {error}")
        except RefusedError as error:
            return number, _error(error.code, str(error))

    def _do(self, command: Any) -> Any:
        if isinstance(command, str):
            name, value = command, None
        elif isinstance(command, dict) and len(command) == 1:
            ((name, value),) = command.items()
        else:
            raise UnreadableError("expected a command's name, or a map of one")
        known: dict[Any, Callable[[Any], Any]] = {
            "GetConfig": self._config,
            "GetMode": lambda _: {"Mode": self.mode},
            "SetMode": self._set_mode,
            "SetLightstage": self._set_lightstage,
            "SetArc": self._set_arc,
            "SetFixture": lambda value: self._set_fixtures([value]),
            "SetFixtures": self._set_fixtures,
            "ManualTrigger": self._trigger,
            "ListSequences": self._list,
            "GetSequence": lambda value: {"Sequence": self._summary(self._known(value))},
            "DeleteSequence": self._delete,
            "UploadSequence": self._upload,
        }
        if not isinstance(name, str) or name not in known:
            raise UnreadableError(f"unknown variant `{name}`")
        return known[name](value)

    def _config(self, _: Any) -> Any:
        return {
            "Config": {
                "num_arcs": ARCS,
                "lights_per_arc": LIGHTS,
                "kinet_port": 6038,
                "heartbeat_port": 6045,
                "refresh_rate_ms": REFRESH_MS,
                "api_ip": "0.0.0.0",
                "api_port": 8080,
                "seq_path": "sequences",
            }
        }

    def _set_mode(self, value: Any) -> str:
        kind = _field(value, "type")
        if kind in (DEMO, MANUAL):
            self._change_mode(kind)
        elif kind == OLAT:
            self._begin(OLAT, _field(_field(value, "config"), "capture_hz"), self._olat_frames())
        elif kind == PLAYBACK:
            sequence = self._known(_field(value, "id"), "InvalidPayload")
            self._begin(PLAYBACK, sequence["capture_hz"], iter(sequence["frames"]))
        else:
            raise UnreadableError(f"unknown variant `{kind}`, expected Demo, Manual, OLAT ..")
        return "Ok"

    def _begin(self, mode: str, hz: Any, frames: Iterator[dict[str, Grid]]) -> None:
        if not _is_number(hz):
            raise UnreadableError("expected a float")
        if not math.isfinite(hz) or hz <= 0:
            raise RefusedError("InvalidPayload", "Capture rate must be a positive finite number")
        if hz > MAX_HZ:
            raise RefusedError(
                "InvalidPayload",
                f"Requested capture rate ({hz:.1f} Hz) exceeds maximum supported rate "
                f"({MAX_HZ:.1f} Hz)",
            )
        self._hold, self._held, self._frames = int(MAX_HZ // hz), 0, frames
        self._change_mode(mode)

    def _change_mode(self, mode: str) -> None:
        self._trigger_waits = False
        if mode != self.mode:
            self.mode = mode
            self.events.append({"ModeChanged": mode})

    def _set_lightstage(self, value: Any) -> str:
        return self._set([((slice(None), slice(None)), _colour(value))])

    def _set_arc(self, value: Any) -> str:
        arc = _index(value, "arc_idx")
        colour = _colour(_field(value, "colour"))
        _require_arc(arc)
        return self._set([((arc, slice(None)), colour)])

    def _set_fixtures(self, values: Any) -> str:
        if not isinstance(values, list):
            raise UnreadableError("expected a sequence")
        read = [
            (_index(each, "arc_idx"), _index(each, "light_idx"), _colour(_field(each, "colour")))
            for each in values
        ]
        for arc, light, _ in read:  # all of them, before one is set
            _require_arc(arc)
            if light >= LIGHTS:
                raise RefusedError(
                    "InvalidPayload",
                    f"Light index {light} out of bounds for arc {arc} (max light_idx per arc: "
                    f"{LIGHTS - 1})",
                )
        return self._set([((arc, light), colour) for arc, light, colour in read])

    def _set(self, places: list[tuple[Any, dict[str, list[int]]]]) -> str:
        self._change_mode(MANUAL)
        for place, colour in places:
            for group, values in colour.items():
                self.fixtures[group][place] = values
        return "Ok"

    def _trigger(self, _: Any) -> str:
        if self.mode != MANUAL:
            raise RefusedError("InvalidPayload", "Manual trigger only available in manual mode")
        if self._trigger_waits:
            raise RefusedError("InvalidPayload", "Manual trigger already pending")
        self._trigger_waits = True
        return "Ok"

    def _list(self, _: Any) -> Any:
        return {"SequenceList": [self._summary(each) for each in self.sequences.values()]}

    def _known(self, value: Any, code: str = "CommandFailed") -> dict[str, Any]:
        if not isinstance(value, str) or len(value) != ULID_LETTERS or set(value) - set(CROCKFORD):
            raise UnreadableError("invalid ULID")
        if value not in self.sequences:
            raise RefusedError(code, f"Sequence id '{value}' not found")
        return self.sequences[value]

    def _delete(self, value: Any) -> str:
        del self.sequences[self._known(value, "InvalidPayload")["id"]]
        return "Ok"

    def _upload(self, value: Any) -> Any:
        name, hz, frames = (_field(value, key) for key in ("name", "capture_hz", "frames"))
        if not isinstance(name, str) or not _is_number(hz) or not isinstance(frames, list):
            raise UnreadableError("expected a name, a rate and frames")
        read = [
            {group: _grid(_field(frame, f"{group}_fixtures")) for group in GROUPS}
            for frame in frames
        ]
        number = _ulid()
        sequence = {"id": number, "name": name, "capture_hz": float(hz), "frames": read}
        self.sequences[number] = sequence
        return {"Sequence": self._summary(sequence)}

    def _summary(self, sequence: dict[str, Any]) -> dict[str, Any]:
        hz, frames = sequence["capture_hz"], len(sequence["frames"])
        return {
            "id": sequence["id"],
            "name": sequence["name"],
            "capture_hz": hz,
            "total_frames": frames,
            "duration_secs": frames / hz if hz > 0 else 0.0,
        }

    def _olat_frames(self) -> Iterator[dict[str, Grid]]:
        """Each white light alone, arc by arc."""
        for arc, light in np.ndindex(ARCS, LIGHTS):
            frame = {group: np.zeros((ARCS, LIGHTS, 3), np.uint16) for group in GROUPS}
            frame["white"][arc, light] = MOST
            yield frame

    def _next_frame(self) -> None:
        frame = next(self._frames, None)
        if frame is None:
            if self.mode == OLAT:  # a dark packet; a playback's last frame is sent once more
                self.fixtures = {
                    group: np.zeros_like(grid) for group, grid in self.fixtures.items()
                }
            self.events.append("CaptureFinished")
            self._change_mode(DEMO)
            return
        for group, grid in frame.items():
            arcs, lights = min(ARCS, grid.shape[0]), min(LIGHTS, grid.shape[1])
            self.fixtures[group][:arcs, :lights] = grid[:arcs, :lights]
        self.triggers += 1
        self._held = self._hold

    def _animate(self) -> None:
        """Slow waves of colour over the arcs, while nobody wants anything."""
        seconds = self._ticks * REFRESH_MS / 1000
        arc, light = np.meshgrid(np.arange(ARCS), np.arange(LIGHTS), indexing="ij")
        turn = seconds * 0.3 + arc / ARCS + light / (2 * LIGHTS)
        colours = turn[..., None] + np.arange(3) / 3
        for group, phase in (("rgb", colours), ("white", np.repeat(turn[..., None], 3, axis=2))):
            wave = 0.5 + 0.5 * np.sin(2 * np.pi * phase)
            self.fixtures[group] = np.round(DEMO_SHARE * MOST * wave).astype(np.uint16)


def _error(code: str, message: str) -> dict[str, Any]:
    return {"Error": {"code": code, "message": message}}


def _is_whole(value: Any, low: int, high: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and low <= value <= high


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _field(value: Any, name: str) -> Any:
    if not isinstance(value, dict) or name not in value:
        raise UnreadableError(f"missing field `{name}`")
    return value[name]


def _index(value: Any, name: str) -> int:
    index = _field(value, name)
    if not _is_whole(index, 0, MOST_ID):
        raise UnreadableError(f"invalid value of `{name}`, expected usize")
    return int(index)


def _require_arc(arc: int) -> None:
    if arc >= ARCS:
        raise RefusedError("InvalidPayload", f"Arc index {arc} out of bounds (max: {ARCS - 1})")


def _values(value: Any) -> list[int]:
    """Three values of a fixture."""
    if not isinstance(value, (list, tuple)) or len(value) != 3:
        raise UnreadableError("expected three values of a colour")
    if not all(_is_whole(each, 0, MOST) for each in value):
        raise UnreadableError("invalid value of a colour, expected u16")
    return list(value)


def _colour(value: Any) -> dict[str, list[int]]:
    """Values of the groups that are there; the others stay as they are."""
    if not isinstance(value, dict):
        raise UnreadableError("expected a colour")
    return {group: _values(value[group]) for group in GROUPS if value.get(group) is not None}


def _grid(value: Any) -> Grid:
    """A frame's values of one group; arcs and lights that the stage does not have go nowhere."""
    if not isinstance(value, list) or not all(isinstance(arc, list) for arc in value):
        raise UnreadableError("expected arcs of lights")
    rows = [[_values(light) for light in arc] for arc in value]
    if len({len(row) for row in rows}) > 1:
        raise UnreadableError("arcs of different lengths")
    return np.array(rows, np.uint16).reshape(len(rows), len(rows[0]) if rows else 0, 3)


def _ulid() -> str:
    """48 bits of milliseconds and 80 random ones, in Crockford's base 32."""
    number = (time.time_ns() // 1_000_000) << 80 | secrets.randbits(80)
    return "".join(CROCKFORD[number >> 5 * place & 31] for place in reversed(range(ULID_LETTERS)))
