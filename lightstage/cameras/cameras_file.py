"""The cameras file: where each camera is, what it must report, and what may stay unverified."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

from lightstage.cameras.camera import VERIFIABLE
from lightstage.errors import ConfigError
from lightstage.formats.config import make_config, read_toml

DRIVER = re.compile(r"[^\W\d]\w*(\.[^\W\d]\w*)*:[^\W\d]\w*")
"""A driver's place: a module's dotted name, a colon, a name in it."""


@dataclasses.dataclass(frozen=True)
class CameraEntry:
    """Where one camera is; without a port it is found by the serial number in rig.json.

    Attributes:
        port: libgphoto2's name, such as ``usb:001,004``; what the driver calls it where one is
            named.
        virtual_folder: folder of libgphoto2's virtual camera.
        driver: ``package.module:name``, called with the port, of a camera that is not
            libgphoto2's.
        expect: what this camera must report, by Summary's names, over what all must.
    """

    port: str | None = None
    virtual_folder: Path | None = None
    driver: str | None = None
    expect: dict[str, str] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class CamerasFile:
    """The cameras file.

    Attributes:
        allow_unverifiable: names of what a camera may be unable to report (of VERIFIABLE).
        expect: what every camera must report, by Summary's names.
        cameras: camera id to where it is.
    """

    allow_unverifiable: tuple[str, ...] = ()
    expect: dict[str, str] = dataclasses.field(default_factory=dict)
    cameras: dict[str, CameraEntry] = dataclasses.field(default_factory=dict)


def read_cameras_file(path: Path) -> CamerasFile:
    """Read a cameras file (TOML); ConfigError on an unknown key or name, or a value of no text."""
    if not path.exists():
        raise ConfigError(
            path,
            found="no such file",
            expected="a cameras file (TOML)",
            hint="Without --cameras, cameras are found by their serial numbers; the simulated "
            "stage prints where its file is.",
        )
    file = make_config(CamerasFile, read_toml(path), path)
    _check_expect(path, "expect", file.expect)
    for name in file.allow_unverifiable:
        if name not in VERIFIABLE:
            raise ConfigError(
                path,
                field="allow_unverifiable",
                found=repr(name),
                expected=f"of {', '.join(VERIFIABLE)}",
            )
    entries = {}
    for camera_id, entry in file.cameras.items():
        _check_expect(path, f"cameras.{camera_id}.expect", entry.expect)
        if entry.virtual_folder is not None:
            folder = path.parent / entry.virtual_folder.expanduser()
            entry = dataclasses.replace(entry, virtual_folder=folder.absolute())
        if entry.driver is not None and not DRIVER.fullmatch(entry.driver):
            raise ConfigError(
                path,
                field=f"cameras.{camera_id}.driver",
                found=repr(entry.driver),
                expected="package.module:name",
            )
        entries[camera_id] = entry
    return dataclasses.replace(file, cameras=entries)


def _check_expect(path: Path, table: str, expect: dict[str, str]) -> None:
    """ConfigError where a name is none of Summary's."""
    for name in expect:
        if name not in VERIFIABLE:
            raise ConfigError(
                path,
                field=f"{table}.{name}",
                found="an unknown name",
                expected=f"of {', '.join(VERIFIABLE)}",
            )
