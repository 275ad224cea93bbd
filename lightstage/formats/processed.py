"""Processed folder: where each map of a session is and what it holds; truth has the same form."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np

from lightstage.errors import FormatError
from lightstage.formats.exr import read_exr, read_half_exr, write_exr
from lightstage.formats.png import write_png

HEAD_SCHEMA = "lightstage.head/1"
"""Of head_from_world.json."""
TRUTH_SCHEMA = "lightstage.truth/1"
"""Of report.json where the simulator wrote a person's true maps; `processing`'s has its own."""


@dataclasses.dataclass(frozen=True)
class MapSpec:
    """One map: its number of channels and whether half floats hold it."""

    channels: int
    half: bool = True


MAPS: dict[str, MapSpec] = {
    "diffuse_albedo": MapSpec(3),
    "ambient_occlusion": MapSpec(1),
    "specular_albedo": MapSpec(1),
    "roughness": MapSpec(1),
    "diffuse_normal": MapSpec(3),
    "specular_normal": MapSpec(3),
    "confidence": MapSpec(1),
    "position": MapSpec(3, half=False),
    "view": MapSpec(1),
    "tangent_normal": MapSpec(3),
    "coverage": MapSpec(1),
    "filled": MapSpec(1),
    "skin": MapSpec(1),
}
"""Every map that a view or the atlas may hold: position in mm; view an index, -1 for none;
tangent_normal the specular normal in MikkTSpace's frame, -1..1; coverage the number of views;
filled 0 where seen, 1 where guessed from the other side of the face, 2 from around; skin 1 where
the template has skin, 0 where it has eyes, hair or the opening of the mouth."""


@dataclasses.dataclass(frozen=True)
class ProcessedFolder:
    """Paths and maps of one processed session (or of a simulated one's truth)."""

    root: Path

    @property
    def base_mesh(self) -> Path:
        """Reconstructed mesh, mm, world."""
        return self.root / "base_mesh.ply"

    @property
    def occluders(self) -> Path:
        """What else hides light from the skin, mm, world, where there is anything."""
        return self.root / "occluders.ply"

    @property
    def hull(self) -> Path:
        """The last triangles of `occluders`, where these are no measured surface, mm, world."""
        return self.root / "work" / "hull.ply"

    @property
    def detailed_mesh(self) -> Path:
        """The base mesh with the specular normals' relief, mm, world, where it was asked for."""
        return self.root / "detailed_mesh.ply"

    @property
    def registered_mesh(self) -> Path:
        """Template topology and UV, mm, world."""
        return self.root / "registered_mesh.obj"

    @property
    def neutral_mesh(self) -> Path:
        """The registered mesh without an expression, mm; a fit of photographs has one."""
        return self.root / "neutral_mesh.obj"

    @property
    def head_pose(self) -> Path:
        """JSON ``{"schema": HEAD_SCHEMA, "head_from_world": [[3 x 4]]}``, of registration."""
        return self.root / "head_from_world.json"

    @property
    def true_landmarks(self) -> Path:
        """JSON of the landmarks, mm, world; only the truth of a simulated session has it."""
        return self.root / "landmarks_mm.json"

    def view_ids(self) -> list[str]:
        """Cameras that have a folder under views/, sorted."""
        return sorted(p.name for p in (self.root / "views").glob("*") if p.is_dir())

    def view_path(self, camera: str, name: str) -> Path:
        """Path of a view's map."""
        _spec(name)
        return self.root / "views" / camera / f"{name}.exr"

    def mask_path(self, camera: str) -> Path:
        """Path of a view's mask, 255 = face."""
        return self.root / "views" / camera / "mask.png"

    def atlas_path(self, name: str) -> Path:
        """Path of an atlas map."""
        _spec(name)
        return self.root / "atlas" / f"{name}.exr"

    def write_view(self, camera: str, name: str, image: np.ndarray) -> Path:
        """Write a view's (h, w[, 3]) map atomically in its format."""
        return write_map(self.view_path(camera, name), name, image)

    def read_view(self, camera: str, name: str) -> np.ndarray:
        """Read a view's map: (h, w) or (h, w, 3) float32, finite."""
        return read_map(self.view_path(camera, name), name)

    def read_half_view(self, camera: str, name: str) -> np.ndarray:
        """Read a view's map: (h, w) or (h, w, 3) float16, finite."""
        return read_map(self.view_path(camera, name), name, half=True)

    def write_mask(self, camera: str, mask: np.ndarray) -> Path:
        """Write a view's (h, w) bool mask as PNG."""
        pixels = np.asarray(mask, bool).view(np.uint8) * np.uint8(255)
        return write_png(self.mask_path(camera), pixels)

    def read_mask(self, camera: str) -> np.ndarray:
        """Read a view's mask: (h, w) bool."""
        path = self.mask_path(camera)
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) if path.is_file() else None
        if image is None:
            raise FormatError(path, found="no readable picture", expected="a mask, 255 = face")
        return np.asarray(image) > 127

    def write_atlas(self, name: str, image: np.ndarray) -> Path:
        """Write an atlas's (rows, columns[, 3]) map atomically in its format."""
        return write_map(self.atlas_path(name), name, image)

    def read_atlas(self, name: str) -> np.ndarray:
        """Read an atlas map: (rows, columns) or (rows, columns, 3) float32, finite."""
        return read_map(self.atlas_path(name), name)


def write_map(path: Path, name: str, image: np.ndarray) -> Path:
    """Write one (h, w[, c]) map; FormatError when its channels are not those of its name."""
    spec = _spec(name)
    if (1 if image.ndim == 2 else image.shape[2]) != spec.channels:
        raise FormatError(path, found=f"shape {image.shape}", expected=f"{spec.channels} channels")
    return write_exr(path, image, half=spec.half)


def read_map(path: Path, name: str, *, half: bool = False) -> np.ndarray:
    """Read one map, as float32 or as half floats.

    Raises:
        FormatError: it is missing, has NaN, or other channels than its name's.
    """
    spec = _spec(name)
    image = read_half_exr(path) if half else read_exr(path, finite=True)
    if (1 if image.ndim == 2 else image.shape[2]) != spec.channels:
        raise FormatError(path, found=f"shape {image.shape}", expected=f"{spec.channels} channels")
    return image


def _spec(name: str) -> MapSpec:
    if name not in MAPS:
        raise FormatError(f"map {name!r}", found="an unknown name", expected=", ".join(MAPS))
    return MAPS[name]
