"""Every error of a processed folder against truth, with units."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lightstage.commands import ProgressCallback, quiet
from lightstage.formats.files import read_json, write_json
from lightstage.formats.landmarks import read_points_mm
from lightstage.formats.mesh import read_obj, read_ply
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.template import default_template_path, load_template
from processing.closest import ClosestPoints
from processing.errors import EvaluationError
from processing.evaluation.config import AlbedoOf, EvaluateConfig
from processing.evaluation.maps import DIFFUSE, MapReader, map_errors, samples_of
from processing.evaluation.meshes import base_mesh_errors, registration_errors, true_skin_points
from processing.evaluation.texels import atlas_coverage, evaluate_maps, truth_in_atlas
from processing.lighting.interface import ENTERED_SHARE
from processing.pages import write_processed_report
from processing.reconstruction.pictures import write_distance
from processing.records import EVALUATION, read_report

SCHEMA = "lightstage.evaluation/1"


def evaluate(
    out: Path,
    truth: Path,
    template: Path | None = None,
    config: EvaluateConfig | None = None,
    progress: ProgressCallback = quiet,
) -> dict[str, Any]:
    """Compare a processed folder with truth; writes OUT/evaluation.json, and the mesh's distance
    to the truth into the report.

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
        EvaluationError: a folder that is missing, truth of another person or expression, nothing
            to compare, or pictures of different size; the albedo of incident light requested from
                maps whose report does not have the factor.
        FormatError: a damaged file.
    """
    config = config or EvaluateConfig()
    _require_same_person(out, truth)
    factor = _albedo_factor(out, config.albedo)
    found, true = ProcessedFolder(out), ProcessedFolder(truth)
    facts: dict[str, Any] = {}
    cameras = [c for c in true.view_ids() if found.view_path(c, "confidence").is_file()]
    parts = len(cameras) + 3
    pooled: dict[str, list[np.ndarray]] = {}
    per_view: dict[str, dict[str, float]] = {}
    skin_pixels = 0
    for index, camera in enumerate(cameras):
        skin = true.read_mask(camera)
        samples = samples_of(
            _reader(found, camera, factor), _reader(true, camera), skin, str(out), camera
        )
        # Skin of a view in which the result knows nothing counts too, as not covered.
        skin_pixels += int(skin.sum())
        if samples:
            per_view[camera] = map_errors(samples, int(skin.sum()))
            for name, values in samples.items():
                pooled.setdefault(name, []).append(values)
        progress(index + 1, parts)
    if per_view:
        joined = {name: np.concatenate(values) for name, values in pooled.items()}
        facts["views"] = {"cameras": len(per_view), **map_errors(joined, skin_pixels)}
        facts["view"] = per_view
    surface = true_skin_points(true, config.surface_points)
    if found.base_mesh.is_file() and true.base_mesh.is_file():
        mesh, true_mesh = read_ply(found.base_mesh), read_ply(true.base_mesh)
        within_mm = config.complete_within_mm
        facts["base_mesh"] = base_mesh_errors(mesh, true_mesh, surface, within_mm)
        whole = ClosestPoints(true_mesh.vertices, true_mesh.triangles())
        write_distance(out, mesh, whole.query(mesh.vertices).distance_mm)
    progress(parts - 2, parts)
    if found.registered_mesh.is_file() and true.registered_mesh.is_file():
        facts["registered_mesh"] = registration_errors(
            read_obj(found.registered_mesh),
            read_obj(true.registered_mesh),
            surface,
            read_points_mm(true.true_landmarks),
            load_template(template or default_template_path()),
        )
    progress(parts - 1, parts)
    if found.atlas_path("position").is_file() and true.atlas_path("confidence").is_file():
        maps = truth_in_atlas(out, truth)
        facts["atlas"] = evaluate_maps(out / "atlas", maps, factor)
        facts["atlas"]["coverage_share"] = atlas_coverage(found, surface)
        facts["atlas"]["position_median_mm"] = float(
            np.median(maps["distance_mm"][maps["confidence"] > 0])
        )
    progress(parts, parts)
    facts["albedo_of"] = config.albedo.value
    if len(facts) == 1:
        raise EvaluationError(
            out, found=f"nothing that {truth} also holds", expected="views, meshes or atlas"
        )
    write_json(out / EVALUATION, {"schema": SCHEMA, **facts})
    report = out / "report.json"
    if report.is_file():
        write_processed_report(out, read_json(report))
    return facts


def headline(facts: Mapping[str, Any]) -> dict[str, float]:
    """The few figures of `evaluate` that a person reads first, each with its unit in its name.

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


def _albedo_factor(out: Path, albedo: AlbedoOf) -> float:
    """What a folder's diffuse albedo is multiplied by to be a share of the light that is meant."""
    if albedo is AlbedoOf.ENTERED:
        return 1.0
    refined = dict(_report(out).get("stages", {})).get("refine", {})
    factor = refined.get(ENTERED_SHARE) if isinstance(refined, Mapping) else None
    if not isinstance(factor, float):
        raise EvaluationError(
            out / "report.json",
            field=f"stages.refine.{ENTERED_SHARE}",
            found=repr(factor),
            expected="the share of light that entered the skin",
            hint="Run `refine` again, or score by --albedo entered.",
        )
    return factor


def _reader(folder: ProcessedFolder, camera: str, factor: float = 1.0) -> MapReader:
    def read(name: str) -> np.ndarray:
        path = folder.view_path(camera, name)
        if not path.is_file():
            return np.zeros(0)
        values = folder.read_view(camera, name)
        return values * np.float32(factor) if name == DIFFUSE else values

    return read


def _require_same_person(out: Path, truth: Path) -> None:
    """EvaluationError where two folders are not there, or name different people."""
    for folder in (out, truth):
        if not folder.is_dir():
            raise EvaluationError(
                folder, found="no such folder", expected="a processed folder, then its truth"
            )
    reports = [_report(folder) for folder in (out, truth)]
    for field in ("subject", "expression"):
        ours, true = (report.get(field) for report in reports)
        if ours is not None and true is not None and ours != true:
            raise EvaluationError(
                truth,
                field=field,
                found=repr(true),
                expected=f"{ours!r}, as {out / 'report.json'} has it",
                hint="Errors against another person's truth mean nothing.",
            )


def _report(folder: Path) -> dict[str, Any]:
    path = folder / "report.json"
    return read_report(path) if path.is_file() else {}
