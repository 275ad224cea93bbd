"""Anybody's mesh with UV and 68 landmarks as a template."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from lightstage.commands import ProgressCallback, quiet
from lightstage.errors import FormatError
from lightstage.formats.fields import Fields
from lightstage.formats.files import read_json
from lightstage.formats.landmarks import COUNTS, SCHEME, read_points_mm
from lightstage.formats.mesh import Mesh, read_mesh
from lightstage.formats.template import Template
from processing.registration.start import named
from processing.template.build import with_maps
from processing.template.config import ImportConfig
from processing.template.frame import head_from_mesh, is_inside_out
from processing.template.own import own_template
from processing.template.regions import guessed_regions, read_regions
from processing.units import Unit, likely_unit


def import_obj(
    path: Path,
    landmarks: Path,
    config: ImportConfig | None = None,
    unit: Unit | None = None,
    regions: Path | None = None,
    licence: str = "",
    progress: ProgressCallback = quiet,
) -> tuple[Template, dict[str, Any]]:
    """Make a template of a mesh; topology, order of vertices and UV stay.

    Args:
        path: the mesh.
        landmarks: JSON, see `read_landmarks`.
        config: settings.
        unit: of the mesh; None finds it by its size.
        regions: JSON, see `read_regions`; without it our own template gives them.
        licence: of the mesh.
        progress: called with (done, total).

    Returns:
        The template, and facts.

    Raises:
        FormatError: a mesh without UV or with UV outside of one tile, landmarks that are not 68 on
            the mesh, of no face, or of no face's size in the unit; a mesh that is inside out.
        RegistrationError: our template cannot be fitted to it, where regions are not given.
    """
    settings = config or ImportConfig()
    mesh = read_mesh(path)
    require_uv(mesh, path)
    unit = unit or likely_unit(mesh.vertices[np.unique(mesh.triangles())])
    marks, gap_mm = read_landmarks(landmarks, mesh, unit, settings)
    own = own_template()
    motion = head_from_mesh(
        mesh.vertices, marks, own.mesh.vertices[own.landmarks], unit, path, settings
    )
    mesh = mesh.with_vertices(motion.apply(mesh.vertices))
    if is_inside_out(mesh.vertices, mesh.triangles(), marks, own, np.eye(3)):
        raise FormatError(
            path,
            field="faces",
            found="faces that run clockwise seen from outside: the head is inside out",
            expected="counter-clockwise",
            hint="Turn all faces over in a mesh editor (flip normals), and export it again.",
        )
    if regions is None:
        with named(path, landmarks):
            found = guessed_regions(mesh, marks, own, settings, progress=progress)
    else:
        found = read_regions(regions, len(mesh.vertices))
    template = with_maps(path.stem, mesh, marks, found, None, licence, path.name, settings)
    facts = {
        "unit": unit.name,
        "vertices": len(mesh.vertices),
        "faces": len(mesh.faces),
        "landmark_gap_mm": gap_mm,
        "regions": "guessed by our own template" if regions is None else regions.name,
    }
    return template, facts


def require_uv(mesh: Mesh, path: Path) -> None:
    """FormatError where a mesh has no UV, or UV outside of one 0..1 tile."""
    if mesh.uvs is None or mesh.face_uvs is None:
        raise FormatError(
            path,
            field="uv",
            found="no texture coordinates",
            expected="an OBJ mesh with UV in one 0..1 tile",
            hint="Unwrap the mesh and export it as OBJ with UV; PLY files are read without it.",
        )
    used = mesh.uvs[np.unique(mesh.face_uvs[mesh.face_uvs >= 0])]
    low, high = used.min(axis=0), used.max(axis=0)
    if low.min() < -1e-6 or high.max() > 1 + 1e-6:
        raise FormatError(
            path,
            field="uv",
            found=f"u from {low[0]:.3g} to {high[0]:.3g}, v from {low[1]:.3g} to {high[1]:.3g}",
            expected="one tile, 0..1",
            hint="Pack all tiles (UDIM) into one before the export.",
        )


def read_landmarks(
    path: Path, mesh: Mesh, unit: Unit, config: ImportConfig
) -> tuple[np.ndarray, float]:
    """68 vertices of a mesh, from a file that has them or points beside them.

    Args:
        path: JSON with `points_mm` as for `register-mesh`, in the mesh's own coordinates, or with
            `vertices`: 68 indices, from 0.
        mesh: in its own unit.
        unit: of the mesh.
        config: settings.

    Returns:
        (68,) int64 vertices that a face uses, and the largest distance of a point to its vertex.

    Raises:
        FormatError: not 68, null, beyond the mesh, or farther from its vertices than
            `landmark_gap_mm`.
    """
    used = np.unique(mesh.triangles())
    value = Fields(read_json(path), path, "").rest()
    if "vertices" in value:
        if value.get("scheme") != SCHEME:
            raise FormatError(
                path, field="scheme", found=repr(value.get("scheme")), expected=repr(SCHEME)
            )
        given, count = value["vertices"], len(mesh.vertices)
        if not isinstance(given, list) or len(given) != COUNTS[SCHEME]:
            raise FormatError(
                path,
                field="vertices",
                found=f"{len(given)}" if isinstance(given, list) else type(given).__name__,
                expected=f"{COUNTS[SCHEME]} indices of vertices",
            )
        for index, vertex in enumerate(given):
            if type(vertex) is not int or not 0 <= vertex < count:
                raise FormatError(
                    path,
                    field=f"vertices[{index}]",
                    found=ascii(vertex)[:80],
                    expected=f"a vertex of the mesh, 0 to {count - 1}",
                    hint="Vertices are numbered from 0; an OBJ's own faces count from 1.",
                )
        marks = np.array(given, np.int64)
        loose = np.flatnonzero(~np.isin(marks, used))
        if len(loose):
            raise FormatError(
                path,
                field=f"vertices[{loose[0]}]",
                found=f"vertex {marks[loose[0]]}, which no face uses",
                expected="vertices of the surface",
            )
        return marks, 0.0
    points = read_points_mm(path)
    missing = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if len(missing):
        raise FormatError(
            path,
            field=f"points_mm[{missing[0]}]",
            found="null",
            expected=f"all {COUNTS[SCHEME]} points: a template needs each",
        )
    away, place = cKDTree(mesh.vertices[used]).query(points)
    away_mm = unit.mm * np.asarray(away)
    worst = int(np.argmax(away_mm))
    if away_mm[worst] > config.landmark_gap_mm:
        raise FormatError(
            path,
            field=f"points_mm[{worst}]",
            found=f"a point {away_mm[worst]:.3g} mm from the mesh's nearest vertex",
            expected=f"at most {config.landmark_gap_mm:g} mm",
            hint=f"Are points and mesh in the same coordinates? {unit.name} was taken for the "
            "mesh's unit; --unit names another.",
        )
    return used[np.asarray(place)].astype(np.int64), float(away_mm[worst])
