"""Stage `register`: landmarks, pose, shape model, non-rigid ICP; the template fitted to a scan."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from lightstage.commands import ProgressCallback, quiet
from lightstage.counting import counted
from lightstage.errors import FaceError
from lightstage.faces.weights import require_weights
from lightstage.formats.files import write_json
from lightstage.formats.landmarks import LANDMARKS, read_clicked
from lightstage.formats.mesh import Mesh, read_ply, vertex_normals, write_obj
from lightstage.formats.processed import HEAD_SCHEMA, ProcessedFolder
from lightstage.formats.session import Session
from lightstage.formats.template import Template
from processing.colour import srgb_from_linear
from processing.errors import RegistrationError
from processing.frames.read import read_frames
from processing.rays import MeshRays
from processing.registration.areas import areas_of
from processing.registration.config import NonrigidConfig, RegisterConfig
from processing.registration.ears import ears_in_place, find_ears
from processing.registration.flips import against_scan
from processing.registration.landmarks import triangulate
from processing.registration.modes import fit_modes
from processing.registration.nonrigid import Fit, fit_nonrigid
from processing.registration.providers import (
    CommandLandmarks,
    DetectedLandmarks,
)
from processing.registration.residual import residual, scan_in_common, write_residual
from processing.registration.rigid import Similarity, robust_umeyama
from processing.registration.start import first_pose, named, require_surface
from processing.registration.target import Target, quieted, sky_share
from processing.splitting import unsplit

CLICK = (
    "Click them in the photographs (docs/registration.md shows landmarks.json), or name a program "
    "as landmark_command in the table [register] of --config."
)
DETECTOR = "detector"
ENOUGH_FACES = 100_000
"""A mesh that was split for its finest relief is taken as it was before, where it had so many."""


def register(
    session: Session,
    out: Path,
    template: Template,
    config: RegisterConfig,
    progress: ProgressCallback = quiet,
) -> dict[str, Any]:
    """Register a session's base mesh; writes registered_mesh.obj, head_from_world.json and,
    for the report, work/registration/residual.npz and .png.

    Args:
        session: with landmarks.json in its folder, unless they are to be found in the views.
        out: processed folder with base_mesh.ply.
        template: what is fitted to the scan.
        config: settings.
        progress: called with (done, total).

    Returns:
        Facts for the report, JSON-ready.

    Raises:
        RegistrationError: no landmarks, or landmarks that do not fit scan and template.
        FormatError: no mesh.
    """
    folder = ProcessedFolder(out)
    scan = unsplit(read_ply(folder.base_mesh), ENOUGH_FACES)
    points_px, by = _landmarks(session, folder, template, config)
    found = triangulate(
        points_px,
        {camera.id: camera for camera in session.rig.cameras},
        agree_mm=config.detected_agree_mm if by == DETECTOR else config.click_agree_mm,
        surface=MeshRays(scan.vertices, scan.triangles()),
    )
    with named(folder.base_mesh, session.root / LANDMARKS if by == LANDMARKS else None):
        vertices, facts = register_mesh(scan, found.points_mm, template, config, progress)
    registered = template.mesh.with_vertices(vertices)
    write_obj(registered, folder.registered_mesh)
    left = residual(scan, vertices, template.mesh.triangles())
    write_residual(out, left, registered, scan)
    head_from_world = head_pose(vertices, template)
    write_json(
        folder.head_pose,
        {
            "schema": HEAD_SCHEMA,
            "template": template.name,
            "head_from_world": head_from_world.matrix().tolist(),
        },
    )
    several = found.views >= 2
    rays = found.residual_mm[several]
    return {
        "landmarks_by": by,
        "landmarks_triangulated": int(several.sum()),
        "landmarks_of_one_view": int((found.views == 1).sum()),
        "landmark_rays_rms_mm": float(np.sqrt(np.mean(rays**2))) if several.any() else None,
        "residual_median_mm": float(np.nanmedian(np.abs(left.distance_mm))),
        "residual_angle_median_deg": float(np.nanmedian(left.angle_deg)),
        "clicks_left_out": [str(outlier) for outlier in found.outliers],
        **facts,
    }


def _landmarks(
    session: Session, folder: ProcessedFolder, template: Template, config: RegisterConfig
) -> tuple[dict[str, np.ndarray], str]:
    """Camera id to (68, 2) pixels, and who gave them."""
    if config.landmark_command:
        finder = CommandLandmarks(config.landmark_command)
        return finder.find(_pictures(session, folder)), "program"
    if (session.root / LANDMARKS).is_file():
        return read_clicked(session.root / LANDMARKS, session.rig), LANDMARKS
    pictures = _pictures(session, folder)
    found = DetectedLandmarks(template).find(pictures)
    if not found:
        raise RegistrationError(
            session.root,
            field="landmarks",
            found=f"no face in {counted(len(pictures), 'view')}, and no {LANDMARKS}",
            expected="a face in two or more",
            hint=CLICK,
        )
    return found, DETECTOR


def _pictures(session: Session, folder: ProcessedFolder) -> dict[str, np.ndarray]:
    """Camera id to (h, w, 3) uint8: its view's albedo, or its brightest photograph."""
    pictures = {}
    for camera in sorted(set(folder.view_ids()) & {c.id for c in session.rig.cameras}):
        if folder.view_path(camera, "diffuse_albedo").is_file():
            linear = folder.read_view(camera, "diffuse_albedo")
        else:  # photographs that give no normals give no albedo either
            linear = read_frames(folder.root, camera).brightest()
        lit = linear[folder.read_mask(camera)]
        white = max(float(np.quantile(lit, 0.99)), 1e-6) if len(lit) else 1.0
        pictures[camera] = (255 * srgb_from_linear(np.clip(linear / white, 0, 1))).astype(np.uint8)
    return pictures


