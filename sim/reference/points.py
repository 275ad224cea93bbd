"""Points of a subject's surface and what its skin is there."""

from __future__ import annotations

import dataclasses

import numpy as np

from lightstage.formats.mesh import vertex_normals
from sim.errors import SimError
from sim.light.texture import sample
from sim.people.subject import Subject

START_MM = 0.02
"""A ray that leaves the surface starts this far above it."""


@dataclasses.dataclass(frozen=True)
class Points:
    """n places on the surface, all float32.

    Attributes:
        position: (n, 3) mm, world.
        start: (n, 3) where rays that leave start.
        smooth: (n, 3) unit normals of the mesh.
        normal: (n, 3) unit normals that shade, with the finest relief.
        view: (n, 3) unit directions in which the light is asked for.
        albedo: (n, 3) diffuse albedo.
        specular: (n,) reflectance at normal incidence.
        roughness: (n,) m.
        translucency: (n,) 0..1.
        uv: (n, 2) v upward.
    """

    position: np.ndarray
    start: np.ndarray
    smooth: np.ndarray
    normal: np.ndarray
    view: np.ndarray
    albedo: np.ndarray
    specular: np.ndarray
    roughness: np.ndarray
    translucency: np.ndarray
    uv: np.ndarray

    def __len__(self) -> int:
        return len(self.position)

    def part(self, chosen: np.ndarray | slice) -> Points:
        """The chosen ones of these points, a slice or (k,) indices."""
        return Points(*(getattr(self, f.name)[chosen] for f in dataclasses.fields(self)))


class Skin:
    """A subject's surface, asked by triangle and barycentric weights."""

    def __init__(self, subject: Subject) -> None:
        """SimError when Mitsuba's model cannot hold this skin."""
        if subject.anisotropy is not None and np.any(subject.anisotropy > 0):
            raise SimError(
                f"subject {subject.name}",
                field="anisotropy",
                found="above 0",
                expected="0 for the reference, whose skin (roughplastic) has a round lobe",
                hint="Use --light fast.",
            )
        self.subject = subject
        self.triangles = subject.mesh.triangles()
        self.uv_triangles = subject.mesh.triangle_uvs()
        self.vertices = np.asarray(subject.mesh.vertices, np.float64)
        self.normals = vertex_normals(self.vertices, self.triangles)

    def points(
        self, face: np.ndarray, weights: np.ndarray, view: np.ndarray | None = None
    ) -> Points:
        """What the skin is at places of the mesh.

        Args:
            face: (n,) triangles.
            weights: (n, 3) barycentric.
            view: (n, 3) unit; the shading normals where None.
        """
        subject, uvs = self.subject, self.subject.mesh.uvs
        assert uvs is not None
        corners = self.vertices[self.triangles[face]]
        corner_normals = self.normals[self.triangles[face]]
        position = np.einsum("nck,nc->nk", corners, weights)
        smooth = unit(np.einsum("nck,nc->nk", corner_normals, weights))
        uv = np.einsum("nck,nc->nk", uvs[self.uv_triangles[face]], weights)
        fine = sample(subject.normal, uv)
        # Outside the texture's charts the mesh's own normal shades.
        drawn = np.linalg.norm(fine, axis=1) >= 0.25
        normal = np.where(drawn[:, None], unit(fine), smooth)
        # The smooth surface lies above the flat triangle where the skin bulges; a ray that started
        # on the triangle would meet its neighbours at grazing angles [Hanika2021].
        height = np.einsum("nck,nck->nc", position[:, None] - corners, corner_normals)
        lift = np.einsum("nc,nck,nc->nk", np.maximum(-height, 0.0), corner_normals, weights)
        flat = unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
        return Points(
            position=position.astype(np.float32),
            start=(position + lift + START_MM * flat).astype(np.float32),
            smooth=smooth.astype(np.float32),
            normal=normal.astype(np.float32),
            view=(normal if view is None else view).astype(np.float32),
            albedo=sample(subject.diffuse_albedo, uv),
            specular=sample(subject.specular_albedo, uv),
            roughness=sample(subject.roughness, uv),
            translucency=sample(subject.translucency, uv),
            uv=uv.astype(np.float64),
        )


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors (.., 3) of length one; zero stays zero."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)
