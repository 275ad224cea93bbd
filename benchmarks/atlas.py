"""Atlas: a known texture recovered from nine views, against a texture taken from the best view."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.record import record
from lightstage.formats.mesh import Mesh, vertex_normals, write_obj, write_ply
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.session import Session, SessionFile
from lightstage.formats.template import Template, default_template_path, load_template
from lightstage.rig import Rig, default_rig
from processing.atlas.raster import rasterise
from processing.atlas.stage import AtlasConfig, atlas
from processing.rays import MeshRays, interpolate

ROWS = 768
NOISE = 0.01
GAIN_SIGMA = 0.03
SHARE = 0.1795
"""Of the cameras' full size, as in the demonstration: 720 x 1080."""


def texture(points_mm: np.ndarray) -> np.ndarray:
    """(n, 3) albedo with waves of 6 to 60 mm."""
    x, y, z = points_mm.T
    slow = 0.5 + 0.15 * np.sin(x / 9) * np.cos(y / 11)
    fast = 0.08 * np.sin(x / 1.0 + z / 2) * np.sin(y / 1.1)
    return np.stack([slow + fast, 0.8 * slow + fast, 0.6 * slow + 0.5 * fast], axis=1)


def photograph(template: Template, rig: Rig, out: ProcessedFolder) -> None:
    """Views of the textured template, each with a gain error and noise."""
    rng = np.random.default_rng(3)
    mesh, triangles = template.mesh, template.mesh.triangles()
    normals = vertex_normals(mesh.vertices, triangles)
    rays = MeshRays(mesh.vertices, triangles)
    for camera in rig.cameras:
        hits = rays.cast_camera(camera)
        hit = hits.face >= 0
        shape = (camera.height_px, camera.width_px)
        albedo = texture(interpolate(mesh.vertices, triangles, hits))
        albedo *= 1 + GAIN_SIGMA * rng.normal()
        albedo += NOISE * rng.normal(size=albedo.shape)
        normal = interpolate(normals, triangles, hits)
        flat = np.where(hit, 0.9, 0)[:, None]
        maps = {
            "diffuse_albedo": np.where(hit[:, None], albedo, 5),
            "diffuse_normal": normal,
            "specular_normal": normal,
            "specular_albedo": 0.03 * flat,
            "ambient_occlusion": flat,
            "confidence": flat,
        }
        for name, values in maps.items():
            out.write_view(camera.id, name, values.reshape(*shape, -1))
        out.write_mask(camera.id, hit.reshape(shape))
    write_obj(mesh, out.registered_mesh)
    write_ply(mesh, out.base_mesh)


def best_view(
    mesh: Mesh, rig: Rig, out: ProcessedFolder
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The naive texture: each texel from the nearest pixel of the view that faces it most."""
    triangles = mesh.triangles()
    assert mesh.uvs is not None
    raster = rasterise(mesh.uvs, mesh.triangle_uvs(), ROWS, ROWS * 2 // 3)
    points = raster.at(mesh.vertices, triangles).astype(float)
    normals = raster.at(vertex_normals(mesh.vertices, triangles), triangles)
    centres = np.array([camera.centre_mm for camera in rig.cameras])
    rays = MeshRays(mesh.vertices, triangles)
    visible = rays.visible(points, normals, centres, offset_mm=0.3)
    toward = centres[None] - points[:, None]
    toward /= np.linalg.norm(toward, axis=2, keepdims=True)
    cosine = np.where(visible, np.einsum("nmk,nk->nm", toward, normals), -1)
    chosen = np.where(cosine.max(axis=1) > 0, cosine.argmax(axis=1), -1)
    found = np.zeros((len(points), 3), np.float32)
    for index, camera in enumerate(rig.cameras):
        mine = np.flatnonzero(chosen == index)
        image = out.read_view(camera.id, "diffuse_albedo")
        pixel = np.floor(camera.project(points[mine])[0]).astype(int)
        column = np.clip(pixel[:, 0], 0, camera.width_px - 1)
        row = np.clip(pixel[:, 1], 0, camera.height_px - 1)
        found[mine] = image[row, column]
    shape = raster.face.shape
    image = np.zeros((*shape, 3), np.float32)
    image.reshape(-1, 3)[raster.texels()] = found
    view = np.full(shape, -1)
    view.ravel()[raster.texels()] = chosen
    position = np.zeros((*shape, 3))
    position.reshape(-1, 3)[raster.texels()] = points
    return image, view, position


def seam_step(image: np.ndarray, truth: np.ndarray, view: np.ndarray) -> float:
    """Mean step of the error across borders between best views."""
    error = (image - truth).mean(axis=2)
    border = (view[:, 1:] != view[:, :-1]) & (view[:, 1:] >= 0) & (view[:, :-1] >= 0)
    return float(np.abs(np.diff(error, axis=1))[border].mean())


def main() -> None:
    template = load_template(default_template_path())
    rig = default_rig().scaled(SHARE)
    with tempfile.TemporaryDirectory() as folder:
        out = ProcessedFolder(Path(folder))
        photograph(template, rig, out)
        file = SessionFile(
            id="bench", created_utc="", subject="s", expression="neutral", sequence=[], frames=[]
        )
        session = Session(out.root, file, rig)
        atlas(session, out.root, template, AtlasConfig(rows=96))  # compiles
        begin = time.perf_counter()
        facts = atlas(session, out.root, template, AtlasConfig(rows=ROWS))
        ours_s = time.perf_counter() - begin
        begin = time.perf_counter()
        naive, view, position = best_view(template.mesh, rig, out)
        naive_s = time.perf_counter() - begin
        truth = texture(position.reshape(-1, 3)).reshape(position.shape).astype(np.float32)
        scored = (out.read_atlas("confidence") > 0.05) & (view >= 0)
        rows = []
        for name, image, seconds in (
            ("this project, all 8 maps", out.read_atlas("diffuse_albedo"), ours_s),
            ("best view, nearest pixel, 1 map", naive, naive_s),
        ):
            rms = float(np.sqrt(np.mean((image[scored] - truth[scored]) ** 2)))
            naive_rms = float(np.sqrt(np.mean((naive[scored] - truth[scored]) ** 2)))
            step = seam_step(image, truth, view)
            rows.append(
                [
                    name,
                    f"{-20 * np.log10(rms):.1f}",
                    f"{rms / naive_rms:.2f}",
                    f"{step:.4f}",
                    f"{step / seam_step(naive, truth, view):.2f}",
                    f"{seconds:.1f}",
                    f"{seconds / naive_s:.1f}",
                ]
            )
    record(
        "Atlas: known texture from nine views",
        ["method", "PSNR dB", "RMSE / naive", "step at seams", "/ naive", "seconds", "/ naive"],
        rows,
        f"{ROWS} rows, cameras of {rig.cameras[0].width_px} x {rig.cameras[0].height_px}; "
        f"per-view gain error {GAIN_SIGMA:.0%}, noise {NOISE}; scored on "
        f"{scored.mean():.0%} of the tile. Views per seen texel "
        f"{facts['views_per_seen_texel']:.1f}.",
    )


if __name__ == "__main__":
    main()
