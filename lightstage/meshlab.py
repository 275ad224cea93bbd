"""MeshLab's filters [Cignoni2008], by pymeshlab: scans cleaned, heads decimated, crossings counted.

pymeshlab is under the GPL, so it is an extra that every command can do without, and this is the one
file that imports it.
"""

from __future__ import annotations

import importlib.util
from collections import Counter
from typing import Any, NamedTuple

import numpy as np

from lightstage.counting import counted
from lightstage.formats.mesh import Mesh, connected, directed_edges

ISLAND_MM = 10.0
"""A separate part whose bounding box has a shorter diagonal is a crumb; an eyeball has 40 mm."""
ISLANDS = "triangles_of_islands"
FILTERS = (
    "meshing_remove_duplicate_vertices",
    "meshing_remove_duplicate_faces",
    "meshing_remove_null_faces",
    "meshing_repair_non_manifold_edges",
    "meshing_remove_connected_component_by_diameter",
    "meshing_remove_unreferenced_vertices",
    "meshing_re_orient_faces_coherently",
    "meshing_decimation_quadric_edge_collapse_with_texture",
    "compute_texcoord_transfer_vertex_to_wedge",
    "compute_selection_by_self_intersections_per_face",
)
"""All that are used."""
EXTRA = "pip install 'lightstage[meshlab]'"


class Cleaned(NamedTuple):
    """A scan without what no surface has.

    Attributes:
        mesh: triangles, mm, without UV; of a clean scan the same bits.
        removed: how many vertices and triangles went, and how many triangles were turned over, by
            name, without zeros; None where pymeshlab cannot be used, and the mesh is as it was.
        note: the same for the user; empty where the scan was clean.
    """

    mesh: Mesh
    removed: dict[str, int] | None
    note: str


def reason_without() -> str | None:
    """Why pymeshlab cannot be used, and what to do, in words; None where it can."""
    if importlib.util.find_spec("pymeshlab") is None:
        return f"pymeshlab is not installed ({EXTRA})"
    import pymeshlab

    lost = set(FILTERS) - set(pymeshlab.filter_list())
    if lost:
        return (
            f"pymeshlab lacks {counted(len(lost), 'filter')}: a system library is missing, such as "
            "libopengl0"
        )
    return None


def cleaned(mesh: Mesh, name: str) -> Cleaned:
    """Remove what scanners leave and a surface does not have; vertices that stay are not moved.

    In this order: vertices at the same place become one; triangles that are there twice or have no
    area go; of an edge with more than two triangles the smallest go; parts smaller than `ISLAND_MM`
    go, unless they are half of the mesh; so do vertices of no triangle; triangles that face against
    the most of their part are turned over.

    Args:
        mesh: finite, mm.
        name: of the file, for the note.
    """
    vertices, triangles = mesh.vertices, mesh.triangles()
    reason = reason_without()
    if reason is not None:
        return Cleaned(Mesh(vertices, triangles), None, f"{name} was not cleaned: {reason}")
    import pymeshlab

    crumbs = {"mincomponentdiag": pymeshlab.PureValue(ISLAND_MM), "removeunref": False}
    # What vertices and what triangles are that a filter removes.
    steps: list[tuple[str, str, str, dict[str, Any]]] = [
        ("duplicate_vertices", "triangles_without_area", FILTERS[0], {}),
        ("", "duplicate_triangles", FILTERS[1], {}),
        ("", "triangles_without_area", FILTERS[2], {}),
        ("", "triangles_of_non_manifold_edges", FILTERS[3], {}),
        ("", ISLANDS, FILTERS[4], crumbs),
        ("unused_vertices", "", FILTERS[5], {}),
    ]
    removed: Counter[str] = Counter()
    work = _loaded(vertices, triangles)
    for some, others, which, options in steps:
        before = work.current_mesh()
        kept = before.vertex_matrix(), before.face_matrix()
        work.apply_filter(which, **options)
        after = work.current_mesh()
        gone = len(kept[1]) - after.face_number()
        if others == ISLANDS and 2 * gone > len(kept[1]):
            work = _loaded(*kept)
            continue
        removed[some] += len(kept[0]) - after.vertex_number()
        removed[others] += gone
    found = work.current_mesh()
    if not found.face_number():  # no triangle has an area: the caller refuses it in its own words
        return Cleaned(Mesh(vertices, triangles), {}, "")
    vertices, triangles = found.vertex_matrix(), found.face_matrix()
    over = _turned_over(work, triangles)
    removed["triangles_turned_over"] = int(over.sum())
    triangles = np.where(over[:, None], triangles[:, ::-1], triangles)
    counts = {each: count for each, count in removed.items() if each and count}
    what = ", ".join(f"{each.replace('_', ' ')} {count}" for each, count in counts.items())
    return Cleaned(
        Mesh(vertices, np.ascontiguousarray(triangles, np.int32)),
        counts,
        f"{name} was cleaned: {what}" if what else "",
    )


