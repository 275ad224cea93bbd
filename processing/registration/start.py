"""Where registration starts: a pose by landmarks, and what no pose can be found for."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from lightstage.formats.mesh import Mesh, vertex_normals
from lightstage.formats.template import Template
from processing.errors import RegistrationError
from processing.registration.rigid import Similarity, robust_umeyama, umeyama
from processing.registration.target import Target
from processing.units import CM, METRES, MM, Unit

SCAN, MARKS = "scan", "landmarks"
"""What errors are about, until `named` puts a file in their place."""
OFF_THE_SCAN = 0.25
"""Landmarks farther from the surface than this share of their own size are not on the scan."""
SIZES = (0.6, 1.6)
"""Landmarks in mm are so many times as far apart as the template's."""
SCAN_TIMES = 5.0
"""A scan in mm is at most so many times as large as the template, or as small: a body, a nose."""


@contextlib.contextmanager
def named(scan: Path | str, landmarks: Path | None = None) -> Iterator[None]:
    """Name what a scan and landmarks are from in errors of the block, which knows them as arrays.

    Args:
        scan: its file, or what it is.
        landmarks: their file; None where they were found on the scan.
    """
    try:
        yield
    except RegistrationError as error:
        if error.where not in (SCAN, MARKS):
            raise
        of_scan = error.where == SCAN
        raise RegistrationError(
            scan if of_scan or landmarks is None else landmarks,
            field=error.field if of_scan else ", ".join(filter(None, (MARKS, error.field))),
            found=error.found,
            expected=error.expected,
            hint=error.hint,
        ) from None


def require_surface(scan: Mesh) -> None:
    """Refuse a scan without a usable triangle or with vertices that are not finite.

    Raises:
        RegistrationError: see `first_pose`.
    """
    if not np.isfinite(scan.vertices).all():
        bad = int((~np.isfinite(scan.vertices)).any(axis=1).sum())
        raise RegistrationError(
            SCAN,
            field="vertices",
            found=f"{bad} with NaN or infinity",
            expected="finite mm",
            hint="Remove them in a mesh editor, or export the scan again.",
        )
    corners = scan.vertices[scan.triangles()]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    if not np.abs(cross).any():
        raise RegistrationError(
            SCAN,
            field="triangles",
            found=f"{len(corners)}, none with an area",
            expected="a surface",
            hint="A cloud of points must be meshed first.",
        )


def first_pose(
    target: Target, landmarks_mm: np.ndarray, known: np.ndarray, template: Template
) -> Similarity:
    """world_from_head by landmarks; refuses what cannot be aligned and names the reason.

    Args:
        target: the scan.
        landmarks_mm: (68, 3), NaN where unknown.
        known: (68,) bool.
        template: what is fitted to it.

    Returns:
        A similarity: its scale is the person's size, the scan's millimetres stay as they are.

    Raises:
        RegistrationError: too few landmarks, all in one plane, other units, mirrored, in another
            order, off the scan, or on its inside.
    """
    if known.sum() < 4:
        raise RegistrationError(
            MARKS,
            found=f"{int(known.sum())} of 68 known",
            expected="at least 4",
            hint="Mark eye corners, nose tip and mouth corners at least.",
        )
    world = landmarks_mm[known]
    head = template.mesh.vertices[template.landmarks[known]]
    spread = np.linalg.svd(world - world.mean(axis=0), compute_uv=False)
    if spread[2] < 0.02 * spread[0]:
        raise RegistrationError(
            MARKS,
            found="all in one plane",
            expected="points that span a volume",
            hint="Add some off that plane, such as the nose tip and the jaw line.",
        )
    _require_units(target, world, head, template)
    pose, residual = robust_umeyama(head, world, scale=True)
    mirrored = umeyama(head, world, scale=True, reflect=True)
    if np.linalg.det(mirrored.rotation) < 0:
        error = np.median(np.linalg.norm(mirrored.apply(head) - world, axis=1))
        if error < 0.5 * np.median(residual):
            raise RegistrationError(
                MARKS,
                found=f"a mirror image ({error:.1f} mm against {np.median(residual):.1f} mm)",
                expected="landmarks in iBUG's order, on a scan that is not mirrored",
                hint="Points 0 to 16 go from the person's right ear to the left one; was an axis "
                "of the scan negated?",
            )
    if np.median(residual) > 20:
        raise RegistrationError(
            MARKS,
            found=f"{np.median(residual):.0f} mm median from the template's after alignment",
            expected="less than 20 mm",
            hint="Are they in iBUG's order?",
        )
    closest = target.closest(world)
    away = np.median(closest.distance_mm)
    if away > 20:
        raise RegistrationError(
            MARKS,
            found=f"{away:.0f} mm median from the scan's surface",
            expected="points on the scan",
            hint="Are landmarks and scan in the same coordinates?",
        )
    outward = vertex_normals(template.mesh.vertices, template.mesh.triangles())
    outward = outward[template.landmarks[known]] @ pose.rotation.T
    agree = np.einsum("nk,nk->n", outward, closest.normal)
    if np.median(agree) < -0.5:
        raise RegistrationError(
            SCAN,
            field="normals",
            found="triangles that point inward",
            expected="counter-clockwise seen from outside",
            hint="Turn its faces over in a mesh editor.",
        )
    return pose


