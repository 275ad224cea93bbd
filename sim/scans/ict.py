"""ICT Face Model Light as its users have it: a clone's OBJ files, or its modes in one file.

The model [Li2020] is not part of this project; it is read from the user's copy. Lengths there are
centimetres, the face looks along +z, +y is up: the stage's axes, ten times smaller.
"""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path

import numpy as np

from lightstage.counting import counted
from lightstage.formats.fields import Fields, array_of
from lightstage.formats.files import read_json
from lightstage.formats.mesh import Mesh, read_obj
from lightstage.formats.npz import UNREADABLE_NPZ
from sim.errors import SimError
from sim.scans.head_data import head_data_folder

SOURCE = (
    "ICT Face Model Light, Copyright (c) 2020 USC Institute for Creative Technologies (MIT "
    "licence); skin by lightstage-sim"
)
MM_PER_UNIT = 10.0
MODES_FILE = "ict_facekit_modes.npz"
NEUTRAL_FILE = "generic_neutral_mesh.obj"
INDEX_FILE = "vertex_indices.json"
VERTICES = 26719
"""Number of vertices of every mesh of the model's first release."""


@dataclasses.dataclass(frozen=True, eq=False)
class IctModel:
    """The linear model in the file's axes: vertices = neutral + identity . a + expression . b.

    Attributes:
        where: file or folder it was read from.
        mesh: the neutral head, mm; UV tiles beside each other along u.
        identity: (k, n, 3) float32 mm, each of one standard deviation.
        expression: name to (n, 3) float32 mm at full strength.
        landmarks: (68,) int64 vertex indices in iBUG's order.
    """

    where: Path
    mesh: Mesh
    identity: np.ndarray
    expression: dict[str, np.ndarray]
    landmarks: np.ndarray


def ict_folder() -> Path | None:
    """The model among the optional head data, None where it is absent."""
    return head_data_folder("ict_facekit", "FaceXModel")


def load_ict(path: Path) -> IctModel:
    """Read the model.

    Args:
        path: the clone (a folder with FaceXModel), FaceXModel itself, or a modes file beside it.
            Where a clone holds the modes file too, that is read: it holds all modes.

    Returns:
        The model; the same object for the same files.

    Raises:
        SimError: a missing file, a mode of another vertex count, or landmarks that are not 68
            vertices.
        FormatError: an unreadable OBJ file.
    """
    path = path.resolve()
    if path.suffix == ".npz":
        folder, modes = path.parent / "FaceXModel", path
    else:
        folder = path if (path / NEUTRAL_FILE).is_file() else path / "FaceXModel"
        modes = path / MODES_FILE
    if not (folder / NEUTRAL_FILE).is_file() and not modes.is_file():
        raise SimError(
            path,
            found="no FaceXModel" if path.is_dir() else "no such folder",
            expected=f"a clone of ICT-FaceKit: FaceXModel/{NEUTRAL_FILE}",
            hint="Clone https://github.com/ICT-VGL/ICT-FaceKit and name its folder.",
        )
    used = modes if modes.is_file() else folder
    return _load(folder, used, used.stat().st_mtime_ns)


@functools.lru_cache(maxsize=2)
def _load(folder: Path, used: Path, _changed: int) -> IctModel:
    landmarks = _read_landmarks(folder / INDEX_FILE)
    model = _from_file(used, landmarks) if used.is_file() else _from_clone(folder, landmarks)
    count = len(model.mesh.vertices)
    if landmarks.max() >= count:
        raise SimError(
            folder / INDEX_FILE,
            field="idx_to_landmark_verts",
            found=f"vertex {landmarks.max()}",
            expected=f"indices below the mesh's {count} vertices",
        )
    return model


