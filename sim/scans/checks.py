"""Is a scan's mesh fit for the stage? Counted, mended where that is harmless, refused where not."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from lightstage.counting import counted
from lightstage.formats.mesh import Mesh, connected, directed_edges, edge_counts
from sim.errors import SimError

UNITS_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
HEAD_MM = (150.0, 700.0)
"""Longest side of a box around a face, a head, or a head with shoulders."""
EYES_MM = (70.0, 120.0)
"""Between the outer corners of the eyes: adults 80 to 102 [Farkas1994], children less."""
EYE_CORNERS = (36, 45)


@dataclasses.dataclass(frozen=True)
class CheckConfig:
    """What is refused.

    Attributes:
        largest_hole_mm: a larger hole (longest side of its box) is refused; the neck's edge is
            none.
        zero_area_share: more zero-area triangles than this are refused; fewer are dropped.
        turned_share: more edges whose two triangles disagree about the outside are refused.
    """

    largest_hole_mm: float = 30.0
    zero_area_share: float = 0.1
    turned_share: float = 0.01


@dataclasses.dataclass(frozen=True)
class MeshReport:
    """What was found.

    Attributes:
        zero_area: triangles dropped.
        holes_mm: size of each hole, largest first.
        neck_mm: size of the edge where the scan ends below, 0 when it is closed there.
        flipped: whether all triangles were turned over.
        turned: edges whose two triangles disagree about the outside.
    """

    zero_area: int
    holes_mm: tuple[float, ...]
    neck_mm: float
    flipped: bool
    turned: int


def unit_of(
    mesh: Mesh, landmarks: np.ndarray | None, assumed_mm: float, where: str | Path
) -> float:
    """Millimetres a unit, once the head has a head's size with it.

    Args:
        mesh: in the file's unit.
        landmarks: (68, 3) in the file's unit, NaN where unknown, or None.
        assumed_mm: the unit by the user or the format.
        where: named in the message.

    Returns:
        `assumed_mm`.

    Raises:
        SimError: with it the head is no head; the unit that would fit is named.
    """
    size, range_mm, what = float(np.ptp(mesh.vertices, axis=0).max()), HEAD_MM, "scan's box"
    if landmarks is not None:
        apart = float(np.linalg.norm(landmarks[EYE_CORNERS[0]] - landmarks[EYE_CORNERS[1]]))
        if np.isfinite(apart):
            size, range_mm, what = apart, EYES_MM, "eyes' outer corners"
    if range_mm[0] <= size * assumed_mm <= range_mm[1]:
        return assumed_mm
    fits = [n for n, mm in UNITS_MM.items() if range_mm[0] <= size * mm <= range_mm[1]]
    hint = (
        f"The file's unit seems to be {fits[0]}: give --units {fits[0]}."
        if fits
        else "Cut off all but the head, or give --units with the millimetres of one unit, about "
        f"{(range_mm[0] * range_mm[1]) ** 0.5 / max(size, 1e-30):.2g}."
    )
    raise SimError(
        where,
        field="size",
        found=f"{size * assumed_mm:.4g} mm ({what}; one unit taken as {assumed_mm:g} mm)",
        expected=f"{range_mm[0]:g} to {range_mm[1]:g} mm",
        hint=hint,
    )


def check_scan(
    mesh: Mesh,
    where: str | Path,
    config: CheckConfig = CheckConfig(),
    flip: bool = False,
    up: tuple[float, float, float] = (0.0, 1.0, 0.0),
) -> tuple[Mesh, MeshReport]:
    """Check a scan's mesh and mend what is harmless.

    Args:
        mesh: triangles in mm, vertices merged.
        where: named in messages.
        config: what is refused.
        flip: turn all triangles over first.
        up: unit direction of the crown, to distinguish the neck's edge from a hole.

    Returns:
        The mesh without zero-area triangles, and what was found.

    Raises:
        SimError: NaN, no UV, UV outside 0..1 or of no area, too many zero-area triangles, faces
            that look inward or disagree, a hole larger than allowed.
    """
    if not np.isfinite(mesh.vertices).all():
        raise SimError(where, field="vertices", found="NaN or infinity", expected="finite mm")
    mesh, zero = _without_slivers(mesh, where, config)
    mesh = _with_uv(mesh, where)
    if flip:
        assert mesh.face_uvs is not None
        mesh = dataclasses.replace(
            mesh, faces=mesh.faces[:, ::-1].copy(), face_uvs=mesh.face_uvs[:, ::-1].copy()
        )
    turned, edges = turned_edges(mesh.faces)
    if turned > config.turned_share * edges:
        raise SimError(
            where,
            field="normals",
            found=f"{turned} of {edges} edges whose triangles disagree about the outside",
            expected="all triangles counter-clockwise seen from outside",
            hint="Recalculate the normals outside in a mesh editor.",
        )
    share = outward_share(mesh)
    if share < 0.5:
        raise SimError(
            where,
            field="normals",
            found=f"triangles that look inward ({100 * (1 - share):.0f} % of the surface)",
            expected="triangles that look outward",
            hint="Leave --flip-normals away." if flip else "Give --flip-normals.",
        )
    holes, neck = openings_mm(mesh, np.asarray(up, float))
    if len(holes) and holes[0] > config.largest_hole_mm:
        listed = ", ".join(f"{size:.0f}" for size in holes[:5])
        raise SimError(
            where,
            field="holes",
            found=f"{counted(len(holes), 'hole')}, the largest of {listed} mm",
            expected=f"at most {config.largest_hole_mm:g} mm",
            hint="Close them, or allow them with --largest-hole-mm; a hole shows black.",
        )
    return mesh, MeshReport(zero, holes, neck, flip, turned)


def _without_slivers(mesh: Mesh, where: str | Path, config: CheckConfig) -> tuple[Mesh, int]:
    corners = mesh.vertices[mesh.faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    # Height over the longest side, against rounding of single precision.
    good = np.linalg.norm(cross, axis=1) > 1e-7 * longest**2
    zero = int((~good).sum())
    if zero > config.zero_area_share * len(good):
        raise SimError(
            where,
            field="triangles",
            found=f"{zero} of {len(good)} without area",
            expected=f"at most {100 * config.zero_area_share:g} %",
            hint="Is the mesh flattened, or are its vertices rounded?",
        )
    if not zero:
        return mesh, 0
    face_uvs = None if mesh.face_uvs is None else mesh.face_uvs[good]
    return dataclasses.replace(mesh, faces=mesh.faces[good], face_uvs=face_uvs), zero


def _with_uv(mesh: Mesh, where: str | Path) -> Mesh:
    """The mesh with UV clipped to the tile."""
    if mesh.uvs is None or mesh.face_uvs is None:
        raise SimError(
            where,
            field="uv",
            found="none",
            expected="texture coordinates",
            hint="Unwrap the scan and bake its colour into the texture.",
        )
    if not np.isfinite(mesh.uvs).all():
        raise SimError(where, field="uv", found="NaN or infinity", expected="0 to 1")
    low, high = float(mesh.uvs.min()), float(mesh.uvs.max())
    if low < -1e-4 or high > 1 + 1e-4:
        outside = int(((mesh.uvs < -1e-4) | (mesh.uvs > 1 + 1e-4)).any(axis=1).sum())
        raise SimError(
            where,
            field="uv",
            found=f"{outside} of {len(mesh.uvs)} outside, from {low:.3g} to {high:.3g}",
            expected="one tile, 0 to 1",
            hint="Pack the tiles (UDIM) into one, or undo the repetition of the texture.",
        )
    a, b, c = mesh.uvs[mesh.face_uvs].transpose(1, 2, 0)
    area = np.abs((b - a)[0] * (c - a)[1] - (b - a)[1] * (c - a)[0]).sum() / 2
    if area < 1e-3:
        raise SimError(
            where, field="uv", found=f"an area of {area:.2g} of the tile", expected="an unwrapping"
        )
    return dataclasses.replace(mesh, uvs=np.clip(mesh.uvs, 0.0, 1.0))


def turned_edges(faces: np.ndarray) -> tuple[int, int]:
    """Inner edges that both triangles run along in the same direction, and all inner edges.

    Args:
        faces: (t, 3).
    """
    directed = directed_edges(faces)
    forward = directed[:, 0] < directed[:, 1]
    _, inverse, counts = np.unique(
        np.sort(directed, axis=1), axis=0, return_inverse=True, return_counts=True
    )
    ahead = np.bincount(inverse.ravel(), weights=forward)
    inner = counts == 2
    return int((inner & (ahead != 1)).sum()), int(inner.sum())


def outward_share(mesh: Mesh) -> float:
    """Share of the surface that looks away from the middle, weighted by how far away it is.

    For a closed surface this is above one half exactly when its signed volume is positive.
    """
    corners = mesh.vertices[mesh.faces]
    middle = corners.mean(axis=1)
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    weight = np.linalg.norm(area, axis=1)
    centre = np.average(middle, axis=0, weights=weight)
    volume = np.einsum("ij,ij->i", area, middle - centre)
    return float(np.maximum(volume, 0).sum() / max(np.abs(volume).sum(), 1e-300))


def openings_mm(mesh: Mesh, up: np.ndarray) -> tuple[tuple[float, ...], float]:
    """Sizes of the holes, largest first, and of the neck's edge (0 where there is none).

    An opening is a set of connected border edges; its size is the longest side of the box around
    it. The neck's edge is the opening whose middle is lowest, if it lies in the lowest third and
    is the largest there: a scan of a head ends somewhere.

    Args:
        mesh: triangles, vertices merged.
        up: (3,) unit direction of the crown.
    """
    edges, counts = edge_counts(mesh.faces)
    border = edges[counts == 1]
    if not len(border):
        return (), 0.0
    used, inverse = np.unique(border, return_inverse=True)
    ends = inverse.reshape(-1, 2)
    label = connected(ends, len(used))
    count = int(label.max()) + 1
    points = mesh.vertices[used]
    low, high = (mesh.vertices @ up).min(), (mesh.vertices @ up).max()
    sizes, heights = np.empty(count), np.empty(count)
    for index in range(count):
        ring = points[label == index]
        sizes[index] = np.ptp(ring, axis=0).max()
        heights[index] = ((ring @ up).mean() - low) / max(high - low, 1e-30)
    below = np.flatnonzero(heights < 1 / 3)
    neck = below[sizes[below].argmax()] if len(below) else -1
    holes = sorted((float(s) for i, s in enumerate(sizes) if i != neck), reverse=True)
    return tuple(holes), float(sizes[neck]) if neck >= 0 else 0.0
