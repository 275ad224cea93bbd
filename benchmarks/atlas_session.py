"""Registration and atlas behind our own reconstruction, of a session whose truth is known.

python -m benchmarks.atlas_session SESSION OUT TRUTH [--picture CROPS.jpg]

OUT is what `lightstage-processing run SESSION` left, TRUTH the simulator's folder of that session.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import cv2
import numpy as np

from benchmarks.atlas_accuracy import by_open3d
from benchmarks.record import record
from benchmarks.registration_left_out import PROTOCOLS, left_out
from lightstage.formats.landmarks import read_points_mm
from lightstage.formats.mesh import Mesh, read_obj, read_ply
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.session import Session, load_session
from lightstage.formats.template import Template, default_template_path, load_template
from processing.atlas.raster import rasterise
from processing.colour import srgb_from_linear
from processing.registration.target import Target

PART_TEXELS = 500_000
CROPS = {"cheek": 2, "side of the nose": 31, "ear": 0}
"""Landmarks around which crops are cut; the cheek is between the jaw's and the nose's."""
CROP_PX = 360


def true_values(truth: ProcessedFolder, places: np.ndarray) -> np.ndarray:
    """(n, 3) true diffuse albedo at the points of the true mesh that are closest to (n, 3) mm."""
    mesh, image = read_obj(truth.registered_mesh), truth.read_atlas("diffuse_albedo")
    assert mesh.uvs is not None
    triangles, corners = mesh.triangles(), mesh.uvs[mesh.triangle_uvs()]
    vertices = mesh.vertices[triangles]
    size = np.linalg.norm(
        np.cross(vertices[:, 1] - vertices[:, 0], vertices[:, 2] - vertices[:, 0]), axis=1
    )
    whole = Target(Mesh(mesh.vertices, triangles))
    corners = corners[size > 0]
    out = np.empty((len(places), image.reshape(*image.shape[:2], -1).shape[2]), np.float32)
    for first in range(0, len(places), PART_TEXELS):
        part = slice(first, first + PART_TEXELS)
        face, weight = whole.on(places[part])
        uv = np.einsum("nck,nc->nk", corners[face], weight)
        x = (uv[:, 0] * image.shape[1] - 0.5).astype(np.float32)
        y = ((1 - uv[:, 1]) * image.shape[0] - 0.5).astype(np.float32)
        for start in range(0, len(x), 30_000):  # remap's pictures are smaller than 32768
            some = slice(start, start + 30_000)
            read = cv2.remap(
                image,
                x[some, None],
                y[some, None],
                cv2.INTER_LINEAR,
                borderMode=cv2.BORDER_REPLICATE,
            )
            out[part][some] = np.asarray(read).reshape(len(x[some]), -1)
    return out


def psnr(error: np.ndarray) -> float:
    return -10 * float(np.log10(np.mean(error.astype(float) ** 2)))


def aligned(found: np.ndarray, truth: np.ndarray, inside: np.ndarray) -> tuple[np.ndarray, float]:
    """The found picture warped onto the truth by dense flow, and the flow's median in texels."""
    white = max(float(np.quantile(truth[inside], 0.995)), 1e-6)
    codes = [
        np.round(255 * srgb_from_linear(np.clip(np.where(inside[..., None], a, 0) / white, 0, 1)))
        .mean(axis=2)
        .astype(np.uint8)
        for a in (truth, found)
    ]
    start = np.zeros((*inside.shape, 2), np.float32)
    flow = cv2.DISOpticalFlow.create(cv2.DISOpticalFlow_PRESET_MEDIUM).calc(
        codes[0], codes[1], start
    )
    rows, columns = np.indices(inside.shape, np.float32)
    warped = cv2.remap(found, columns + flow[..., 0], rows + flow[..., 1], cv2.INTER_CUBIC)
    return np.asarray(warped), float(np.median(np.linalg.norm(flow[inside], axis=1)))


def by_peer(
    mesh: Mesh, session: Session, out: ProcessedFolder, truth: ProcessedFolder, rows: int
) -> list[list[str]]:
    """The table's lines for Open3D's albedo of the same mesh and maps, where it shows anything."""
    assert mesh.uvs is not None
    cameras = [camera for camera in session.rig.cameras if camera.id in out.view_ids()]
    found = by_open3d(mesh, cameras, out, rows)
    raster = rasterise(mesh.uvs, mesh.triangle_uvs(), rows, rows)
    texels = raster.texels()
    columns = texels % rows * 2 // 3 + texels // rows * (rows * 2 // 3)
    twice = (out.read_atlas("coverage") >= 2) & (out.read_atlas("filled") == 0)
    ours = twice.ravel()[columns]
    texels = texels[ours & (found.reshape(-1, 3)[texels].sum(axis=1) > 0)]
    inside = np.zeros((rows, rows), bool)
    inside.reshape(-1)[texels] = True
    right = np.zeros_like(found)
    place = raster.at(mesh.vertices, mesh.triangles(), texels)
    right.reshape(-1, 3)[texels] = true_values(truth, place.astype(float))
    warped, _ = aligned(found, right, inside)
    plain, after = (psnr((image - right)[inside]) for image in (found, warped))
    share = len(texels) / ours.sum()
    return [
        ["Open3D project_images_to_albedo, PSNR dB (share of those)", f"{plain:.1f} ({share:.0%})"],
        ["the same after dense flow in UV", f"{after:.1f}"],
    ]


