"""A subject in the stage: what each camera sees of it, and which lights each pixel sees."""

from __future__ import annotations

import dataclasses
import functools
import itertools

import numpy as np
import open3d
from scipy import ndimage

from lightstage.formats.mesh import vertex_normals
from lightstage.rig import Camera
from sim.light.render import ROUND, Lobe
from sim.light.shadows import fill_between, mark_coarse, set_bits
from sim.light.texture import sample, tangent_frames
from sim.people.subject import Subject

CHUNK_RAYS = 2_000_000
TILE_POINTS = 65_536
"""Points whose pairs with all lights are held at a time."""
START_MM = 0.05
"""A shadow ray starts this far along the face's normal, so that it does not meet its own face."""
EDGE_MM = 4.0
"""Neighbouring pixels whose depths differ by more have an edge between them."""
COARSE_PX = 4
"""Shadow rays are cast on every fourth pixel of every fourth row first; see `visible_lights`."""


@dataclasses.dataclass(frozen=True)
class Surface:
    """What a camera's pixels see of the subject: one entry for each of n pixels that see it.

    Attributes:
        camera: the view.
        pixel: (n,) int64 index in row order.
        position: (n, 3) float32 mm, world.
        start: (n, 3) float32 where shadow rays start: the place on the smooth surface.
        geometric: (n, 3) float32 smooth normals of the mesh.
        normal: (n, 3) float32 fine normals that shade.
        view: (n, 3) float32 unit directions to the camera.
        albedo: (n, 3) float32 diffuse albedo.
        specular: (n,) float32 reflectance at normal incidence.
        roughness: (n,) float32 m.
        skin: (n,) bool, scored.
        face: (n,) int32 triangle.
        barycentric: (n, 3) float32.
        lobe: shape of the lobes beyond m.
    """

    camera: Camera
    pixel: np.ndarray
    position: np.ndarray
    start: np.ndarray
    geometric: np.ndarray
    normal: np.ndarray
    view: np.ndarray
    albedo: np.ndarray
    specular: np.ndarray
    roughness: np.ndarray
    skin: np.ndarray
    face: np.ndarray
    barycentric: np.ndarray
    lobe: Lobe = ROUND

    def picture(self, values: np.ndarray) -> np.ndarray:
        """Per-pixel values (n,) or (n, k) as a picture (h, w) or (h, w, k), zero elsewhere."""
        shape = (self.camera.height_px, self.camera.width_px, *values.shape[1:])
        out = np.zeros((shape[0] * shape[1], *values.shape[1:]), values.dtype)
        out[self.pixel] = values
        return out.reshape(shape)


