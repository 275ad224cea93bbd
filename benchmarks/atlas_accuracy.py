"""Atlas with the true mesh: a known texture and an even one from nine views, beside Open3D."""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import open3d
from scipy.ndimage import binary_erosion, gaussian_filter

from benchmarks.atlas_case import AtlasCase, even, make_case, skin
from benchmarks.record import record
from lightstage.formats.mesh import Mesh
from lightstage.formats.processed import ProcessedFolder
from lightstage.rig import Camera
from processing.atlas.config import AtlasConfig
from processing.atlas.raster import rasterise
from processing.atlas.stage import atlas

SCALE = 0.1795
"""Of the cameras' full size, as in the demonstration: 720 x 1080."""
ROWS = 1536
TONE = 0.4


def positions(case: AtlasCase, rows: int, columns: int) -> tuple[np.ndarray, np.ndarray]:
    """(rows, columns, 3) mm and (rows, columns) bool, covered."""
    mesh = case.template.mesh
    assert mesh.uvs is not None
    raster = rasterise(mesh.uvs, mesh.triangle_uvs(), rows, columns)
    place = np.zeros((rows, columns, 3))
    place.reshape(-1, 3)[raster.texels()] = raster.at(mesh.vertices, mesh.triangles())
    return place, raster.face >= 0


def by_open3d(mesh: Mesh, cameras: Sequence[Camera], out: ProcessedFolder, size: int) -> np.ndarray:
    """(size, size, 3) linear: the peer's square 8-bit albedo of a mesh with UV."""
    assert mesh.uvs is not None
    thing = open3d.t.geometry.TriangleMesh(
        open3d.core.Tensor(mesh.vertices.astype(np.float32)),
        open3d.core.Tensor(mesh.triangles().astype(np.int64)),
    )
    thing.triangle.texture_uvs = open3d.core.Tensor(
        mesh.uvs[mesh.triangle_uvs()].astype(np.float32)
    )
    pictures, lenses, poses = [], [], []
    for camera in cameras:
        albedo = out.read_view(camera.id, "diffuse_albedo")
        # Masks it has none: the background is black.
        albedo[~out.read_mask(camera.id)] = 0
        code = (np.clip(albedo, 0, 1) * 255 + 0.5).astype(np.uint8)
        pictures.append(open3d.t.geometry.Image(open3d.core.Tensor(np.ascontiguousarray(code))))
        lens = [[camera.fx_px, 0, camera.cx_px], [0, camera.fy_px, camera.cy_px], [0, 0, 1]]
        lenses.append(open3d.core.Tensor(np.array(lens)))
        pose = np.vstack([camera.cam_from_world, [0, 0, 0, 1]])
        poses.append(open3d.core.Tensor(pose))
    found = thing.project_images_to_albedo(pictures, lenses, poses, size, False)
    return found.as_tensor().numpy().astype(np.float32) / 255


def kept(found: np.ndarray, truth: np.ndarray, inside: np.ndarray) -> float:
    """Share of the finest band's energy: what a blur of one texel takes away, projected on truth's.

    Noise and aliases have energy too, so that only what agrees with the truth counts.
    """
    bands = []
    for image in (found, truth):
        grey = np.where(inside, image.mean(axis=2), 0)
        weight = gaussian_filter(inside.astype(float), 1.0)
        bands.append((grey - gaussian_filter(grey, 1.0) / np.maximum(weight, 1e-6))[inside])
    share = float((bands[0] * bands[1]).sum() / (bands[1] ** 2).sum())
    return share**2


def psnr(found: np.ndarray, truth: np.ndarray, inside: np.ndarray) -> float:
    return float(-10 * np.log10(np.mean((found[inside] - truth[inside]) ** 2)))


