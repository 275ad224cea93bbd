"""Pictures under single lights that no pattern used, rendered from maps and held against truth."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from benchmarks.reflectance_people import new_lights, new_rig
from benchmarks.reflectance_scores import Maps, TrueView
from lightstage.formats.mesh import Mesh, vertex_normals
from lightstage.rig import Camera, Rig
from processing.lighting.interface import skin_interface
from processing.lighting.lamps import Lamps
from processing.lighting.lights import PatternLights, Shadows, lights_of
from processing.lighting.lobe import transport
from processing.rays import MeshRays, interpolate

PEAK_QUANTILE = 0.999
SHADOW_OFFSET_MM = 0.1
EXPONENT = 1.0
"""Of the simulator's lamps; a picture that is to be rendered names its lights."""


@dataclasses.dataclass(frozen=True)
class Relit:
    """Squared errors of a person's pictures, summed.

    Attributes:
        squared: sum over views, lights, pixels and channels.
        values: how many they are.
        peak: PEAK_QUANTILE of the true pictures.
    """

    squared: float
    values: int
    peak: float

    def psnr_db(self, peak: float | None = None) -> float:
        """Peak signal-to-noise ratio; the peak is that of the true pictures unless given."""
        mean = max(self.squared / max(self.values, 1), 1e-12)
        return float(10 * np.log10((self.peak if peak is None else peak) ** 2 / mean))


def single_lights(rig: Rig) -> PatternLights:
    """The new lights, one a pattern: a white at the origin that faces a light reads 1."""
    position = new_rig(rig).positions_mm
    count = len(position)
    lamps = Lamps(position, np.ones((count, 3)), EXPONENT, {}, "nominal")
    return lights_of(lamps, tuple(f"new{k:02d}" for k in range(count)), np.eye(count))


@dataclasses.dataclass(frozen=True)
class Seen:
    """What a camera sees of the mesh at the n pixels that are rendered.

    Attributes:
        mask: (h, w) bool with n true pixels.
        found: (n,) bool, the mesh is seen; k of them.
        points_mm, views: (k, 3).
        shadows: of the new lights.
    """

    mask: np.ndarray
    found: np.ndarray
    points_mm: np.ndarray
    views: np.ndarray
    shadows: Shadows


class Relighter:
    """A mesh that casts the shadows in pictures of maps; its rays are cast once."""

    def __init__(self, mesh: Mesh, rig: Rig, occluders: Mesh | None = None) -> None:
        """Prepare for rays.

        Args:
            mesh: mm, world; the true one or a reconstruction.
            rig: the stage.
            occluders: what else casts shadows.
        """
        self._triangles = mesh.triangles()
        self._rays = MeshRays(mesh.vertices, self._triangles, occluders)
        self._normals = vertex_normals(mesh.vertices, self._triangles)
        self._lights = single_lights(rig)
        self._seen: dict[str, Seen] = {}

    def seen(self, camera: Camera, mask: np.ndarray) -> Seen:
        """What a camera sees at the pixels of a mask (h, w); the last mask's rays are kept."""
        kept = self._seen.get(camera.id)
        if kept is None or not np.array_equal(kept.mask, mask):
            kept = self._seen[camera.id] = self._cast(camera, mask)
        return kept

    def _cast(self, camera: Camera, mask: np.ndarray) -> Seen:
        hits = self._rays.cast_camera(camera, mask)
        chosen = np.flatnonzero(mask.ravel())
        found = hits.face[chosen] >= 0
        hits = dataclasses.replace(
            hits,
            face=hits.face[chosen][found],
            barycentric=hits.barycentric[chosen][found],
            distance_mm=hits.distance_mm[chosen][found],
        )
        origin, rays = camera.pixel_rays()
        toward = rays.reshape(-1, 3)[chosen][found]
        points = origin + toward * hits.distance_mm[:, None]
        normals = interpolate(self._normals, self._triangles, hits)
        visible = self._rays.visible(
            points, normals, self._lights.position_mm, offset_mm=SHADOW_OFFSET_MM
        )
        count = len(points)
        shadows = Shadows(
            np.repeat(np.arange(count, dtype=np.int32)[:, None], 3, axis=1),
            np.tile(np.array([[1, 0, 0]], np.float32), (count, 1)),
            visible.astype(np.uint8),
        )
        return Seen(mask, found, points, -toward, shadows)

    def render(self, maps: Maps, camera: Camera, mask: np.ndarray) -> np.ndarray:
        """(lights, n, 3) of the mask's pixels, black where the mesh is not seen.

        Args:
            maps: of the view; the diffuse part is shaded by the diffuse normal, the mirror lobe by
                the specular normal, the map of roughness and its facets.
            camera: the view.
            mask: (h, w) bool, pixels to render.
        """
        seen = self.seen(camera, mask)
        found = seen.found
        normal, relief, albedo, specular, roughness = (
            getattr(maps, name)[mask][found]
            for name in (
                "diffuse_normal", "specular_normal", "diffuse_albedo", "specular_albedo",
                "roughness",
            )
        )  # fmt: skip
        e, lobe = (
            transport(
                self._lights, seen.points_mm, turned, seen.views, roughness, seen.shadows,
                skin_interface(maps.facets),
            )[part]
            for part, turned in enumerate((normal, relief))
        )  # fmt: skip
        light = e[:, :, None] * albedo[:, None]
        light += (lobe * specular[:, None])[:, :, None]
        light[np.einsum("nk,nk->n", normal, normal) < 0.25] = 0
        out = np.zeros((len(self._lights.patterns), len(found), 3), np.float32)
        out[:, found] = light.transpose(1, 0, 2)
        return out


def relit(
    maps: Mapping[str, Maps],
    relighter: Relighter,
    rig: Rig,
    truth: Mapping[str, TrueView],
    session_path: Path,
) -> Relit:
    """Render every view of a person under the new lights and hold it against truth.

    Args:
        maps: camera id to its maps.
        relighter: of the mesh that casts the shadows.
        rig: the stage.
        truth: camera id to the person's truth.
        session_path: whose truth holds the pictures.
    """
    squared, values = 0.0, 0
    true = []
    for camera_id, view in maps.items():
        skin, mask = truth[camera_id].skin, truth[camera_id].mask
        pictures = new_lights(session_path, camera_id)[:, skin[mask]]
        found = relighter.render(view, rig.camera(camera_id), skin)
        found -= pictures
        squared += float(np.square(found, out=found).sum(dtype=float))
        values += pictures.size
        true.append(pictures[:, ::4].reshape(-1))
    return Relit(squared, values, float(np.quantile(np.concatenate(true), PEAK_QUANTILE)))