def crops(out: ProcessedFolder, template: Template, path: Path) -> None:
    """Diffuse albedo and tangent normals around three places, at full size."""
    uvs, uv_faces = template.mesh.uvs, template.mesh.triangle_uvs()
    assert uvs is not None
    triangles = template.mesh.triangles()
    albedo, normal = out.read_atlas("diffuse_albedo"), out.read_atlas("tangent_normal")
    seen = out.read_atlas("coverage") > 0
    white = float(np.quantile(albedo[seen], 0.998))
    rows = []
    for name, mark in CROPS.items():
        vertex = template.landmarks[mark]
        place = template.mesh.vertices[vertex].copy()
        if name == "cheek":
            place = 0.5 * (place + template.mesh.vertices[template.landmarks[31]])
            place[2] += 10
        if name == "ear":
            ears = template.mesh.vertices[template.regions["ears"]]
            place = ears[ears[:, 0] < 0].mean(axis=0)
        vertex = int(np.argmin(np.linalg.norm(template.mesh.vertices - place, axis=1)))
        face, corner = np.argwhere(triangles == vertex)[0]
        u, v = uvs[uv_faces[face, corner]]
        top = int(np.clip((1 - v) * len(albedo) - CROP_PX / 2, 0, len(albedo) - CROP_PX))
        left = int(np.clip(u * albedo.shape[1] - CROP_PX / 2, 0, albedo.shape[1] - CROP_PX))
        box = (slice(top, top + CROP_PX), slice(left, left + CROP_PX))
        colour = srgb_from_linear(np.clip(albedo[box] / white, 0, 1))
        rows.append(np.concatenate([colour, 0.5 * normal[box] + 0.5], axis=1))
        print(name, "crop at row", top, "column", left)
    image = np.round(255 * np.concatenate(rows, axis=1)).clip(0, 255).astype(np.uint8)
    cv2.imwrite(str(path), image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 85])


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("session", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("truth", type=Path)
    parser.add_argument("--picture", type=Path)
    arguments = parser.parse_args()
    out, truth = ProcessedFolder(arguments.out), ProcessedFolder(arguments.truth)
    template = load_template(default_template_path())
    if arguments.picture:
        crops(out, template, arguments.picture)
    scan, surface = read_ply(out.base_mesh), Target(read_ply(truth.base_mesh))
    registered = read_obj(out.registered_mesh)
    near = Target(scan).closest(registered.vertices)
    faced = ~near.border & (near.distance_mm < 1.5)
    skin = np.zeros(len(faced), bool)
    skin[template.regions["skin"]] = True
    skin[template.regions["ears"]] = False
    lies = surface.closest(registered.vertices[faced & skin]).distance_mm
    table = [
        ["skin's vertices that the scan shows, to the true head, mm: mean", f"{lies.mean():.3f}"],
        ["the same: median / 95 %", f"{np.median(lies):.3f} / {np.quantile(lies, 0.95):.2f}"],
    ]
    marks = read_points_mm(truth.true_landmarks)
    error = left_out(scan, marks, template, PROTOCOLS["every second"])
    inner = error[17:]
    table += [
        ["landmarks left out of the fit, mm: mean of 68", f"{np.nanmean(error):.2f}"],
        [
            "the same: brows, nose, eyes, mouth / jaw line",
            f"{np.nanmean(inner):.2f} / {np.nanmean(error[:17]):.2f}",
        ],
    ]
    place, coverage = out.read_atlas("position"), out.read_atlas("coverage")
    inside = (coverage >= 2) & (out.read_atlas("filled") == 0)
    found = out.read_atlas("diffuse_albedo")
    right = np.zeros_like(found)
    right[inside] = true_values(truth, place[inside].astype(float))
    gain = float((found[inside] * right[inside]).sum() / (found[inside] ** 2).sum())
    warped, shift = aligned(found, right, inside)
    texel = json.loads((arguments.out / "report.json").read_text())["stages"]["atlas"]
    table += [
        ["diffuse albedo where two or more see, PSNR dB", f"{psnr((found - right)[inside]):.1f}"],
        ["after dense flow in UV", f"{psnr((warped - right)[inside]):.1f}"],
        ["after the best single gain", f"{psnr((gain * found - right)[inside]):.1f} ({gain:.3f})"],
        ["flow's median, texels (mm)", f"{shift:.2f} ({shift * texel['texel_mm_median']:.3f})"],
    ]
    table += by_peer(registered, load_session(arguments.session), out, truth, len(found))
    for line in table:
        print(line, flush=True)
    record(
        f"Registration and atlas behind our own reconstruction: {arguments.session.parent.name}",
        ["what", "found"],
        table,
        f"{arguments.session.parent.name}; own decode, separate, reconstruct, refine, register and "
        f"atlas of {len(found)} rows with our template; truth at a texel is the true map at the "
        f"true head's point closest to it. Head: Lee Perry-Smith, CC BY 3.0.",
    )


if __name__ == "__main__":
    main()
