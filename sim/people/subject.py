"""Subject: a person with known shape and skin, ready to be lit."""

from __future__ import annotations

import dataclasses

import numpy as np

from lightstage.formats.mesh import Mesh


@dataclasses.dataclass(frozen=True)
class Subject:
    """A person, placed in the stage: world axes, mm, head near the origin, face toward +z.

    Attributes:
        name: pseudonym.
        expression: such as ``neutral``.
        mesh: with UV.
        diffuse_albedo: (rows, columns, 3) float32 linear, 1 = perfect white, in the mesh's UV.
        specular_albedo: (rows, columns) float32, reflectance at normal incidence (skin about .028).
        roughness: (rows, columns) float32, m of the facets' distribution.
        normal: (rows, columns, 3) float32 unit, world axes: the surface's own, with its finest
            relief. Zero where no surface is.
        translucency: (rows, columns) float32, 0..1.
        landmarks_mm: (68, 3) iBUG landmarks on the surface.
        skin: (rows, columns) bool, texels that are face skin or lips: what is scored.
        head_from_world: (3, 4) rigid, to the template's axes.
        source: who made it; a scan's author is named wherever a picture of it is shown.
        distribution: of the facets that mirror: ``beckmann`` or ``ggx``.
        anisotropy: (rows, columns) float32 in 0..0.9, or None where the lobe is round. The lobe's
            m is m / a along the UV's u tangent and m a across it, a = sqrt(1 - 0.9 anisotropy).
        synthetic: drawn from a model: nobody exists who could be recognised or asked for consent.
    """

    name: str
    expression: str
    mesh: Mesh
    diffuse_albedo: np.ndarray
    specular_albedo: np.ndarray
    roughness: np.ndarray
    normal: np.ndarray
    translucency: np.ndarray
    landmarks_mm: np.ndarray
    skin: np.ndarray
    head_from_world: np.ndarray
    source: str
    distribution: str = "beckmann"
    anisotropy: np.ndarray | None = None
    synthetic: bool = False
