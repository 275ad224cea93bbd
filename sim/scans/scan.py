"""Any textured scan as a subject: unit, place, colour in linear light, and what it lacks made up.

A scan's colour is photographed skin under even light. It is taken as diffuse albedo as it is
(sRGB decoded to linear light): what shading and gloss the photographs baked in stays in. Gloss,
roughness and, without a normal map, the finest relief were not measured; they are made from the
colour's fine detail.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from lightstage.session import check_pseudonym
from sim.errors import SimError
from sim.people.person import FACE_MIDDLE_MM
from sim.people.subject import Subject
from sim.scans.checks import CheckConfig, MeshReport, check_scan, unit_of
from sim.scans.lps import head_from_landmarks
from sim.scans.maps import scan_maps
from sim.scans.pose import (
    head_from_box,
    median_edge,
    millimetres,
    read_landmarks,
    require_fit,
    require_near,
)
from sim.scans.reading import read_scan
from sim.scans.scan_file import ScanFile, read_picture
from sim.scans.subdivide import loop_subdivide

WORLD_SHIFT_MM = np.array([0.0, 0.0, 6.0]) - FACE_MIDDLE_MM
"""From the head frame to the stage: where a parametric person sits on average."""


@dataclasses.dataclass(frozen=True)
class ScanConfig:
    """How a scan is read.

    Attributes:
        units: ``mm``, ``cm``, ``m``, or millimetres a unit as a number; None for what the format
            has (glTF: metres), mm where it has none (OBJ).
        rows: of the textures; None for the colour texture's own. Columns keep its proportion.
        flip_v: the file's v runs against its format's rule.
        flip_normals: its triangles look inward.
        facet_mm: a mesh with a median edge above this is subdivided once, so that it shows none.
        relief_mm: height of the relief made from the colour's detail, where no normal map is.
        farthest_landmark_mm: a landmark farther from the surface is refused.
        largest_misfit_mm: landmarks that fit a head worse (rms, rigid) are refused.
        checks: of the mesh.
    """

    units: str | None = None
    rows: int | None = None
    flip_v: bool = False
    flip_normals: bool = False
    facet_mm: float = 2.5
    relief_mm: float = 0.04
    farthest_landmark_mm: float = 15.0
    largest_misfit_mm: float = 25.0
    checks: CheckConfig = dataclasses.field(default_factory=CheckConfig)


@dataclasses.dataclass(frozen=True)
class ScanReport:
    """What was found in the scan and assumed about it."""

    mesh: MeshReport
    mm_per_unit: float
    landmarks: int
    made_up: tuple[str, ...]

    def facts(self) -> dict[str, Any]:
        """For a command's last line."""
        return {
            "mm_per_unit": self.mm_per_unit,
            "landmarks": self.landmarks,
            "zero_area_triangles_dropped": self.mesh.zero_area,
            "holes_mm": [round(size, 1) for size in self.mesh.holes_mm],
            "neck_mm": round(self.mesh.neck_mm, 1),
            "edges_turned": self.mesh.turned,
            "made_up": list(self.made_up),
        }


