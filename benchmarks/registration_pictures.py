"""Five people registered with our template, to look at: scan, wireframe, checker texture.

python -m benchmarks.registration_pictures PICTURE.jpg [--scan HEAD.ply --landmarks L.json]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np

from benchmarks.registration_case import make_case, model
from lightstage.formats.landmarks import read_points_mm
from lightstage.formats.mesh import Mesh, read_ply, vertex_normals
from lightstage.formats.template import default_template_path, load_template
from processing.rays import interpolate
from processing.registration.config import RegisterConfig
from processing.registration.residual import residual
from processing.registration.stage import head_pose, register_mesh
from processing.sides import side_hits

PEOPLE = {1: "neutral", 2: "smile", 3: "neutral", 4: "smile", 5: "smile"}
SIDE_PX = 460
SIDE_DEG = 25.0
CHECKS = (36, 54)
"""Across and down the texture."""
LINE = 0.06
"""Of a triangle's height, drawn dark."""
LAMP = np.array([0.45, 0.5, 0.75])


def shaded(mesh: Mesh, paint: str) -> np.ndarray:
    """(px, px, 3) uint8 the mesh lit from above, plain, with its edges, or with a checker."""
    hits = side_hits(mesh, SIDE_DEG, SIDE_PX)
    triangles = mesh.triangles()
    seen = hits.face >= 0
    normals = interpolate(vertex_normals(mesh.vertices, triangles), triangles, hits)
    shade = 0.25 + 0.75 * np.clip(normals @ (LAMP / np.linalg.norm(LAMP)), 0, 1)
    tone = np.full((len(shade), 3), 205.0)
    face = np.maximum(hits.face, 0)
    if paint == "edges":
        tone[hits.barycentric.min(axis=1) < LINE] = (40, 60, 110)
    if paint == "checker":
        assert mesh.uvs is not None
        corners = mesh.uvs[mesh.triangle_uvs()[face]]
        uv = np.einsum("nck,nc->nk", corners, hits.barycentric)
        odd = (np.floor(uv * CHECKS).sum(axis=1) % 2).astype(bool)
        tone[odd] = (60, 110, 130)
    image = np.where(seen[:, None], tone * shade[:, None], 255)
    return np.round(image).astype(np.uint8).reshape(SIDE_PX, SIDE_PX, 3)


def row(scan: Mesh, landmarks_mm: np.ndarray, name: str) -> np.ndarray:
    """One person: scan, wireframe, checker; what is left is printed."""
    template = load_template(default_template_path())
    found, facts = register_mesh(scan, landmarks_mm, template, RegisterConfig())
    left = residual(scan, found, template.mesh.triangles())
    pose = head_pose(found, template)
    print(
        name,
        f"median {np.nanmedian(np.abs(left.distance_mm)):.3f} mm,",
        f"95 % {np.nanquantile(np.abs(left.distance_mm), 0.95):.2f} mm,",
        f"angle median {np.nanmedian(left.angle_deg):.1f} deg,",
        f"faulty {facts['triangles_flipped']}",
        flush=True,
    )
    mesh = template.mesh.with_vertices(pose.apply(found))
    turned = scan.with_vertices(pose.apply(scan.vertices))
    # The same frame for all three: the scan is drawn with the mesh's bounds.
    inside = np.ones(len(turned.faces), bool)
    for axis in range(3):
        low, high = mesh.vertices[:, axis].min() - 2, mesh.vertices[:, axis].max() + 2
        place = turned.vertices[turned.faces][:, :, axis]
        inside &= ((place > low) & (place < high)).all(axis=1)
    cut = Mesh(turned.vertices, turned.faces[inside])
    used = np.unique(cut.faces)
    number = np.zeros(len(cut.vertices), np.int32)
    number[used] = np.arange(len(used))
    plain = shaded(Mesh(cut.vertices[used], number[cut.faces]), "plain")
    return np.concatenate([plain, shaded(mesh, "edges"), shaded(mesh, "checker")], axis=1)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("picture", type=Path)
    parser.add_argument("--scan", type=Path, help="a scanned head in place of the fifth person")
    parser.add_argument("--landmarks", type=Path, help="of that scan")
    arguments = parser.parse_args()
    ict = model()
    rows = []
    for seed, expression in PEOPLE.items():
        if arguments.scan and seed == max(PEOPLE):
            continue
        case = make_case(ict, seed, expression=expression)
        rows.append(row(case.scan, case.landmarks_mm, f"person {seed}, {expression}"))
    if arguments.scan:
        rows.append(
            row(read_ply(arguments.scan), read_points_mm(arguments.landmarks), arguments.scan.stem)
        )
    half = np.concatenate(rows[:3], axis=0)
    rest = np.concatenate(rows[3:], axis=0)
    blank = np.full((len(half) - len(rest), half.shape[1], 3), 255, np.uint8)
    image = np.concatenate([half, np.concatenate([rest, blank])], axis=1)
    cv2.imwrite(str(arguments.picture), image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 82])


if __name__ == "__main__":
    main()
