"""OBJ with its MTL as a scan comes in it: mesh, UV, colour and normal texture."""

from __future__ import annotations

from pathlib import Path

from lightstage.counting import counted
from lightstage.formats.mesh import read_obj
from sim.errors import SimError
from sim.scans.scan_file import Picture, ScanFile, merged, read_picture

_COLOUR, _NORMALS = "map_kd", "norm"


def read_textured_obj(path: Path) -> ScanFile:
    """Read a scan.

    Args:
        path: the .obj; its material files are beside it. A .obj that names none has no textures.

    Returns:
        The mesh as triangles, in the file's own unit and axes.

    Raises:
        SimError: a missing material file or texture, or several colour textures.
        FormatError: an unreadable OBJ file, or NaN in it.
    """
    mesh = read_obj(path)
    libraries, used = _materials_of(path)
    values = [_read_mtl(path.parent / name) for name in libraries]
    materials = {name: value for file in values for name, value in file.items()}
    unknown = [name for name in used if name not in materials] if libraries else []
    if unknown:
        raise SimError(
            path,
            field=f"usemtl {unknown[0]}",
            found="no such material",
            expected=f"one of {', '.join(materials) or 'none'} in {', '.join(libraries)}",
        )
    if not used:
        used = list(materials)
    face_uvs = None if mesh.face_uvs is None else mesh.triangle_uvs()
    return ScanFile(
        where=path,
        mesh=merged(mesh.vertices, mesh.triangles(), mesh.uvs, face_uvs),
        mm_per_unit=None,
        colour=_texture(path, materials, used, _COLOUR),
        normals=_texture(path, materials, used, _NORMALS),
    )


def _materials_of(path: Path) -> tuple[list[str], list[str]]:
    """Names of material files and of the materials that faces use."""
    libraries, used, current = [], [], None
    with path.open(errors="replace") as file:
        for line in file:
            key, _, rest = line.strip().partition(" ")
            if key == "mtllib":
                libraries.append(rest.strip())
            elif key == "usemtl":
                current = rest.strip()
            elif key == "f" and current is not None and current not in used:
                used.append(current)
    return libraries, used


def _read_mtl(path: Path) -> dict[str, dict[str, Path]]:
    """Material name to its textures by their lower-case keyword."""
    if not path.is_file():
        raise SimError(
            path,
            found="no such file",
            expected="the material file that the OBJ names",
            hint="Put it beside the OBJ, or remove its mtllib line and give --colour.",
        )
    materials: dict[str, dict[str, Path]] = {}
    current: dict[str, Path] = {}
    for line in path.read_text(errors="replace").splitlines():
        words = line.split()
        if not words:
            continue
        if words[0] == "newmtl":
            current = materials.setdefault(" ".join(line.split(None, 1)[1:]).strip(), {})
        elif words[0].lower() in (_COLOUR, _NORMALS) and len(words) > 1:
            current[words[0].lower()] = path.parent / _file_name(words[1:])
    return materials


def _file_name(words: list[str]) -> str:
    """The file name behind a texture's options, such as ``-bm 0.3 skin colour.png``."""
    options = {"-blendu": 1, "-blendv": 1, "-cc": 1, "-clamp": 1, "-bm": 1, "-boost": 1}
    options |= {"-texres": 1, "-imfchan": 1, "-mm": 2, "-o": 3, "-s": 3, "-t": 3}
    rest = words
    while len(rest) > 1 and rest[0] in options:
        rest = rest[1 + options[rest[0]] :]
    return " ".join(rest).replace("\\", "/")


def _texture(
    path: Path, materials: dict[str, dict[str, Path]], used: list[str], key: str
) -> Picture | None:
    files = [materials[name].get(key) for name in used if name in materials]
    named = sorted({str(file) for file in files if file is not None})
    if not named:
        return None
    if len(named) > 1 or None in files:
        raise SimError(
            path,
            field=key,
            found=f"{len(named)} of them on {counted(len(files), 'material')}",
            expected="one texture for the whole mesh",
            hint="Bake all materials into one texture with one UV.",
        )
    return read_picture(Path(named[0]))