def import_scan(
    path: Path,
    name: str,
    landmarks: Path | None = None,
    colour: Path | None = None,
    normals: Path | None = None,
    source: str = "",
    expression: str = "neutral",
    config: ScanConfig = ScanConfig(),
) -> tuple[Subject, ScanReport]:
    """Read a scan.

    With landmarks the head is turned and put upright into the stage, its head frame is theirs, and
    the skin that is scored is our own head's skin carried over. Without, the file must have +y up
    and the face toward +z (glTF's rule): crown and nose tip are placed at the height and depth of
    our own head's, every texel counts as skin, and landmarks are unknown (NaN).

    Args:
        path: .glb, .gltf or .obj.
        name: pseudonym.
        landmarks: JSON, scheme ibug68, with 68 ``points_mm`` (mm, the file's axes) or ``points``
            (the file's unit); null where unknown.
        colour: a texture in place of the file's own.
        normals: a tangent-space normal map in place of the file's own.
        source: who made the scan, to be named beside pictures of it.
        expression: what the face does.
        config: see there.

    Returns:
        The subject, and what was found and assumed.

    Raises:
        SimError: whatever `sim.scans.checks` refuses; no colour, a texture of other proportions
            than the colour, albedo below 0 or above 1, landmarks that are off the surface or fit no
            head.
        FormatError: a damaged file.
    """
    check_pseudonym(name, "name")
    check_pseudonym(expression, "expression")
    scan = _with_textures(read_scan(path), colour, normals, config)
    mm = millimetres(scan, config.units)
    marks, in_mm = None, False
    if landmarks is not None:
        marks, in_mm = read_landmarks(landmarks)
    if marks is not None and in_mm:
        marks = marks / mm
    unit_of(scan.mesh, marks, mm, path)
    mesh = scan.mesh.with_vertices(scan.mesh.vertices * mm)
    head_marks = np.full((68, 3), np.nan)
    if marks is None or landmarks is None:
        motion = head_from_box(mesh)
    else:
        require_near(mesh, marks * mm, landmarks, config.farthest_landmark_mm)
        motion = head_from_landmarks(marks * mm)
        require_fit(marks * mm, motion, landmarks, config.largest_misfit_mm)
        head_marks = (marks * mm) @ motion[:, :3].T + motion[:, 3]
    up = motion[1, :3]
    mesh, found = check_scan(mesh, path, config.checks, config.flip_normals, (up[0], up[1], up[2]))
    if median_edge(mesh) > config.facet_mm:
        mesh = loop_subdivide(mesh)
    head = mesh.vertices @ motion[:, :3].T + motion[:, 3]
    mesh = mesh.with_vertices(head + WORLD_SHIFT_MM)
    maps = scan_maps(scan, mesh, head, head_marks, config.rows, config.relief_mm)
    subject = Subject(
        name=name,
        expression=expression,
        mesh=mesh,
        diffuse_albedo=maps.diffuse_albedo,
        specular_albedo=maps.specular_albedo,
        roughness=maps.roughness,
        normal=maps.normal,
        translucency=maps.translucency,
        landmarks_mm=head_marks + WORLD_SHIFT_MM,
        skin=maps.skin,
        head_from_world=np.concatenate([np.eye(3), -WORLD_SHIFT_MM[:, None]], axis=1),
        source=source or f"scan {path.name}",
    )
    count = int(np.isfinite(head_marks).all(axis=1).sum())
    return subject, ScanReport(found, mm, count, maps.made_up)


def _with_textures(
    scan: ScanFile, colour: Path | None, normals: Path | None, config: ScanConfig
) -> ScanFile:
    if colour is not None:
        scan = dataclasses.replace(scan, colour=read_picture(colour), colour_factor=(1.0, 1.0, 1.0))
    if normals is not None:
        scan = dataclasses.replace(scan, normals=read_picture(normals))
    if scan.colour is None:
        raise SimError(
            scan.where,
            field="colour",
            found="no colour texture",
            expected="one that the file names, or --colour",
            hint="Without colour there is no albedo; for a face without a texture use import-ict.",
        )
    shape = scan.colour.pixels.shape
    for field, picture in (("normals", scan.normals), ("roughness", scan.roughness)):
        if picture is not None:
            other = picture.pixels.shape
            if abs(other[0] / other[1] / (shape[0] / shape[1]) - 1) > 0.01:
                raise SimError(
                    picture.where,
                    field=field,
                    found=f"{other[0]} rows x {other[1]} columns",
                    expected=f"the colour's proportions, {shape[0]} x {shape[1]}",
                    hint="All textures of a scan share one UV.",
                )
    if config.flip_v and scan.mesh.uvs is not None:
        uvs = np.stack([scan.mesh.uvs[:, 0], 1.0 - scan.mesh.uvs[:, 1]], axis=1)
        scan = dataclasses.replace(scan, mesh=dataclasses.replace(scan.mesh, uvs=uvs))
    return scan
