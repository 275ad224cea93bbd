"""Somebody's mesh in the head frame: mm, +y up, +z out of the face, origin between the ears.

Axes and origin are our own template's: the mesh is fitted to it by the 68 landmarks, rigidly, so
that shapes and maps of people registered to either template compare.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from lightstage.errors import FormatError
from lightstage.formats.mesh import vertex_normals
from lightstage.formats.template import Template
from processing.registration.rigid import Similarity, umeyama
from processing.template.config import ImportConfig
from processing.units import Unit, largest_side


def head_from_mesh(
    vertices: np.ndarray,
    landmarks: np.ndarray,
    own_mm: np.ndarray,
    unit: Unit,
    where: Path,
    config: ImportConfig,
) -> Similarity:
    """The motion from a mesh's axes and unit to the head frame; its scale is the unit's mm.

    Args:
        vertices: (n, 3) in that unit.
        landmarks: (68,) indices into them.
        own_mm: (68, 3) our template's landmarks, head frame.
        unit: of the mesh.
        where: the mesh's file, for errors.
        config: settings.

    Raises:
        FormatError: landmarks that are no head's: mirrored, in another order, or of no head's size
            in that unit.
    """
    marks = unit.mm * vertices[landmarks]
    if len(np.unique(landmarks)) < len(landmarks) // 2:
        raise FormatError(
            where,
            field="landmarks",
            found=f"{len(np.unique(landmarks))} different vertices",
            expected="68 landmarks in iBUG's order",
        )
    likeness = umeyama(marks, own_mm, scale=True, reflect=True)
    if np.linalg.det(likeness.rotation) < 0:
        raise FormatError(
            where,
            field="landmarks",
            found="a mirror image of a face",
            expected="landmarks in iBUG's order on a mesh that is not mirrored",
            hint="Points 0 to 16 go from the person's right ear to the left one.",
        )
    away = np.median(np.linalg.norm(likeness.apply(marks) - own_mm, axis=1))
    if away > config.largest_misfit_mm:
        raise FormatError(
            where,
            field="landmarks",
            found=f"{away:.0f} mm median from a face's after alignment",
            expected=f"at most {config.largest_misfit_mm:g} mm",
            hint="Are they in iBUG's order, and of this mesh?",
        )
    size = 1 / likeness.scale
    if not config.smallest_size <= size <= config.largest_size:
        raise FormatError(
            where,
            field="vertices",
            found=f"a face {size:.3g} times as large as usual where {unit.name} is the unit "
            f"(largest side of the mesh {largest_side(vertices):.3g})",
            expected=f"{config.smallest_size:g} to {config.largest_size:g} times",
            hint="Name the mesh's unit by --unit mm, cm or m.",
        )
    rigid = umeyama(marks, own_mm)
    return Similarity(rigid.rotation, rigid.translation, unit.mm)


def is_inside_out(
    vertices: np.ndarray,
    triangles: np.ndarray,
    landmarks: np.ndarray,
    own: Template,
    rotation: np.ndarray,
) -> bool:
    """Whether a head's triangles run clockwise seen from outside, by our template's landmarks.

    Args:
        vertices: (n, 3).
        triangles: (t, 3).
        landmarks: (68,) vertices.
        own: our template.
        rotation: 3 x 3 from the head's axes to the head frame.
    """
    normals = vertex_normals(vertices, triangles)[landmarks]
    outward = vertex_normals(own.mesh.vertices, own.mesh.triangles())[own.landmarks]
    return bool(np.median(np.einsum("nk,nk->n", normals @ rotation.T, outward)) < -0.5)
