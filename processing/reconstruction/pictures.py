"""Pictures of a reconstruction: what each view covered, and the mesh from three sides."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import open3d

from lightstage.formats.files import atomic_path
from lightstage.formats.mesh import Mesh, vertex_normals
from processing.report import Picture, Section, resize, side_by_side

SIDES_DEG = (-50.0, 0.0, 50.0)
SIDE_PX = 420
THUMBNAIL_PX = 240
ENOUGH = 3
"""Agreement of so many other views is drawn brightest."""
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


def three_sides(mesh: Mesh) -> np.ndarray:
    """(h, w, 3) uint8 the mesh lit from above, from three sides, on white; its back is blue."""
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        open3d.core.Tensor(mesh.vertices.astype(np.float32)),
        open3d.core.Tensor(mesh.faces.astype(np.uint32)),
    )
    normals = vertex_normals(mesh.vertices, mesh.faces)
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    middle, reach = 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low))
    shown = []
    for side in np.radians(SIDES_DEG):
        toward = np.array([np.sin(side), 0.0, np.cos(side)])
        across = np.array([np.cos(side), 0.0, -np.sin(side)])
        rays = open3d.t.geometry.RaycastingScene.create_rays_pinhole(
            fov_deg=2 * float(np.degrees(np.arctan(1 / 8))),
            center=open3d.core.Tensor(middle.astype(np.float32)),
            eye=open3d.core.Tensor((middle + 8 * reach * toward).astype(np.float32)),
            up=open3d.core.Tensor(np.array([0, -1, 0], np.float32)),  # its rows run upward
            width_px=SIDE_PX,
            height_px=SIDE_PX,
        )
        hit = scene.cast_rays(rays)
        seen = np.isfinite(hit["t_hit"].numpy())
        u, v = np.moveaxis(hit["primitive_uvs"].numpy(), -1, 0)
        corners = mesh.faces[np.where(seen, hit["primitive_ids"].numpy(), 0)]
        weights = np.stack([1 - u - v, u, v], axis=-1)
        normal = np.einsum("hwk,hwkc->hwc", weights, normals[corners])
        normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
        lamp = toward + 0.5 * across + np.array([0.0, 0.6, 0.0])
        shade = np.clip(normal @ (lamp / np.linalg.norm(lamp)), 0, 1)
        grey = np.repeat(np.round(30 + 215 * shade)[..., None], 3, axis=2)
        grey[normal @ toward < 0] = (60, 80, 160)
        grey[~seen] = 255
        shown.append(grey.astype(np.uint8))
    return np.concatenate(shown, axis=1)


def write_pictures(
    out: Path,
    names: Sequence[str],
    shown: Sequence[np.ndarray],
    mesh: Mesh,
) -> None:
    """Write each view's `coverage` and the mesh into a processed folder, where the report looks.

    Args:
        out: the processed folder.
        names: of the views' cameras.
        shown: of each view (h, w, 3) uint8, its `coverage`.
        mesh: mm, world.
    """
    _write(_folder(out) / "mesh.png", three_sides(mesh))
    for name, image in zip(names, shown, strict=True):
        _write(_folder(out) / f"coverage-{name}.png", image)


def mesh_section(out: Path) -> Section | None:
    """The report's section on the mesh; None where it was not reconstructed."""
    mesh = _read(_folder(out) / "mesh.png")
    if mesh is None:
        return None
    said = (
        "The mesh from three sides. Skin should be smooth without ripples, holes only where no two "
        "cameras looked; blue is its inside."
    )
    parts: list[str | Picture] = [Picture(mesh, said, "mesh", lossless=True)]
    paths = sorted(_folder(out).glob("coverage-*.png"))
    views = [view for view in map(_read, paths) if view is not None]
    if views:
        row = side_by_side([resize(view, THUMBNAIL_PX) for view in views], THUMBNAIL_PX)
        names = ", ".join(path.stem.removeprefix("coverage-") for path in paths)
        said = (
            f"Where views agree: white where {ENOUGH} others or more confirm a pixel's depth, "
            "red where none does (edges, hair, and what one camera alone sees). From left to "
            f"right: {names}."
        )
        parts.append(Picture(row, said, "coverage"))
    return Section("Mesh", parts)


def _folder(out: Path) -> Path:
    return out / "work" / "geometry"


def _write(path: Path, image: np.ndarray) -> None:
    with atomic_path(path) as beside:
        cv2.imwrite(str(beside), image[..., ::-1])


def _read(path: Path) -> np.ndarray | None:
    image = cv2.imread(str(path)) if path.is_file() else None
    return None if image is None else np.ascontiguousarray(image[..., ::-1])
