"""A fitted head with openings and what shows in them: mouth and eyes."""

from __future__ import annotations

import dataclasses

import numpy as np

from learning.export.morphs import axes_of
from learning.export.parts.eyes import BROWN, IRIS_MM, PUPIL_MM, eyes, lids_of_looks
from learning.export.parts.mouth import mouth
from learning.export.parts.opened import CENTRE_MM, is_ours, opened, template_lines
from learning.export.parts.part import Part
from learning.export.source import Source
from lightstage.formats.mesh import vertex_normals
from processing.atlas.tangents import tangent_frames

BRIGHTEST = 0.3
"""Mean albedo of an iris; what is painted brighter is no iris."""


@dataclasses.dataclass(frozen=True)
class Furnished:
    """A head as glTF and the page show it.

    Attributes:
        source: the head; where there are parts with openings.
        morphs: by name (n', 3) offsets of its vertices, mm.
        parts: beside the skin; none of a captured head or another template's.
    """

    source: Source
    morphs: dict[str, np.ndarray]
    parts: tuple[Part, ...] = ()


def furnished(source: Source, morphs: dict[str, np.ndarray]) -> Furnished:
    """Open a fitted head between lips and lids, and put mouth and eyes there.

    A captured head keeps the eyes that it was captured with.

    Args:
        source: the head, neutral.
        morphs: by name (n, 3) offsets of its vertices, mm.
    """
    if source.photo_mm is None or not is_ours(source.mesh):
        return Furnished(source, morphs)
    skin = opened(source.mesh)
    mesh = skin.mesh
    assert mesh.uvs is not None
    triangles = mesh.triangles()
    normals = vertex_normals(mesh.vertices, triangles)
    frames = tangent_frames(mesh.vertices, triangles, mesh.uvs, mesh.triangle_uvs(), normals)
    cut = dataclasses.replace(source, mesh=mesh, normals=normals, frames=frames)
    moved = {name: skin.carried(offsets) for name, offsets in morphs.items()}
    looks = lids_of_looks(moved, len(mesh.vertices))
    turn = axes_of(source.mesh, template_lines().mesh)
    places = mesh.vertices @ turn.T
    local = {name: offsets @ turn.T for name, offsets in (moved | looks).items()}
    parts = [*eyes(places, local, _iris(source)), *mouth(skin, places, local)]
    back = tuple(
        dataclasses.replace(
            part,
            places=part.places @ turn,
            morphs={name: offsets @ turn for name, offsets in part.morphs.items()},
        )
        for part in parts
    )
    return Furnished(cut, moved | looks, back)


def _iris(source: Source) -> np.ndarray:
    """(3,) linear albedo of the irises as painted; brown where it is too light for one."""
    lines, texels = template_lines(), source.raster.texels()
    own = source.raster.at(lines.mesh.vertices, source.mesh.triangles(), texels)
    albedo = source.maps["diffuse_albedo"].reshape(-1, 3)[texels].astype(float)
    x, y = np.abs(own[:, 0]) - CENTRE_MM[0], own[:, 1] - CENTRE_MM[1]
    away = np.hypot(x, y)
    ring = (away > PUPIL_MM) & (away < 0.8 * IRIS_MM) & (own[:, 2] > CENTRE_MM[2])
    colour = np.median(albedo[ring], axis=0) if ring.any() else BROWN
    return colour if colour.mean() < BRIGHTEST else BROWN
