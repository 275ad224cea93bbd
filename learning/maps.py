"""Maps on disk to what the renderer takes."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from learning.errors import MapsError
from learning.map_checks import (
    compared_texels,
    looks_encoded,
    not_unit,
    require_albedo,
    require_millimetres,
    require_same_surface,
)
from learning.render.shading import SkinMaps
from learning.render.uv import UvRaster, rasterise, texel_surface
from lightstage.counting import counted
from lightstage.formats.mesh import Mesh
from lightstage.formats.processed import read_map
from lightstage.formats.template import Template

READ = (
    "diffuse_albedo",
    "specular_albedo",
    "diffuse_normal",
    "specular_normal",
    "position",
    "confidence",
)
"""Maps of a store that trainings read."""
SHININESS = 32.0
"""Blinn-Phong's exponent where there is no map: Beckmann m = 0.25, skin's middle."""
ROUGHNESS_RANGE = (0.05, 0.95)
"""Range of Beckmann's m that is taken from a map: the exponents 798 and 0.2."""
TRANSLUCENCY = 0.5
"""Translucency where there is no map."""


@dataclasses.dataclass(frozen=True)
class TexturedHead:
    """Maps of one person, ready to be rendered.

    Attributes:
        mesh: in the maps' axes.
        raster: its texels at the maps' size.
        skin: batch of one.
        captured: (rows, columns) bool, texels of the surface whose confidence is above 0.
        notes: what was mended or looks wrong in the maps, one line each.
    """

    mesh: Mesh
    raster: UvRaster
    skin: SkinMaps
    captured: np.ndarray
    notes: tuple[str, ...] = ()


def load_head(
    folder: Path,
    mesh: Mesh,
    template: Template | None = None,
    mesh_named: str | Path = "mesh",
) -> TexturedHead:
    """Read a folder of atlas maps.

    Needed are diffuse_albedo, specular_albedo, diffuse_normal and specular_normal; a texel without
    a normal takes the mesh's; normals of another length than 1 are made unit and counted; an albedo
    that looks like undecoded sRGB is warned of, and taken as it is. ambient_occlusion and
    confidence are used where present, and position shows whose maps they are. Shininess and
    translucency come from the template.

    Args:
        folder: such as OUT/atlas.
        mesh: with UV, in the axes of the normals.
        template: its skin maps are used; without one, constants.
        mesh_named: what to name the mesh in errors.

    Raises:
        MapsError: maps of different sizes or of another mesh, a negative albedo, a mesh that is not
            in mm.
        FormatError: a missing map, NaN, or a mesh without UV.
    """
    names = ("diffuse_albedo", "specular_albedo", "diffuse_normal", "specular_normal")
    maps = {name: read_map(folder / f"{name}.exr", name) for name in names}
    for name in ("ambient_occlusion", "confidence", "roughness", "position"):
        if (folder / f"{name}.exr").exists():
            maps[name] = read_map(folder / f"{name}.exr", name)
    rows, columns = maps["diffuse_albedo"].shape[:2]
    for name, image in maps.items():
        if image.shape[:2] != (rows, columns):
            raise MapsError(
                folder / f"{name}.exr",
                found=f"{image.shape[0]} x {image.shape[1]} texels",
                expected=f"{rows} x {columns}, as diffuse_albedo",
                hint="Maps of one folder belong to one atlas; make them again together.",
            )
    for name in ("diffuse_albedo", "specular_albedo"):
        require_albedo(maps[name], folder / f"{name}.exr")
    require_millimetres(mesh, mesh_named)
    raster = rasterise(mesh, rows, columns)
    notes = _notes(maps, raster.covered)
    position = raster.interpolate(mesh.vertices)
    normals = raster.normals(mesh)
    texels = compared_texels(raster.covered)
    place_mm, normal = (values.reshape(-1, 3)[texels] for values in (position, normals))
    require_same_surface(maps, texels, place_mm, normal, folder, mesh_named)
    for name in ("diffuse_normal", "specular_normal"):
        missing = np.linalg.norm(maps[name], axis=2) < 1e-3
        maps[name] = np.where(missing[..., None], normals, maps[name])
    ones = np.ones((rows, columns), np.float32)
    captured = raster.covered & (maps.get("confidence", ones) > 0)
    skin_maps = template.maps if template else {}
    shininess = _resized(skin_maps.get("shininess"), rows, columns, SHININESS)
    if "roughness" in maps:
        # What was measured replaces what a template states; texels without it stay as they were.
        known = maps["roughness"] > 0
        m = np.clip(maps["roughness"], *ROUGHNESS_RANGE)
        shininess = np.where(known, 2 / m**2 - 2, shininess).astype(np.float32)
    skin = skin_maps_from(
        {**maps, "position": position},
        raster.covered,
        shininess,
        _resized(skin_maps.get("translucency"), rows, columns, TRANSLUCENCY),
    )
    return TexturedHead(mesh, raster, skin, captured, notes)