class Scene:
    """A subject prepared for rays."""

    def __init__(self, subject: Subject) -> None:
        self.subject = subject
        self.triangles = subject.mesh.triangles()
        self.vertices = np.asarray(subject.mesh.vertices, np.float64)
        self.normals = vertex_normals(self.vertices, self.triangles)
        self._rays = open3d.t.geometry.RaycastingScene()
        self._rays.add_triangles(
            open3d.core.Tensor(self.vertices.astype(np.float32)),
            open3d.core.Tensor(self.triangles.astype(np.uint32)),
        )

    def hit(
        self, origins_mm: np.ndarray, directions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """First hits of rays.

        Args:
            origins_mm: (n, 3) or (3,).
            directions: (n, 3) unit.

        Returns:
            (n,) int32 triangle (-1 for none), (n, 3) float32 barycentric weights, (n,) float32
            distance in mm.
        """
        rays = np.empty((len(directions), 6), np.float32)
        rays[:, :3], rays[:, 3:] = origins_mm, directions
        found = self._rays.cast_rays(open3d.core.Tensor(rays))
        face = found["primitive_ids"].numpy().astype(np.int64)
        distance = found["t_hit"].numpy()
        face[~np.isfinite(distance)] = -1
        uv = found["primitive_uvs"].numpy()
        weights = np.stack([1 - uv[:, 0] - uv[:, 1], uv[:, 0], uv[:, 1]], axis=1)
        return face.astype(np.int32), weights, distance

    def blocked(self, start_mm: np.ndarray, target_mm: np.ndarray) -> np.ndarray:
        """(n,) bool: whether anything is between (n, 3) starts and (n, 3) targets."""
        rays = np.concatenate([start_mm, target_mm - start_mm], axis=1).astype(np.float32)
        # 0.999: a camera or light that stands on a surface must not hide behind it.
        return self._rays.test_occlusions(open3d.core.Tensor(rays), tnear=0.0, tfar=0.999).numpy()

    def surface(self, camera: Camera) -> Surface:
        """What a camera sees."""
        origin, directions = camera.pixel_rays()
        flat = directions.reshape(-1, 3)
        return self._seen(camera, np.arange(len(flat)), origin, flat)

    def edge_samples(self, surface: Surface, samples: int) -> tuple[np.ndarray, Surface]:
        """More rays where one ray a pixel would draw steps: at silhouettes and depth edges.

        Args:
            surface: what one ray a pixel sees.
            samples: a side: samples x samples rays, on a regular grid in each pixel.

        Returns:
            (k,) the pixels that are sampled again, and what their rays see: `pixel` then holds a
            pixel once for each of its rays that meets the subject.
        """
        camera = surface.camera
        depth = np.linalg.norm(surface.position - camera.centre_mm, axis=1)
        picture = surface.picture(depth.astype(np.float32))
        step = ndimage.maximum_filter(picture, 3) - ndimage.minimum_filter(picture, 3)
        edge = np.flatnonzero(step > EDGE_MM)
        offsets = (np.arange(samples) + 0.5) / samples - 0.5
        directions = []
        for dy, dx in itertools.product(offsets, offsets):
            moved = dataclasses.replace(camera, cx_px=camera.cx_px - dx, cy_px=camera.cy_px - dy)
            directions.append(moved.pixel_rays()[1].reshape(-1, 3)[edge])
        rays = np.concatenate(directions)
        pixel = np.tile(edge, samples * samples)
        return edge, self._seen(camera, pixel, camera.centre_mm, rays)

    def _seen(
        self, camera: Camera, pixel: np.ndarray, origin: np.ndarray, directions: np.ndarray
    ) -> Surface:
        """What rays (n, 3) of pixels (n,) see."""
        flat = directions
        face, weights, _ = self.hit(origin, flat)
        # The inside of an open mesh (a neck's end) is no skin: it is seen as background.
        points = self.vertices[self.triangles[np.maximum(face, 0)]]
        outward = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
        met = np.nonzero((face >= 0) & (np.sum(outward * flat, axis=1) < 0))[0]
        pixel, face, weights, flat = pixel[met], face[met], weights[met], flat[met]
        mesh, subject = self.subject.mesh, self.subject
        assert mesh.uvs is not None
        corners = self.triangles[face]
        position = np.einsum("nck,nc->nk", self.vertices[corners], weights)
        smooth = _unit(np.einsum("nck,nc->nk", self.normals[corners], weights))
        uvs = np.einsum("nck,nc->nk", mesh.uvs[mesh.triangle_uvs()[face]], weights)
        fine = sample(subject.normal, uvs)
        # Where the texture has no normal (outside its charts) the mesh's own shades.
        empty = np.linalg.norm(fine, axis=1) < 0.25
        normal = np.where(empty[:, None], smooth, _unit(fine))
        return Surface(
            camera=camera,
            pixel=pixel,
            position=position.astype(np.float32),
            start=self._start(position, face, weights).astype(np.float32),
            geometric=smooth.astype(np.float32),
            normal=normal.astype(np.float32),
            view=(-flat).astype(np.float32),
            albedo=sample(subject.diffuse_albedo, uvs),
            specular=sample(subject.specular_albedo, uvs),
            roughness=sample(subject.roughness, uvs),
            skin=sample(subject.skin.astype(np.float32), uvs) > 0.5,
            face=face,
            barycentric=weights.astype(np.float32),
            lobe=self._lobe(face, weights, uvs),
        )

    def _lobe(self, face: np.ndarray, weights: np.ndarray, uvs: np.ndarray) -> Lobe:
        """The lobes' shape at points: stretched along the UV's u tangent where the map has it."""
        subject = self.subject
        if subject.anisotropy is None:
            return Lobe(subject.distribution)
        tangent = np.einsum("nck,nc->nk", self._tangents[face], weights).astype(np.float32)
        return Lobe(subject.distribution, tangent, sample(subject.anisotropy, uvs))

    @functools.cached_property
    def _tangents(self) -> np.ndarray:
        """(t, 3, 3) u tangent of each corner of each triangle."""
        return tangent_frames(self.subject.mesh)[0]

    def _start(self, position: np.ndarray, face: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Shadow rays start on the smooth surface that the vertex normals describe [Hanika2021].

        Rays from the flat triangle itself would draw the triangles at the shadow's edge.
        """
        corners = self.triangles[face]
        points, normals = self.vertices[corners], self.normals[corners]
        below = np.einsum("nck,nck->nc", position[:, None] - points, normals)
        raised = -np.einsum("nck,nc->nk", np.minimum(below, 0.0)[..., None] * normals, weights)
        flat = _unit(np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]))
        return position + raised + START_MM * flat

    def visible_lights(
        self, surface: Surface, lights_mm: np.ndarray, *, coarse_px: int = COARSE_PX
    ) -> np.ndarray:
        """Which lights each pixel's surface point sees.

        Rays are cast on a coarse grid of pixels; a pixel whose four coarse neighbours lie on one
        surface and agree about a light takes their answer, all others cast their own ray. Only a
        shadow thinner than the grid can be missed.

        Args:
            surface: n pixels.
            lights_mm: (m, 3).
            coarse_px: the grid's step; 1 casts every ray.

        Returns:
            (n, ceil(m / 8)) uint8, bit k & 7 of byte k >> 3 set where light k is seen. Lights
            below the horizon of the smooth normal are not seen and cost no ray.
        """
        lights = np.ascontiguousarray(lights_mm, np.float32)
        camera, count = surface.camera, len(surface.pixel)
        bits = np.zeros((count, (len(lights) + 7) // 8), np.uint8)
        row, column = np.divmod(surface.pixel, camera.width_px)
        coarse = (row % coarse_px == 0) & (column % coarse_px == 0)
        todo = np.zeros((min(count, TILE_POINTS), len(lights)), bool)
        tiles = [slice(a, min(a + TILE_POINTS, count)) for a in range(0, count, TILE_POINTS)]
        for tile in tiles:
            part = todo[: tile.stop - tile.start]
            mark_coarse(surface.position[tile], surface.geometric[tile], lights, coarse[tile], part)
            self._cast(surface, lights, part, tile.start, bits)
        if coarse_px == 1:
            return bits
        index = np.full(camera.height_px * camera.width_px, -1, np.int64)
        index[surface.pixel] = np.arange(count)
        depth = np.linalg.norm(surface.position - camera.centre_mm, axis=1)
        for tile in tiles:
            part = todo[: tile.stop - tile.start]
            fill_between(
                surface.position,
                surface.geometric,
                lights,
                index.reshape(camera.height_px, camera.width_px),
                surface.pixel,
                depth.astype(np.float32),
                coarse_px,
                tile.start,
                bits,
                part,
            )
            self._cast(surface, lights, part, tile.start, bits)
        return bits

    def _cast(
        self,
        surface: Surface,
        lights: np.ndarray,
        todo: np.ndarray,
        start: int,
        bits: np.ndarray,
    ) -> None:
        """Cast a ray for each pair of point, from `start`, and light in `todo`; set its bit."""
        points, targets = np.nonzero(todo)
        points += start
        for first in range(0, len(points), CHUNK_RAYS):
            part = slice(first, first + CHUNK_RAYS)
            free = ~self.blocked(surface.start[points[part]], lights[targets[part]])
            set_bits(bits, points[part][free], targets[part][free])


def _unit(vectors: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)
