"""GNM Head as its users have it: one npz of arrays and a text of 68 landmarks [GNM2026].

The arrays' names and shapes are those of the model's published loader. Lengths are metres; one unit
of an identity mode is one standard deviation. Each of the landmarks' 68 lines has three vertices
with a weight each.
"""

from __future__ import annotations

import dataclasses
import zipfile
from pathlib import Path

import numpy as np

from lightstage.counting import counted
from lightstage.errors import FormatError
from lightstage.formats.npz import UNREADABLE_NPZ
from lightstage.formats.values import open_regular

LANDMARKS = "head_sparse_68.txt"
BESIDE = Path("..") / ".." / "landmarks" / LANDMARKS
"""Where the repository has the landmarks, from the model's folder."""
LARGEST_BYTES = 2**31
"""Of one array, unpacked."""
SHAPES: dict[str, tuple[int | str, ...]] = {
    "template_vertex_positions": ("V", 3),
    "quads": ("Q", 4),
    "quad_uvs": ("Q", 4, 2),
    "vertex_identity_basis": ("I", "V", 3),
    "expression_basis": ("E", "V", 3),
    "identity_names": ("I",),
    "expression_names": ("E",),
    "vertex_groups": ("G", "V"),
    "vertex_group_names": ("G",),
}
"""What is read of the file: a letter is the same number everywhere."""


@dataclasses.dataclass(frozen=True, eq=False)
class GnmModel:
    """The model in its own axes, metres.

    Attributes:
        vertices: (V, 3).
        quads: (Q, 4) int.
        quad_uvs: (Q, 4, 2), of each quad's corners.
        identity: (I, V, 3) float32 offsets, each of one standard deviation.
        identity_names: I names, by part: ``head_..``, ``eyes_..``, ``teeth_..``.
        expression: (E, V, 3) float32 offsets.
        expression_names: E names.
        groups: by name, (V,) bool.
    """

    vertices: np.ndarray
    quads: np.ndarray
    quad_uvs: np.ndarray
    identity: np.ndarray
    identity_names: tuple[str, ...]
    expression: np.ndarray
    expression_names: tuple[str, ...]
    groups: dict[str, np.ndarray]


def read_gnm(path: Path) -> GnmModel:
    """Read the model's npz.

    Raises:
        FormatError: a file that is no npz, an array that is missing, of another shape, or with NaN
            or a vertex that is not there.
    """
    arrays = _arrays(path)
    sizes: dict[str, int] = {}
    for name, shape in SHAPES.items():
        found = arrays[name].shape
        known = [sizes.get(s, "any") if isinstance(s, str) else s for s in shape]
        right = len(found) == len(shape) and all(
            k in ("any", f) for k, f in zip(known, found, strict=True)
        )
        if not right:
            raise FormatError(path, field=name, found=f"shape {found}", expected=f"{tuple(known)}")
        sizes |= {s: f for s, f in zip(shape, found, strict=True) if isinstance(s, str)}
    for name in SHAPES:
        if name.endswith("_names"):
            continue
        if arrays[name].dtype.kind not in "fiu" or not np.isfinite(arrays[name]).all():
            raise FormatError(path, field=name, found="NaN, or no numbers", expected="numbers")
    quads = arrays["quads"].astype(np.int64)
    if not len(quads) or quads.min() < 0 or quads.max() >= sizes["V"]:
        raise FormatError(
            path,
            field="quads",
            found="none, or vertices that are not there",
            expected=f"indices below {sizes['V']}",
        )
    groups = arrays["vertex_groups"] > 0.5
    return GnmModel(
        arrays["template_vertex_positions"].astype(float),
        quads,
        arrays["quad_uvs"].astype(float),
        arrays["vertex_identity_basis"].astype(np.float32),
        _names(arrays["identity_names"]),
        arrays["expression_basis"].astype(np.float32),
        _names(arrays["expression_names"]),
        dict(zip(_names(arrays["vertex_group_names"]), groups, strict=True)),
    )


def read_gnm_landmarks(path: Path, count: int) -> tuple[np.ndarray, np.ndarray]:
    """(68, 3) vertices and (68, 3) weights of the landmarks, in the file's order.

    Args:
        path: the text.
        count: of the model's vertices.

    Raises:
        FormatError: lines that are not 68 of three vertices and three weights.
    """
    expected = "68 lines of three vertices, each followed by its weight"
    try:
        with open(open_regular(path, "landmarks"), encoding="utf-8") as handle:
            lines = [line.split("#")[0].split() for line in handle]
        rows = [[float(word) for word in line] for line in lines if line]
    except (ValueError, UnicodeDecodeError):
        raise FormatError(path, found="something else", expected=expected) from None
    if len(rows) != 68 or any(len(row) != 6 for row in rows):
        raise FormatError(path, found=counted(len(rows), "line"), expected=expected)
    values = np.array(rows)
    vertices, weights = values[:, ::2], values[:, 1::2]
    whole = (vertices == np.floor(vertices)) & (vertices >= 0) & (vertices < count)
    if not whole.all() or not np.isfinite(weights).all():
        line = int(np.flatnonzero(~whole.all(axis=1) | ~np.isfinite(weights).all(axis=1))[0])
        raise FormatError(
            path,
            field=f"landmark {line}",
            found=str(rows[line]),
            expected=f"vertices below {count}, and weights",
        )
    return vertices.astype(np.int64), weights


def _arrays(path: Path) -> dict[str, np.ndarray]:
    """The arrays that are read."""
    with open(open_regular(path, "GNM's npz"), "rb") as handle:
        try:
            with zipfile.ZipFile(handle) as archive:
                large = [i.filename for i in archive.infolist() if i.file_size > LARGEST_BYTES]
            if large:
                raise FormatError(
                    path, field=large[0], found="more than 2 GiB", expected="GNM's arrays"
                )
            handle.seek(0)
            with np.load(handle, allow_pickle=False) as file:
                missing = [name for name in SHAPES if name not in file]
                if missing:
                    raise FormatError(
                        path,
                        field=missing[0],
                        found=f"none, but {', '.join(sorted(file.files)[:12]) or 'nothing'}",
                        expected="gnm_head.npz, as https://github.com/google/GNM has it",
                    )
                return {name: file[name] for name in SHAPES}
        except UNREADABLE_NPZ as error:
            raise FormatError(
                path, found=str(error)[:100], expected="an npz of arrays, such as gnm_head.npz"
            ) from None


def _names(values: np.ndarray) -> tuple[str, ...]:
    return tuple(str(name) for name in values)