def require_landmarks(session: Session, config: RegisterConfig) -> None:
    """Make sure that landmarks are there, or that somebody can find them.

    Raises:
        FormatError: landmarks.json is not in its form, or names a camera that the rig lacks.
        RegistrationError: there are none and no detector.
    """
    if config.landmark_command:
        return
    if (session.root / LANDMARKS).is_file():
        read_clicked(session.root / LANDMARKS, session.rig)
        return
    try:
        require_weights()
    except FaceError as error:
        raise RegistrationError(
            session.root / LANDMARKS,
            found="no such file, and no detector",
            expected="68 iBUG landmarks in two cameras or more",
            hint=f"{CLICK} Or install the detector: {error.hint}",
        ) from None


def register_mesh(
    scan: Mesh,
    landmarks_mm: np.ndarray,
    template: Template,
    config: RegisterConfig,
    progress: ProgressCallback = quiet,
) -> tuple[np.ndarray, dict[str, Any]]:
    """Fit the template to a scan.

    Args:
        scan: triangles in mm, world; may be a part of a head.
        landmarks_mm: (68, 3) on the scan, NaN where unknown.
        template: topology, landmarks, and modes where it has them.
        config: settings.
        progress: called with (done, total).

    Returns:
        (n, 3) the template's vertices in the world, mm, and facts for a report.

    Raises:
        RegistrationError: fewer than four landmarks or all in one plane, other units, mirrored, or
            landmarks that are not on the scan.
    """
    require_surface(scan)
    triangles = template.mesh.triangles()
    target = Target(quieted(scan, config.quiet_rounds))
    known = np.isfinite(landmarks_mm).all(axis=1)
    start = first_pose(target, landmarks_mm, known, template)
    hidden = ~open_to_sky(template.mesh.vertices, triangles, config.least_open_sky)
    hidden[template.landmarks] = False
    fit = fit_modes(template, triangles, target, landmarks_mm, start, config.modes, free=hidden)

    offset = landmarks_mm - fit.vertices[template.landmarks]
    gap = np.linalg.norm(offset, axis=1)
    wrong = _unsupported(template.mesh.vertices[template.landmarks], offset, config)
    kept = np.flatnonzero(known & ~wrong)
    ears = _region(template, "ears")

    def fitted(
        start: np.ndarray, settings: NonrigidConfig, shown: ProgressCallback, **given: Any
    ) -> Fit:
        return fit_nonrigid(
            start,
            triangles,
            target,
            template.landmarks[kept],
            landmarks_mm[kept],
            settings,
            hidden=hidden,
            progress=shown,
            **given,
        )

    begin, found = fit.vertices, []
    both_ways, in_place = np.zeros_like(ears), np.zeros_like(ears)
    if ears.any() and config.ears.sought:
        rough = fitted(begin, config.nonrigid.down_to(config.ears_after_mm), quiet, free=ears)
        found = find_ears(rough.vertices, triangles, ears, target, config.ears)
        plate = config.nonrigid.plate
        if found:
            begin = ears_in_place(rough.vertices, triangles, found, plate, config.ears.blend_mm)
        for ear, _ in found:
            away = cKDTree(begin[ear]).query(begin)[0]
            both_ways |= (away <= config.nonrigid.both_ways.around_mm) & ~hidden
            in_place[ear] = True
    result = fitted(
        begin,
        config.nonrigid,
        progress,
        intricate=ears & ~in_place,
        both_ways=both_ways | in_place,
        in_place=in_place,
    )
    contradicted = np.zeros(len(gap), bool)
    contradicted[kept[result.contradicted]] = True
    kept = kept[~result.contradicted]
    left = np.linalg.norm(result.vertices[template.landmarks] - landmarks_mm, axis=1)[kept]
    facts: dict[str, Any] = {
        "vertices": len(result.vertices),
        "matched_share": float(result.matched.mean()),
        "template_to_scan_median_mm": _quantile(result.distance_mm[result.matched], 0.5),
        "template_to_scan_p95_mm": _quantile(result.distance_mm[result.matched], 0.95),
        **scan_in_common(scan, template.mesh.with_vertices(result.vertices), areas_of(template)),
        "landmarks_used": len(kept),
        "landmarks_left_out": [
            f"landmark {i} ({gap[i]:.1f} mm from the fitted model)" for i in np.flatnonzero(wrong)
        ]
        + [f"landmark {i} (contradicted by all others)" for i in np.flatnonzero(contradicted)],
        "landmarks_mean_mm": float(left.mean()),
        "landmarks_max_mm": float(left.max()),
        "model_landmarks_mean_mm": float(gap[kept].mean()),
        "size_against_template": fit.world_from_head.scale,
        "triangles_flipped": int(result.faulty.sum()),
        "triangles_flipped_before_mending": result.mended,
        "triangles_against_scan": int(against_scan(result.vertices, triangles, target).sum()),
        "ears_found": len(found),
        "rounds": result.rounds,
        "matches_kept_share": result.kept_share,
        "solver_residual": result.residual,
    }
    return result.vertices, facts


