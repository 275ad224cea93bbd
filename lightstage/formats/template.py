"""Template folder: topology, UV, landmarks, regions, modes and skin maps of the head model."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from lightstage.errors import FormatError
from lightstage.formats.exr import read_exr, write_exr
from lightstage.formats.fields import Fields, whole_number
from lightstage.formats.files import atomic_path, read_json, write_json
from lightstage.formats.mesh import Mesh, read_obj, write_obj
from lightstage.formats.npz import UNREADABLE_NPZ
from lightstage.formats.population import FILE as POPULATION
from lightstage.formats.population import POINTS_FILE as POPULATION_POINTS
from lightstage.formats.population import Population, read_population, write_population
from lightstage.formats.surface_points import (
    FACE_SCHEME,
    SurfacePoints,
    file_name,
    read_surface_points,
    write_surface_points,
)

SCHEMA = "lightstage.template/1"
DEPTH_RATIOS = (0.3, 3.0)
OWN = (
    *("template.json", "mesh.obj", "modes.npz", "maps/*.exr", "maps/skin.png"),
    *(POPULATION, POPULATION_POINTS, file_name(FACE_SCHEME)),
)
"""All that a template's folder has, as globs."""
REGIONS = ("skin", "lips", "eyes", "ears", "hair")


@dataclasses.dataclass(frozen=True)
class Modes:
    """Linear shape model: vertices = mean + identity . a + expression . b, in mm.

    Attributes:
        identity: (k, n, 3) offsets, each of one standard deviation.
        expression: (m, n, 3) offsets at full strength.
        expression_names: m names.
    """

    identity: np.ndarray
    expression: np.ndarray
    expression_names: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class Template:
    """The head model that every scan is registered to, in the head frame (mm)."""

    name: str
    mesh: Mesh
    landmarks: np.ndarray
    """(68,) int64 vertex indices in iBUG's order."""
    regions: dict[str, np.ndarray]
    """Region name to vertex indices."""
    licence: str
    source: str
    modes: Modes | None = None
    maps: dict[str, np.ndarray] = dataclasses.field(default_factory=dict)
    """shininess (exponent), translucency (0..1): (rows, columns) float32, where present."""
    depth_ratio: float = 1.0
    """People's faces are so many times as deep, from the ears to the front, as the mesh's."""
    face_points: SurfacePoints | None = None
    """Where the face detector's 468 points are on the mesh, where the folder has them."""
    population: Population | None = None
    """The heads of people, where the folder has them."""


def default_template_path() -> Path:
    """Folder of our own template, committed as data."""
    return Path(__file__).parents[1] / "data" / "template"


def load_template(path: Path) -> Template:
    """Read a template folder.

    Raises:
        FormatError: a missing file, no UV, UV outside the tile, landmarks that are not 68 vertices,
            modes of another vertex count, or points beyond the mesh.
    """
    if not (path / "template.json").is_file():
        raise FormatError(
            path,
            found="no template.json" if path.is_dir() else "no such folder",
            expected="a template folder",
        )
    value = read_json(path / "template.json", SCHEMA)
    mesh = read_obj(path / "mesh.obj")
    if mesh.uvs is None or mesh.face_uvs is None:
        raise FormatError(
            path / "mesh.obj",
            field="uv",
            found="no texture coordinates",
            expected="UV in one 0..1 tile",
            hint="Unwrap the template and export it with UV; the atlas is made in that space.",
        )
    if mesh.uvs.min() < -1e-6 or mesh.uvs.max() > 1 + 1e-6:
        raise FormatError(
            path / "mesh.obj",
            field="uv",
            found=f"UV from {mesh.uvs.min():.3g} to {mesh.uvs.max():.3g}",
            expected="one tile, 0..1",
        )
    if value.get("units") != "mm":
        raise FormatError(
            path / "template.json", field="units", found=repr(value.get("units")), expected="'mm'"
        )
    count = len(mesh.vertices)
    landmarks = Fields(value.get("landmarks", {}), path / "template.json", "landmarks").rest()
    marks = _indices(landmarks.get("ibug68"), count, path, "landmarks.ibug68", 68)
    named = Fields(value.get("regions", {}), path / "template.json", "regions").rest()
    regions = {
        name: _indices(given, count, path, f"regions.{name}") for name, given in named.items()
    }
    maps = {}
    for name in ("shininess", "translucency"):
        file = path / "maps" / f"{name}.exr"
        if file.exists():
            maps[name] = read_exr(file, finite=True)
    points = path / file_name(FACE_SCHEME)
    return Template(
        name=str(value.get("name", path.name)),
        mesh=mesh,
        landmarks=marks,
        regions=regions,
        licence=str(value.get("licence", "")),
        source=str(value.get("source", "")),
        modes=_load_modes(path / "modes.npz", count),
        maps=maps,
        depth_ratio=_depth_ratio(value.get("depth_ratio", 1.0), path / "template.json"),
        face_points=read_surface_points(points, count) if points.exists() else None,
        population=read_population(path, count),
    )


