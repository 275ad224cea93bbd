"""Stage `atlas`: every map of the views merged into the template's UV tile."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from lightstage.commands import ProgressCallback, quiet
from lightstage.errors import LightstageError, one_error
from lightstage.formats.mesh import Mesh, read_obj, read_ply
from lightstage.formats.processed import MAPS, ProcessedFolder
from lightstage.formats.session import Session
from lightstage.formats.template import Template
from lightstage.rig import Camera
from processing.atlas.blend import Blender
from processing.atlas.config import OPTIONAL, AtlasConfig
from processing.atlas.fill import BY_DIFFUSION, MeshFill, mirrored_vertices
from processing.atlas.finish import gutter_sources, picture, towards, unit_towards
from processing.atlas.geometry import Geometry
from processing.atlas.sampling import room, side_by_side
from processing.atlas.seen import Seen
from processing.atlas.skin import skin_vertices
from processing.atlas.weights import Sampler, Texels, ViewSamples
from processing.closest import ClosestPoints
from processing.errors import AtlasError
from processing.parallel import Behind, over_views

NORMALS = ("diffuse_normal", "specular_normal")
OWN = ("position", "view", "confidence", "coverage", "skin", "filled")
"""Maps that are always written."""
MOST_OVERLAP = 0.01
AHEAD = 2
"""Views that are read, or maps that are written, while others are worked on."""


def atlas(
    session: Session,
    out: Path,
    template: Template,
    config: AtlasConfig,
    progress: ProgressCallback = quiet,
) -> dict[str, Any]:
    """Merge the views' maps; writes atlas/NAME.exr for all map names, in world axes.

    Maps that an earlier run wrote there and that are not wanted now are removed.

    Args:
        session: its rig's cameras.
        out: processed folder with views/, registered_mesh.obj and base_mesh.ply.
        template: whose topology the registered mesh has.
        config: settings.
        progress: called with (done, total).

    Returns:
        Facts for the report, JSON-ready.

    Raises:
        AtlasError: another topology than the template's, or no view that sees the mesh.
        FormatError: missing or damaged maps, all of them in one message.
    """
    folder = ProcessedFolder(out)
    mesh = _registered(folder, template)
    cameras = _cameras(session, folder, config)
    names = [
        name
        for name in config.maps
        if name not in OPTIONAL
        or all(folder.view_path(camera.id, name).is_file() for camera in cameras.values())
    ]
    total = 2 * len(cameras) + len(names)
    shape = Geometry.of(mesh, config.rows)
    flat = shape.tiles.flat
    texels = Texels(
        shape.at(shape.vertices),
        shape.normals(),
        shape.at(_trust(folder, shape, config))[:, 0],
        shape.tiles.start,
    )
    views: dict[str, ViewSamples] = {}
    seen = Seen.none(len(flat))
    middle = shape.vertices.mean(axis=0)
    finest = min(np.linalg.norm(c.centre_mm - middle) / c.fx_px for c in cameras.values())
    sampler = Sampler(shape.vertices, shape.triangles, texels, float(finest), config.blend.weights)
    given = over_views(
        lambda camera: (
            folder.read_view(camera, "confidence"),
            folder.read_mask(camera),
            folder.read_half_view(camera, "diffuse_normal"),
        ),
        [camera.id for camera in cameras.values()],
        AHEAD,
    )
    for (index, camera), (_, maps) in zip(cameras.items(), given, strict=True):
        views[camera.id] = sampler.look(camera, *maps)
        seen.add(views[camera.id].reading, index)
        progress(len(views), total)
    del sampler, maps
    best = seen.best
    if not best.any():
        raise AtlasError(
            out,
            found="no view that sees the registered mesh",
            expected="masks and confidences above 0 on it",
            hint="Do rig.json and the mesh share world coordinates?",
        )
    facts = _facts(shape, config, best, list(views.values()))
    with Behind(AHEAD) as behind:
        gutter = gutter_sources(shape.raster.face >= 0, config.gutter_px)
        size = shape.raster.face.shape

        def write(name: str, values: np.ndarray) -> None:
            outside = -1.0 if name == "view" else 0.0
            image = picture(values, size, flat, gutter, outside, MAPS[name].half)
            behind.do(folder.write_atlas, name, image)

        write("position", texels.positions)
        write("view", seen.heaviest)
        write("confidence", best)
        write("coverage", seen.count)
        skin = skin_vertices(template, config.skin_margin_mm)
        write("skin", shape.whole(skin).astype(np.float32))
        del texels, seen
        mirror = mirrored_vertices(template.mesh.vertices, config.mirror_mm)
        fill = MeshFill(shape.vertices, shape.triangles, shape.raster, flat, best, mirror)
        kind = np.round(shape.at(fill.kind[:, None].astype(float)))[:, 0]
        write("filled", np.where(best > 0, 0, np.clip(kind, 1, BY_DIFFUSION)))
        del kind
        values = _blended(
            folder, views, names, best, config, lambda n: progress(n + len(cameras), total)
        )
        views.clear()
        normals = shape.normals()
        first = 0
        for number, name in enumerate(names, 1):
            own = values[:, first : first + MAPS[name].channels]
            first += MAPS[name].channels
            if name in NORMALS:
                # Unseen texels have the mesh's own normal.
                unit_towards(own, normals, best)
            else:
                towards(own, fill.vertex_values(own), shape.raster, shape.triangles, flat, best)
            write(name, own)
            if name == "specular_normal":
                write("tangent_normal", shape.tangent(own))
            progress(total - len(names) + number, total)
    written = ["tangent_normal"] if "specular_normal" in names else []
    for name in MAPS.keys() - {*OWN, *names, *written}:
        # Of an earlier run with other settings: of another mesh, or of other views.
        folder.atlas_path(name).unlink(missing_ok=True)
    return {**facts, "maps": [*names, *written]}


def _blended(
    folder: ProcessedFolder,
    views: dict[str, ViewSamples],
    names: list[str],
    best: np.ndarray,
    config: AtlasConfig,
    done: Callable[[int], None],
) -> np.ndarray:
    """(k, d) float32 blended values of some maps, their channels one after the other."""
    channels = sum(MAPS[name].channels for name in names)
    values = np.zeros((len(best), room(channels)), np.float32)
    blender = Blender(best, list(views.values()), config.blend)
    place = {camera: number for number, camera in enumerate(views)}

    def side(camera: str) -> np.ndarray:
        window = views[camera].window
        pictures = (folder.read_half_view(camera, name)[window] for name in names)
        return side_by_side(pictures, channels)

    looking = [camera for camera, samples in views.items() if len(samples.reading.slot)]
    given = over_views(side, looking, AHEAD)
    for count, camera in enumerate(looking, 1):
        # No name and no loop may hold a view's pictures while the next but one are read.
        blender.add(place[camera], next(given)[1], values)
        done(count)
    blender.finish(values)
    return values


def _registered(folder: ProcessedFolder, template: Template) -> Mesh:
    mesh = read_obj(folder.registered_mesh)
    if not np.array_equal(mesh.faces, template.mesh.faces) or mesh.uvs is None:
        raise AtlasError(
            folder.registered_mesh,
            found=f"{len(mesh.vertices)} vertices, {len(mesh.faces)} faces",
            expected=f"the topology and UV of template {template.name!r} "
            f"({len(template.mesh.vertices)} vertices, {len(template.mesh.faces)} faces)",
            hint="Run `register` again with this template.",
        )
    return mesh


def _cameras(session: Session, folder: ProcessedFolder, config: AtlasConfig) -> dict[int, Camera]:
    """Rig index to camera, of all with a folder of maps; every missing map is named at once."""
    have = set(folder.view_ids())
    cameras = {i: c for i, c in enumerate(session.rig.cameras) if c.id in have}
    if not cameras:
        raise AtlasError(folder.root / "views", found="no views of this rig", expected="some")
    problems: list[LightstageError] = []
    for camera in cameras.values():
        needed = {"confidence", "diffuse_normal", *config.maps} - set(OPTIONAL)
        for name in sorted(needed):
            path = folder.view_path(camera.id, name)
            if not path.is_file():
                problems.append(
                    AtlasError(
                        path,
                        found="no such file",
                        expected=f"the map of {camera.id}",
                        hint="Run `separate` and `refine` first.",
                    )
                )
    if problems:
        raise one_error(problems)
    return cameras


def _trust(folder: ProcessedFolder, shape: Geometry, config: AtlasConfig) -> np.ndarray:
    """(n, 1) per vertex: 1 on the scan, falling to 0 at the largest gap."""
    scan = read_ply(folder.base_mesh)
    gap = ClosestPoints(scan.vertices, scan.triangles()).query(shape.vertices).distance_mm
    ratio: np.ndarray = np.clip(gap / config.largest_gap_mm, 0, 1)
    return (1 - ratio**2)[:, None]


def _facts(
    shape: Geometry, config: AtlasConfig, best: np.ndarray, views: list[ViewSamples]
) -> dict[str, Any]:
    flat = shape.tiles.flat
    seen = best > 0
    overlap = shape.overlap_share()
    warnings = []
    if overlap > MOST_OVERLAP:
        warnings.append(
            f"{overlap:.0%} of the template's UV overlaps: there one place's colours show at both"
        )
    return {
        "warnings": warnings,
        "uv_overlap_share": overlap,
        "rows": config.rows,
        "columns": config.rows * 2 // 3,
        "views": len(views),
        "covered_share": len(flat) / shape.raster.face.size,
        "seen_share": float(seen.mean()),
        "views_per_seen_texel": float(sum(len(v.reading.slot) for v in views) / seen.sum()),
        "texel_mm_median": shape.texel_mm_median(seen),
        "mean_confidence": float(best[seen].mean()),
    }
