"""Pictures of the renderer: each term on and off, and a scanned head beside Mitsuba.

Writes docs/renderer_terms.jpg and one picture a light, docs/renderer_street.jpg and so on. The scan
is Infinite, 3D Head Scan by Lee Perry-Smith, CC BY 3.0, www.triplegangers.com.
"""

from __future__ import annotations

import argparse
import dataclasses
import tempfile
import time
from pathlib import Path
from typing import Any

import cv2
import mitsuba
import numpy as np
import torch

from benchmarks.record import record
from learning.maps import TexturedHead, skin_maps_from, to_batch
from learning.relight import FAR_MM, render_head, shadows_of
from learning.render.panorama import Panorama, median_cut
from learning.render.skin import ShadeOptions
from learning.render.uv import rasterise
from lightstage.formats.environment import LightSet
from lightstage.rig import Camera, default_rig
from processing.colour import srgb_from_linear
from sim.light.environments import Panorama as SimulatedPanorama
from sim.light.relight import SKIES
from sim.light.sky import mitsuba_sky
from sim.light.street import street
from sim.people.subject import Subject
from sim.reference.variant import find_variant
from sim.scans.lps import load_scan, scan_folder

DOCS = Path(__file__).parents[1] / "docs"
CREDIT = "Scan: Infinite, 3D Head Scan by Lee Perry-Smith, CC BY 3.0, www.triplegangers.com"
TEXTURE, SAMPLES, LIGHTS, SCALE = 320, 32, 64, 0.05
NAMES = ("street", "noon", "sunset")
GAIN = 4.0
"""Of the differences that are shown."""
SOFT = ShadeOptions()


def head_of(person: Subject, fine: bool) -> TexturedHead:
    """The scan as the renderer takes it; smooth normals of the mesh unless fine."""
    rows, columns = person.diffuse_albedo.shape[:2]
    raster = rasterise(person.mesh, rows, columns)
    smooth = raster.normals(person.mesh)
    normal = person.normal if fine else smooth
    maps = {
        "diffuse_albedo": person.diffuse_albedo,
        "specular_albedo": person.specular_albedo,
        "diffuse_normal": smooth * 0.5 + normal * 0.5,
        "specular_normal": normal,
        "position": raster.interpolate(person.mesh.vertices),
    }
    shininess = 2 / np.maximum(person.roughness, 0.05) ** 2 - 2
    skin = skin_maps_from(maps, raster.covered, shininess, person.translucency)
    return TexturedHead(person.mesh, raster, skin, raster.covered)


def matte(head: TexturedHead) -> TexturedHead:
    """Without its specular part."""
    skin = dataclasses.replace(head.skin, specular_albedo=0 * head.skin.specular_albedo)
    return dataclasses.replace(head, skin=skin)


def lights_of(panorama: SimulatedPanorama, count: int) -> LightSet:
    found = median_cut(Panorama(panorama.radiance), count, np.zeros(3))
    position = FAR_MM * found.position_mm[0].double().numpy()
    return LightSet(panorama.name, position, found.rgb[0].double().numpy(), np.zeros(3))


