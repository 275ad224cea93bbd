"""ICT Face Model Light as a template: its parts by material, one UV tile, the head frame."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from lightstage.commands import ProgressCallback, quiet
from lightstage.errors import FormatError
from lightstage.formats.mesh import Mesh, connected, directed_edges
from lightstage.formats.template import Modes, Template
from processing.template.build import with_maps
from processing.template.config import ImportConfig
from processing.template.frame import head_from_mesh
from processing.template.ict import EYES, FACE, HEAD, INNER, NEUTRAL, IctModel, read_ict
from processing.template.own import own_template
from processing.template.packing import packed
from processing.template.regions import guessed_regions
from processing.units import Unit, likely_unit

NAME = "ICT Face Model Light"
LICENCE = "MIT"
SOURCE = (
    "ICT Face Model Light, Copyright (c) 2020 USC Institute for Creative Technologies, "
    "https://github.com/ICT-VGL/ICT-FaceKit"
)
EAR_TILE = (0.12, 0.44, 0.72)
"""An ear is in these parts of the face's tile: u from its border, v from and to."""


def import_ict(
    path: Path,
    config: ImportConfig | None = None,
    unit: Unit | None = None,
    mouth: bool = False,
    progress: ProgressCallback = quiet,
) -> tuple[Template, dict[str, Any]]:
    """Make a template of a clone of ICT-FaceKit.

    Skin, sockets and eyeballs are kept, in the order of ICT's vertices. Left out is what only a
    transparent renderer can show (irises within the eyeballs, lacrimal fluid, eye blend and
    occlusion, lashes), and, unless wanted, gums, tongue and teeth, which no scan of a closed
    mouth moves.

    Args:
        path: the clone.
        config: settings.
        unit: of the clone's meshes; None finds it by their size, cm as ICT has it.
        mouth: keep gums, tongue and teeth.
        progress: called with (done, total).

    Returns:
        The template, and facts.

    Raises:
        FormatError: see `read_ict`; a release without the materials that are known, or UV that
            is not in tiles.
        RegistrationError: our template, which gives lips, ears and hair, cannot be fitted to it.
    """
    settings = config or ImportConfig()
    model = read_ict(path)
    unit = unit or likely_unit(model.mesh.vertices)
    where = model.folder / NEUTRAL
    names = [FACE, HEAD, *EYES, *(INNER if mouth else ())]
    part = _parts(model, names)
    own = own_template()
    triangle_part = np.repeat(part, 1 + (model.mesh.faces[:, 3:] >= 0).sum(axis=1))
    motion = head_from_mesh(
        model.mesh.vertices,
        model.landmarks,
        own.mesh.vertices[own.landmarks],
        unit,
        where,
        settings,
    )
    whole = motion.apply(model.mesh.vertices)
    uvs = _one_tile(model, whole, triangle_part, names, where)
    kept = part >= 0
    vertices, faces = compact(model.mesh.faces[kept])
    corners, face_uvs = compact(model.mesh.face_uvs[kept])  # type: ignore[index]  # read_ict
    mesh = Mesh(whole[vertices], faces, uvs[corners], face_uvs)
    landmarks = np.searchsorted(vertices, model.landmarks)
    if not np.array_equal(vertices[np.minimum(landmarks, len(vertices) - 1)], model.landmarks):
        raise FormatError(where, field="landmarks", found="some off the skin", expected=FACE)
    part = part[kept]
    surface = _outer_skin(mesh, part)
    regions = guessed_regions(mesh, landmarks, own, settings, surface, False, progress)
    eyes = _of(faces, part, [names.index(name) for name in EYES], len(vertices))
    regions["eyes"] = np.flatnonzero(eyes)
    regions["ears"] = np.flatnonzero(_ears(model)[vertices])
    for name in ("lips", "hair"):
        regions[name] = np.setdiff1d(regions[name], regions["ears"])
    known = ("lips", "ears", "hair", "eyes")
    others = np.concatenate([regions[name] for name in known])
    regions["skin"] = np.setdiff1d(np.flatnonzero(surface), others)
    turn = motion.scale * motion.rotation.T
    modes = None
    if len(model.identity) or len(model.expression):
        modes = Modes(
            model.identity[:, vertices] @ turn,
            model.expression[:, vertices] @ turn,
            model.expression_names,
        )
    template = with_maps(NAME, mesh, landmarks, regions, modes, LICENCE, SOURCE, settings)
    facts = {
        "unit": unit.name,
        "vertices": len(vertices),
        "faces": len(faces),
        "identity_modes": len(model.identity),
        "expression_modes": len(model.expression),
        "passed_over": list(model.passed_over),
    }
    return template, facts


