"""A user's own patterns, from a TOML file.

    [patterns.rim]
    levels = [0.0, 0.25, 1.0]           # one a light, in the rig's order

    [patterns.left-arcs]
    lights = [0, 1, 2]                  # ids
    names = ["arc00/*", "arc01/*"]      # and all lights so named
    level = 0.5

    [patterns.key]
    direction = [1.0, 0.5, 1.0]         # toward the light
    cap_deg = 30.0                      # a disc this far around it, or
    # cosine = 2.0                      # the cosine of the angle to it, to this power

    [patterns.street]
    environment = "street.hdr"          # beside this file; .exr, .hdr or a light set, .json
    rotate_deg = 90.0                   # about +y, +z toward +x
    exposure_stops = -1.0               # 0: the brightest lamp at level 1

Each is used by its name, also with @parallel and @cross.
"""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import Any, Literal

import numpy as np

from lightstage.counting import counted
from lightstage.errors import LightstageError, PatternError, one_error
from lightstage.formats.config import make_config, read_toml
from lightstage.patterns.names import is_reserved
from lightstage.patterns.shapes import check_levels, chosen, numbers, shape
from lightstage.patterns.surroundings import surroundings_flux
from lightstage.rig import Rig

Kind = Literal["levels", "lights", "direction", "environment"]
USED = {
    "levels": {"levels"},
    "lights": {"lights", "names", "level"},
    "direction": {"direction", "cap_deg", "cosine", "level"},
    "environment": {"environment", "rotate_deg", "exposure_stops"},
}
"""Keys of each kind of pattern."""


@dataclasses.dataclass(frozen=True)
class PatternConfig:
    """One pattern of the file; the module's docstring has which keys go together.

    Attributes:
        levels: one a light, 0..1; driven as they are.
        lights: ids of lights.
        names: lights' names, with * and ? as in file names.
        level: of these lights, or at the middle of a direction's shape, 0..1.
        direction: x, y, z toward which the light is strongest; any length but 0.
        cap_deg: the shape is a disc of directions up to this angle from it, 0 to 180.
        cosine: or the cosine of the angle from it to this power, 0 beyond 90 degrees.
        environment: picture or light set, relative to the file.
        rotate_deg: turn of the environment about +y, +z toward +x.
        exposure_stops: at most 0; 0 drives the brightest lamp at level 1.
    """

    levels: tuple[float, ...] = ()
    lights: tuple[int, ...] = ()
    names: tuple[str, ...] = ()
    level: float = 1.0
    direction: tuple[float, ...] = ()
    cap_deg: float | None = None
    cosine: float | None = None
    environment: str = ""
    rotate_deg: float = 0.0
    exposure_stops: float = 0.0


@dataclasses.dataclass(frozen=True)
class PatternsFile:
    """A file of patterns: their tables by name."""

    patterns: dict[str, Any] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class UserPattern:
    """One of the user's own patterns on a rig.

    Attributes:
        name: what it is called.
        kind: how it was given.
        levels: (n,) 0..1, in the rig's order of lights.
        is_field: whether the levels are of a field of light, which `drive_levels` weights by the
            solid angles of the lights; what names single lights, and an environment, which is
            summed over solid angles already, is driven as it is.
        scale: level for one unit of luminance times steradian of an environment, at the rig's
            largest distance; None for other kinds.
        summary: in plain words, what was made of it.
    """

    name: str
    kind: Kind
    levels: np.ndarray
    is_field: bool
    scale: float | None
    summary: str


def read_patterns(path: Path, rig: Rig) -> dict[str, UserPattern]:
    """Read a file of patterns.

    Args:
        path: TOML, as above.
        rig: the lights they are for.

    Returns:
        The patterns by name, in the file's order.

    Raises:
        LightstageError: every fault found in the file and in what it names, in one message.
    """
    file = make_config(PatternsFile, read_toml(path), path)
    problems: list[LightstageError] = []
    if not file.patterns:
        problems.append(
            PatternError(path, found="no pattern", expected="tables such as [patterns.rim]")
        )
    patterns = {}
    for name, table in file.patterns.items():
        where = f"{path}, [patterns.{name}]"
        try:
            _check_name(name, where)
            patterns[name] = make_pattern(name, table, where, path.parent, rig)
        except LightstageError as error:
            problems.append(error)
    if problems:
        raise one_error(problems)
    return patterns


