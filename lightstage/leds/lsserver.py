"""Messages to and from ICL's lsserver: one map of CBOR each (docs/icl.md). Pure bytes.

The commands are those of lsserver 0.4 and its client [Lsserver2026]; CBOR is [RFC8949-2020].
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, TypeGuard

import cbor2
import numpy as np

from lightstage.printable import printable

FULL = 65535
"""Largest value of an emitter."""
GROUPS = (("rgb", slice(0, 3)), ("white", slice(3, 6)))
"""Groups of a fixture's emitters: red, green, blue, warm, neutral, cool."""
EMITTERS = 6
MANUAL = "Manual"
MOST_A_SIDE = 64
"""A grid of more is not believed."""
OK = "Ok"
GET_CONFIG = "GetConfig"
BLACK = {"SetLightstage": {name: [0, 0, 0] for name, _ in GROUPS}}
"""All off, and Manual, as every command that sets something: no animation begins."""


class LsserverError(Exception):
    """A message that is none of lsserver's: what was found, in words."""


@dataclasses.dataclass(frozen=True)
class Reply:
    """An answer.

    Attributes:
        number: of the request; None where the server could not read it.
        response: "Ok", or a map of one key.
    """

    number: int | None
    response: Any

    @property
    def error(self) -> str | None:
        """The server's error; None where there is none."""
        error = self.response.get("Error") if isinstance(self.response, dict) else None
        if error is None:
            return None
        fields = error if isinstance(error, dict) else {}
        return ": ".join(printable(fields.get(key, "?")) for key in ("code", "message"))


@dataclasses.dataclass(frozen=True)
class Event:
    """What the server sends everybody by itself.

    Attributes:
        mode: to which it has changed; None where it sends something else.
    """

    mode: str | None


def encode_request(number: int, command: Any) -> bytes:
    """A request under a number that its answer repeats."""
    return cbor2.dumps({"id": number, "command": command})


def encode_ok(number: int) -> bytes:
    """The answer to a request that was done, as the server writes it."""
    return cbor2.dumps({"Response": {"id": number, "response": OK}})


def set_fixtures(counts: np.ndarray) -> dict[str, Any]:
    """The command that sets every fixture.

    Args:
        counts: (arcs, lights, 6) of red, green, blue, warm, neutral and cool, 0..65535.
    """
    return {
        "SetFixtures": [
            {
                "arc_idx": arc,
                "light_idx": light,
                "colour": {name: counts[arc, light, part].tolist() for name, part in GROUPS},
            }
            for arc in range(counts.shape[0])
            for light in range(counts.shape[1])
        ]
    }


def read_message(data: bytes) -> Reply | Event:
    """A message's content; LsserverError where it is none of lsserver's."""
    try:
        message = cbor2.loads(data)
    except Exception:  # it decodes dates, fractions and the like too, each with errors of its own
        raise LsserverError(f"a message of {len(data)} bytes that is no CBOR") from None
    if not isinstance(message, dict) or len(message) != 1:
        raise LsserverError(f"a message that is {_kind(message)}")
    if "Event" in message:
        event = message["Event"]
        mode = event.get("ModeChanged") if isinstance(event, dict) else None
        return Event(mode if isinstance(mode, str) else None)
    reply = message.get("Response")
    if not isinstance(reply, dict) or "response" not in reply:
        raise LsserverError(f"a message that is {_kind(message)}")
    number = reply.get("id")
    if number is not None and (not isinstance(number, int) or isinstance(number, bool)):
        raise LsserverError(f"an answer with the id {printable(repr(number), 40)}")
    return Reply(number, reply["response"])


def read_grid(response: Any) -> tuple[int, int]:
    """Arcs, and lights of each, from GetConfig's answer; LsserverError on any other answer."""
    config = response.get("Config") if isinstance(response, dict) else None
    if not isinstance(config, dict):
        raise LsserverError(f"an answer to GetConfig that is {_kind(response)}")
    arcs, lights = config.get("num_arcs"), config.get("lights_per_arc")
    if _is_size(arcs) and _is_size(lights):
        return arcs, lights
    found = " x ".join(printable(repr(each), 20) for each in (arcs, lights))
    raise LsserverError(f"a grid of {found} lights")


def _is_size(value: Any) -> TypeGuard[int]:
    return isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= MOST_A_SIDE


def text_of_response(response: Any) -> str:
    """A response in a few words."""
    return repr(OK) if response == OK else _kind(response)


def _kind(value: Any) -> str:
    if isinstance(value, dict):
        keys: Sequence[str] = [printable(key, 20) for key in list(value)[:3]]
        return f"a map of {', '.join(keys)}" if keys else "an empty map"
    return printable(repr(value), 40)
