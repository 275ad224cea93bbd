"""A template folder of a mesh, landmarks, regions and modes: its maps, and how it is written."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from lightstage.formats.files import atomic_folder
from lightstage.formats.mesh import Mesh
from lightstage.formats.png import write_png
from lightstage.formats.template import OWN, Modes, Template, save_template
from processing.atlas.finish import gutter_sources
from processing.atlas.raster import Raster, rasterise
from processing.laplacian import neighbour_mean
from processing.template.config import SHININESS, TRANSLUCENCY, ImportConfig

MARKER = "template.json"
GUTTER_PX = 4
"""Maps reach so far beyond their islands, so that looking texels up between them shows no seam."""


def with_maps(
    name: str,
    mesh: Mesh,
    landmarks: np.ndarray,
    regions: dict[str, np.ndarray],
    modes: Modes | None,
    licence: str,
    source: str,
    config: ImportConfig,
) -> Template:
    """A template whose shininess and translucency follow its regions.

    Args:
        name: of the template.
        mesh: head frame, mm, UV in one tile.
        landmarks: (68,) vertices.
        regions: by name, (k,) vertices.
        modes: where there are any.
        licence: the mesh's.
        source: where the mesh is from.
        config: settings.
    """
    raster = map_raster(mesh, config)
    maps = {
        "shininess": _by_region(mesh, regions, SHININESS, raster, config),
        "translucency": _by_region(mesh, regions, TRANSLUCENCY, raster, config),
    }
    return Template(name, mesh, landmarks, regions, licence, source, modes, maps)


def write_template(template: Template, out: Path, config: ImportConfig) -> Path:
    """Write a template folder, whole or not at all; returns `out`.

    Raises:
        FormatError: `out` holds something that is no template, or files of others.
    """
    with atomic_folder(out, MARKER, own=OWN) as beside:
        save_template(template, beside)
        raster = map_raster(template.mesh, config)
        skin = np.zeros((len(template.mesh.vertices), 1))
        for name in ("skin", "lips"):
            skin[template.regions.get(name, np.zeros(0, int))] = 1
        image = _drawn(skin, template.mesh, raster) > 0.5
        write_png(beside / "maps" / "skin.png", np.where(image, 255, 0).astype(np.uint8))
    return out


def map_raster(mesh: Mesh, config: ImportConfig) -> Raster:
    """Where a template's mesh is in its maps."""
    assert mesh.uvs is not None  # whoever imports a mesh has made sure of it
    rows = config.map_rows
    return rasterise(mesh.uvs, mesh.triangle_uvs(), rows, rows * 2 // 3)


def _by_region(
    mesh: Mesh,
    regions: dict[str, np.ndarray],
    values: dict[str, float],
    raster: Raster,
    config: ImportConfig,
) -> np.ndarray:
    """(rows, columns) float32, one value a region, smooth between them."""
    triangles = mesh.triangles()
    of = np.full((len(mesh.vertices), 1), values[""])
    for name, vertices in regions.items():
        of[vertices] = values.get(name, values[""])
    mean = neighbour_mean(triangles, len(of))
    used = np.zeros(len(of), bool)
    used[triangles] = True
    for _ in range(config.soft_rings):
        of[used] = (0.5 * (of + mean @ of))[used]
    return _drawn(of, mesh, raster)


def _drawn(values: np.ndarray, mesh: Mesh, raster: Raster) -> np.ndarray:
    """(rows, columns) float32 of (n, 1) values of vertices; beside islands, their nearest texel."""
    image = np.full(raster.face.shape, float(np.median(values)), np.float32)
    image.ravel()[raster.texels()] = raster.at(values, mesh.triangles())[:, 0]
    gutter, source = gutter_sources(raster.face >= 0, GUTTER_PX)
    image.ravel()[gutter] = image.ravel()[source]
    return image
