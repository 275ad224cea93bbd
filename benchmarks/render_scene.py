"""A scanned head in light from everywhere: as the renderer takes it, and as Mitsuba does."""

from __future__ import annotations

import dataclasses
import tempfile
from typing import Any

import mitsuba
import numpy as np

from learning.maps import TexturedHead, skin_maps_from
from learning.relight import FAR_MM
from learning.render.panorama import Panorama, median_cut
from learning.render.uv import rasterise
from lightstage.formats.environment import LightSet
from lightstage.formats.mesh import vertex_normals
from lightstage.rig import Camera
from sim.light.environments import Panorama as SimulatedPanorama
from sim.light.relight import SKIES
from sim.light.sky import mitsuba_sky
from sim.light.street import street
from sim.people.subject import Subject
from sim.reference.variant import find_variant
from sim.scans.lps import load_scan, scan_folder

NAMES = ("street", "noon", "sunset")


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


def panorama_of(name: str) -> SimulatedPanorama:
    """One of NAMES."""
    return street(0) if name == "street" else mitsuba_sky(SKIES[name], name)


def scanned_head(texels: int) -> Subject:
    """The scan with maps of so many texels a side; ends the program where it is not at hand."""
    folder = scan_folder()
    if folder is None:
        raise SystemExit("no scan of a head at hand (LIGHTSTAGE_DATA)")
    return load_scan(folder, texels)


def lights_of(panorama: SimulatedPanorama, count: int) -> LightSet:
    found = median_cut(Panorama(panorama.radiance), count, np.zeros(3))
    position = FAR_MM * found.position_mm[0].double().numpy()
    ambient_rgb = found.ambient_rgb[0].double().numpy()
    return LightSet(panorama.name, position, found.rgb[0].double().numpy(), ambient_rgb)


class MatteScene:
    """The matte head in direct light, for Mitsuba."""

    def __init__(self, person: Subject, panorama: SimulatedPanorama, camera: Camera) -> None:
        """Load the scene."""
        mi: Any = mitsuba
        mi.set_variant(find_variant())
        self._mi = mi
        with tempfile.TemporaryDirectory() as folder:
            _mesh(mi, person).write_ply(f"{folder}/head.ply")
            # Mitsuba's v runs down the texture's rows, and its light's columns toward -x.
            albedo = mi.Bitmap(np.ascontiguousarray(person.diffuse_albedo[::-1], np.float32))
            light = np.ascontiguousarray(panorama.radiance[:, ::-1], np.float32)
            skin = {
                "type": "diffuse",
                "reflectance": {"type": "bitmap", "bitmap": albedo, "raw": True},
            }
            self._scene = mi.load_dict(
                {
                    "type": "scene",
                    "integrator": {"type": "path", "max_depth": 2},
                    "sky": {"type": "envmap", "bitmap": mi.Bitmap(light)},
                    "head": {"type": "ply", "filename": f"{folder}/head.ply", "bsdf": skin},
                    "sensor": _sensor(mi, camera),
                }
            )

    def picture(self, samples: int, seed: int = 0) -> np.ndarray:
        """(h, w, 3) linear, of so many paths a pixel."""
        return np.array(self._mi.render(self._scene, spp=samples, seed=seed))[..., :3]


def _mesh(mi: Any, person: Subject) -> Any:
    """The scan with smooth normals, every corner a vertex of its own."""
    mesh = person.mesh
    corners = mesh.triangles()
    count = corners.size
    made = mi.Mesh("head", count, len(corners), has_vertex_normals=True, has_vertex_texcoords=True)
    normals = vertex_normals(mesh.vertices, corners)
    params = mi.traverse(made)
    params["vertex_positions"] = mesh.vertices[corners].astype(np.float32).ravel()
    params["vertex_normals"] = normals[corners].astype(np.float32).ravel()
    if mesh.uvs is None:
        raise SystemExit("the scan has no texture coordinates")
    params["vertex_texcoords"] = mesh.uvs[mesh.triangle_uvs()].astype(np.float32).ravel()
    params["faces"] = np.arange(count, dtype=np.uint32)
    params.update()
    return made


def _sensor(mi: Any, camera: Camera) -> dict[str, Any]:
    rotation, centre = camera.cam_from_world[:, :3], camera.centre_mm
    wide = 2 * np.degrees(np.arctan(camera.width_px / 2 / camera.fx_px))
    frame = mi.ScalarTransform4f().look_at(
        origin=centre.tolist(),
        target=(centre + rotation[2]).tolist(),
        up=(-rotation[1]).tolist(),
    )
    return {
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
        "sampler": {"type": "independent"},
    }
