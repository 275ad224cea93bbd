"""A calibration as a session carries it: colours, flats, measured lights."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lightstage.errors import FormatError
from lightstage.formats.cameras import NAME as CAMERAS_NAME
from lightstage.formats.colour import SCHEMA as COLOUR_SCHEMA
from lightstage.formats.colour import colour_numbers
from lightstage.formats.files import check_schema, read_json
from lightstage.formats.flats import SCHEMA as FLATS_SCHEMA
from lightstage.formats.flats import each_flat
from lightstage.formats.lights import read_measured_lights
from lightstage.formats.paths import check_name, path_inside
from lightstage.formats.scale import chart_levels
from lightstage.formats.values import FILE, parse_json, read_regular
from lightstage.rig import Camera, Rig

COLOUR_PATH = "calibration/colour.json"
BORDER_SHARE = 0.02
"""A sensor's sides may differ by so much from the rig's."""
GAINS_BYTES = 1 << 31
"""Largest size of a file of gains of single pixels."""
COLOUR_NAME, FLATS_NAME, LIGHTS_NAME = "colour.json", "flats.json", "lights.json"


@dataclasses.dataclass(frozen=True)
class Carried:
    """What a session keeps of a calibration, in its folder ``calibration``.

    Attributes:
        colour: the value of colour.json; None where there is none.
        beside: name to bytes of the other files.
    """

    colour: dict[str, Any] | None = None
    beside: Mapping[str, bytes] = dataclasses.field(default_factory=dict)


def read_calibration(path: Path, rig: Rig) -> Carried:
    """Read what a session is to carry.

    Args:
        path: a colour calibration alone, or a folder as `lightstage-processing calibrate` writes
            it, with colour.json, flats.json and lights.json or some of them.
        rig: the session's.

    Raises:
        FormatError: a file that cannot be used with this rig, or a folder with none of them.
    """
    if not path.is_dir():
        return Carried(read_colour(path, rig))
    colour, flats, lights = (path / name for name in (COLOUR_NAME, FLATS_NAME, LIGHTS_NAME))
    beside: dict[str, bytes] = {}
    if flats.is_file():
        beside |= _flats(flats, rig)
    if lights.is_file():
        read_measured_lights(lights, rig)
        beside[LIGHTS_NAME] = read_regular(lights, FILE.size_bytes)
    if not beside and not colour.is_file():
        raise FormatError(
            path,
            found="no colour.json, flats.json or lights.json",
            expected="a calibration folder, or a colour calibration",
            hint="Make one: lightstage-processing calibrate LAB --out CALIBRATION.",
        )
    return Carried(read_colour(colour, rig) if colour.is_file() else None, beside)


def carried_paths(colour: Mapping[str, Any] | None, beside: Mapping[str, bytes]) -> dict[str, str]:
    """The field ``calibration`` of session.json: kind to path in the session."""
    kinds = {} if colour is None else {"colour": COLOUR_PATH}
    folder = Path(COLOUR_PATH).parent.as_posix()
    for kind, name in (("flats", FLATS_NAME), ("lights", LIGHTS_NAME), ("cameras", CAMERAS_NAME)):
        if name in beside:
            kinds[kind] = f"{folder}/{name}"
    return kinds


def _flats(path: Path, rig: Rig) -> dict[str, bytes]:
    """flats.json and the gains of single pixels that it names, by name.

    Raises:
        FormatError: not usable by processing, or of pictures of another size than the rig's.
    """
    data = read_regular(path, FILE.size_bytes)
    value = parse_json(data, path)
    check_schema(path, value, FLATS_SCHEMA)
    try:
        named = [entry.get("per_pixel") for entry in value["cameras"].values()]
    except (AttributeError, KeyError) as error:
        raise FormatError(
            path, found=f"no usable {error}", expected="flats of cameras, an object each"
        ) from None
    for camera in rig.cameras:
        _require_size(path, camera, value["cameras"].get(camera.id, {}))
    files = {}
    for name in named:
        if name is not None:
            check_name(name, path, "per_pixel")  # beside this file
            beside = path_inside(path.parent, name, path, "per_pixel")
            if not beside.is_file():
                raise FormatError(
                    path, field="per_pixel", found=f"no file {name}", expected="a file beside it"
                )
            files[name] = read_regular(beside, GAINS_BYTES, "gains of single pixels")
    for _ in each_flat(value, [camera.id for camera in rig.cameras], path):
        pass  # It raises what processing would, before anybody is captured.
    return {path.name: data, **files}


def _require_size(path: Path, camera: Camera, field: Mapping[str, Any]) -> None:
    """FormatError where a camera's flats are of another size than its pictures, upright or not."""
    stated = field.get("width_px"), field.get("height_px")
    size = camera.width_px, camera.height_px
    sides = [side for side in stated if isinstance(side, int)]
    if len(sides) < 2:
        return  # its reader reports what is wrong
    # A rig may count a border that a sensor reads and a picture does not show.
    pairs = zip(sorted(sides), sorted(size), strict=True)
    if any(abs(own - wanted) > BORDER_SHARE * wanted for own, wanted in pairs):
        raise FormatError(
            path,
            field=f"cameras.{camera.id}",
            found=f"flats of {stated[0]} x {stated[1]} pixels",
            expected=f"{size[0]} x {size[1]}, as the rig's pictures of this camera",
            hint="Take flats and darks at the size at which sessions are taken, and run "
            "`lightstage-processing calibrate` again.",
        )


def read_colour(path: Path, rig: Rig) -> dict[str, Any]:
    """A colour calibration: for each camera a 3x3 matrix from raw to linear rgb.

    Raises:
        FormatError: another schema, a camera of the rig that is missing or whose numbers processing
            could not use, or levels of the chart's light that do not fit the rig (formats.scale).
    """
    value = read_json(path, COLOUR_SCHEMA)
    colour_numbers(value, [camera.id for camera in rig.cameras], path)
    chart_levels(value, len(rig.lights), path)
    return dict(value)
