"""Stage `atlas`: every map of the views merged into the template's UV tile."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from lightstage.commands import ProgressCallback, quiet
from lightstage.errors import ConfigError, LightstageError, one_error
from lightstage.formats.mesh import Mesh, read_obj, read_ply, vertex_normals
from lightstage.formats.processed import MAPS, ProcessedFolder
from lightstage.formats.session import Session
from lightstage.formats.template import Template
from lightstage.rig import Camera
from processing.atlas.blend import BlendConfig, Blender
from processing.atlas.fill import BY_DIFFUSION, MeshFill, gutter_sources, mirrored_vertices
from processing.atlas.raster import Raster, overlap_share, rasterise, texel_size_mm
from processing.atlas.tangents import tangent_frames, to_tangent_space
from processing.atlas.weights import Texels, ViewSamples, view_samples
from processing.errors import AtlasError
from processing.registration.target import Target

BLENDED = (
    "diffuse_albedo",
    "specular_albedo",
    "diffuse_normal",
    "specular_normal",
    "ambient_occlusion",
)
NORMALS = ("diffuse_normal", "specular_normal")
OPTIONAL = ("roughness",)
"""Blended where every view has it."""
MOST_OVERLAP = 0.01
FILL_WEIGHT = 0.02
"""The guess for unseen texels counts like a view of this weight, which feathers its rim."""


@dataclasses.dataclass(frozen=True)
class AtlasConfig:
    """The atlas's settings."""

    rows: int = 6144
    """Columns are two thirds of it."""
    gutter_px: int = 16
    """How far the islands' colours reach beyond their borders."""
    maps: tuple[str, ...] = BLENDED + OPTIONAL
    """Which of the views' maps are merged; the others are not read."""
    largest_gap_mm: float = 1.5
    """Where the registered mesh is farther than this from the scan, views are not believed."""
    mirror_mm: float = 3.0
    """A template's vertex whose mirror image has none nearer than this has no other side."""
    blend: BlendConfig = dataclasses.field(default_factory=BlendConfig)

    def __post_init__(self) -> None:
        """Refuse rows that no 3:2 atlas has, before any stage runs."""
        if self.rows < 6 or self.rows % 3:
            raise ConfigError(
                "atlas", field="rows", found=str(self.rows), expected="a multiple of 3, 6 at least"
            )
        unknown = sorted(set(self.maps) - {*BLENDED, *OPTIONAL})
        if unknown:
            raise ConfigError(
                "atlas",
                field="maps",
                found=", ".join(unknown),
                expected=f"some of {', '.join(BLENDED + OPTIONAL)}",
            )


@dataclasses.dataclass(frozen=True)
class _Geometry:
    """The atlas's covered texels and the mesh they lie on."""

    raster: Raster
    flat: np.ndarray
    mesh: Mesh
    triangles: np.ndarray
    vertices: np.ndarray
    vertex_normals: np.ndarray

    def at(self, values: np.ndarray) -> np.ndarray:
        """(k, c) float32 of per-vertex values."""
        return self.raster.at(values, self.triangles, self.flat)


