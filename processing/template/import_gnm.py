"""GNM Head as a template: its skin and eyes, one UV tile, the head frame, its modes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from lightstage.commands import ProgressCallback, quiet
from lightstage.errors import FormatError
from lightstage.formats.mesh import Mesh, connected, directed_edges
from lightstage.formats.template import Modes, Template
from processing.registration.rigid import umeyama
from processing.template.build import with_maps
from processing.template.config import ImportConfig
from processing.template.frame import head_from_mesh
from processing.template.gnm import BESIDE, LANDMARKS, GnmModel, read_gnm, read_gnm_landmarks
from processing.template.import_ict import compact
from processing.template.own import own_template
from processing.template.packing import packed
from processing.template.regions import guessed_regions
from processing.units import METRES, Unit

NAME = "GNM Head"
LICENCE = "Apache-2.0"
SOURCE = "GNM Head, Copyright 2026 Google LLC, https://github.com/google/GNM"
REVERSED = np.array([0, 1, 6, 5, 4, 3, 2, *range(7, 68)])
"""Some releases have points 2 to 6 of the jaw from the chin to the ear, against iBUG's order."""
EYES = ("eye_exteriors", "eyeball_exterior", "eyes", "left_eye")
"""Groups of the eyeballs, that of their outer surface first."""
INNER = ("teeth", "gums", "tongue")
"""In the names of groups that no scan of a closed mouth shows."""
GRID = 2.0**20
"""Texture coordinates that are the same in so many parts of a tile are one."""
STILL_MM = 1e-3
"""A mode that moves no kept vertex farther is left out."""


def import_gnm(
    path: Path,
    landmarks: Path | None = None,
    config: ImportConfig | None = None,
    unit: Unit | None = None,
    progress: ProgressCallback = quiet,
) -> tuple[Template, dict[str, Any]]:
    """Make a template of GNM Head.

    Skin and the outer surface of the eyeballs are kept, in the order of GNM's vertices; left out is
    what only a transparent renderer or an open mouth shows.

    Args:
        path: gnm_head.npz.
        landmarks: head_sparse_68.txt; where None, as the repository has it beside the model.
        config: settings.
        unit: of the model; metres where None.
        progress: called with (done, total).

    Returns:
        The template, and facts.

    Raises:
        FormatError: see `read_gnm` and `read_gnm_landmarks`; a skin whose UV is in several tiles.
        RegistrationError: our template, which gives regions, cannot be fitted to it.
    """
    settings = config or ImportConfig()
    model = read_gnm(path)
    where = _landmarks_file(path, landmarks)
    own = own_template()
    marks = _landmarks(model, where, own.mesh.vertices[own.landmarks])
    motion = head_from_mesh(
        model.vertices, marks, own.mesh.vertices[own.landmarks], unit or METRES, path, settings
    )
    whole = motion.apply(model.vertices)
    part, names = _parts(model, marks, whole, settings)
    kept = part >= 0
    vertices, faces = compact(model.quads[kept])
    flat = _one_tile(model, whole, part, names, path).reshape(-1, 2)
    # A corner of several quads is one where vertex and place in the texture are the same.
    place = np.column_stack([model.quads[kept].ravel(), np.round(flat * GRID)])
    _, first, corner = np.unique(place, axis=0, return_index=True, return_inverse=True)
    corners = corner.reshape(-1, 4).astype(np.int32)
    mesh = Mesh(whole[vertices], faces.astype(np.int32), flat[first], corners)
    own_marks = np.searchsorted(vertices, marks)
    skin = np.zeros(len(model.vertices), bool)
    skin[model.quads[part == 0]] = True
    regions = guessed_regions(mesh, own_marks, own, settings, skin[vertices], True, progress)
    eyes = np.zeros(len(model.vertices), bool)
    eyes[model.quads[part > 1]] = True
    regions["eyes"] = np.flatnonzero(eyes[vertices])
    turn = motion.scale * motion.rotation.T
    identity, _ = _moving(model.identity[:, vertices] @ turn, model.identity_names)
    expression, expressions = _moving(model.expression[:, vertices] @ turn, model.expression_names)
    modes = Modes(identity, expression, expressions)
    template = with_maps(NAME, mesh, own_marks, regions, modes, LICENCE, SOURCE, settings)
    facts = {
        "unit": (unit or METRES).name,
        "vertices": len(vertices),
        "faces": len(faces),
        "identity_modes": len(identity),
        "expression_modes": len(expression),
        "landmarks": str(where),
    }
    return template, facts