def decimated(mesh: Mesh, triangles: int) -> Mesh:
    """A mesh of fewer triangles in the same texture, by quadrics of place and UV [Garland1998].

    Args:
        mesh: finite, with UV in one tile; seams stay closed.
        triangles: that are wanted; MeshLab may stop a few above.

    Returns:
        Triangles with UV in 0..1.
    """
    corners = np.stack([mesh.triangles().ravel(), mesh.triangle_uvs().ravel()], axis=1)
    assert mesh.uvs is not None  # triangle_uvs refuses a mesh without
    pairs, corner = np.unique(corners, axis=0, return_inverse=True)
    import pymeshlab

    work = pymeshlab.MeshSet(verbose=False)
    # MeshLab marks UV of corners as a texture's only where it moves them there from vertices. So
    # seams are cut first, and closed again.
    work.add_mesh(
        pymeshlab.Mesh(
            mesh.vertices[pairs[:, 0]],
            corner.reshape(-1, 3).astype(np.int32),
            v_tex_coords_matrix=mesh.uvs[pairs[:, 1]],
        )
    )
    work.compute_texcoord_transfer_vertex_to_wedge()
    work.meshing_remove_duplicate_vertices()
    work.meshing_decimation_quadric_edge_collapse_with_texture(
        targetfacenum=triangles, preserveboundary=True, preservenormal=True
    )
    found = work.current_mesh()
    uvs, face_uvs = np.unique(
        np.clip(found.wedge_tex_coord_matrix(), 0, 1), axis=0, return_inverse=True
    )
    return Mesh(
        found.vertex_matrix(), found.face_matrix(), uvs, face_uvs.reshape(-1, 3).astype(np.int32)
    )


def self_intersecting(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(t,) bool: triangles that cut through another one of the mesh.

    Args:
        vertices: (n, 3) finite.
        triangles: (t, 3).
    """
    work = _loaded(vertices, triangles)
    work.compute_selection_by_self_intersections_per_face()
    return np.asarray(work.current_mesh().face_selection_array(), bool)


def _loaded(vertices: np.ndarray, triangles: np.ndarray) -> Any:
    """A set of pymeshlab that holds one mesh."""
    import pymeshlab

    work = pymeshlab.MeshSet(verbose=False)
    work.add_mesh(pymeshlab.Mesh(np.asarray(vertices, float), np.asarray(triangles, np.int32)))
    return work


def _turned_over(work: Any, triangles: np.ndarray) -> np.ndarray:
    """(t,) bool: triangles that face against the most of their part; none of a Moebius strip."""
    import pymeshlab

    try:
        work.meshing_re_orient_faces_coherently()
    except pymeshlab.PyMeshLabException:
        return np.zeros(len(triangles), bool)
    after = work.current_mesh().face_matrix()
    over = ~np.any(
        [(np.roll(after, turn, axis=1) == triangles).all(axis=1) for turn in range(3)], axis=0
    )
    # MeshLab takes the direction of a part's first triangle, which may be the wrong one.
    edges = np.sort(directed_edges(triangles), axis=1)
    keys = edges[:, 0] * (int(edges.max(initial=0)) + 1) + edges[:, 1]
    order = np.argsort(keys, kind="stable")
    shared = np.flatnonzero(keys[order][1:] == keys[order][:-1])
    part = connected(np.stack([order[shared], order[shared + 1]], axis=1) // 3, len(triangles))
    mostly = np.bincount(part, weights=over) > 0.5 * np.bincount(part)
    return np.asarray(over ^ mostly[part])