def head_pose(vertices: np.ndarray, template: Template) -> Similarity:
    """The rigid head_from_world of a registered mesh: robust, so that a moved jaw does not turn it.

    Args:
        vertices: (n, 3) mm, world.
        template: whose axes are the head frame.
    """
    # The neck bends and its length is anyone's: skin above the chin, ears aside, carries the pose.
    head = template.mesh.vertices
    face = _region(template, "skin") if "skin" in template.regions else np.ones(len(head), bool)
    face &= (head[:, 1] > head[template.landmarks[8], 1]) & ~_region(template, "ears")
    return robust_umeyama(vertices[face], head[face])[0]


def open_to_sky(vertices: np.ndarray, triangles: np.ndarray, least_share: float) -> np.ndarray:
    """Which vertices see the outside: the inside of mouth and nose does not.

    Args:
        vertices: (n, 3) mm.
        triangles: (t, 3).
        least_share: of all directions that must be unblocked.

    Returns:
        (n,) bool.
    """
    normals = vertex_normals(vertices, triangles)
    wide: np.ndarray = sky_share(MeshRays(vertices, triangles), vertices, normals) >= least_share
    return wide


def _region(template: Template, name: str) -> np.ndarray:
    """(n,) bool: vertices of a region; none where the template does not have it."""
    inside = np.zeros(len(template.mesh.vertices), bool)
    inside[template.regions.get(name, np.zeros(0, int))] = True
    return inside


def _unsupported(places: np.ndarray, offset: np.ndarray, config: RegisterConfig) -> np.ndarray:
    """(68,) bool: landmarks far from the fitted model that no neighbour follows.

    A jaw opened farther than the model can moves several landmarks alike; a wrong one is alone.

    Args:
        places: (68, 3) on the template, mm.
        offset: (68, 3) from the fitted model to the landmark, NaN where unknown.
        config: settings.
    """
    known = np.flatnonzero(np.isfinite(offset).all(axis=1))
    gap = np.linalg.norm(offset[known], axis=1)
    between = np.linalg.norm(places[known, None] - places[None, known], axis=2)
    near = np.argsort(between, axis=1)[:, 1:7]
    unlike = np.linalg.norm(offset[known][near] - offset[known][:, None], axis=2)
    alone = (unlike > 0.5 * gap[:, None]).all(axis=1)
    wrong = np.zeros(len(offset), bool)
    wrong[known] = (gap > config.landmark_outlier_mm) & alone
    return wrong


def _quantile(values: np.ndarray, share: float) -> float | None:
    return float(np.quantile(values, share)) if len(values) else None
