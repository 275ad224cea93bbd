"""A user's own mesh in place of a reconstructed one, and meshes of what else casts shadows.

Neither is moved: both must be where the photographs show them. That is compared with points that
the photographs alone gave, features matched between views.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from lightstage.counting import counted
from lightstage.formats.mesh import Mesh, read_mesh
from lightstage.meshlab import cleaned
from lightstage.rig import Camera
from processing.closest import ClosestPoints
from processing.errors import ReconstructionError
from processing.rays import MeshRays
from processing.reconstruction.config import ReconstructConfig
from processing.units import MM, SMALLEST_MM, largest_side, likely_unit

FEWEST_POINTS = 20
"""Fewer matched points do not show where a head is."""
FARTHEST_MM = 3.0
"""Median distance of matched points to a mesh that shows the same head; those of the scanned head
are within .3."""
LOOK_PX = 20_000
"""About so many pixels of each view decide which way faces point, and what an occluder hides."""
MOST_HIDDEN = 0.5
"""Share of the skin that occluders may hide from the cameras."""
FIT_ROUNDS = 60
FIT_SHARE = 0.8
"""Nearest points by which a fit is sought; the others may be where the mesh has nothing."""


class Given(NamedTuple):
    """A mesh as it is used.

    Attributes:
        mesh: mm, world, triangles; faces point outward.
        facts: for the report, JSON-ready.
        warnings: what the user should know.
    """

    mesh: Mesh
    facts: dict[str, Any]
    warnings: list[str]


def require_given(config: ReconstructConfig) -> None:
    """Read the meshes that are named, before work is done that one of them would waste.

    Raises:
        FormatError: no such file, or no mesh.
        ReconstructionError: a mesh in another unit than mm.
    """
    for name in filter(None, (config.mesh, config.occluders)):
        read_given(Path(name))


def given_mesh(path: Path, cameras: Sequence[Camera], points_mm: np.ndarray) -> Given:
    """Read a head's mesh, clean it, turn its faces outward, and hold it against the photographs.

    Args:
        path: .ply or .obj, mm, in the rig's axes.
        cameras: of the session.
        points_mm: (n, 3) matched points, by the rig's poses.

    Raises:
        FormatError: no such file, or no mesh.
        ReconstructionError: another unit or another pose than the photographs'.
    """
    mesh, removed, note = cleaned(read_given(path), path.name)
    warnings = [note] if note else []
    if _inside_out(path, mesh, cameras):
        mesh = dataclasses.replace(mesh, faces=np.ascontiguousarray(mesh.faces[:, ::-1]))
        warnings.append(f"the faces of {path.name} pointed inward and were turned")
    facts: dict[str, Any] = {"normals": "none were needed: the mesh was given"}
    facts |= {"given_mesh": path.name, "given_mesh_cleaned": removed}
    if len(points_mm) < FEWEST_POINTS:
        found = counted(len(points_mm), "point")
        warnings.append(
            f"whether {path.name} is where the photographs show the head could not be checked: "
            f"{found} matched between them, {FEWEST_POINTS} needed"
        )
        return Given(mesh, facts, warnings)
    closest = ClosestPoints(mesh.vertices, mesh.faces)
    apart_mm = float(np.median(closest.query(points_mm).distance_mm))
    facts |= {"points_to_mesh_mm": round(apart_mm, 3), "matched_points": len(points_mm)}
    if apart_mm > FARTHEST_MM:
        raise ReconstructionError(
            path,
            found=f"a mesh that points of the photographs miss by {apart_mm:.1f} mm (median of "
            f"{len(points_mm)})",
            expected=f"at most {FARTHEST_MM:g} mm: this head as it sat, mm, in the rig's axes",
            hint=_better_place(closest, points_mm, apart_mm),
        )
    return Given(mesh, facts, warnings)


def facts_of_occluders(
    path: Path, occluders: Mesh, skin: Mesh, cameras: Sequence[Camera]
) -> dict[str, Any]:
    """What a given mesh of clothes, hair, glasses, a headrest hides; for the report, JSON-ready.

    Args:
        path: where it was read from.
        occluders: mm, world.
        skin: the head's mesh.
        cameras: of the session.

    Raises:
        ReconstructionError: a mesh that hides the face.
    """
    alone = MeshRays(skin.vertices, skin.triangles())
    both = MeshRays(skin.vertices, skin.triangles(), occluders)
    seen = left = 0
    for camera in cameras:
        small = _small(camera)
        seen += int((alone.cast_camera(small).face >= 0).sum())
        left += int((both.cast_camera(small).face >= 0).sum())
    hidden = 1 - left / max(seen, 1)
    if hidden > MOST_HIDDEN:
        raise ReconstructionError(
            path,
            found=f"a mesh that hides {hidden:.0%} of the skin from the cameras",
            expected=f"at most {MOST_HIDDEN:.0%}: what is not skin",
            hint="Cut the skin out of it; it is in base_mesh.ply.",
        )
    return {"occluders": path.name, "occluders_hide_share": round(hidden, 4)}


def read_given(path: Path) -> Mesh:
    """Read a mesh, as triangles.

    Raises:
        FormatError: no such file, or no mesh.
        ReconstructionError: too small to be in mm.
    """
    mesh = read_mesh(path)
    unit = likely_unit(mesh.vertices)
    if unit is not MM:
        raise ReconstructionError(
            path,
            field="vertices",
            found=f"a mesh whose largest side is {largest_side(mesh.vertices):.3g}",
            expected=f"mm, so at least {SMALLEST_MM:g}",
            hint=f"Is it in {unit.name}? Then multiply it by {unit.mm:g}.",
        )
    return Mesh(mesh.vertices, mesh.triangles())


def _small(camera: Camera) -> Camera:
    """The camera with about `LOOK_PX` pixels."""
    pixels = camera.width_px * camera.height_px
    return camera.scaled(min(1.0, (LOOK_PX / pixels) ** 0.5))


def _inside_out(path: Path, mesh: Mesh, cameras: Sequence[Camera]) -> bool:
    """Whether most of what the cameras see of a mesh are its insides.

    Raises:
        ReconstructionError: no camera sees it.
    """
    rays = MeshRays(mesh.vertices, mesh.faces)
    corners = mesh.vertices[mesh.faces]
    outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    front = back = 0
    for camera in cameras:
        face = rays.cast_camera(_small(camera)).face
        face = face[face >= 0]
        toward = camera.centre_mm - corners[face].mean(axis=1)
        facing = np.einsum("nk,nk->n", outward[face], toward)
        front, back = front + int((facing > 0).sum()), back + int((facing < 0).sum())
    if front + back == 0:
        raise ReconstructionError(
            path,
            found="a mesh that no camera of the rig sees",
            expected="this head as it sat, mm, in the rig's axes",
            hint="Is it in its scanner's own axes? Bring it to the rig's first.",
        )
    return back > front


def _better_place(closest: ClosestPoints, points_mm: np.ndarray, apart_mm: float) -> str:
    """Where the mesh would fit, by turns of nearest points and rigid motion [Besl1992]."""
    moved = points_mm
    for _ in range(FIT_ROUNDS):
        near = closest.query(moved)
        some = near.distance_mm <= np.quantile(near.distance_mm, FIT_SHARE)
        moved = _onto(moved, moved[some], near.point_mm[some].astype(float))[0]
    left_mm = float(np.median(closest.query(moved).distance_mm))
    if left_mm > FARTHEST_MM or left_mm > apart_mm / 2:
        return "Is it of another person or another expression, or far from its place?"
    # The points were moved onto the mesh; the mesh has to go the other way.
    back, turn = _onto(moved, moved, points_mm)
    shift = back.mean(axis=0) - moved.mean(axis=0)
    return (
        f"It would fit within {left_mm:.2f} mm if it were moved by ({shift[0]:.1f}, "
        f"{shift[1]:.1f}, {shift[2]:.1f}) mm and turned by "
        f"{np.degrees(turn.magnitude()):.1f} degrees."
    )


def _onto(
    points_mm: np.ndarray, source_mm: np.ndarray, target_mm: np.ndarray
) -> tuple[np.ndarray, Rotation]:
    """Points moved as (n, 3) sources best move rigidly to their targets, and the turn in it."""
    middle, goal = source_mm.mean(axis=0), target_mm.mean(axis=0)
    turn, _ = Rotation.align_vectors(target_mm - goal, source_mm - middle)
    return turn.apply(points_mm - middle) + goal, turn