def path_traced(person: Subject, panorama: SimulatedPanorama, camera: Camera) -> np.ndarray:
    """The matte head in direct light, by Mitsuba."""
    mi: Any = mitsuba
    mi.set_variant(find_variant())
    mesh = person.mesh
    corners = mesh.triangles()
    count = corners.size
    made = mi.Mesh("head", count, len(corners), has_vertex_normals=True, has_vertex_texcoords=True)
    smooth = np.zeros((len(mesh.vertices), 3))
    crossed = np.cross(
        mesh.vertices[corners[:, 1]] - mesh.vertices[corners[:, 0]],
        mesh.vertices[corners[:, 2]] - mesh.vertices[corners[:, 0]],
    )
    for k in range(3):
        np.add.at(smooth, corners[:, k], crossed)
    smooth /= np.maximum(np.linalg.norm(smooth, axis=1, keepdims=True), 1e-12)
    params = mi.traverse(made)
    params["vertex_positions"] = mesh.vertices[corners].astype(np.float32).ravel()
    params["vertex_normals"] = smooth[corners].astype(np.float32).ravel()
    if mesh.uvs is None:
        raise SystemExit("the scan has no texture coordinates")
    params["vertex_texcoords"] = mesh.uvs[mesh.triangle_uvs()].astype(np.float32).ravel()
    params["faces"] = np.arange(count, dtype=np.uint32)
    params.update()
    with tempfile.TemporaryDirectory() as folder:
        made.write_ply(f"{folder}/head.ply")
        # Mitsuba's v runs down the texture's rows, and its light's columns toward -x.
        albedo = mi.Bitmap(np.ascontiguousarray(person.diffuse_albedo[::-1], np.float32))
        light = np.ascontiguousarray(panorama.radiance[:, ::-1], np.float32)
        rotation, centre = camera.cam_from_world[:, :3], camera.centre_mm
        wide = 2 * np.degrees(np.arctan(camera.width_px / 2 / camera.fx_px))
        frame = mi.ScalarTransform4f().look_at(
            origin=centre.tolist(),
            target=(centre + rotation[2]).tolist(),
            up=(-rotation[1]).tolist(),
        )
        scene = mi.load_dict(
            {
                "type": "scene",
                "integrator": {"type": "path", "max_depth": 2},
                "sky": {"type": "envmap", "bitmap": mi.Bitmap(light)},
                "head": {
                    "type": "ply",
                    "filename": f"{folder}/head.ply",
                    "bsdf": {
                        "type": "diffuse",
                        "reflectance": {"type": "bitmap", "bitmap": albedo, "raw": True},
                    },
                },
                "sensor": {
                    "type": "perspective",
                    "fov": float(wide),
                    "fov_axis": "x",
                    "principal_point_offset_x": 0.5 - camera.cx_px / camera.width_px,
                    "principal_point_offset_y": 0.5 - camera.cy_px / camera.height_px,
                    "to_world": frame,
                    "film": {
                        "type": "hdrfilm",
                        "width": camera.width_px,
                        "height": camera.height_px,
                        "rfilter": {"type": "box"},
                    },
                    "sampler": {"type": "independent", "sample_count": SAMPLES},
                },
            }
        )
        return np.array(mi.render(scene))[..., :3]


