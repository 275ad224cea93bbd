"""rig.json (lightstage.rig/1), read and written; the hash of a rig."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np

from lightstage.errors import LightstageError, RigError, one_error
from lightstage.formats.fields import Fields
from lightstage.formats.files import read_json, write_json
from lightstage.formats.paths import check_name
from lightstage.rig.camera import Camera
from lightstage.rig.faults import folded, rig_faults
from lightstage.rig.stage import CONTROLLER, Light, LightAddress, Rig

SCHEMA = "lightstage.rig/1"
MOST_ID = (1 << 31) - 1
MOST_CHANNEL = 65534
"""The wires count lights with 16 bits."""
MOST_PX = 1 << 16
"""No sensor has more pixels a side."""
LIGHT_FIELDS = tuple(field.name for field in dataclasses.fields(Light) if field.name != "more")
ADDRESS_FIELDS = ("controller", "channel")
CAMERA_FIELDS = tuple(field.name for field in dataclasses.fields(Camera) if field.name != "more")


def default_rig() -> Rig:
    """The committed default rig (lightstage/data/rig.json): 168 lights, nine cameras."""
    return load_rig(Path(__file__).parents[1] / "data" / "rig.json")


def load_rig(path: Path) -> Rig:
    """Read rig.json.

    Raises:
        RigError, FormatError: every fault found, in one message.
    """
    return rig_from_json(read_json(path, SCHEMA), path)


def save_rig(rig: Rig, path: Path) -> Path:
    """Write rig.json atomically, with the fields that others added; returns `path`."""
    value = rig_to_json(rig)
    entries = [*value["lights"], *value["cameras"]]
    items: list[Light | Camera] = [*rig.lights, *rig.cameras]
    for entry, item in zip(entries, items, strict=True):
        entry.update(item.more)
        if isinstance(item, Light) and item.address is not None:
            entry["address"].update(item.address.more)
    return write_json(path, {**value, **rig.more})


def rig_to_json(rig: Rig) -> dict[str, Any]:
    """The rig as rig.json holds it (docs/formats.md), without the fields that others added.

    Hashes of a rig are taken of this: a note in the file makes it no other rig.
    """
    return {
        "schema": SCHEMA,
        "lights": [
            {
                name: getattr(light, name)
                for name in LIGHT_FIELDS
                if name != "address"
                and (name not in ("bank", "colour") or getattr(light, name) is not None)
            }
            | _address_to_json(light)
            for light in rig.lights
        ],
        "cameras": [
            {name: getattr(camera, name) for name in CAMERA_FIELDS}
            | {"cam_from_world": camera.cam_from_world.tolist()}
            for camera in rig.cameras
        ],
    }


def _address_to_json(light: Light) -> dict[str, Any]:
    """A light's address as a field of its entry; nothing where the rig gives none."""
    if light.address is None:
        return {}
    return {"address": {"controller": light.address.controller, "channel": light.address.channel}}


def rig_sha256(rig: Rig) -> str:
    """SHA-256 of a rig's content, however its file is formatted.

    Calibration shots and measured rigs have it; a session's journal has `session.rig_hash`, of the
    same content with a space after each comma and colon. Labs keep files of both.
    """
    text = json.dumps(rig_to_json(rig), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def rig_from_json(value: Any, where: str | Path) -> Rig:
    """Build a rig from the value of rig.json; fields that others added are kept."""
    problems: list[LightstageError] = []
    lights, cameras = [], []
    for index, entry in enumerate(_entries(value, "lights", where)):
        try:
            lights.append(_light(entry, where, f"lights[{index}]"))
        except RigError as error:
            problems.append(error)
    for index, entry in enumerate(_entries(value, "cameras", where)):
        try:
            cameras.append(_camera(entry, where, f"cameras[{index}]"))
        except RigError as error:
            problems.append(error)
    more = {key: each for key, each in value.items() if key not in ("schema", "lights", "cameras")}
    rig = Rig(tuple(lights), tuple(cameras), more)
    problems += rig_faults(rig, where)
    if problems:
        raise one_error(folded(problems))
    return rig


def _entries(value: Any, key: str, where: str | Path) -> list[Any]:
    entries = value.get(key) if isinstance(value, dict) else None
    if not isinstance(entries, list) or not entries:
        raise RigError(where, field=key, found=type(entries).__name__, expected="a non-empty list")
    return entries


def _light(entry: Any, where: str | Path, place: str) -> Light:
    fields = Fields(entry, where, place, RigError, LIGHT_FIELDS)
    x, y, z = fields.numbers("position_mm", 3)
    r, g, b = fields.numbers("rgb_gain", 3, (1.0, 1.0, 1.0))
    return Light(
        id=fields.whole("id", 0, MOST_ID),
        name=fields.text("name"),
        position_mm=(x, y, z),
        bank=fields.text("bank") if fields.has("bank") else None,
        rgb_gain=(r, g, b),
        colour=fields.text("colour") if fields.has("colour") else None,
        address=_address(entry["address"], where, f"{place}.address")
        if fields.has("address")
        else None,
        more=fields.rest(),
    )


def _address(value: Any, where: str | Path, place: str) -> LightAddress:
    fields = Fields(value, where, place, RigError, ADDRESS_FIELDS)
    controller = fields.text("controller") if fields.has("controller") else CONTROLLER
    if not controller.strip():
        raise RigError(where, field=f"{place}.controller", found="no name", expected="a name")
    return LightAddress(
        channel=fields.whole("channel", 0, MOST_CHANNEL),
        controller=controller,
        more=fields.rest(),
    )


def _camera(entry: Any, where: str | Path, place: str) -> Camera:
    fields = Fields(entry, where, place, RigError, CAMERA_FIELDS)
    k1, k2, p1, p2, k3 = fields.numbers("dist", 5, (0.0,) * 5)
    return Camera(
        id=check_name(fields.text("id"), where, f"{place}.id", RigError),
        serial=fields.text("serial"),
        model=fields.text("model"),
        width_px=fields.whole("width_px", 1, MOST_PX),
        height_px=fields.whole("height_px", 1, MOST_PX),
        fx_px=fields.number("fx_px"),
        fy_px=fields.number("fy_px"),
        cx_px=fields.number("cx_px"),
        cy_px=fields.number("cy_px"),
        dist=(k1, k2, p1, p2, k3),
        cam_from_world=np.array(fields.rows("cam_from_world", 3, 4)),
        more=fields.rest(),
    )
