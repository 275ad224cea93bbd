"""Subject folder: a person with all maps on disk, ready to be lit again.

```
SUBJECT/
  subject.json  {"schema": "lightstage.subject/1", "name", "expression", "source", "units": "mm",
                 "distribution", "head_from_world": 3 x 4, "landmarks_mm": [68 points or null]}
  mesh.obj      mm, world, with UV
  maps/         diffuse_albedo, specular_albedo, roughness, normal, translucency, and anisotropy
                where there is one: OpenEXR of 32-bit floats, all of one size
  skin.png      255 where face skin or lips are
```
Numbers are written so that reading gives the same bits back.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np

from lightstage.counting import counted
from lightstage.formats.exr import read_exr, write_exr
from lightstage.formats.fields import array_of
from lightstage.formats.files import (
    atomic_folder,
    read_json,
    require_replaceable,
    write_json,
    write_text,
)
from lightstage.formats.mesh import Mesh, read_obj
from lightstage.formats.png import write_png
from lightstage.session import check_pseudonym
from sim.errors import SimError
from sim.light.facets import DISTRIBUTIONS
from sim.people.subject import Subject

SCHEMA = "lightstage.subject/1"
MARKER = "subject.json"

# Channels, and the least and largest value of each map.
_MAPS = {
    "diffuse_albedo": (3, 0.0, 1.0),
    "specular_albedo": (1, 0.0, 1.0),
    "roughness": (1, 1e-3, 1.0),
    "normal": (3, -1.001, 1.001),
    "translucency": (1, 0.0, 1.0),
    "anisotropy": (1, 0.0, 0.9),
}

OWN = (MARKER, "mesh.obj", "skin.png", *(f"maps/{name}.exr" for name in _MAPS))


def save_subject(subject: Subject, path: Path, facts: dict[str, Any] | None = None) -> Path:
    """Write a subject folder, whole or not at all.

    Args:
        subject: the person; maps are kept as 32-bit floats.
        path: a new folder, or one with a subject in it, which is replaced.
        facts: what else to record, such as where it was imported from; kept as "import".

    Returns:
        `path`.

    Raises:
        FormatError: `path` holds something else.
        SimError: the subject is not one that `load_subject_folder` would read.
    """
    maps = _maps_of(subject)
    _check_maps(maps, subject.skin, path)
    _check_mesh(subject.mesh, path / "mesh.obj")
    marks = [
        [float(c) for c in row] if np.isfinite(row).all() else None for row in subject.landmarks_mm
    ]
    value: dict[str, Any] = {
        "schema": SCHEMA,
        "name": subject.name,
        "expression": subject.expression,
        "source": subject.source,
        "synthetic": subject.synthetic,
        "units": "mm",
        "distribution": subject.distribution,
        "head_from_world": np.asarray(subject.head_from_world, float).tolist(),
        "landmarks_mm": marks,
    }
    if facts is not None:
        value["import"] = facts
    with atomic_folder(path, MARKER, own=OWN) as folder:
        write_text(folder / "mesh.obj", _obj_text(subject.mesh))
        for name, image in maps.items():
            write_exr(folder / "maps" / f"{name}.exr", image, half=False)
        write_png(folder / "skin.png", subject.skin.astype(np.uint8) * 255)
        write_json(folder / MARKER, value)
    return path


def require_free(path: Path) -> None:
    """What `save_subject` refuses of `path`, raised before the work, not after it.

    Raises:
        SimError: something else than a subject; FormatError: files of others.
    """
    taken = path.is_file() or (path.is_dir() and any(path.iterdir()))
    if taken and not (path / MARKER).is_file():
        raise SimError(
            path,
            found="something else",
            expected="a new folder, or a subject to replace",
            hint="Choose another output folder.",
        )
    require_replaceable(path, MARKER, own=OWN)


def load_subject_folder(path: Path) -> Subject:
    """Read a subject folder.

    Raises:
        SimError: a missing map, maps of different sizes, values out of range (negative albedo),
            landmarks that are not 68, a pose that is no rigid motion, UV outside 0..1, other units.
        FormatError: a missing or damaged file, NaN, a newer schema.
    """
    if not (path / MARKER).is_file():
        raise SimError(
            path,
            found=f"no {MARKER}" if path.is_dir() else "no such folder",
            expected="a subject folder",
            hint="Make one with lightstage-sim import-scan or import-ict.",
        )
    value = read_json(path / MARKER, SCHEMA)
    where = path / MARKER
    for field in ("name", "expression", "source", "distribution"):
        if not isinstance(value.get(field), str):
            raise SimError(where, field=field, found=repr(value.get(field)), expected="a text")
    for field in ("name", "expression"):
        check_pseudonym(value[field], field)
    if value["distribution"] not in DISTRIBUTIONS:
        raise SimError(
            where,
            field="distribution",
            found=repr(value["distribution"]),
            expected=" or ".join(DISTRIBUTIONS),
        )
    if value.get("units") != "mm":
        raise SimError(where, field="units", found=repr(value.get("units")), expected="'mm'")
    pose = _numbers(value.get("head_from_world"), (3, 4), where, "head_from_world")
    turn = pose[:, :3]
    if not np.allclose(turn @ turn.T, np.eye(3), atol=1e-6) or np.linalg.det(turn) < 0:
        raise SimError(
            where, field="head_from_world", found="no rigid motion", expected="rotation and shift"
        )
    marks = value.get("landmarks_mm")
    if not isinstance(marks, list) or len(marks) != 68:
        found = counted(len(marks), "entry", "entries") if isinstance(marks, list) else repr(marks)
        raise SimError(where, field="landmarks_mm", found=found, expected="68 points or null")
    points = np.full((68, 3), np.nan)
    for index, entry in enumerate(marks):
        if entry is not None:
            points[index] = _numbers(entry, (3,), where, f"landmarks_mm[{index}]")
    maps = {
        name: read_exr(path / "maps" / f"{name}.exr", finite=True)
        for name in _MAPS
        if name != "anisotropy" or (path / "maps" / "anisotropy.exr").exists()
    }
    skin = _read_skin(path / "skin.png")
    _check_maps(maps, skin, path)
    mesh = read_obj(path / "mesh.obj")
    _check_mesh(mesh, path / "mesh.obj")
    return Subject(
        name=value["name"],
        expression=value["expression"],
        mesh=mesh,
        landmarks_mm=points,
        skin=skin,
        head_from_world=pose,
        source=value["source"],
        distribution=value["distribution"],
        synthetic=value.get("synthetic") is True,
        diffuse_albedo=maps["diffuse_albedo"],
        specular_albedo=maps["specular_albedo"],
        roughness=maps["roughness"],
        normal=maps["normal"],
        translucency=maps["translucency"],
        anisotropy=maps.get("anisotropy"),
    )


def _maps_of(subject: Subject) -> dict[str, np.ndarray]:
    maps = {name: getattr(subject, name) for name in _MAPS}
    return {
        name: np.asarray(image, np.float32) for name, image in maps.items() if image is not None
    }


def _check_maps(maps: dict[str, np.ndarray], skin: np.ndarray, path: Path) -> None:
    shape = maps["diffuse_albedo"].shape[:2]
    for name, image in {**maps, "skin": skin}.items():
        channels, low, high = _MAPS.get(name, (1, 0.0, 1.0))
        where = path / ("skin.png" if name == "skin" else f"maps/{name}.exr")
        wanted = (*shape, 3) if channels == 3 else shape
        if image.shape != wanted:
            raise SimError(
                where,
                found=f"shape {image.shape}",
                expected=f"{wanted}, as diffuse_albedo",
                hint="All maps of a subject are of one size.",
            )
        bad = ~((image >= low) & (image <= high))
        if bad.any():
            first = tuple(int(i) for i in np.argwhere(bad)[0])
            raise SimError(
                where,
                field=f"texel {first}",
                found=f"{float(image[first]):.4g} ({counted(int(bad.sum()), 'such value')})",
                expected=f"{low:g} to {high:g}",
            )


def _check_mesh(mesh: Mesh, where: Path) -> None:
    if mesh.uvs is None or mesh.face_uvs is None:
        raise SimError(where, field="uv", found="none", expected="texture coordinates")
    if not np.isfinite(mesh.vertices).all():
        raise SimError(where, field="vertices", found="NaN or infinity", expected="finite mm")
    low, high = float(mesh.uvs.min()), float(mesh.uvs.max())
    if low < -1e-6 or high > 1 + 1e-6:
        raise SimError(
            where, field="uv", found=f"UV from {low:.3g} to {high:.3g}", expected="one tile, 0..1"
        )


def _read_skin(path: Path) -> np.ndarray:
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) if path.is_file() else None
    if image is None:
        found = "no readable picture" if path.exists() else "no such file"
        raise SimError(path, found=found, expected="a mask, 255 where skin is scored")
    return np.asarray(image) > 127


def _numbers(value: object, shape: tuple[int, ...], where: Path, field: str) -> np.ndarray:
    try:
        return array_of(value, *shape)
    except ValueError:
        wanted = " x ".join(str(n) for n in shape)
        raise SimError(
            where, field=field, found=repr(value)[:60], expected=f"{wanted} numbers"
        ) from None


def _obj_text(mesh: Mesh) -> str:
    """OBJ with the fewest digits that give the same numbers back."""
    assert mesh.uvs is not None
    assert mesh.face_uvs is not None
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in mesh.vertices.tolist()]
    lines += [f"vt {u!r} {v!r}" for u, v in mesh.uvs.tolist()]
    for row, uv_row in zip(mesh.faces.tolist(), mesh.face_uvs.tolist(), strict=True):
        corners = [f"{i + 1}/{t + 1}" for i, t in zip(row, uv_row, strict=True) if i >= 0]
        lines.append("f " + " ".join(corners))
    return "\n".join(lines) + "\n"