def tile(picture: np.ndarray, exposure: float, text: str) -> np.ndarray:
    """SRGB bytes with a label."""
    out = np.round(255 * srgb_from_linear(np.clip(picture * exposure, 0, 1))).astype(np.uint8)
    out = np.ascontiguousarray(cv2.resize(out, None, fx=1.5, fy=1.5)[..., ::-1])
    cv2.putText(out, text, (8, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (40, 40, 200), 1, cv2.LINE_AA)
    return out


def write_sheet(path: Path, rows: list[list[np.ndarray]]) -> None:
    sheet = np.concatenate([np.concatenate(row, axis=1) for row in rows])
    strip = np.full((26, sheet.shape[1], 3), 255, np.uint8)
    cv2.putText(strip, CREDIT, (8, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (0, 0, 0), 1, cv2.LINE_AA)
    cv2.imwrite(str(path), np.concatenate([sheet, strip]), [cv2.IMWRITE_JPEG_QUALITY, 88])


def environment(person: Subject, camera: Camera, name: str) -> None:
    """One light: ours, Mitsuba's, the difference, and ours with all terms."""
    smooth, fine = matte(head_of(person, False)), head_of(person, True)
    flat = ShadeOptions(subsurface_mm=0)
    panorama = street(0) if name == "street" else mitsuba_sky(SKIES[name], name)
    lights = lights_of(panorama, LIGHTS)
    # Once for nothing: what is compiled is read from disk.
    render_head(smooth, lights, camera, 0.0, options=flat)
    began = time.process_time()
    seen = shadows_of(smooth, lights)
    baked = time.process_time()
    ours, alpha = render_head(smooth, lights, camera, 0.0, options=flat, seen=seen)
    drawn = time.process_time()
    truth = path_traced(person, panorama, camera)
    traced = time.process_time()
    full, _ = render_head(fine, lights, camera, 0.0, options=SOFT, seen=seen)
    inside = alpha > 0.999
    truth = truth * inside[..., None]
    exposure = 0.6 / float(np.quantile(truth[inside], 0.95))
    off, mean = np.abs(ours - truth)[inside], float(truth[inside].mean())
    row = [
        f"{100 * off.mean() / mean:.1f}",
        f"{100 * (ours[inside].mean() / mean - 1):+.1f}",
        f"{drawn - baked:.2f}",
        f"{baked - began:.1f}",
        f"{traced - drawn:.1f}",
    ]
    tiles = [
        tile(ours, exposure, f"{name}: matte, {LIGHTS} lights"),
        tile(truth, exposure, f"Mitsuba, {SAMPLES} paths"),
        tile(GAIN * np.abs(ours - truth) * inside[..., None], exposure, f"difference x {GAIN:g}"),
        tile(full, exposure, "with gloss and scattering"),
    ]
    write_sheet(DOCS / f"renderer_{name}.jpg", [tiles])
    record(
        f"Renderer: a scanned head beside Mitsuba, {name}",
        ["mean error, %", "mean light, %", "s", "s of shadow rays", "Mitsuba s"],
        [row],
        f"Matte head in direct light, {camera.width_px} x {camera.height_px} px, {TEXTURE} texels "
        f"a side, {LIGHTS} lights by median cut, against {SAMPLES} paths a pixel, whose noise is "
        "part of the error. Processor seconds of all threads.",
    )


def terms(person: Subject, camera: Camera) -> None:
    head = head_of(person, True)
    places = np.array([[900.0, 500, 900], [-1200, 200, 300], [0, 300, 1300]])
    rgb = np.array([[0.75, 0.7, 0.65], [0.3, 0.36, 0.45], [0.1, 0.1, 0.1]])
    lights = LightSet("studio", places, rgb, np.full(3, 0.05))
    seen = shadows_of(head, lights)
    bare = ShadeOptions(subsurface_mm=0)

    def shown(
        text: str, who: TexturedHead, options: ShadeOptions, mask: Any, light: LightSet = lights
    ) -> np.ndarray:
        picture, _ = render_head(who, light, camera, 0.0, options=options, seen=mask)
        return tile(picture, 1.4, text)

    bright = dataclasses.replace(lights, ambient_rgb=np.ones(3))

    smooth = to_batch(head.raster.normals(head.mesh))
    skin = dataclasses.replace(head.skin, specular_normal=smooth)
    coarse = dataclasses.replace(head, skin=skin)
    thick = dataclasses.replace(
        head,
        skin=dataclasses.replace(head.skin, translucency=torch.ones_like(head.skin.translucency)),
    )
    rows = [
        [
            shown("all terms (physical)", head, SOFT, seen),
            shown("without gloss", matte(head), SOFT, seen),
            shown("without cast shadows", head, SOFT, None),
            shown("without scattering", head, bare, seen),
        ],
        [
            shown("gloss on the mesh's normals", coarse, SOFT, seen),
            shown("translucency 1, 4 mm", thick, ShadeOptions(subsurface_mm=4.0), seen),
            shown("mode ggx", head, ShadeOptions(mode="ggx"), seen),
            shown("mode paper, ambient 1", head, ShadeOptions(mode="paper"), None, bright),
        ],
    ]
    write_sheet(DOCS / "renderer_terms.jpg", rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", choices=("terms", *NAMES))
    chosen = parser.parse_args().only
    folder = scan_folder()
    if folder is None:
        raise SystemExit("no scan of a head at hand (LIGHTSTAGE_DATA)")
    person = load_scan(folder, TEXTURE)
    camera = default_rig().scaled(SCALE).camera("cam0")
    if chosen in (None, "terms"):
        terms(person, camera)
    for name in NAMES:
        if chosen in (None, name):
            environment(person, camera, name)


if __name__ == "__main__":
    main()