def _landmarks_file(path: Path, given: Path | None) -> Path:
    """The text of the landmarks.

    Raises:
        FormatError: there is none beside the model.
    """
    if given is not None:
        return given
    beside = [path.parent / LANDMARKS, path.parent / BESIDE]
    for each in beside:
        if each.is_file():
            return each
    raise FormatError(
        path,
        field="landmarks",
        found=f"no {LANDMARKS} beside it or at {BESIDE}",
        expected="the text that GNM's repository has in gnm/shape/data/landmarks",
        hint="Name it by --landmarks.",
    )


def _landmarks(model: GnmModel, where: Path, own_mm: np.ndarray) -> np.ndarray:
    """(68,) vertices in iBUG's order: of each landmark the one that weighs most."""
    corners, weights = read_gnm_landmarks(where, len(model.vertices))
    points = np.einsum("pck,pc->pk", model.vertices[corners], weights)
    marks = corners[np.arange(len(corners)), weights.argmax(axis=1)]

    def off(order: np.ndarray) -> float:
        likeness = umeyama(points[order], own_mm, scale=True)
        return float(np.square(likeness.apply(points[order]) - own_mm).sum())

    plain = np.arange(len(marks))
    found: np.ndarray = marks[min((plain, REVERSED), key=off)]
    return found


def _parts(
    model: GnmModel, marks: np.ndarray, whole_mm: np.ndarray, config: ImportConfig
) -> tuple[np.ndarray, list[str]]:
    """(Q,) part of each quad: 0 the skin, from 2 the eyeballs, -1 what is left out; their names."""
    count = len(model.vertices)
    triangles = model.quads[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)
    piece = connected(directed_edges(triangles), count)
    of_quad = piece[model.quads[:, 0]]
    part = np.where(np.isin(of_quad, piece[marks]), 0, -1)
    outer = np.ones(count, bool)
    for name in EYES:
        if name in model.groups:
            outer = model.groups[name]
            break
    inner = np.zeros(count, bool)
    for name, group in model.groups.items():
        if any(word in name for word in INNER):
            inner |= group
    names = ["skin", ""]
    for eye in (slice(36, 42), slice(42, 48)):
        middle = whole_mm[marks[eye]].mean(axis=0)
        near = np.linalg.norm(whole_mm - middle, axis=1) < config.eye_within_mm
        for each in np.unique(of_quad[part < 0]):
            here = (of_quad == each) & (part < 0)
            used = np.unique(model.quads[here])
            if near[used].all() and outer[used].mean() > 0.5 and not inner[used].any():
                part[here] = len(names)
                names.append(f"eye {len(names) - 1}")
    return part, names


def _one_tile(
    model: GnmModel, whole_mm: np.ndarray, part: np.ndarray, names: list[str], where: Path
) -> np.ndarray:
    """(k, 4, 2) UV of the kept quads in one tile."""
    kept = part >= 0
    uvs = model.quad_uvs[kept]
    corners = np.arange(4 * len(uvs)).reshape(-1, 4)
    triangle_uvs = corners[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)
    triangles = model.quads[kept][:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)
    of_triangle = np.repeat(part[kept], 2)
    sides = whole_mm[triangles]
    normal = np.cross(sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0])
    area = 0.5 * np.linalg.norm(normal, axis=1)
    areas = np.array([area[of_triangle == number].sum() for number in range(len(names))])
    flat = packed(uvs.reshape(-1, 2), triangle_uvs, of_triangle, areas, where, names)
    a, b, c = flat[triangle_uvs[of_triangle == 0]].transpose(1, 0, 2)
    turned = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    if turned.sum() < 0:
        # Rows counted from above: turned over, texts in the texture would be mirrored.
        above = model.quad_uvs[kept] * [1, -1] + [0, 1]
        flat = packed(above.reshape(-1, 2), triangle_uvs, of_triangle, areas, where, names)
    return flat.reshape(-1, 4, 2)


def _moving(modes: np.ndarray, names: tuple[str, ...]) -> tuple[np.ndarray, tuple[str, ...]]:
    """Modes that move a vertex, and their names."""
    if not len(modes):
        return modes, ()
    moves = np.abs(modes).max(axis=(1, 2)) > STILL_MM
    return modes[moves], tuple(n for n, m in zip(names, moves, strict=True) if m)
