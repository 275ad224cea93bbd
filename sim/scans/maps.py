"""Maps of a scan: its colour as albedo, its normals, and what it lacks made from its colour."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy import ndimage

from lightstage.formats.mesh import Mesh, vertex_normals
from sim.errors import SimError
from sim.head.maps import over_grid, region_share
from sim.light.texture import raster_uv, sample, texture_of
from sim.scans.lps import (
    DETAIL_TEXEL_MM,
    fine_detail,
    linear_of,
    resized,
    skin_specular,
    world_normals,
)
from sim.scans.match import carried, own_grid_uv
from sim.scans.scan_file import Picture, ScanFile
from sim.skin.normals import bend_normals

NECK_MM = 30.0
"""Skin is scored down to here below the lowest landmark: the warp knows no shoulders."""
FARTHEST_MM = 15.0
"""Points that the warp leaves farther from our own head correspond to nothing on it."""
ROUGHNESS_RANGE = (0.05, 1.0)


@dataclasses.dataclass(frozen=True)
class ScanMaps:
    """A scan's maps over its own UV, as a `sim.people.subject.Subject` has them.

    Attributes:
        made_up: which of them were not in the scan.
    """

    diffuse_albedo: np.ndarray
    specular_albedo: np.ndarray
    roughness: np.ndarray
    normal: np.ndarray
    translucency: np.ndarray
    skin: np.ndarray
    made_up: tuple[str, ...]


def scan_maps(
    scan: ScanFile,
    mesh: Mesh,
    head_mm: np.ndarray,
    marks_mm: np.ndarray,
    rows: int | None,
    relief_mm: float,
) -> ScanMaps:
    """Make a scan's maps.

    Args:
        scan: with a colour.
        mesh: as it is in the stage.
        head_mm: (n, 3) its vertices in the head frame.
        marks_mm: (68, 3) landmarks in the head frame, NaN where unknown.
        rows: of the maps; None for the colour's own.
        relief_mm: height of the relief made from the colour where no normal map is.

    Raises:
        SimError: albedo below 0 or above 1, or no texel on the surface.
    """
    assert scan.colour is not None
    height, width = scan.colour.pixels.shape[:2]
    rows = height if rows is None else rows
    columns = max(1, round(rows * width / height))
    face, weights = raster_uv(mesh, rows, columns)
    covered = face >= 0
    if not covered.any():
        raise SimError(scan.where, field="uv", found="no texel covered", expected="an unwrapping")
    albedo = _filled(_albedo(scan, rows, columns), covered)
    triangles = mesh.triangles()
    corners = mesh.vertices[triangles]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    texel_mm = float(np.sqrt(np.linalg.norm(area, axis=1).sum() / 2 / covered.sum()))
    scale = DETAIL_TEXEL_MM / texel_mm
    specular, roughness = skin_specular(albedo, scale)
    made_up = ["specular albedo", "translucency"]
    if scan.roughness is None:
        made_up.append("roughness")
    else:
        # glTF: the facets' m is the square of the perceptual roughness.
        perceptual = resized(scan.roughness.pixels, rows, columns)[..., 1]
        roughness = (scan.roughness_factor * perceptual) ** 2
        roughness = np.clip(roughness, *ROUGHNESS_RANGE).astype(np.float32)
    if scan.normals is not None:
        normal = world_normals(mesh, np.clip(resized(scan.normals.pixels, rows, columns), 0, 1))
    else:
        made_up.append("relief")
        placed = texture_of(mesh.vertices, triangles, face, weights)
        smooth = texture_of(vertex_normals(mesh.vertices, triangles), triangles, face, weights)
        relief = relief_mm * fine_detail(albedo, scale)
        normal = bend_normals(placed, smooth, relief, covered, 20 * texel_mm)
    return ScanMaps(
        diffuse_albedo=albedo,
        specular_albedo=specular,
        roughness=roughness,
        normal=normal,
        translucency=np.full((rows, columns), 0.5, np.float32),
        skin=_skin(mesh, head_mm, marks_mm, face, weights),
        made_up=tuple(made_up),
    )


def _albedo(scan: ScanFile, rows: int, columns: int) -> np.ndarray:
    """(rows, columns, 3) float32 linear; SimError below 0 or above 1."""
    picture: Picture | None = scan.colour
    assert picture is not None
    pixels = picture.pixels if picture.linear else linear_of(picture.pixels)
    pixels = pixels * np.array(scan.colour_factor, np.float32)
    if pixels.min() < 0:
        row, column = np.argwhere(pixels.min(axis=2) < 0)[0]
        raise SimError(
            picture.where,
            field=f"texel ({row}, {column})",
            found=f"albedo of {pixels.min():.3g}",
            expected="0 to 1",
        )
    if np.mean(pixels > 1.0) > 1e-3:
        raise SimError(
            picture.where,
            field="colour",
            found=f"albedo up to {pixels.max():.3g}",
            expected="0 to 1",
            hint="Divide the texture by what a perfect white diffuser would read in it.",
        )
    return np.clip(resized(pixels, rows, columns), 0.0, 1.0)


def _filled(values: np.ndarray, covered: np.ndarray) -> np.ndarray:
    """Texels off the surface take the nearest one on it, so that its rim samples true colour."""
    if covered.all():
        return values
    nearest = ndimage.distance_transform_edt(~covered, return_distances=False, return_indices=True)
    return np.ascontiguousarray(values[tuple(nearest)])


def _skin(
    mesh: Mesh,
    head_mm: np.ndarray,
    marks_mm: np.ndarray,
    face: np.ndarray,
    weights: np.ndarray,
) -> np.ndarray:
    """(rows, columns) bool: our own head's skin and lips carried over, or all the surface."""
    covered = face >= 0
    if not np.isfinite(marks_mm).any():
        return covered
    values = np.concatenate([carried(head_mm, marks_mm), head_mm[:, 1:2]], axis=1)
    places = texture_of(values, mesh.triangles(), face, weights)[covered]
    uv, off_mm = own_grid_uv(places[:, :3])
    share = sample(over_grid(region_share("skin") + region_share("lips"), 768, 512), uv)
    above = places[:, 3] > np.nanmin(marks_mm[:, 1]) - NECK_MM
    out = np.zeros(face.shape, bool)
    out[covered] = (share > 0.5) & (off_mm < FARTHEST_MM) & above
    return out
