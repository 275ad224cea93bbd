"""Errors of an atlas, or of maps in any UV, against what the true surface holds there."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from lightstage.errors import FormatError
from lightstage.formats.exr import read_exr
from lightstage.formats.mesh import read_obj
from lightstage.formats.processed import ProcessedFolder
from processing.closest import ClosestPoints, sample_texture
from processing.errors import EvaluationError
from processing.evaluation.maps import ALBEDOS, DIFFUSE, NORMALS, map_errors, samples_of


def atlas_coverage(found: ProcessedFolder, surface_mm: np.ndarray) -> float:
    """The share of (n, 3) true skin points whose texel of the atlas has a confidence above 0."""
    mesh = read_obj(found.registered_mesh)
    if mesh.uvs is None:
        raise FormatError(found.registered_mesh, field="uv", found="none", expected="coordinates")
    closest = ClosestPoints(mesh.vertices, mesh.triangles()).query(surface_mm)
    corners = mesh.uvs[mesh.triangle_uvs()[closest.face]]
    seen = found.read_atlas("confidence") > 0
    uv = np.einsum("nck,nc->nk", corners, closest.barycentric)
    return float(seen[texel_of(uv, *seen.shape)].mean()) if len(uv) else 0.0


def texel_of(uv: np.ndarray, rows: int, columns: int) -> tuple[np.ndarray, np.ndarray]:
    """Row and column of the texel that holds each of (n, 2) texture coordinates."""
    column = np.clip((uv[:, 0] * columns).astype(int), 0, columns - 1)
    row = np.clip(((1 - uv[:, 1]) * rows).astype(int), 0, rows - 1)
    return row, column


def truth_in_atlas(out: Path, truth: Path) -> dict[str, np.ndarray]:
    """The truth's maps in the atlas of a processed folder, whatever the truth's own UV.

    Each covered texel of OUT's position map takes what the true surface holds at its closest point.

    Args:
        out: the processed folder.
        truth: truth, with registered_mesh.obj and atlas/ in the person's own UV.

    Returns:
        The truth's map names, (rows, columns[, 3]) float32, in world axes; `confidence` is 1 where
        the texel is covered and is on true skin; `position` is the true point; `distance_mm` how
        far OUT's point was from it. Zero where the atlas is not covered.
    """
    found, true = ProcessedFolder(out), ProcessedFolder(truth)
    mesh = read_obj(true.registered_mesh)
    if mesh.uvs is None:
        raise FormatError(true.registered_mesh, field="uv", found="none", expected="coordinates")
    covered = found.read_atlas("confidence") > 0
    position = found.read_atlas("position")
    closest = ClosestPoints(mesh.vertices, mesh.triangles()).query(position[covered])
    uv = np.einsum("nck,nc->nk", mesh.uvs[mesh.triangle_uvs()[closest.face]], closest.barycentric)
    names = [n for n in (*ALBEDOS, *NORMALS) if true.atlas_path(n).is_file()]
    maps = {name: true.read_atlas(name) for name in names}
    skin = true.read_atlas("confidence") > 0
    normals = [maps[name] for name in NORMALS if name in maps]
    surface = np.any([(image != 0).any(axis=2) for image in normals], axis=0) if normals else skin

    def spread(values: np.ndarray) -> np.ndarray:
        image = np.zeros((*covered.shape, values.shape[1]), np.float32)
        image[covered] = values
        return image[:, :, 0] if values.shape[1] == 1 else image

    out_maps: dict[str, np.ndarray] = {}
    for name, image in maps.items():
        values = sample_texture(image.reshape(*surface.shape, -1), surface, uv)
        if name in NORMALS:
            length = np.linalg.norm(values, axis=1, keepdims=True)
            values = np.divide(values, length, out=np.zeros_like(values), where=length > 0)
        out_maps[name] = spread(values)
    everywhere = np.ones_like(skin)
    share = sample_texture(skin[:, :, None].astype(float), everywhere, uv)
    out_maps["confidence"] = spread((share > 0.5).astype(float))
    out_maps["position"] = spread(closest.point_mm)
    out_maps["distance_mm"] = spread(closest.distance_mm[:, None])
    return out_maps


def evaluate_maps(
    predicted: Path, truth: Mapping[str, np.ndarray], albedo_factor: float = 1.0
) -> dict[str, float]:
    """Errors of a folder of maps (an atlas, or what inference wrote) against maps in the same UV.

    Args:
        predicted: folder of NAME.exr.
        truth: (rows, columns[, 3]) maps as `truth_in_atlas` gives; the places where its
            confidence is above 0 are scored.
        albedo_factor: the folder's diffuse albedo is multiplied by it.

    Returns:
        As `map_errors`; where the folder holds a confidence map it is heeded.
    """
    skin = np.asarray(truth["confidence"]) > 0

    def found(name: str) -> np.ndarray:
        path = predicted / f"{name}.exr"
        if path.is_file():
            values = read_exr(path, finite=True)
            return values * np.float32(albedo_factor) if name == DIFFUSE else values
        return np.ones(skin.shape) if name == "confidence" else np.zeros(0)

    def true(name: str) -> np.ndarray:
        return truth.get(name, np.zeros(0))

    samples = samples_of(found, true, skin, str(predicted), "maps")
    if not samples:
        raise EvaluationError(
            predicted, found="no scored texel", expected="maps over the truth's skin"
        )
    return map_errors(samples, int(skin.sum()))
