"""Meshes with UV: OBJ (topology kept, quads kept) and PLY."""

from __future__ import annotations

import dataclasses
import errno
import re
from pathlib import Path

import numpy as np

from lightstage.counting import counted
from lightstage.errors import FormatError
from lightstage.failures import free_bytes
from lightstage.formats.files import atomic_path, write_text
from lightstage.formats.values import open_regular


@dataclasses.dataclass(frozen=True)
class Mesh:
    """A triangle or quad mesh.

    Attributes:
        vertices: (n, 3) float64 mm.
        faces: (m, 3) or (m, 4) int32 vertex indices; -1 in the last column marks a triangle.
        uvs: (k, 2) float64, v upward, or None.
        face_uvs: the shape of `faces`, indices into `uvs`, or None.
    """

    vertices: np.ndarray
    faces: np.ndarray
    uvs: np.ndarray | None = None
    face_uvs: np.ndarray | None = None

    def triangles(self) -> np.ndarray:
        """(t, 3) int32: quads are split along their first diagonal."""
        return _split(self.faces, self.faces)

    def triangle_uvs(self) -> np.ndarray:
        """(t, 3) int32 indices into `uvs`, in the order of `triangles()`."""
        if self.face_uvs is None:
            raise FormatError("mesh", field="uv", found="none", expected="texture coordinates")
        return _split(self.face_uvs, self.faces)

    def with_vertices(self, vertices: np.ndarray) -> Mesh:
        """The same topology and UV at other places (n, 3)."""
        return dataclasses.replace(self, vertices=np.asarray(vertices, float))


def _split(values: np.ndarray, faces: np.ndarray) -> np.ndarray:
    if faces.shape[1] == 3:
        return values.astype(np.int32)
    quad = faces[:, 3] >= 0
    counts = 1 + quad.astype(int)
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
    out = np.empty((int(counts.sum()), 3), np.int32)
    out[starts] = values[:, :3]
    out[starts[quad] + 1] = values[quad][:, [0, 2, 3]]
    return out