def save_template(template: Template, path: Path) -> Path:
    """Write a template folder (all but skin.png, a picture that its maker adds); returns `path`."""
    write_obj(template.mesh, path / "mesh.obj")
    for name, image in template.maps.items():
        write_exr(path / "maps" / f"{name}.exr", image)
    if template.face_points is not None:
        write_surface_points(template.face_points, path / file_name(FACE_SCHEME))
    if template.population is not None:
        write_population(template.population, path)
    if template.modes is not None:
        with atomic_path(path / "modes.npz") as beside:
            np.savez_compressed(
                beside,
                identity=template.modes.identity.astype(np.float32),
                expression=template.modes.expression.astype(np.float32),
                expression_names=np.array(template.modes.expression_names),
            )
    write_json(
        path / "template.json",
        {
            "schema": SCHEMA,
            "name": template.name,
            "units": "mm",
            "landmarks": {"ibug68": template.landmarks.tolist()},
            "regions": {name: indices.tolist() for name, indices in template.regions.items()},
            "licence": template.licence,
            "source": template.source,
            "depth_ratio": template.depth_ratio,
        },
    )
    return path


def _depth_ratio(value: Any, path: Path) -> float:
    least, most = DEPTH_RATIOS
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if not number or not least <= value <= most:
        raise FormatError(
            path,
            field="depth_ratio",
            found=repr(value)[:40],
            expected=f"a number, {least:g} to {most:g}; 1 where people's faces are as deep",
        )
    return float(value)


def _indices(
    given: Any, vertices: int, path: Path, field: str, wanted: int | None = None
) -> np.ndarray:
    """(n,) int64 indices of vertices that a template's file lists, so many where that is known."""
    expected = f"{'' if wanted is None else f'{wanted} '}vertex indices below {vertices}"
    if not isinstance(given, list):
        found = "none" if given is None else type(given).__name__
    elif wanted is not None and len(given) != wanted:
        found = str(len(given))
    else:
        indices = [whole_number(each) for each in given]
        wrong = [each for each in indices if type(each) is not int or not 0 <= each < vertices]
        if not wrong:
            return np.array(indices, np.int64)
        found = f"index {wrong[0]!r}"[:40]
    raise FormatError(path / "template.json", field=field, found=found, expected=expected)


def _load_modes(path: Path, count: int) -> Modes | None:
    if not path.exists():
        return None
    try:
        with np.load(path, allow_pickle=False) as file:
            identity = file["identity"].astype(float)
            expression = file["expression"].astype(float)
            names = tuple(str(name) for name in file["expression_names"])
    except UNREADABLE_NPZ as error:
        raise FormatError(
            path, found=str(error), expected="identity, expression, expression_names"
        ) from None
    for name, modes in (("identity", identity), ("expression", expression)):
        if modes.ndim != 3 or modes.shape[1:] != (count, 3):
            raise FormatError(
                path, field=name, found=f"shape {modes.shape}", expected=f"(k, {count}, 3)"
            )
        if not np.isfinite(modes).all():
            raise FormatError(path, field=name, found="NaN or infinity", expected="finite mm")
    if len(names) != len(expression):
        raise FormatError(
            path, field="expression_names", found=str(len(names)), expected=str(len(expression))
        )
    return Modes(identity, expression, names)
