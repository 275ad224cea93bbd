"""What registration left: distance and angle between the mesh and the scan, and their picture."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np

from lightstage.formats.files import atomic_path
from lightstage.formats.mesh import Mesh, vertex_normals
from lightstage.formats.png import write_png
from processing.registration.target import Target
from processing.report import Picture, Section
from processing.sides import coloured_sides

SIDE_PX = 360
LARGEST_MM = 1.0
LARGEST_DEG = 30.0
"""Drawn brightest."""


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


def residual_section(out: Path) -> Section | None:
    """The report's section; None where nothing was registered."""
    path = out / "work" / "registration" / "residual.png"
    image = cv2.imread(str(path)) if path.is_file() else None
    if image is None:
        return None
    said = (
        f"Registered mesh against the scan from three sides: above the distance (brightest at "
        f"{LARGEST_MM:g} mm), below the angle between both normals (brightest at {LARGEST_DEG:g} "
        f"degrees). Grey: the scan has nothing there. Dark skin with thin bright lines at lids, "
        f"lips and ears is as it should be; a bright patch is a place that did not follow."
    )
    picture = Picture(np.ascontiguousarray(image[..., ::-1]), said, "residual", lossless=True)
    return Section("Registration", [picture])