def _check_name(name: str, where: str) -> None:
    """A pattern's name is a folder's name in the session, and no other pattern's."""
    if not re.fullmatch(r"[a-z][a-z0-9_-]{0,31}", name):
        raise PatternError(
            where,
            field="name",
            found=repr(name),
            expected="a small letter, then up to 31 small letters, digits, - and _",
        )
    if is_reserved(name):
        raise PatternError(
            where, field="name", found="a name that the stage uses itself", expected="another name"
        )


def make_pattern(name: str, table: Any, where: str, folder: Path, rig: Rig) -> UserPattern:
    """One pattern from its table.

    Args:
        name: what it is called.
        table: as `PatternConfig`; keys that do not go together are refused.
        where: what to name in an error.
        folder: that an environment's path starts from.
        rig: the lights it is for.

    Raises:
        LightstageError: what is wrong with the table or the file it names.
    """
    if not isinstance(table, dict):
        raise PatternError(where, found=type(table).__name__, expected="a table")
    config = make_config(PatternConfig, table, where)
    kinds = [kind for kind in USED if kind in table or (kind == "lights" and "names" in table)]
    if len(kinds) != 1:
        raise PatternError(
            where,
            found=" and ".join(kinds) or "none of them",
            expected="one of levels, lights or names, direction, environment",
        )
    kind = kinds[0]
    idle = sorted(set(table) - USED[kind])
    if idle:
        raise PatternError(
            where, field=idle[0], found=f"it beside {kind}", expected=", ".join(sorted(USED[kind]))
        )
    if kind == "levels":
        levels = numbers(config.levels, where, "levels", len(rig.lights))
        check_levels(levels, where, "levels")
        return _made(name, "levels", levels, False)
    if kind == "lights":
        check_levels(np.array([config.level]), where, "level")
        return _made(
            name, "lights", chosen(config.lights, config.names, where, rig) * config.level, False
        )
    if kind == "direction":
        check_levels(np.array([config.level]), where, "level")
        lit = shape(config.direction, config.cap_deg, config.cosine, where, rig)
        return _made(name, "direction", lit * config.level, True)
    for key in ("rotate_deg", "exposure_stops"):
        value = getattr(config, key)
        if not np.isfinite(value) or (key == "exposure_stops" and value > 0):
            raise PatternError(
                where,
                field=key,
                found=str(value),
                expected="degrees" if key == "rotate_deg" else "at most 0",
                hint="" if key == "rotate_deg" else "At 0 the brightest lamp has its full level.",
            )
    try:
        flux = surroundings_flux(folder / config.environment, rig, config.rotate_deg)
    except OSError as error:
        raise PatternError(
            where, field="environment", found=str(error), expected="a file that can be read"
        ) from None
    # A lamp farther away must send more for the same flux at the centre.
    far = np.linalg.norm(rig.positions_mm, axis=1)
    sent = flux * (far / far.max()) ** 2
    scale = float(2.0**config.exposure_stops / sent.max())
    return _made(name, "environment", np.minimum(sent * scale, 1.0), False, scale)


def _made(
    name: str, kind: Kind, levels: np.ndarray, is_field: bool, scale: float | None = None
) -> UserPattern:
    lit = int((levels > 0).sum())
    summary = f"{lit} of {counted(len(levels), 'lamp')}"
    if scale is not None:
        summary += f", level {scale:.4g} for one unit of luminance times steradian"
        faint = int(((levels > 0) & (levels < 0.5 / 65535)).sum())
        if faint:
            summary += f"; {faint} of them too faint for the wire's steps, so dark"
    return UserPattern(name, kind, levels, is_field, scale, summary)
