"""What registration left: distance and angle between the mesh and the scan, and their picture."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from lightstage.formats.files import atomic_path
from lightstage.formats.mesh import Mesh, vertex_normals
from lightstage.formats.png import write_png
from processing.registration.areas import AREAS
from processing.registration.target import Target
from processing.report import Picture, Section, Table
from processing.sides import coloured_sides

SIDE_PX = 360
LARGEST_MM = 1.0
LARGEST_DEG = 30.0
"""Drawn brightest."""
BESIDE_MM = 10.0
"""The scan is drawn as far beyond the mesh."""
MOST_POINTS = 50_000
"""Points of a scan that are compared; more add time and no information."""


@dataclasses.dataclass(frozen=True)
class Residual:
    """A vertex each; NaN where the closest point is on the scan's border: nothing faces it.

    Attributes:
        distance_mm: (n,) float32, positive where the scan is outside the mesh.
        angle_deg: (n,) float32 between both normals.
    """

    distance_mm: np.ndarray
    angle_deg: np.ndarray


def residual(scan: Mesh, vertices: np.ndarray, triangles: np.ndarray) -> Residual:
    """Compare a registered mesh with the scan it is on.

    Args:
        scan: as it was measured.
        vertices: (n, 3) mm.
        triangles: (t, 3).
    """
    closest = Target(scan).closest(vertices)
    normals = vertex_normals(vertices, triangles)
    way = closest.point - vertices
    side = np.where(np.einsum("nk,nk->n", way, normals) < 0, -1.0, 1.0)
    facing = np.clip(np.einsum("nk,nk->n", normals, closest.normal), -1, 1)
    distance = np.where(closest.border, np.nan, side * closest.distance_mm)
    angle = np.where(closest.border, np.nan, np.rad2deg(np.arccos(facing)))
    return Residual(distance.astype(np.float32), angle.astype(np.float32))


def scan_in_common(scan: Mesh, mesh: Mesh, areas: np.ndarray | None = None) -> dict[str, Any]:
    """How far a scan is from a registered mesh, over what both have.

    A point that is nearest to where the mesh ends, such as one of the shoulders below a head, has
    nothing on the mesh to be compared with.

    Args:
        scan: as it was measured.
        mesh: registered, mm.
        areas: (n,) index into `AREAS` of the mesh's vertices.

    Returns:
        ``scan_in_common_share`` of the scan's points, and ``scan_in_common_to_template_median_mm``
        and ``.._p95_mm`` of these; None where there is none. With areas also
        ``scan_in_common_by_area``: of each area that has a point its ``median_mm``, ``p95_mm`` and
        ``share`` of the points.
    """
    target = Target(mesh)
    points = scan.vertices[:: max(1, len(scan.vertices) // MOST_POINTS)]
    closest = target.closest(points)
    common = closest.distance_mm[~closest.border]
    name = "scan_in_common_to_template"
    by_area = {}
    if areas is not None:
        face, weight = target.on(points[~closest.border])
        nearest = target.triangles[face, weight.argmax(axis=1)]
        for index, area in enumerate(AREAS):
            some = common[areas[nearest] == index]
            if len(some):
                by_area[area] = {
                    "median_mm": float(np.median(some)),
                    "p95_mm": float(np.quantile(some, 0.95)),
                    "share": len(some) / len(common),
                }
    return {
        **({} if areas is None else {"scan_in_common_by_area": by_area}),
        "scan_in_common_share": len(common) / len(closest.border),
        f"{name}_median_mm": float(np.median(common)) if len(common) else None,
        f"{name}_p95_mm": float(np.quantile(common, 0.95)) if len(common) else None,
    }


def write_residual(out: Path, found: Residual, mesh: Mesh, scan: Mesh | None = None) -> None:
    """Write residual.npz and its pictures into a processed folder, for the report.

    Args:
        out: the processed folder.
        found: of the mesh's vertices.
        mesh: registered, mm.
        scan: drawn too, by its distance to the mesh.
    """
    folder = out / "work" / "registration"
    if scan is not None:
        write_png(folder / "scan_residual.png", drawn_scan(scan, mesh))
    with atomic_path(folder / "residual.npz") as beside, beside.open("wb") as file:
        np.savez_compressed(file, distance_mm=found.distance_mm, angle_deg=found.angle_deg)
    write_png(folder / "residual.png", drawn(found, mesh))


def drawn(found: Residual, mesh: Mesh) -> np.ndarray:
    """(h, w, 3) uint8: distance above, angle below, from three sides."""
    rows = [
        coloured_sides(mesh, np.abs(found.distance_mm), LARGEST_MM, SIDE_PX),
        coloured_sides(mesh, found.angle_deg, LARGEST_DEG, SIDE_PX),
    ]
    return np.concatenate(rows, axis=0)


def drawn_scan(scan: Mesh, mesh: Mesh) -> np.ndarray:
    """(h, w, 3) uint8: the scan's distance to the mesh, drawn on the scan, from three sides."""
    corners = scan.vertices[scan.triangles()]
    low, high = mesh.vertices.min(axis=0) - BESIDE_MM, mesh.vertices.max(axis=0) + BESIDE_MM
    inside = ((corners > low) & (corners < high)).all(axis=(1, 2))
    used, faces = np.unique(scan.triangles()[inside], return_inverse=True)
    if not len(used):
        return np.full((SIDE_PX, 3 * SIDE_PX, 3), 255, np.uint8)
    cut = Mesh(scan.vertices[used], faces.reshape(-1, 3).astype(np.int32))
    closest = Target(mesh).closest(cut.vertices)
    values = np.where(closest.border, np.nan, closest.distance_mm)
    return coloured_sides(cut, values, LARGEST_MM, SIDE_PX)


