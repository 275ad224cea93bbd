"""The registered head with its atlas under the session's full light, beside the photograph.

python -m benchmarks.atlas_rerender SESSION OUT CAMERA PICTURE.jpg [--columns 900]

Lambert's part alone, with cast shadows and no specular light: what differs at the brow, the nose
and the lips' shine is left out on purpose; what differs elsewhere is a fault.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import cv2
import numpy as np

from lightstage.formats.mesh import read_obj, vertex_normals
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.session import load_session
from processing.colour import srgb_from_linear
from processing.rays import MeshRays, interpolate


def photograph(out: ProcessedFolder, camera: str, shape: tuple[int, int]) -> np.ndarray:
    """(h, w, 3) linear photograph under full light, 0 outside the window that was kept."""
    folder = out.root / "work" / "frames" / camera
    facts = json.loads((folder / "frames.json").read_text())
    kept = np.load(folder / "half.npy", mmap_mode="r")[facts["patterns"].index("full")]
    top, left = facts["window"]["top"], facts["window"]["left"]
    image = np.zeros((*shape, 3), np.float32)
    image[top : top + kept.shape[0], left : left + kept.shape[1]] = kept
    return image


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("session", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("camera")
    parser.add_argument("picture", type=Path)
    parser.add_argument("--columns", type=int, default=900, help="of the picture, at most")
    arguments = parser.parse_args()
    session, out = load_session(arguments.session), ProcessedFolder(arguments.out)
    camera = next(c for c in session.rig.cameras if c.id == arguments.camera)
    mesh = read_obj(out.registered_mesh)
    assert mesh.uvs is not None
    triangles = mesh.triangles()
    rays = MeshRays(mesh.vertices, triangles)
    normals = vertex_normals(mesh.vertices, triangles)
    lights = np.array([light.position_mm for light in session.rig.lights])
    power = session.levels("full") * np.array(
        [np.mean(light.rgb_gain) for light in session.rig.lights]
    )
    visible = rays.visible(mesh.vertices, normals, lights)
    way = lights - mesh.vertices[:, None]
    far = np.linalg.norm(way, axis=2)
    # One vector a vertex: light is its product with any normal there.
    vector = np.einsum("nl,nlk->nk", visible * power / far**3, way)
    hits = rays.cast_camera(camera)
    seen = hits.face >= 0
    corners = mesh.uvs[mesh.triangle_uvs()[np.maximum(hits.face, 0)]]
    uv = np.einsum("nck,nc->nk", corners, hits.barycentric)
    shape = (camera.height_px, camera.width_px)
    albedo, bumps = out.read_atlas("diffuse_albedo"), out.read_atlas("diffuse_normal")
    x = (uv[:, 0] * albedo.shape[1] - 0.5).astype(np.float32).reshape(shape)
    y = ((1 - uv[:, 1]) * albedo.shape[0] - 0.5).astype(np.float32).reshape(shape)
    colour, normal = (
        np.asarray(cv2.remap(a, x, y, cv2.INTER_LINEAR)).reshape(-1, 3) for a in (albedo, bumps)
    )
    light = np.einsum("nk,nk->n", normal, interpolate(vector, triangles, hits))
    made = (colour * np.clip(light, 0, None)[:, None] * seen[:, None]).reshape(*shape, 3)
    photo = photograph(out, camera.id, shape)
    inside = out.read_mask(camera.id) & seen.reshape(shape)
    gain = float(np.median(photo[inside]) / np.median(made[inside]))
    white = float(np.quantile(photo[inside], 0.998))
    error = np.abs(gain * made - photo)[inside].mean() / photo[inside].mean()
    print(f"{camera.id}: mean difference {error:.1%} of the photograph's mean, gain {gain:.3g}")
    rows, columns = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
    box = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
    pair = np.concatenate([photo[box], gain * made[box]], axis=1)
    smaller = min(arguments.columns / pair.shape[1], 1)
    pair = np.asarray(cv2.resize(pair, None, fx=smaller, fy=smaller, interpolation=cv2.INTER_AREA))
    image = np.round(255 * srgb_from_linear(np.clip(pair / white, 0, 1))).astype(np.uint8)
    cv2.imwrite(str(arguments.picture), image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 85])


if __name__ == "__main__":
    main()
