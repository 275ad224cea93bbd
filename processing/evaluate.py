"""Every error of a processed folder against truth, with units.

Only pixels and texels are scored that are skin in the truth and of which the result claims to know
something (confidence above 0); the share of the skin that is so covered stands beside each error,
since a method may not shine by leaving out what is hard.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lightstage.commands import ProgressCallback, quiet
from lightstage.errors import FormatError
from lightstage.formats.exr import read_exr
from lightstage.formats.files import write_json
from lightstage.formats.landmarks import read_points_mm
from lightstage.formats.mesh import Mesh, read_obj, read_ply
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.template import Template, default_template_path, load_template
from processing.closest import ClosestPoints, sample_texture, weighted_quantile
from processing.colour import srgb_from_linear
from processing.errors import ProcessingError

SCHEMA = "lightstage.evaluation/1"
ALBEDOS = ("diffuse_albedo", "specular_albedo", "ambient_occlusion")
NORMALS = ("diffuse_normal", "specular_normal")
MapReader = Callable[[str], np.ndarray]


@dataclasses.dataclass(frozen=True)
class EvaluateConfig:
    """Settings of the evaluation.

    Attributes:
        complete_within_mm: a true surface point this near to the mesh counts as reconstructed.
        surface_points: at most so many of the pixels of true skin measure a mesh.
    """

    complete_within_mm: float = 0.5
    surface_points: int = 200_000


class EvaluationError(ProcessingError):
    """Result and truth that have nothing to compare."""


def evaluate(
    out: Path,
    truth: Path,
    template: Path | None = None,
    config: EvaluateConfig | None = None,
    progress: ProgressCallback = quiet,
) -> dict[str, Any]:
    """Compare a processed folder with truth; writes OUT/evaluation.json.

    Args:
        out: the processed folder.
        truth: truth in the processed folder's form.
        template: the template that `out` was registered to; the project's own by default.
        config: settings.
        progress: called after each part.

    Returns:
        JSON-ready facts under `views`, `view` (a camera each), `base_mesh`, `registered_mesh` and
        `atlas`: those of which both sides hold the files.

    Raises:
        EvaluationError: nothing to compare, or pictures of different size.
        FormatError: a damaged file.
    """
    config = config or EvaluateConfig()
    found, true = ProcessedFolder(out), ProcessedFolder(truth)
    facts: dict[str, Any] = {}
    cameras = [c for c in true.view_ids() if found.view_path(c, "confidence").is_file()]
    parts = len(cameras) + 3
    pooled: dict[str, list[np.ndarray]] = {}
    per_view: dict[str, dict[str, float]] = {}
    skin_pixels = 0
    for index, camera in enumerate(cameras):
        skin = true.read_mask(camera)
        samples = _samples(_reader(found, camera), _reader(true, camera), skin, str(out), camera)
        if samples:
            skin_pixels += int(skin.sum())
            per_view[camera] = map_errors(samples, int(skin.sum()))
            for name, values in samples.items():
                pooled.setdefault(name, []).append(values)
        progress(index + 1, parts)
    if per_view:
        joined = {name: np.concatenate(values) for name, values in pooled.items()}
        facts["views"] = {"cameras": len(per_view), **map_errors(joined, skin_pixels)}
        facts["view"] = per_view
    surface = _true_skin_points(true, config.surface_points)
    if found.base_mesh.is_file() and true.base_mesh.is_file():
        facts["base_mesh"] = base_mesh_errors(
            read_ply(found.base_mesh), read_ply(true.base_mesh), surface, config
        )
    progress(parts - 2, parts)
    if found.registered_mesh.is_file() and true.registered_mesh.is_file():
        facts["registered_mesh"] = registration_errors(
            read_obj(found.registered_mesh),
            read_obj(true.registered_mesh),
            surface,
            read_points_mm(truth / "landmarks_mm.json"),
            load_template(template or default_template_path()),
        )
    progress(parts - 1, parts)
    if found.atlas_path("position").is_file() and true.atlas_path("confidence").is_file():
        maps = truth_in_atlas(out, truth)
        facts["atlas"] = evaluate_maps(out / "atlas", maps)
        facts["atlas"]["coverage_share"] = atlas_coverage(found, surface)
        facts["atlas"]["position_median_mm"] = float(
            np.median(maps["distance_mm"][maps["confidence"] > 0])
        )
    progress(parts, parts)
    if not facts:
        raise EvaluationError(
            out, found=f"nothing that {truth} also holds", expected="views, meshes or atlas"
        )
    write_json(out / "evaluation.json", {"schema": SCHEMA, **facts})
    return facts


def headline(facts: Mapping[str, Any]) -> dict[str, float]:
    """The few figures of `evaluate` that a person looks at first, each with its unit in its name.

    Args:
        facts: as `evaluate` returns.
    """
    wanted = (
        ("views", "coverage_share"),
        ("views", "diffuse_albedo_rmse"),
        ("views", "specular_albedo_rmse"),
        ("views", "diffuse_normal_mean_deg"),
        ("views", "specular_normal_mean_deg"),
        ("base_mesh", "base_mesh_median_mm"),
        ("base_mesh", "skin_within_share"),
        ("registered_mesh", "skin_median_mm"),
        ("registered_mesh", "landmark_mean_mm"),
        ("atlas", "coverage_share"),
        ("atlas", "diffuse_albedo_rmse"),
        ("atlas", "diffuse_normal_mean_deg"),
    )
    return {
        f"{part}.{name}": round(facts[part][name], 4)
        for part, name in wanted
        if name in facts.get(part, {})
    }


def _reader(folder: ProcessedFolder, camera: str) -> MapReader:
    def read(name: str) -> np.ndarray:
        path = folder.view_path(camera, name)
        return folder.read_view(camera, name) if path.is_file() else np.zeros(0)

    return read


def _samples(
    found: MapReader, true: MapReader, skin: np.ndarray, where: str, field: str
) -> dict[str, np.ndarray]:
    """Values of both sides at the scored places: NAME and NAME/true, (n, c) each."""
    confidence = found("confidence")
    if confidence.shape != skin.shape:
        raise EvaluationError(
            where,
            field=field,
            found=f"maps of {confidence.shape}",
            expected=f"the truth's {skin.shape}",
            hint="Is this the truth of another session?",
        )
    scored = skin & (confidence > 0)
    samples: dict[str, np.ndarray] = {}
    if not scored.any():
        return samples
    for name in (*ALBEDOS, *NORMALS):
        mine, theirs = found(name), true(name)
        if mine.size and theirs.size:
            samples[name] = mine[scored].reshape(int(scored.sum()), -1).astype(float)
            samples[f"{name}/true"] = theirs[scored].reshape(int(scored.sum()), -1).astype(float)
    return samples


def map_errors(samples: Mapping[str, np.ndarray], skin_pixels: int) -> dict[str, float]:
    """Errors of maps at scored places.

    Args:
        samples: NAME and NAME/true, (n, c) float64 each.
        skin_pixels: how many places are skin in the truth.

    Returns:
        coverage_share; for albedos and occlusion NAME_rmse and NAME_bias (mean of found - true);
        for the specular albedo also the best constant's RMSE and the share of it that is left; for
        the diffuse albedo PSNR (peak 1) of linear and of sRGB values; for normals mean and median
        degrees. `diffuse_as_specular_normal_mean_deg` is what taking the diffuse normal for the
        specular one would score.
    """
    facts: dict[str, float] = {}
    for name in ALBEDOS:
        if name not in samples:
            continue
        difference = samples[name] - samples[f"{name}/true"]
        facts[f"{name}_rmse"] = _rms(difference)
        facts[f"{name}_bias"] = float(difference.mean())
    if "diffuse_albedo" in samples:
        mine, theirs = samples["diffuse_albedo"], samples["diffuse_albedo/true"]
        facts["diffuse_albedo_linear_psnr_db"] = psnr_db(mine, theirs)
        facts["diffuse_albedo_srgb_psnr_db"] = psnr_db(
            srgb_from_linear(mine), srgb_from_linear(theirs)
        )
    if "specular_albedo" in samples:
        theirs = samples["specular_albedo/true"]
        constant = _rms(theirs - theirs.mean())
        facts["specular_albedo_best_constant_rmse"] = constant
        if constant > 0:
            facts["specular_albedo_share_of_best_constant"] = (
                facts["specular_albedo_rmse"] / constant
            )
    for name in NORMALS:
        if name in samples:
            _add_angles(facts, name, samples[name], samples[f"{name}/true"])
    if "diffuse_normal" in samples and "specular_normal" in samples:
        angles = angle_deg(samples["diffuse_normal"], samples["specular_normal/true"])
        facts["diffuse_as_specular_normal_mean_deg"] = float(angles.mean())
    count = max((len(values) for values in samples.values()), default=0)
    return {"coverage_share": count / max(1, skin_pixels), **facts}


def _add_angles(facts: dict[str, float], name: str, mine: np.ndarray, theirs: np.ndarray) -> None:
    angles = angle_deg(mine, theirs)
    facts[f"{name}_mean_deg"] = float(angles.mean())
    facts[f"{name}_median_deg"] = float(np.median(angles))


def angle_deg(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angles between (n, 3) vectors of any length, (n,) degrees; 90 where one is zero."""
    # atan2 keeps small angles, where acos of a rounded dot product does not.
    cross = np.linalg.norm(np.cross(a, b), axis=1)
    dot = np.einsum("ni,ni->n", a, b)
    angles = np.degrees(np.arctan2(cross, dot))
    return np.where((cross == 0) & (dot == 0), 90.0, angles)