DISTANCES = (
    ("template_to_scan", "template to scan, where a vertex has a match"),
    ("scan_in_common_to_template", "scan to template, over what both have"),
)


def residual_section(out: Path, facts: Mapping[str, Any] | None = None) -> Section | None:
    """The report's section; None where nothing was registered.

    Args:
        out: processed folder.
        facts: of `register_mesh`.
    """
    path = out / "work" / "registration" / "residual.png"
    image = cv2.imread(str(path)) if path.is_file() else None
    if image is None:
        return None
    caption = (
        f"Registered mesh against the scan from three sides: above the distance (brightest at "
        f"{LARGEST_MM:g} mm), below the angle between both normals (brightest at {LARGEST_DEG:g} "
        f"degrees). Grey: the scan has nothing there. Dark skin with thin bright lines at lids and "
        "lips is as it should be. Ears are mostly yellow: the template's ear is placed as a "
        "whole and keeps its own folds, since no two people's are alike, and the back of an ear "
        "is seldom on the scan. Nostrils are yellow too, which no camera sees into, and so is "
        "where the neck ends or clothes begin. Bad would be a bright patch on the face itself, or "
        "an ear that is beside the person's: there the mesh did not follow, and the atlas "
        "shows another place's skin."
    )
    picture = Picture(np.ascontiguousarray(image[..., ::-1]), caption, "residual", lossless=True)
    parts: list[str | Picture | Table] = [picture]
    path = out / "work" / "registration" / "scan_residual.png"
    image = cv2.imread(str(path)) if path.is_file() else None
    if image is not None:
        caption = (
            f"The scan, by its distance to the registered mesh (brightest at {LARGEST_MM:g} mm): "
            "what the mesh does not reach, such as a flattened ear, is seen here alone. Grey: the "
            "mesh ends there. Ear canals and nostrils are bright, since the template has none."
        )
        picture = Picture(np.ascontiguousarray(image[..., ::-1]), caption, "scan", lossless=True)
        parts.append(picture)
    known = facts or {}
    rows = [
        (words, *(known[f"{name}_{part}_mm"] for part in ("median", "p95")))
        for name, words in DISTANCES
        if known.get(f"{name}_median_mm") is not None
    ]
    if rows:
        share = known["scan_in_common_share"]
        parts.append(
            Table(
                ("distance", "median, mm", "95th percentile, mm"),
                rows,
                f"{share:.0%} of the scan's points are compared. The others are nearest to where "
                "the template ends: shoulders, clothes or the inside of an open mouth, which it "
                "does not have. Hair is compared too. Where all is well the median is below 0.1 mm "
                "and the last column below 1 mm; bad would be a median of several tenths, skin "
                "that the template misses.",
            )
        )
    by_area = known.get("scan_in_common_by_area") or {}
    if by_area:
        parts.append(
            Table(
                ("scan to template", "median, mm", "95th percentile, mm"),
                [(name, here["median_mm"], here["p95_mm"]) for name, here in by_area.items()],
                "By the area of the template that is nearest. Bad would be ears above 1 mm in the "
                "median or cheeks above .2.",
            )
        )
    return Section("Registration", parts)