def landmarks_unit(scan: Mesh, points: np.ndarray, template: Template) -> Unit:
    """In which unit a scan and landmarks on it are: the one that gives the template's size.

    Args:
        scan: in that unit.
        points: (68, 3) in the scan's coordinates, NaN where unknown.
        template: mm.

    Returns:
        mm where no unit is certain; `first_pose` reports what is wrong then.
    """
    known = np.isfinite(points).all(axis=1)
    if known.sum() < 4 or not len(scan.vertices):
        return MM
    size = _size(points[known])
    away = np.median(Target(scan).closest(points[known]).distance_mm)
    if away > OFF_THE_SCAN * size:
        return MM
    fits = size / _size(template.mesh.vertices[template.landmarks[known]])
    return next((u for u in (CM, METRES) if SIZES[0] < u.mm * fits < SIZES[1]), MM)


def _require_units(target: Target, world: np.ndarray, head: np.ndarray, template: Template) -> None:
    """Refuse other units than mm, and report whether landmarks or scan or both have them.

    Landmarks that are on the scan are in its units. Of those that are not, what is of the
    template's size is right: the scan's size alone would not decide, as it may be a part of a head
    or a body.
    """
    size = _size(world) / _size(head)
    away = np.median(target.closest(world).distance_mm)
    apart = away > OFF_THE_SCAN * _size(world)
    scan = _size(target.vertices[np.unique(target.triangles)]) / _size(template.mesh.vertices)
    fits, scan_fits = SIZES[0] < size < SIZES[1], 1 / SCAN_TIMES < scan < SCAN_TIMES
    scale = "(metres x 1000, centimetres x 10)"
    if fits and apart and not scan_fits:
        where, found = SCAN, f"a scan {scan:.3g} times as large as the template, and landmarks "
        found += f"{size:.3g} times"
        hint = f"The landmarks are in mm. Scale the scan {scale}."
    elif not fits and apart and scan_fits:
        where, found = MARKS, f"landmarks {size:.3g} times as far apart as the template's, "
        found += f"and a scan {scan:.3g} times as large"
        hint = f"The scan is in mm. Scale the landmarks {scale}."
    elif not fits:
        where, found = MARKS, f"a scan {size:.3g} times as large as the template"
        hint = (
            f"Scale the scan and its landmarks {scale}, or the template if that one is not in mm."
        )
    else:
        return
    raise RegistrationError(where, field="units", found=found, expected="both in mm", hint=hint)


def _size(points: np.ndarray) -> float:
    """Median distance from the median point, which a few wrong points do not move."""
    return float(np.median(np.linalg.norm(points - np.median(points, axis=0), axis=1)))