def atlas(
    session: Session,
    out: Path,
    template: Template,
    config: AtlasConfig,
    progress: ProgressCallback = quiet,
) -> dict[str, Any]:
    """Merge the views' maps; writes atlas/NAME.exr for all map names, in world axes.

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
    total = len(cameras) * (1 + len(names))
    shape = _geometry(mesh, config)
    texels = Texels(
        shape.at(shape.vertices),
        _unit(shape.at(shape.vertex_normals)),
        shape.at(_trust(folder, shape, config))[:, 0],
    )
    views: list[ViewSamples] = []
    best = np.zeros(len(shape.flat), np.float32)
    heaviest = np.full(len(shape.flat), -1, np.float32)
    coverage = np.zeros(len(shape.flat), np.float32)
    middle = shape.vertices.mean(axis=0)
    finest = min(np.linalg.norm(c.centre_mm - middle) / c.fx_px for c in cameras.values())
    for index, camera in cameras.items():
        found = view_samples(
            camera,
            shape.vertices,
            shape.triangles,
            texels,
            folder.read_view(camera.id, "confidence"),
            folder.read_mask(camera.id),
            folder.read_view(camera.id, "diffuse_normal"),
            float(finest),
            config.blend.weights,
        )
        better = found.weight > best[found.slot]
        best[found.slot[better]] = found.weight[better]
        heaviest[found.slot[better]] = index
        coverage[found.slot] += 1
        views.append(found)
        progress(len(views), total)
    if not best.any():
        raise AtlasError(
            out,
            found="no view that sees the registered mesh",
            expected="masks and confidences above 0 on it",
            hint="Do rig.json and the mesh share world coordinates?",
        )
    gutter = gutter_sources(shape.raster.face >= 0, config.gutter_px)

    def write(name: str, values: np.ndarray) -> None:
        image = np.zeros((shape.raster.face.size, MAPS[name].channels), np.float32)
        if name == "view":
            image[:] = -1
        image[shape.flat] = values.reshape(len(values), -1)
        image[gutter[0]] = image[gutter[1]]
        folder.write_atlas(name, image.reshape(*shape.raster.face.shape, -1))

    normals = texels.normals
    write("position", texels.positions)
    write("view", heaviest)
    write("confidence", best)
    write("coverage", coverage)
    facts = _facts(shape, config, best, views)
    del texels, heaviest, coverage
    mirror = mirrored_vertices(template.mesh.vertices, config.mirror_mm)
    fill = MeshFill(shape.vertices, shape.triangles, shape.raster, shape.flat, best, mirror)
    kind = np.round(shape.at(fill.kind[:, None].astype(float)))[:, 0]
    write("filled", np.where(best > 0, 0, np.clip(kind, 1, BY_DIFFUSION)))
    share = (best / (best + FILL_WEIGHT))[:, None]
    for number, name in enumerate(names, 1):
        blender = Blender(len(shape.flat), MAPS[name].channels, config.blend)
        for view, camera in enumerate(cameras.values()):
            if len(views[view].slot):
                image = folder.read_view(camera.id, name)
                blender.add(views[view], image.reshape(*image.shape[:2], -1))
            progress(number * len(cameras) + view + 1, total)
        values = blender.result()
        if name in NORMALS:
            # Unseen texels have the mesh's own normal.
            values = _unit(_unit(values) * share + normals * (1 - share))
        else:
            guess = fill.vertex_values(values)
            values *= share
            values += (1 - share) * shape.at(guess)
        write(name, values)
        if name == "specular_normal":
            write("tangent_normal", _tangent(shape, values))
    written = ["tangent_normal"] if "specular_normal" in names else []
    return {**facts, "maps": [*names, *written]}


def _tangent(shape: _Geometry, world: np.ndarray) -> np.ndarray:
    """(k, 3) tangent-space normals."""
    mesh = shape.mesh
    assert mesh.uvs is not None  # _geometry refused it
    normals = shape.vertex_normals
    frames = tangent_frames(shape.vertices, shape.triangles, mesh.uvs, mesh.triangle_uvs(), normals)
    return to_tangent_space(world, shape.raster, shape.flat, shape.triangles, normals, frames)


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


def _geometry(mesh: Mesh, config: AtlasConfig) -> _Geometry:
    triangles = mesh.triangles()
    if mesh.uvs is None:
        raise AtlasError("registered mesh", found="no UV", expected="the template's UV")
    raster = rasterise(mesh.uvs, mesh.triangle_uvs(), config.rows, config.rows * 2 // 3)
    normals = vertex_normals(mesh.vertices, triangles)
    return _Geometry(raster, raster.texels(), mesh, triangles, mesh.vertices, normals)


def _trust(folder: ProcessedFolder, shape: _Geometry, config: AtlasConfig) -> np.ndarray:
    """(n, 1) per vertex: 1 on the scan, falling to 0 at the largest gap."""
    gap = Target(read_ply(folder.base_mesh)).closest(shape.vertices).distance_mm
    ratio: np.ndarray = np.clip(gap / config.largest_gap_mm, 0, 1)
    return (1 - ratio**2)[:, None]


def _unit(vectors: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    unit: np.ndarray = np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 1e-9)
    return unit


def _facts(
    shape: _Geometry, config: AtlasConfig, best: np.ndarray, views: list[ViewSamples]
) -> dict[str, Any]:
    columns = config.rows * 2 // 3
    mesh = shape.mesh
    assert mesh.uvs is not None  # _geometry refused it
    size = texel_size_mm(
        mesh.vertices, shape.triangles, mesh.uvs, mesh.triangle_uvs(), config.rows, columns
    )
    seen = best > 0
    overlap = overlap_share(mesh.uvs, mesh.triangle_uvs(), shape.raster)
    warnings = []
    if overlap > MOST_OVERLAP:
        warnings.append(
            f"{overlap:.0%} of the template's UV overlaps: there one place's colours show at both"
        )
    return {
        "warnings": warnings,
        "uv_overlap_share": overlap,
        "rows": config.rows,
        "columns": columns,
        "views": len(views),
        "covered_share": len(shape.flat) / shape.raster.face.size,
        "seen_share": float(seen.mean()),
        "views_per_seen_texel": float(sum(len(v.slot) for v in views) / seen.sum()),
        "texel_mm_median": float(np.median(size[shape.raster.face.ravel()[shape.flat][seen]])),
        "mean_confidence": float(best[seen].mean()),
    }
