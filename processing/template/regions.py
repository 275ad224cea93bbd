"""Which vertices of somebody's mesh are skin, lips, eyes, ears and hair.

Where the mesh's maker does not give them, our own template is fitted to the mesh, roughly, and each
vertex is in the region of the place of ours that is nearest then.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from lightstage.commands import ProgressCallback, quiet
from lightstage.errors import FormatError
from lightstage.formats.fields import Fields
from lightstage.formats.files import read_json
from lightstage.formats.mesh import Mesh, connected, directed_edges, vertex_normals
from lightstage.formats.template import REGIONS, Template
from processing.registration.config import RegisterConfig
from processing.registration.flips import grown
from processing.registration.stage import open_to_sky, register_mesh
from processing.template.config import ImportConfig

EYES = (slice(36, 42), slice(42, 48))
"""Landmarks of the right and the left eye."""


def joined_to(landmarks: np.ndarray, triangles: np.ndarray, count: int) -> np.ndarray:
    """(n,) bool: vertices of the parts of a mesh that have a landmark."""
    part = connected(directed_edges(triangles), count)
    return np.asarray(np.isin(part, part[landmarks]))


def guessed_regions(
    mesh: Mesh,
    landmarks: np.ndarray,
    own: Template,
    config: ImportConfig,
    surface: np.ndarray | None = None,
    ears: bool = True,
    progress: ProgressCallback = quiet,
) -> dict[str, np.ndarray]:
    """Regions by our own template fitted to a mesh.

    Args:
        mesh: head frame, mm.
        landmarks: (68,) vertices.
        own: our template.
        config: settings.
        surface: (n,) bool, vertices that may be skin; None takes all parts that have a landmark.
        ears: fit ears as wholes, which takes half of the time; else their region is empty.
        progress: called with (done, total).

    Returns:
        By each name of `REGIONS`, sorted vertices; a region may be empty.

    Raises:
        RegistrationError: our template cannot be fitted to the mesh.
    """
    vertices, triangles = mesh.vertices, mesh.triangles()
    chosen = joined_to(landmarks, triangles, len(vertices)) if surface is None else surface
    outer = triangles[chosen[triangles].all(axis=1)]
    settings = RegisterConfig()
    rough = dataclasses.replace(
        settings,
        nonrigid=settings.nonrigid.down_to(config.region_stiffness_mm),
        ears=dataclasses.replace(settings.ears, sought=ears),
    )
    placed, _ = register_mesh(Mesh(vertices, outer), vertices[landmarks], own, rough, progress)
    normals = vertex_normals(vertices, outer)
    laid_normals = vertex_normals(placed, own.mesh.triangles())
    # Nearest in place and direction: the two sides of a lip or an ear are close to each other.
    radian_mm = settings.ears.radian_mm
    tree = cKDTree(np.concatenate([placed, radian_mm * laid_normals], axis=1))
    there = np.asarray(tree.query(np.concatenate([vertices, radian_mm * normals], axis=1))[1])
    near = np.linalg.norm(placed[there] - vertices, axis=1)
    agree = np.einsum("nk,nk->n", normals, laid_normals[there])
    open_air = open_to_sky(vertices, triangles, config.least_open_sky)
    beyond = near > config.region_gap_mm
    known = chosen & open_air & ~beyond
    known &= agree >= np.cos(np.deg2rad(config.region_angle_deg))
    out = {}
    for name in REGIONS:
        of_ours = np.zeros(len(placed), bool)
        of_ours[own.regions.get(name, np.zeros(0, int))] = True
        out[name] = np.flatnonzero(known & of_ours[there])
    # Shoulders, which our template does not have, are skin.
    out["skin"] = np.union1d(out["skin"], np.flatnonzero(chosen & open_air & beyond))
    if not ears:
        out["ears"] = out["ears"][:0]
    for name in ("hair", "ears"):
        whole = _closed(np.isin(np.arange(len(vertices)), out[name]), outer, config.gap_rings)
        out = {other: some[~whole[some]] for other, some in out.items()}
        out[name] = np.flatnonzero(whole)
    balls = eyeballs(vertices, landmarks, triangles, config) & ~chosen
    if balls.any():
        # Our own template's eyes are closed skin over the hole; here they are what fills it.
        out["skin"] = np.union1d(out["skin"], out["eyes"])
        out["eyes"] = np.flatnonzero(balls)
    return out


def _closed(chosen: np.ndarray, triangles: np.ndarray, rings: int) -> np.ndarray:
    """(n,) bool: vertices with the gaps between them filled that are narrower than 2 rings."""
    wide = grown(chosen, triangles, rings)
    return np.asarray(chosen | (wide & ~grown(~wide, triangles, rings)))


def eyeballs(
    vertices: np.ndarray, landmarks: np.ndarray, triangles: np.ndarray, config: ImportConfig
) -> np.ndarray:
    """(n,) bool: vertices of parts without a landmark that are wholly around an eye."""
    part = connected(directed_edges(triangles), len(vertices))
    far = np.full(len(vertices), np.inf)
    for eye in EYES:
        centre = vertices[landmarks[eye]].mean(axis=0)
        far = np.minimum(far, np.linalg.norm(vertices - centre, axis=1))
    farthest = np.zeros(int(part.max()) + 1)
    np.maximum.at(farthest, part, far)
    size = np.bincount(part)
    within = (farthest <= config.eye_within_mm) & (size > 3)
    within[part[landmarks]] = False
    return np.asarray(within[part])


def read_regions(path: Path, count: int) -> dict[str, np.ndarray]:
    """Regions of a file that names them: an object of lists of vertex indices.

    Args:
        path: JSON such as ``{"skin": [0, 1, ..], "lips": [..]}``, or a template.json.
        count: of the mesh's vertices.

    Raises:
        FormatError: an unknown region, or something else than indices of vertices.
    """
    value = Fields(read_json(path), path, "").rest()
    if "regions" in value:
        value = Fields(value["regions"], path, "regions").rest()
    named = {name: indices for name, indices in value.items() if name != "schema"}
    unknown = sorted(set(named) - set(REGIONS))
    if unknown or not named:
        raise FormatError(
            path,
            field="regions",
            found=", ".join(unknown)[:200] or "none",
            expected=", ".join(REGIONS),
        )
    out = {}
    for name, indices in named.items():
        right = isinstance(indices, list) and all(
            type(i) is int and 0 <= i < count for i in indices
        )
        if not right:
            raise FormatError(
                path,
                field=name,
                found="something else",
                expected=f"vertex indices below the mesh's {count} vertices",
            )
        out[name] = np.unique(np.array(indices, np.int64))
    return out