def vertex_normals(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Area-weighted vertex normals; zero where all triangles are degenerate.

    Args:
        vertices: (n, 3).
        triangles: (t, 3).

    Returns:
        (n, 3) float64, unit or zero.
    """
    corners = vertices[triangles]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(vertices, dtype=float)
    for corner in range(3):
        for axis in range(3):
            normals[:, axis] += np.bincount(
                triangles[:, corner], weights=area[:, axis], minlength=len(vertices)
            )
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.divide(normals, length, out=np.zeros_like(normals), where=length > 0)


def directed_edges(triangles: np.ndarray) -> np.ndarray:
    """(3 t, 2) int64 edges of (t, 3) triangles as these run round, one triangle after the other."""
    return triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2).astype(np.int64)


def edge_counts(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Every edge of (t, 3) triangles once: (e, 2) int64, in order, the lower vertex first.

    Returns:
        The edges, and (e,) how many triangles have each: the border's one.
    """
    ends = np.sort(directed_edges(triangles), axis=1)
    count = int(ends.max(initial=0)) + 1
    keys, counts = np.unique(ends[:, 0] * count + ends[:, 1], return_counts=True)
    return np.stack(np.divmod(keys, count), axis=1), counts


def connected(edges: np.ndarray, count: int) -> np.ndarray:
    """Which connected part each vertex is in.

    Args:
        edges: (e, 2) vertices that are joined; either way round, any number of times.
        count: of the vertices.

    Returns:
        (count,) labels from 0; a vertex without an edge is a part of its own.
    """
    from scipy import sparse

    joined = sparse.coo_array((np.ones(len(edges), bool), tuple(edges.T)), shape=(count, count))
    return np.asarray(sparse.csgraph.connected_components(joined, directed=False)[1])


def read_obj(path: Path) -> Mesh:
    """Read an OBJ file's vertices, faces and texture coordinates, in the file's order.

    Materials, groups and normals are passed over; polygons of more than four corners are refused.

    Raises:
        FormatError: missing, malformed, or an index out of range.
    """
    try:
        # Comments and names of materials may be in any encoding; all that is read is ASCII.
        handle = open_regular(path, "an OBJ mesh")
        with open(handle, encoding="utf-8-sig", errors="replace") as file:
            lines = file.readlines()
    except OSError as error:
        raise FormatError(path, found=str(error), expected="a readable OBJ mesh") from None
    return parse_obj(lines, path)


def parse_obj(lines: list[str], path: Path) -> Mesh:
    """The mesh of an OBJ file's lines, each with its end; see `read_obj`.

    Args:
        lines: of the file.
        path: what an error names.
    """
    try:
        mesh = _read_plain(lines) or _read_lines(lines, path)
    except (ValueError, IndexError) as error:
        raise FormatError(path, found=str(error), expected="a readable OBJ mesh") from None
    _check(mesh, path)
    return mesh


PLY_HEADER_BYTES = 1 << 16
MOST_INDEX = 2**31 - 1
NUMBER, INDEX = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?", r"\d{1,9}"
"""Patterns of `numbers_of`."""


def _read_plain(lines: list[str]) -> Mesh | None:
    """A mesh as programs write it: one space between numbers, no index from the end.

    None for any other: `_read_lines` reads it, and names what is wrong with it.
    """
    vertices = [line[2:] for line in lines if line.startswith("v ")]
    uvs = [line[3:] for line in lines if line.startswith("vt ")]
    faces = [line[2:] for line in lines if line.startswith("f ")]
    plain = len(vertices) + len(uvs) + len(faces)
    if plain != sum(line.split(None, 1)[:1] in (["v"], ["vt"], ["f"]) for line in lines):
        return None
    spaces = [line.count(" ") for line in faces]
    if not faces or not {2, 3}.issuperset(spaces):
        return None
    indices = 1 + faces[0].count("/") // (spaces[0] + 1)
    corner = "/".join(indices * [INDEX])
    places = numbers_of(vertices, " ".join(3 * [NUMBER]), 3, float)
    textures = numbers_of(uvs, " ".join(2 * [NUMBER]), 2, float)
    if places is None or textures is None:
        return None
    by_corner = np.zeros((len(faces), 4, indices), np.int32)
    for corners in (3, 4):
        of_kind = [k for k, count in enumerate(spaces) if count == corners - 1]
        pattern = " ".join(corners * [corner])
        joins = numbers_of([faces[k] for k in of_kind], pattern, corners * indices, np.int64)
        if joins is None or (joins < 1).any():
            return None
        by_corner[of_kind, :corners] = joins.reshape(-1, corners, indices)
    by_corner -= 1
    return Mesh(
        places,
        _trim(np.ascontiguousarray(by_corner[..., 0])),
        textures if uvs else None,
        _trim(np.ascontiguousarray(by_corner[..., 1])) if indices > 1 else None,
    )


def numbers_of(lines: list[str], pattern: str, count: int, kind: type) -> np.ndarray | None:
    """Numbers of lines that all match a pattern, read at once.

    Args:
        lines: each with its end.
        pattern: of a line without its end, of `NUMBER` and `INDEX`, spaces and slashes.
        count: of a line's numbers.
        kind: float or an integer type.

    Returns:
        (n, count); None where a line does not match the pattern.
    """
    if not lines:
        return np.zeros((0, count), kind)
    text = "".join(lines)
    # Possessive: a million lines leave no million places to go back to.
    if re.fullmatch(f"(?:{pattern}\n)*+(?:{pattern})?", text, re.ASCII) is None:
        return None
    return np.fromstring(text.replace("/", " "), kind, sep=" ").reshape(-1, count)


def _read_lines(lines: list[str], path: Path) -> Mesh:
    """Any mesh, a line after the other."""
    vertices: list[list[float]] = []
    uvs: list[list[float]] = []
    faces: list[list[int]] = []
    face_uvs: list[list[int]] = []
    for number, line in enumerate(lines, 1):
        words = line.split()
        if not words:
            continue
        if words[0] == "v":
            vertices.append(_numbers(words[1:4], 3))
        elif words[0] == "vt":
            uvs.append(_numbers(words[1:3], 2))
        elif words[0] == "f":
            corners = [w.split("/") for w in words[1:]]
            if len(corners) not in (3, 4):
                raise FormatError(
                    path,
                    field=f"line {number}",
                    found=f"a face of {counted(len(corners), 'corner')}",
                    expected="triangles or quads",
                )
            pad = [-1] * (4 - len(corners))
            faces.append([_index(c[0], len(vertices)) for c in corners] + pad)
            if all(len(c) > 1 and c[1] for c in corners):
                face_uvs.append([_index(c[1], len(uvs)) for c in corners] + pad)
    return Mesh(
        np.array(vertices, float).reshape(-1, 3),
        _trim(np.array(faces, np.int32).reshape(-1, 4)),
        np.array(uvs, float).reshape(-1, 2) if uvs else None,
        _trim(np.array(face_uvs, np.int32).reshape(-1, 4)) if face_uvs else None,
    )


def _numbers(words: list[str], count: int) -> list[float]:
    if len(words) != count:
        raise ValueError(f"{counted(len(words), 'coordinate')} instead of {count}")
    return [float(word) for word in words]


def _index(word: str, count: int) -> int:
    """From 0 on; OBJ counts from 1, or back from the last one so far. ValueError for none."""
    value = int(word)
    if value == 0 or value < -count or value > MOST_INDEX:
        raise ValueError(f"an index of {word}, after {count}")
    return value - 1 if value > 0 else count + value


def _trim(faces: np.ndarray) -> np.ndarray:
    return faces if (faces[:, 3] >= 0).any() else np.ascontiguousarray(faces[:, :3])


def _check(mesh: Mesh, path: Path) -> None:
    if not len(mesh.vertices) or not len(mesh.faces):
        raise FormatError(
            path,
            found=f"{counted(len(mesh.vertices), 'vertex', 'vertices')}, "
            f"{counted(len(mesh.faces), 'face')}",
            expected="a mesh",
        )
    if not np.isfinite(mesh.vertices).all():
        raise FormatError(path, field="vertices", found="NaN or infinity", expected="finite mm")
    if mesh.faces[:, :3].min() < 0 or mesh.faces.max() >= len(mesh.vertices):
        raise FormatError(path, field="faces", found="an index of no vertex", expected="a mesh")
    if mesh.face_uvs is not None:
        if len(mesh.face_uvs) != len(mesh.faces):
            raise FormatError(
                path,
                field="uv",
                found=f"{len(mesh.face_uvs)} of {counted(len(mesh.faces), 'face')} with UV",
                expected="all or none",
            )
        if mesh.uvs is not None and not np.isfinite(mesh.uvs).all():
            raise FormatError(path, field="uv", found="NaN or infinity", expected="finite UV")
        lowest = mesh.face_uvs[:, :3].min()
        if mesh.uvs is None or lowest < 0 or mesh.face_uvs.max() >= len(mesh.uvs):
            raise FormatError(path, field="uv", found="an index of no vt", expected="a mesh")


def write_obj(mesh: Mesh, path: Path, normals: np.ndarray | None = None) -> Path:
    """Write an OBJ file atomically, topology and UV as they are; returns `path`.

    Args:
        mesh: to write.
        path: of the file.
        normals: (n, 3) unit, of the vertices; left out where None.

    Raises:
        FormatError: a name that does not end in .obj.
    """
    if path.suffix.lower() != ".obj":
        raise FormatError(path, found=f"suffix {path.suffix!r}", expected=".obj")
    parts = [_rows("v %.6f %.6f %.6f\n", mesh.vertices)]
    if mesh.uvs is not None:
        parts.append(_rows("vt %.8f %.8f\n", mesh.uvs))
    if normals is not None:
        parts.append(_rows("vn %.6f %.6f %.6f\n", normals))
    # One smooth surface: without this and without normals Blender shades every face flat.
    parts.append("s 1\n")
    # Of each corner vertex, texture coordinate, normal.
    numbers, corner = [mesh.faces], " %d"
    if mesh.face_uvs is not None:
        numbers.append(mesh.face_uvs)
        corner += "/%d"
    if normals is not None:
        numbers.append(mesh.faces)
        corner += "/%d" if mesh.face_uvs is not None else "//%d"
    there = mesh.faces >= 0
    lines = ["f" + corner * count + "\n" for count in range(there.shape[1] + 1)]
    pattern = "".join([lines[count] for count in there.sum(axis=1).tolist()])
    parts.append(pattern % tuple((np.stack(numbers, axis=-1)[there] + 1).ravel().tolist()))
    return write_text(path, "".join(parts))


def _rows(pattern: str, values: np.ndarray) -> str:
    """(n, k) numbers, each row by a pattern: one format for all takes half of the time."""
    return (pattern * len(values)) % tuple(values.ravel().tolist())


def read_ply(path: Path) -> Mesh:
    """Read a PLY triangle mesh (vertices and faces); FormatError when missing or empty."""
    import open3d

    if not path.is_file():
        raise FormatError(path, found="no such file", expected="a PLY mesh")
    with open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error):
        found = open3d.io.read_triangle_mesh(str(path))
    mesh = Mesh(np.asarray(found.vertices, float), np.asarray(found.triangles, np.int32))
    # Open3D returns what it read before the file ended. A polygon is several triangles.
    for element, read in (("vertex", len(mesh.vertices)), ("face", len(mesh.faces))):
        stated = _stated(path, element)
        if read < stated:
            raise FormatError(
                path,
                field=f"element {element}",
                found=f"{read} that can be read",
                expected=f"{stated}, as its header states",
                hint="Was the file cut short? Copy or export it again.",
            )
    _check(mesh, path)
    return mesh