def _notes(maps: dict[str, np.ndarray], covered: np.ndarray) -> tuple[str, ...]:
    """What a user should know of the maps."""
    notes = []
    for name in ("diffuse_normal", "specular_normal"):
        count = not_unit(maps[name], covered)
        if count:
            notes.append(f"{name}: {counted(count, 'normal')} not of length 1, made unit")
    if looks_encoded(maps["diffuse_albedo"], covered):
        notes.append("diffuse_albedo looks like an 8-bit sRGB picture; linear light is expected")
    return tuple(notes)


def skin_maps_from(
    maps: dict[str, np.ndarray],
    covered: np.ndarray,
    shininess: np.ndarray,
    translucency: np.ndarray,
) -> SkinMaps:
    """Arrays of (rows, columns[, 3]), by their maps' names, to the renderer's batch of one."""
    surface = texel_surface(maps["position"], covered)
    texel_mm = typical_texel_mm(surface.area_mm2)
    # A texel without neighbours has no area of its own, yet it shows skin.
    area = np.where(covered & ~(surface.area_mm2 > 0), texel_mm**2, surface.area_mm2)
    return SkinMaps(
        diffuse_albedo=to_batch(maps["diffuse_albedo"]),
        specular_albedo=to_batch(maps["specular_albedo"]),
        diffuse_normal=to_batch(maps["diffuse_normal"]),
        specular_normal=to_batch(maps["specular_normal"]),
        shininess=to_batch(shininess),
        translucency=to_batch(translucency),
        position_mm=to_batch(maps["position"]),
        area=to_batch(area / texel_mm**2),
        texel_mm=texel_mm,
        ambient_occlusion=to_batch(maps.get("ambient_occlusion", np.ones(covered.shape))),
        edges=to_batch(surface.edges_mm / texel_mm),
    )


def typical_texel_mm(area_mm2: np.ndarray) -> float:
    """Edge, mm, of the median texel of (rows, columns) areas; 1 where all are 0."""
    some = area_mm2[area_mm2 > 0]
    return float(np.sqrt(np.median(some))) if some.size else 1.0


def to_batch(image: np.ndarray) -> Tensor:
    """(rows, columns[, c]) to (1, c, rows, columns) float32."""
    planes = image[None] if image.ndim == 2 else image.transpose(2, 0, 1)
    return torch.from_numpy(np.ascontiguousarray(planes[None], np.float32))


def from_batch(image: Tensor) -> np.ndarray:
    """(1, c, rows, columns) to (rows, columns, c), or (rows, columns) of one channel."""
    planes = image[0].detach().cpu().numpy()
    return planes[0] if len(planes) == 1 else np.ascontiguousarray(planes.transpose(1, 2, 0))


def _resized(image: np.ndarray | None, rows: int, columns: int, constant: float) -> np.ndarray:
    if image is None:
        return np.full((rows, columns), constant, np.float32)
    planes = torch.nn.functional.interpolate(
        to_batch(image), size=(rows, columns), mode="bilinear", align_corners=False, antialias=True
    )
    return from_batch(planes)
