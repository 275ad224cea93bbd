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
from processing.registration.target import Target
from processing.report import Picture, Section, Table
from processing.sides import coloured_sides

SIDE_PX = 360
LARGEST_MM = 1.0
LARGEST_DEG = 30.0
"""Drawn brightest."""
MOST_POINTS = 50_000
"""Of a scan that are compared; more add time and no information."""


@dataclasses.dataclass(frozen=True)
class Residual:
    """A vertex each; NaN where the closest point lies on the scan's border: nothing faces it.

    Attributes:
        distance_mm: (n,) float32, positive where the scan lies outside the mesh.
        angle_deg: (n,) float32 between both normals.
    """

    distance_mm: np.ndarray
    angle_deg: np.ndarray


def residual(scan: Mesh, vertices: np.ndarray, triangles: np.ndarray) -> Residual:
    """Compare a registered mesh with the scan it lies on.

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


def scan_in_common(scan: Mesh, mesh: Mesh) -> dict[str, float | None]:
    """How far a scan lies from a registered mesh, over what both have.

    A point that lies nearest to where the mesh ends, such as one of the shoulders below a head, has
    nothing on the mesh to be compared with.

    Args:
        scan: as it was measured.
        mesh: registered, mm.

    Returns:
        ``scan_in_common_share`` of the scan's points, and ``scan_in_common_to_template_median_mm``
        and ``.._p95_mm`` of these; None where there is none.
    """
    closest = Target(mesh).closest(scan.vertices[:: max(1, len(scan.vertices) // MOST_POINTS)])
    common = closest.distance_mm[~closest.border]
    name = "scan_in_common_to_template"
    return {
        "scan_in_common_share": len(common) / len(closest.border),
        f"{name}_median_mm": float(np.median(common)) if len(common) else None,
        f"{name}_p95_mm": float(np.quantile(common, 0.95)) if len(common) else None,
    }


def write_residual(out: Path, found: Residual, mesh: Mesh) -> None:
    """Write residual.npz and its picture into a processed folder, where the report looks.

    Args:
        out: the processed folder.
        found: of the mesh's vertices.
        mesh: registered, mm.
    """
    folder = out / "work" / "registration"
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
    said = (
        f"Registered mesh against the scan from three sides: above the distance (brightest at "
        f"{LARGEST_MM:g} mm), below the angle between both normals (brightest at {LARGEST_DEG:g} "
        f"degrees). Grey: the scan has nothing there. Dark skin with thin bright lines at lids and "
        "lips is as it should be. Ears are mostly yellow: the template's ear is laid on as a "
        "whole and keeps its own folds, since no two people's are alike, and the back of an ear "
        "is seldom on the scan. Nostrils are yellow too, which no camera looks into, and so is "
        "where the neck ends or clothes begin. Bad would be a bright patch on the face itself, or "
        "an ear that stands beside the person's: there the mesh did not follow, and the atlas "
        "shows another place's skin."
    )
    picture = Picture(np.ascontiguousarray(image[..., ::-1]), said, "residual", lossless=True)
    parts: list[str | Picture | Table] = [picture]
    told = facts or {}
    rows = [
        (words, *(told[f"{name}_{part}_mm"] for part in ("median", "p95")))
        for name, words in DISTANCES
        if told.get(f"{name}_median_mm") is not None
    ]
    if rows:
        share = told["scan_in_common_share"]
        parts.append(
            Table(
                ("distance", "median, mm", "95th percentile, mm"),
                rows,
                f"{share:.0%} of the scan's points are compared. The others lie nearest to where "
                "the template ends: shoulders, clothes or the inside of an open mouth, which it "
                "does not have. Hair is compared too. Where all is well the median is below 0.1 mm "
                "and the last column below 1 mm; bad would be a median of several tenths, skin "
                "that the template misses.",
            )
        )
    return Section("Registration", parts)