def _read_landmarks(path: Path) -> np.ndarray:
    expected = "68 vertex indices"
    field = "idx_to_landmark_verts"
    given = Fields(read_json(path), path, error=SimError).rest().get(field)
    try:
        marks = array_of(given, 68)
    except ValueError:
        marks = np.full(68, -1.0)
    if (marks < 0).any() or (marks % 1 != 0).any():
        found = ascii(given)[:60]
        if isinstance(given, list) and len(given) != 68:
            found = counted(len(given), "entry", "entries")
        raise SimError(path, field=field, found=found, expected=expected)
    return marks.astype(np.int64)


def _from_file(path: Path, landmarks: np.ndarray) -> IctModel:
    try:
        with np.load(path, allow_pickle=False) as file:
            neutral = file["neutral_vertices_cm"].astype(float)
            uvs, faces, face_uvs = file["uv"].astype(float), file["faces"], file["faces_uv"]
            identity = file["identity_modes_cm"].astype(np.float32)
            expression = file["expression_modes_cm"].astype(np.float32)
            names = [str(name) for name in file["expression_names"]]
    except UNREADABLE_NPZ as error:
        raise SimError(path, found=str(error), expected="the model's modes") from None
    for field, modes in (("identity_modes_cm", identity), ("expression_modes_cm", expression)):
        _require_modes(path, field, modes, len(neutral))
    if len(names) != len(expression):
        raise SimError(
            path, field="expression_names", found=f"{len(names)}", expected=f"{len(expression)}"
        )
    for field, values in (
        ("neutral_vertices_cm", neutral),
        ("identity_modes_cm", identity),
        ("expression_modes_cm", expression),
    ):
        if not np.isfinite(values).all():
            raise SimError(path, field=field, found="NaN or infinity", expected="finite cm")
    mesh = Mesh(neutral * MM_PER_UNIT, faces.astype(np.int32), uvs, face_uvs.astype(np.int32))
    identity *= MM_PER_UNIT
    expression *= MM_PER_UNIT
    return IctModel(path, mesh, identity, dict(zip(names, expression, strict=True)), landmarks)


def _from_clone(folder: Path, landmarks: np.ndarray) -> IctModel:
    mesh = read_obj(folder / NEUTRAL_FILE)
    if mesh.uvs is None:
        raise SimError(folder / NEUTRAL_FILE, field="uv", found="none", expected="UV tiles")
    files = sorted(path for path in folder.glob("*.obj") if path.name != NEUTRAL_FILE)
    identity, expression = [], {}
    for path in files:
        offset = (_read_vertices(path, len(mesh.vertices)) - mesh.vertices) * MM_PER_UNIT
        if path.stem.startswith("identity"):
            identity.append(offset.astype(np.float32))
        else:
            expression[path.stem] = offset.astype(np.float32)
    if not identity:
        raise SimError(folder, found="no identity000.obj", expected="the identity shapes")
    mesh = mesh.with_vertices(mesh.vertices * MM_PER_UNIT)
    return IctModel(folder, mesh, np.stack(identity), expression, landmarks)


def _read_vertices(path: Path, count: int) -> np.ndarray:
    """(count, 3) of an OBJ file whose topology is known."""
    try:
        with path.open() as file:
            rows = [line.split()[1:4] for line in file if line.startswith("v ")]
        vertices = np.array(rows, float)
    except (OSError, ValueError) as error:
        raise SimError(path, found=str(error), expected="a readable OBJ mesh") from None
    if vertices.shape != (count, 3):
        raise SimError(
            path,
            field="vertices",
            found=str(len(rows)),
            expected=f"{count}, as in {NEUTRAL_FILE}",
            hint="Are neutral mesh and shapes of the same release?",
        )
    if not np.isfinite(vertices).all():
        raise SimError(path, field="vertices", found="NaN or infinity", expected="finite cm")
    return vertices


def _require_modes(path: Path, field: str, modes: np.ndarray, count: int) -> None:
    if modes.ndim != 3 or modes.shape[1:] != (count, 3) or not len(modes):
        raise SimError(
            path,
            field=field,
            found=f"shape {modes.shape}",
            expected=f"(k, {count}, 3): the neutral mesh has {count} vertices",
        )
