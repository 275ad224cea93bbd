"""ICT Face Model Light as its users have it [Li2020]: a clone of ICT-FaceKit with its OBJ files.

The neutral mesh names a material at each face; `vertex_indices.json` has the landmarks and the
expressions' names; `identity000.obj` and the following are the mean face moved along one identity
mode each, and one file a named expression is the mean face with that expression at full strength.
"""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import numpy as np

from lightstage.counting import counted
from lightstage.errors import FormatError, unreadable_file
from lightstage.formats.fields import Fields
from lightstage.formats.files import read_json
from lightstage.formats.landmarks import COUNTS, SCHEME
from lightstage.formats.mesh import Mesh, read_obj
from lightstage.formats.values import open_regular

NEUTRAL = "generic_neutral_mesh.obj"
INDICES = "vertex_indices.json"
LFS = "Is the clone complete? `git lfs pull` fetches its meshes."
FACE, HEAD = "M_Face", "M_BackHead"
"""Materials of the skin: the face with its ears, and head, neck and sockets."""
EYES = ("M_ScleraLeft", "M_ScleraRight")
"""Materials of the eyeballs' outer surface, the cornea with them."""
INNER = ("M_GumsTongue", "M_Teeth")
"""Materials of what an open mouth shows."""


@dataclasses.dataclass(frozen=True, eq=False)
class IctModel:
    """The model in its own axes and unit.

    Attributes:
        folder: FaceXModel.
        mesh: the mean face; UV tiles are beside each other along u.
        materials: (m,) name of each face's material, "" where none was named.
        landmarks: (68,) int64 vertices in iBUG's order.
        identity: (k, n, 3) float32 offsets, one for each identity mesh in the order of the numbers.
        expression: (e, n, 3) float32 offsets.
        expression_names: e names, as ICT's files have them.
        passed_over: names of OBJ files that are neither.
    """

    folder: Path
    mesh: Mesh
    materials: np.ndarray
    landmarks: np.ndarray
    identity: np.ndarray
    expression: np.ndarray
    expression_names: tuple[str, ...]
    passed_over: tuple[str, ...]


def read_ict(path: Path) -> IctModel:
    """Read a clone.

    Args:
        path: the clone, a folder with FaceXModel, or FaceXModel itself.

    Raises:
        FormatError: a folder without the model, a file that is missing or unreadable, landmarks
            that are not 68 vertices, a mesh without UV, or shapes of another vertex count.
    """
    folder = path if (path / NEUTRAL).is_file() else path / "FaceXModel"
    if not (folder / NEUTRAL).is_file():
        raise FormatError(
            path,
            found=f"no FaceXModel/{NEUTRAL}" if path.is_dir() else "no such folder",
            expected="a clone of ICT-FaceKit",
            hint="Clone https://github.com/ICT-VGL/ICT-FaceKit and name its folder; "
            "`template import-obj` takes other meshes.",
        )
    landmarks, expressions = _read_indices(folder / INDICES)
    mesh = read_obj(folder / NEUTRAL)
    count = len(mesh.vertices)
    if mesh.uvs is None or mesh.face_uvs is None:
        raise FormatError(
            folder / NEUTRAL, field="uv", found="none", expected="ICT's UV tiles", hint=LFS
        )
    if landmarks.max() >= count:
        raise FormatError(
            folder / INDICES,
            field="idx_to_landmark_verts",
            found=f"vertex {landmarks.max()}",
            expected=f"indices below the {count} vertices of {NEUTRAL}",
        )
    identity, expression, names, others = [], [], [], []
    for file in sorted(folder.glob("*.obj")):
        if file.name == NEUTRAL:
            continue
        if re.fullmatch("identity[0-9]{1,6}", file.stem):
            identity.append(_offset(file, mesh))
        elif file.stem in expressions:
            expression.append(_offset(file, mesh))
            names.append(file.stem)
        else:
            others.append(file.name)
    none = np.zeros((0, count, 3), np.float32)
    return IctModel(
        folder=folder,
        mesh=mesh,
        materials=face_materials(folder / NEUTRAL, len(mesh.faces)),
        landmarks=landmarks,
        identity=np.stack(identity) if identity else none,
        expression=np.stack(expression) if expression else none,
        expression_names=tuple(names),
        passed_over=tuple(others),
    )


def face_materials(path: Path, count: int) -> np.ndarray:
    """(count,) the material that an OBJ file has in use at each face; "" before the first.

    Args:
        path: a file that `read_obj` has read.
        count: of its faces.
    """
    names, current = [], ""
    with open(open_regular(path, "an OBJ mesh"), encoding="utf-8") as handle:
        for line in handle:
            word, _, rest = line.strip().partition(" ")
            if word == "usemtl":
                current = rest.strip()
            elif word == "f":
                names.append(current)
    if len(names) != count:
        raise FormatError(path, found=counted(len(names), "face"), expected=str(count))
    return np.array(names, object)


def _read_indices(path: Path) -> tuple[np.ndarray, set[str]]:
    """The 68 landmarks and the expressions' names."""
    value = Fields(read_json(path), path, "").rest()
    marks = value.get("idx_to_landmark_verts")
    whole = isinstance(marks, list) and all(type(i) is int and 0 <= i < 2**31 for i in marks)
    if not whole or not isinstance(marks, list) or len(marks) != COUNTS[SCHEME]:
        found = counted(len(marks), "entry", "entries") if isinstance(marks, list) else repr(marks)
        raise FormatError(
            path,
            field="idx_to_landmark_verts",
            found=found,
            expected=f"{COUNTS[SCHEME]} vertex indices",
        )
    names = value.get("expressions")
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise FormatError(path, field="expressions", found=repr(names)[:80], expected="names")
    return np.array(marks, np.int64), set(names)


def _offset(path: Path, mesh: Mesh) -> np.ndarray:
    """(n, 3) float32 of a mesh whose topology is known, against the mean face."""
    vertices = read_vertices(path)
    if vertices.shape != mesh.vertices.shape:
        raise FormatError(
            path,
            field="vertices",
            found=str(len(vertices)),
            expected=f"{len(mesh.vertices)}, as in {NEUTRAL}",
            hint=f"Are neutral mesh and shapes of the same release? {LFS}",
        )
    return np.asarray(vertices - mesh.vertices, np.float32)


def read_vertices(path: Path) -> np.ndarray:
    """(n, 3) float64 of an OBJ file's vertices alone.

    Raises:
        FormatError: unreadable, or a vertex that is no three finite numbers.
    """
    try:
        with open(open_regular(path, "an OBJ mesh"), encoding="utf-8") as handle:
            rows = [line.split()[1:4] for line in handle if line.startswith("v ")]
        vertices = np.array(rows, float).reshape(len(rows), 3)
    except OSError as error:
        raise unreadable_file(path, error) from None
    except ValueError as error:
        raise FormatError(path, found=str(error), expected="a readable OBJ mesh") from None
    if not np.isfinite(vertices).all():
        raise FormatError(path, field="vertices", found="NaN or infinity", expected="finite")
    return vertices