def _stated(path: Path, element: str) -> int:
    """How many of an element a PLY's header states; 0 where it states none."""
    with path.open("rb") as file:
        header = file.read(PLY_HEADER_BYTES).partition(b"end_header")[0]
    found = re.search(rf"^element {element} (\d+)\s*$".encode(), header, re.MULTILINE)
    return 0 if found is None else int(found[1])


def write_ply(mesh: Mesh, path: Path) -> Path:
    """Write vertices and triangles as binary PLY, atomically; returns `path`."""
    import open3d

    shape = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(mesh.vertices),
        open3d.utility.Vector3iVector(mesh.triangles()),
    )
    size = 24 * len(mesh.vertices) + 13 * len(mesh.triangles())  # doubles; a count, three ints
    with atomic_path(path, size) as beside:
        written = open3d.io.write_triangle_mesh(str(beside), shape)
        # Open3D does not always notice a full disk; its file is short then.
        if not written or beside.stat().st_size < size:
            raise OSError(errno.ENOSPC if free_bytes(path) < size else errno.EIO, "", str(path))
    return path


def read_mesh(path: Path) -> Mesh:
    """Read .obj or .ply by its suffix."""
    if path.suffix.lower() == ".obj":
        return read_obj(path)
    if path.suffix.lower() == ".ply":
        return read_ply(path)
    raise FormatError(path, found=f"suffix {path.suffix!r}", expected=".obj or .ply")