def psnr_db(found: np.ndarray, true: np.ndarray) -> float:
    """Peak signal-to-noise ratio in decibels for a peak of 1; at most 120."""
    return -20 * math.log10(max(_rms(found - true), 1e-6))


def _rms(difference: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(difference))))


def _true_skin_points(true: ProcessedFolder, most: int) -> np.ndarray:
    """(n, 3) points of the true skin that the cameras see, evenly from all views' pixels."""
    points = [
        true.read_view(camera, "position")[true.read_mask(camera)] for camera in true.view_ids()
    ]
    joined = np.concatenate(points) if points else np.zeros((0, 3), np.float32)
    return joined[:: max(1, -(-len(joined) // most))]


def base_mesh_errors(
    found: Mesh, true: Mesh, surface_mm: np.ndarray, config: EvaluateConfig
) -> dict[str, float]:
    """How far a reconstructed mesh lies from the true one, and how much of the face it has.

    Args:
        found: the reconstruction.
        true: the whole true mesh.
        surface_mm: (n, 3) points of true skin that the cameras saw.
        config: settings.

    Returns:
        base_mesh_median_mm and _p95_mm (reconstruction to truth, every part of it weighted by its
        area), skin_median_mm and skin_p95_mm (true skin to reconstruction) and the share of the
        skin within `complete_within_mm`.
    """
    triangles = found.triangles()
    corners = found.vertices[triangles]
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    if not area.any():
        raise EvaluationError("base mesh", found="no area", expected="a surface")
    away = ClosestPoints(true.vertices, true.triangles()).query(corners.mean(axis=1)).distance_mm
    facts = {
        "base_mesh_median_mm": weighted_quantile(away, area, 0.5),
        "base_mesh_p95_mm": weighted_quantile(away, area, 0.95),
    }
    if len(surface_mm):
        missing = ClosestPoints(found.vertices, triangles).query(surface_mm).distance_mm
        facts["skin_median_mm"] = float(np.median(missing))
        facts["skin_p95_mm"] = float(np.percentile(missing, 95))
        facts["skin_within_share"] = float((missing <= config.complete_within_mm).mean())
        facts["skin_within_mm"] = config.complete_within_mm
    return facts


def registration_errors(
    found: Mesh,
    true: Mesh,
    surface_mm: np.ndarray,
    landmarks_mm: np.ndarray,
    template: Template,
) -> dict[str, float]:
    """How far a registered template lies from the person, as a surface and as a correspondence.

    A surface error near zero with landmarks millimetres away is a failed registration that looks
    perfect, so both are said.

    Args:
        found: the registered template.
        true: the person's own mesh.
        surface_mm: (n, 3) points of true skin that the cameras saw.
        landmarks_mm: (68, 3) true landmarks, NaN where absent.
        template: what was registered.

    Returns:
        skin_median_mm and skin_p95_mm (true skin to registered surface), landmark_mean_mm and
        landmark_max_mm; correspondence_mean_mm over the template's skin where the person has the
        template's own topology, so that each vertex has a true place.
    """
    if len(found.vertices) != len(template.mesh.vertices):
        raise EvaluationError(
            "registered mesh",
            found=f"{len(found.vertices)} vertices",
            expected=f"the {len(template.mesh.vertices)} of template {template.name}",
            hint="Name the template that it was registered to.",
        )
    facts: dict[str, float] = {}
    if len(surface_mm):
        away = ClosestPoints(found.vertices, found.triangles()).query(surface_mm).distance_mm
        facts["skin_median_mm"] = float(np.median(away))
        facts["skin_p95_mm"] = float(np.percentile(away, 95))
    apart = np.linalg.norm(found.vertices[template.landmarks] - landmarks_mm, axis=1)
    apart = apart[np.isfinite(apart)]
    if len(apart):
        facts["landmark_mean_mm"] = float(apart.mean())
        facts["landmark_max_mm"] = float(apart.max())
    if np.array_equal(found.faces, true.faces) and "skin" in template.regions:
        skin = template.regions["skin"]
        facts["correspondence_mean_mm"] = float(
            np.linalg.norm(found.vertices[skin] - true.vertices[skin], axis=1).mean()
        )
    return facts


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
        the texel is covered and lies on true skin; `position` is the true point; `distance_mm` how
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


def evaluate_maps(predicted: Path, truth: Mapping[str, np.ndarray]) -> dict[str, float]:
    """Errors of a folder of maps (an atlas, or what inference wrote) against maps in the same UV.

    Args:
        predicted: folder of NAME.exr.
        truth: as `truth_in_atlas` gives; the places where its confidence is above 0 are scored.

    Returns:
        As `map_errors`; where the folder holds a confidence map it is heeded.
    """
    skin = np.asarray(truth["confidence"]) > 0

    def found(name: str) -> np.ndarray:
        path = predicted / f"{name}.exr"
        if path.is_file():
            return read_exr(path, finite=True)
        return np.ones(skin.shape) if name == "confidence" else np.zeros(0)

    def true(name: str) -> np.ndarray:
        return truth.get(name, np.zeros(0))

    samples = _samples(found, true, skin, str(predicted), "maps")
    if not samples:
        raise EvaluationError(
            predicted, found="no scored texel", expected="maps over the truth's skin"
        )
    return map_errors(samples, int(skin.sum()))


def picture_errors(found: np.ndarray, true: np.ndarray, mask: np.ndarray) -> dict[str, float]:
    """Errors of a linear picture over a mask.

    Args:
        found: (h, w, 3) linear.
        true: (h, w, 3) linear.
        mask: (h, w) bool, not empty.

    Returns:
        rmse (linear, white = 1), relative_rmse (of the true picture's RMS) and srgb_psnr_db.
    """
    if found.shape != true.shape or not mask.any():
        raise EvaluationError(
            "picture",
            found=f"shape {found.shape}, {int(mask.sum())} pixels",
            expected=f"shape {true.shape} and a mask",
        )
    mine, theirs = found[mask].astype(float), true[mask].astype(float)
    error = _rms(mine - theirs)
    return {
        "rmse": error,
        "relative_rmse": error / max(_rms(theirs), 1e-12),
        "srgb_psnr_db": psnr_db(srgb_from_linear(mine), srgb_from_linear(theirs)),
    }
