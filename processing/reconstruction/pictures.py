"""Pictures of a reconstruction: what each view covered, and the mesh from three sides."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np

from lightstage.formats.mesh import Mesh
from lightstage.formats.png import write_png
from processing.report import Picture, Section, resize, side_by_side
from processing.sides import coloured_sides, lit_sides

SIDE_PX = 420
THUMBNAIL_PX = 240
LARGEST_MM = 0.5
"""Distance to the truth that is drawn brightest."""
ENOUGH = 3
"""Agreement of so many other views is drawn brightest."""
HULL = (1.0, 0.8, 0.3)
"""Tint of what is no measured surface among the occluders: yellow."""
UNSEEN = (150, 40, 40)
"""Colour of foreground on which no other view agrees."""


def coverage(agreeing: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """(h, w, 3) uint8: grey to white by how many views agree, red where none does.

    Args:
        agreeing: (h, w) how many other views agree on a pixel's point, 0 or less for none.
        mask: (h, w) bool foreground; the rest is black.
    """
    share = np.clip(agreeing / ENOUGH, 0, 1)
    out = np.repeat(np.round(60 + 195 * share)[..., None], 3, axis=2)
    out[agreeing <= 0] = UNSEEN
    out[~mask] = 0
    return out.astype(np.uint8)


def write_pictures(
    out: Path,
    shown: Mapping[str, np.ndarray],
    mesh: Mesh,
    occluders: Mesh | None = None,
    hull_faces: int = 0,
) -> None:
    """Write each view's `coverage` and the meshes into a processed folder, for the report.

    Args:
        out: the processed folder.
        shown: of each camera (h, w, 3) uint8, its `coverage`; none where nothing was matched.
        mesh: mm, world.
        occluders: what else casts shadows, mm, world.
        hull_faces: how many of their last triangles are a hull, which is drawn in `HULL`.
    """
    for earlier in [*_folder(out).glob("coverage-*.png"), _occluders(out)]:
        earlier.unlink(missing_ok=True)
    write_png(_folder(out) / "mesh.png", lit_sides(mesh, SIDE_PX))
    if occluders is not None:
        of_hull = np.arange(len(occluders.triangles())) >= len(occluders.triangles()) - hull_faces
        tints = np.where(of_hull[:, None], HULL, 1.0)
        write_png(_occluders(out), lit_sides(occluders, SIDE_PX, tints))
    for name, image in shown.items():
        write_png(_folder(out) / f"coverage-{name}.png", image)
    _distance(out).unlink(missing_ok=True)  # that of an earlier mesh


def write_distance(out: Path, mesh: Mesh, distance_mm: np.ndarray) -> None:
    """Write how far a processed folder's base mesh is from the truth, for the report.

    Args:
        out: the processed folder.
        mesh: its base mesh.
        distance_mm: (v,) of its vertices.
    """
    write_png(_distance(out), coloured_sides(mesh, distance_mm, LARGEST_MM, SIDE_PX))


def mesh_section(out: Path) -> Section | None:
    """The report's section on the mesh; None where it was not reconstructed."""
    mesh = _read(_folder(out) / "mesh.png")
    if mesh is None:
        return None
    caption = (
        "The mesh from three sides. Skin should be smooth without ripples, holes only where no "
        "camera faces it; blue is its inside."
    )
    parts: list[str | Picture] = [Picture(mesh, caption, "mesh", lossless=True)]
    occluders = _read(_occluders(out))
    if occluders is not None:
        caption = (
            "What else casts shadows and hides skin, from three sides. No skin should be in it. "
            "Yellow: a coarse hull of what shows in two photographs and was not matched; it is "
            "used for shadows alone."
        )
        parts.append(Picture(occluders, caption, "occluders", lossless=True))
    distance = _read(_distance(out))
    if distance is not None:
        caption = (
            "Its distance to the truth, as `evaluate` found it: dark blue 0, yellow "
            f"{LARGEST_MM:g} mm or more. Skin should be dark."
        )
        parts.append(Picture(distance, caption, "distance to the truth", lossless=True))
    paths = sorted(_folder(out).glob("coverage-*.png"))
    views = [view for view in map(_read, paths) if view is not None]
    if views:
        row = side_by_side([resize(view, THUMBNAIL_PX) for view in views], THUMBNAIL_PX)
        names = ", ".join(path.stem.removeprefix("coverage-") for path in paths)
        caption = (
            f"Where views agree: white where {ENOUGH} others or more confirm a pixel's depth, "
            "red where none does (edges, hair, and what one camera alone sees). From left to "
            f"right: {names}."
        )
        parts.append(Picture(row, caption, "coverage"))
    return Section("Mesh", parts)


def _folder(out: Path) -> Path:
    return out / "work" / "geometry"


def _occluders(out: Path) -> Path:
    return _folder(out) / "occluders.png"


def _distance(out: Path) -> Path:
    return _folder(out) / "distance.png"


def _read(path: Path) -> np.ndarray | None:
    image = cv2.imread(str(path)) if path.is_file() else None
    return None if image is None else np.ascontiguousarray(image[..., ::-1])