def compact(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Indices that (m, 3 or 4) faces use, sorted, and the faces over them; -1 stays."""
    used, place = np.unique(faces[faces >= 0], return_inverse=True)
    out = np.full(faces.shape, -1, np.int32)
    out[faces >= 0] = place
    return used, out


def _parts(model: IctModel, names: list[str]) -> np.ndarray:
    """(m,) place of each face's material among names; -1 of others.

    Raises:
        FormatError: the skin's or the eyes' material is missing.
    """
    part = np.full(len(model.materials), -1)
    for number, name in enumerate(names):
        part[model.materials == name] = number
    missing = [name for number, name in enumerate(names) if not (part == number).any()]
    if missing:
        found = ", ".join(sorted({name or "none" for name in model.materials.tolist()})[:20])
        raise FormatError(
            model.folder / NEUTRAL,
            field="usemtl",
            found=found,
            expected=f"also {', '.join(missing)}",
            hint="Was it exported anew without materials? Use the mesh of the clone.",
        )
    return part


def _one_tile(
    model: IctModel, vertices_mm: np.ndarray, part: np.ndarray, names: list[str], where: Path
) -> np.ndarray:
    """(k, 2) UV of all parts in one tile; `part` is each triangle's."""
    triangles, corners = model.mesh.triangles(), model.mesh.triangle_uvs()
    sides = vertices_mm[triangles]
    area = 0.5 * np.linalg.norm(
        np.cross(sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0]), axis=1
    )
    areas = np.array([area[part == number].sum() for number in range(len(names))])
    kept = part >= 0
    assert model.mesh.uvs is not None  # read_ict
    return packed(model.mesh.uvs, corners[kept], part[kept], areas, where, names)


def _outer_skin(mesh: Mesh, part: np.ndarray) -> np.ndarray:
    """(n,) bool: vertices of face, head and neck without the sockets of mouth and eyes.

    Head, neck and sockets have one material; without the face that joins them they are apart, and
    head and neck are the largest.
    """
    behind = np.repeat(part == 1, 1 + (mesh.faces[:, 3:] >= 0).sum(axis=1))
    triangles = mesh.triangles()[behind]
    piece = connected(directed_edges(triangles), len(mesh.vertices))
    label = piece[triangles[:, 0]]
    size = {each: np.ptp(mesh.vertices[triangles[label == each]], axis=(0, 1)).max()
            for each in np.unique(label)}  # fmt: skip
    head = max(size, key=lambda each: size[each])
    skin = _of(mesh.faces, part, [0], len(mesh.vertices))
    skin[np.unique(triangles[label == head])] = True
    return skin


def _ears(model: IctModel) -> np.ndarray:
    """(n,) bool: vertices of the ears, which have a place of their own in ICT's face tile."""
    assert model.mesh.uvs is not None  # read_ict
    assert model.mesh.face_uvs is not None
    across, low, high = EAR_TILE
    face = model.materials == FACE
    faces, corners = model.mesh.faces[face], model.mesh.face_uvs[face]
    u, v = model.mesh.uvs[corners[corners >= 0]].T
    out = np.zeros(len(model.mesh.vertices), bool)
    out[faces[faces >= 0][(np.minimum(u, 1 - u) < across) & (v > low) & (v < high)]] = True
    return out


def _of(faces: np.ndarray, part: np.ndarray, numbers: list[int], count: int) -> np.ndarray:
    """(count,) bool: vertices of faces of some parts."""
    chosen = faces[np.isin(part, numbers)]
    out = np.zeros(count, bool)
    out[chosen[chosen >= 0]] = True
    return out