def textured(root: Path, rows: int, scale: float, *, peer: bool) -> list[list[str]]:
    """Rows of the table for the known texture."""
    out = []
    for gain, noise in ((0.0, 0.002), (0.03, 0.01)):
        case = make_case(root / f"{gain}", scale, skin, gain_sigma=gain, noise=noise)
        begin = time.process_time()
        config = AtlasConfig(rows=rows, maps=("diffuse_albedo",))
        atlas(case.session, case.out.root, case.template, config)
        seconds = time.process_time() - begin
        place, covered = positions(case, rows, rows * 2 // 3)
        truth = skin(place.reshape(-1, 3)).reshape(place.shape)
        coverage = case.out.read_atlas("coverage")
        several = (coverage >= 2) & covered & (case.out.read_atlas("filled") == 0)
        inner = binary_erosion(several, iterations=3)
        found = case.out.read_atlas("diffuse_albedo")
        name = f"gains {gain:.0%}, noise {noise}"
        out.append(
            [
                name,
                "this project",
                f"{psnr(found, truth, several):.1f}",
                f"{kept(found, truth, inner):.0%}",
                f"{several.sum() / covered.sum():.0%}",
                f"{seconds:.1f}",
            ]
        )
        print(out[-1], flush=True)
        if not peer:
            continue
        begin = time.process_time()
        found = by_open3d(case.template.mesh, case.session.rig.cameras, case.out, rows)
        seconds = time.process_time() - begin
        place, covered = positions(case, rows, rows)
        truth = skin(place.reshape(-1, 3)).reshape(place.shape)
        columns = np.minimum(np.arange(rows) * 2 // 3, rows * 2 // 3 - 1)
        same = several[:, columns] & covered & (found.sum(axis=2) > 0)
        share = same.sum() / max((several[:, columns] & covered).sum(), 1)
        out.append(
            [
                name,
                "Open3D project_images_to_albedo",
                f"{psnr(found, truth, same):.1f}",
                f"{kept(found, truth, binary_erosion(same, iterations=3)):.0%}",
                f"{share:.0%} of those",
                f"{seconds:.1f}",
            ]
        )
        print(out[-1], flush=True)
    return out


def plain(root: Path, rows: int, scale: float) -> list[str]:
    """Row of the table for the even tone: steps where the heaviest view changes, and bleeding."""
    case = make_case(root / "even", scale, even, gain_sigma=0.0, noise=0.0)
    config = AtlasConfig(rows=rows, maps=("diffuse_albedo",))
    atlas(case.session, case.out.root, case.template, config)
    found = case.out.read_atlas("diffuse_albedo")[..., 0]
    view, covered = case.out.read_atlas("view"), positions(case, rows, rows * 2 // 3)[1]
    steps = []
    for axis in (0, 1):
        a, b = (
            np.moveaxis(np.stack([view, found, covered]), axis + 1, 1)[:, s]
            for s in (slice(1, None), slice(None, -1))
        )
        border = (a[0] != b[0]) & (a[2] > 0) & (b[2] > 0)
        steps.append(np.abs(a[1] - b[1])[border])
    joined = np.concatenate(steps) / TONE
    bleed = np.abs(found[covered] / TONE - 1).max()
    return ["even tone", f"{joined.mean():.3%}", f"{joined.max():.2%}", f"{bleed:.2%}"]


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--rows", type=int, default=ROWS)
    parser.add_argument("--scale", type=float, default=SCALE)
    parser.add_argument("--no-peer", action="store_true")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        rows = textured(Path(folder), arguments.rows, arguments.scale, peer=not arguments.no_peer)
        steps = plain(Path(folder), arguments.rows, arguments.scale)
    print(steps)
    record(
        "Atlas: known texture from nine views",
        [
            "views",
            "method",
            "PSNR dB where two or more see",
            "finest band kept",
            "share of texels",
            "processor s",
        ],
        rows,
        f"{arguments.rows} rows, cameras of {arguments.scale:g} of their full size, true mesh; "
        f"diffuse albedo alone. Open3D: square and 8-bit, linear codes, tex_size {arguments.rows}. "
        "Even tone: "
        f"step where the heaviest view changes {steps[1]} mean, {steps[2]} at most; farthest from "
        f"the tone anywhere, background {5.0 / TONE:.0f} times as bright, {steps[3]}.",
    )


if __name__ == "__main__":
    main()
