"""Which photographs share a focal length: by a file, by EXIF, or to be found out."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from lightstage.errors import FormatError, LightstageError, MotionError, one_error
from lightstage.exif import Exif
from lightstage.formats.fields import Fields
from lightstage.formats.files import read_json
from lightstage.poses_from_photos.pictures import GreyPicture

SCHEMA = "lightstage.lenses/1"
FULL_FRAME_MM = 36.0
"""Longer side of a sensor that lenses.json does not give."""
LEAST_MM, MOST_MM = 0.5, 5000.0
"""Limits of cameras' focal lengths and sensors."""
BY_FILE, BY_EXIF, OPEN = "file", "EXIF", "found"


@dataclasses.dataclass(frozen=True)
class TypedLens:
    """Cameras that share a focal length, as lenses.json has it.

    Attributes:
        cameras: ids.
        focal_mm: what is engraved on the lens; None where it is to be found.
        sensor_mm: longer side of the sensor.
    """

    cameras: tuple[str, ...]
    focal_mm: float | None
    sensor_mm: float


@dataclasses.dataclass(frozen=True)
class Lens:
    """Photographs that begin with one focal length and one term of distortion.

    Attributes:
        cameras: ids.
        focal_px: to begin with, in pixels of the photographs; None where it is not known.
        by: ``file`` or ``EXIF`` where that gives who shares it; ``found`` where it is to be found.
    """

    cameras: tuple[str, ...]
    focal_px: float | None
    by: str


def read_lenses(path: Path) -> list[TypedLens]:
    """Read lenses.json.

    Raises:
        FormatError: another schema, a camera of two lenses, or numbers out of bounds; every fault.
    """
    value = read_json(path, SCHEMA)
    entries = value.get("lenses") if isinstance(value, dict) else None
    if not isinstance(entries, list) or not entries:
        raise FormatError(
            path, field="lenses", found=type(entries).__name__, expected="a non-empty list"
        )
    problems: list[LightstageError] = []
    lenses: list[TypedLens] = []
    seen: dict[str, int] = {}
    for index, entry in enumerate(entries):
        try:
            lens = _typed(entry, path, f"lenses[{index}]")
        except FormatError as error:
            problems.append(error)
            continue
        problems += [
            FormatError(
                path,
                field=f"lenses[{index}].cameras",
                found=f"{name}, which lenses[{seen[name]}] has too",
                expected="each camera once",
            )
            for name in lens.cameras
            if name in seen
        ]
        seen |= dict.fromkeys(lens.cameras, index)
        lenses.append(lens)
    if problems:
        raise one_error(problems)
    return lenses


def _typed(entry: Any, path: Path, place: str) -> TypedLens:
    fields = Fields(entry, path, place, known=("cameras", "focal_mm", "sensor_mm"))
    names = entry.get("cameras")
    if not isinstance(names, list) or not names or not all(isinstance(n, str) for n in names):
        raise FormatError(
            path,
            field=f"{place}.cameras",
            found=ascii(names)[:60],
            expected='names of cameras, such as ["cam0", "cam1"]',
        )
    numbers = {key: fields.number(key) for key in ("focal_mm", "sensor_mm") if fields.has(key)}
    for key, number in numbers.items():
        if not LEAST_MM <= number <= MOST_MM:
            raise FormatError(
                path,
                field=f"{place}.{key}",
                found=f"{number:g}",
                expected=f"{LEAST_MM:g} to {MOST_MM:g} mm",
            )
    return TypedLens(
        tuple(dict.fromkeys(names)),
        numbers.get("focal_mm"),
        numbers.get("sensor_mm", FULL_FRAME_MM),
    )


def shared_lenses(
    pictures: Mapping[str, GreyPicture],
    exifs: Mapping[str, Exif],
    typed: Collection[TypedLens] = (),
) -> list[Lens]:
    """Which photographs begin with one focal length.

    Those of one entry of lenses.json do. Of the others, those do whose files have one size, model
    and focal length; where files have none, those of one size and model do until something else
    explains them better.

    Args:
        pictures: by camera.
        exifs: each photograph's own fields.
        typed: lenses.json; it goes before EXIF.

    Raises:
        MotionError: lenses.json names a camera that is not there, or photographs of unlike sizes
            for one lens.
    """
    problems: list[LightstageError] = []
    lenses: list[Lens] = []
    left = dict.fromkeys(pictures)
    for each in typed:
        unknown = [name for name in each.cameras if name not in pictures]
        sizes = {_size(pictures[name]) for name in each.cameras if name in pictures}
        if unknown:
            problems.append(
                MotionError(
                    "--lenses",
                    found=f"no photograph of {', '.join(unknown)}",
                    expected=f"some of {', '.join(pictures)}",
                )
            )
        elif len(sizes) > 1:
            problems.append(
                MotionError(
                    "--lenses",
                    found=f"photographs of unlike sizes for {', '.join(each.cameras)}",
                    expected="one size for one lens",
                    hint="Name cameras of another size as a lens of their own.",
                )
            )
        else:
            longer = max(sizes.pop()[:2])
            focal = None if each.focal_mm is None else each.focal_mm / each.sensor_mm * longer
            lenses.append(Lens(each.cameras, focal, BY_FILE))
        for name in each.cameras:
            left.pop(name, None)
    if problems:
        raise one_error(problems)
    alike: dict[tuple[Any, ...], list[str]] = {}
    for name in left:
        exif = exifs[name]
        key = (*_size(pictures[name]), exif.model, exif.focal_mm, exif.focal_35mm_mm)
        alike.setdefault(key, []).append(name)
    for names in alike.values():
        exif = exifs[names[0]]
        known = bool(exif.focal_mm or exif.focal_35mm_mm)
        picture = pictures[names[0]]
        focal = exif.focal_px(picture.width_px, picture.height_px)
        lenses.append(Lens(tuple(names), focal, BY_EXIF if known else OPEN))
    return lenses


def _size(picture: GreyPicture) -> tuple[int, int, int]:
    return picture.width_px, picture.height_px, picture.times
