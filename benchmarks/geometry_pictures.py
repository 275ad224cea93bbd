"""A mesh from three sides, shaded and in the colours of its distance to the truth.

`python -m benchmarks.geometry_pictures A.png B.png --out C.jpg` puts pictures of several meshes, as
`geometry_accuracy --pictures` writes them, beside each other.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np
import open3d

from benchmarks.geometry_scores import Surface
from lightstage.formats.mesh import Mesh, vertex_normals

SIDES_DEG = (-50.0, 0.0, 50.0)
ROWS, COLUMNS = 620, 480
GAP_PX = 40
FAR_MM = 1100.0
MARGIN = 1.03
FULL_MM = 0.5
"""Distance at which the scale of colours ends."""


def write_pictures(mesh: Mesh, truth: Mesh, path: Path) -> None:
    """Write PATH.png: shaded above, distance below (blue 0, red FULL_MM and more, grey unseen)."""
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        open3d.core.Tensor(mesh.vertices.astype(np.float32)),
        open3d.core.Tensor(mesh.faces.astype(np.uint32)),
    )
    normals = vertex_normals(mesh.vertices, mesh.faces)
    off = Surface(truth).nearest(mesh.vertices)[0]
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    middle = 0.5 * (low + high)
    # Whatever side it is seen from, all of it is in the picture.
    around = np.linalg.norm((mesh.vertices - middle)[:, [0, 2]], axis=1).max()
    reach = MARGIN * max(around, 0.5 * (high[1] - low[1]) * COLUMNS / ROWS)
    field_deg = 2 * np.degrees(np.arctan2(reach, FAR_MM - around))
    shown = []
    for side in SIDES_DEG:
        turn = np.radians(side)
        toward = np.array([np.sin(turn), 0.0, np.cos(turn)])
        rays = open3d.t.geometry.RaycastingScene.create_rays_pinhole(
            fov_deg=float(field_deg),
            center=open3d.core.Tensor(middle.astype(np.float32)),
            eye=open3d.core.Tensor((middle + FAR_MM * toward).astype(np.float32)),
            up=open3d.core.Tensor(np.array([0, -1, 0], np.float32)),  # its rows run upward
            width_px=COLUMNS,
            height_px=ROWS,
        )
        hit = scene.cast_rays(rays)
        face = hit["primitive_ids"].numpy()
        seen = np.isfinite(hit["t_hit"].numpy())
        u, v = np.moveaxis(hit["primitive_uvs"].numpy(), -1, 0)
        weights = np.stack([1 - u - v, u, v], axis=-1)
        corners = mesh.faces[np.where(seen, face, 0)]
        normal = np.einsum("hwk,hwkc->hwc", weights, normals[corners])
        normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
        lamp = toward + np.array([0.5 * np.cos(turn), 0.6, -0.5 * np.sin(turn)])
        lamp /= np.linalg.norm(lamp)
        shade = np.where(seen, 30 + 215 * np.clip(normal @ lamp, 0, 1), 255)
        grey = np.repeat(shade[..., None], 3, axis=2).astype(np.uint8)
        miss = np.einsum("hwk,hwk->hw", weights, off[corners])
        scale = np.round(255 * np.clip(miss / FULL_MM, 0, 1)).astype(np.uint8)
        colour = cv2.applyColorMap(scale, cv2.COLORMAP_TURBO)
        colour[~seen] = 255
        shown.append(np.concatenate([grey, colour], axis=0))
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path.with_suffix(".png")), np.concatenate(shown, axis=1))


def main() -> None:
    """Put pictures of meshes beside each other, for the docs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("pictures", nargs="+", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--rows", type=int, default=560)
    chosen = parser.parse_args()
    shown = []
    for path in chosen.pictures:
        picture = cv2.imread(str(path))
        if picture is None:
            parser.error(f"{path} is no picture")
        width = round(picture.shape[1] * chosen.rows / picture.shape[0])
        shown.append(cv2.resize(picture, (width, chosen.rows), interpolation=cv2.INTER_AREA))
        shown.append(np.full((chosen.rows, GAP_PX, 3), 255, np.uint8))
    whole = np.concatenate(shown[:-1], axis=1)
    cv2.imwrite(str(chosen.out), whole, [cv2.IMWRITE_JPEG_QUALITY, 85])


if __name__ == "__main__":
    main()
