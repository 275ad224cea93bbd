"""Where lights and cameras stand: Light, Camera, Rig and rig.json.

World: right-handed, mm, origin at the sphere's centre, +y up, +z toward the frontal camera.
Cameras: OpenCV axes (x right, y down, z forward); the top-left pixel's centre is (0.5, 0.5).
"""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path
from typing import Any

import numpy as np

from lightstage.errors import FormatError, LightstageError, RigError, one_error
from lightstage.formats.files import read_json, write_json

SCHEMA = "lightstage.rig/1"
BANKS = ("horizontal", "vertical")


@dataclasses.dataclass(frozen=True)
class Light:
    """One LED.

    Attributes:
        id: label, unique in the rig.
        name: such as ``arc00/light03``.
        position_mm: world position.
        bank: polarisation, ``horizontal`` or ``vertical``.
        rgb_gain: measured radiant intensity relative to nominal, per channel.
    """

    id: int
    name: str
    position_mm: tuple[float, float, float]
    bank: str
    rgb_gain: tuple[float, float, float] = (1.0, 1.0, 1.0)


@dataclasses.dataclass(frozen=True)
class Camera:
    """One camera: intrinsics in pixels, distortion k1 k2 p1 p2 k3 (OpenCV), pose in mm."""

    id: str
    serial: str
    model: str
    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    dist: tuple[float, float, float, float, float]
    cam_from_world: np.ndarray
    """(3, 4) float64, [R | t]."""

    @property
    def centre_mm(self) -> np.ndarray:
        """(3,) the camera's centre in the world."""
        rotation, translation = self.cam_from_world[:, :3], self.cam_from_world[:, 3]
        return -rotation.T @ translation

    @property
    def matrix(self) -> np.ndarray:
        """(3, 3) pinhole matrix for pixel centres at half-integers (top-left is (0.5, 0.5))."""
        return np.array(
            [[self.fx_px, 0, self.cx_px], [0, self.fy_px, self.cy_px], [0, 0, 1]], float
        )

    @property
    def opencv_matrix(self) -> np.ndarray:
        """(3, 3) the same where OpenCV is called: its top-left pixel's centre is (0, 0)."""
        shifted = self.matrix
        shifted[:2, 2] -= 0.5
        return shifted

    def project(self, points_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Project world points.

        Args:
            points_mm: (n, 3).

        Returns:
            (n, 2) pixels, NaN behind the camera, and (n,) depth in mm along the optical axis.
        """
        points = np.asarray(points_mm, float).reshape(-1, 3)
        local = points @ self.cam_from_world[:, :3].T + self.cam_from_world[:, 3]
        depth = local[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            x, y = local[:, 0] / depth, local[:, 1] / depth
        k1, k2, p1, p2, k3 = self.dist
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        pixels = np.stack([self.fx_px * u + self.cx_px, self.fy_px * v + self.cy_px], axis=1)
        pixels[~(depth > 0)] = np.nan
        return pixels, depth

    def pixel_rays(self) -> tuple[np.ndarray, np.ndarray]:
        """Rays through all pixel centres.

        Returns:
            (3,) origin in mm and (h, w, 3) unit directions in the world, float64.
        """
        columns = np.arange(self.width_px) + 0.5
        rows = np.arange(self.height_px) + 0.5
        return self.centre_mm, self.rays_through(*np.meshgrid(columns, rows))

    def rays_through(self, x_px: np.ndarray, y_px: np.ndarray, rounds: int = 8) -> np.ndarray:
        """(.., 3) unit directions in the world through places (..) of the picture, float64.

        A pixel's centre is half a pixel from its corner; the distortion is undone by so many
        rounds of fixed-point iteration.
        """
        u, v = (x_px - self.cx_px) / self.fx_px, (y_px - self.cy_px) / self.fy_px
        x, y = u.copy(), v.copy()
        k1, k2, p1, p2, k3 = self.dist
        for _ in range(rounds if any(self.dist) else 0):
            r2 = x * x + y * y
            radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
            dx = 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
            dy = p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
            x, y = (u - dx) / radial, (v - dy) / radial
        local = np.stack([x, y, np.ones_like(x)], axis=-1)
        local /= np.sqrt(x * x + y * y + 1)[..., None]
        return np.asarray(local @ self.cam_from_world[:, :3])

    def scaled(self, factor: float) -> Camera:
        """The same camera with `factor` times as many pixels a side (rounded to even numbers)."""
        width = max(2, 2 * round(self.width_px * factor / 2))
        height = max(2, 2 * round(self.height_px * factor / 2))
        sx, sy = width / self.width_px, height / self.height_px
        return dataclasses.replace(
            self,
            width_px=width,
            height_px=height,
            fx_px=self.fx_px * sx,
            fy_px=self.fy_px * sy,
            cx_px=self.cx_px * sx,
            cy_px=self.cy_px * sy,
        )


@dataclasses.dataclass(frozen=True)
class Rig:
    """The stage: lights and cameras in order."""

    lights: tuple[Light, ...]
    cameras: tuple[Camera, ...]

    @functools.cached_property
    def positions_mm(self) -> np.ndarray:
        """(n, 3) light positions."""
        return np.array([light.position_mm for light in self.lights], float).reshape(-1, 3)

    @functools.cached_property
    def rgb_gains(self) -> np.ndarray:
        """(n, 3) light gains."""
        return np.array([light.rgb_gain for light in self.lights], float).reshape(-1, 3)

    def camera(self, camera_id: str) -> Camera:
        """The camera of this id; RigError when there is none."""
        for camera in self.cameras:
            if camera.id == camera_id:
                return camera
        known = ", ".join(camera.id for camera in self.cameras)
        raise RigError("rig", field="cameras", found=f"no {camera_id}", expected=f"one of {known}")

    def scaled(self, factor: float) -> Rig:
        """The same rig with `factor` times as many pixels a side in every camera."""
        return dataclasses.replace(
            self, cameras=tuple(camera.scaled(factor) for camera in self.cameras)
        )


def look_at(position_mm: np.ndarray, target_mm: np.ndarray) -> np.ndarray:
    """cam_from_world (3, 4) of a camera at a position that looks at a target, +y upward."""
    position = np.asarray(position_mm, float)
    forward = np.asarray(target_mm, float) - position
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return np.concatenate([rotation, (-rotation @ position)[:, None]], axis=1)


def default_rig() -> Rig:
    """The committed default rig (lightstage/data/rig.json): 168 lights, nine cameras."""
    return load_rig(Path(__file__).parent / "data" / "rig.json")


def load_rig(path: Path) -> Rig:
    """Read rig.json.

    Raises:
        RigError, FormatError: every fault found, in one message.
    """
    return rig_from_json(read_json(path, SCHEMA), path)


def save_rig(rig: Rig, path: Path) -> Path:
    """Write rig.json atomically; returns `path`."""
    return write_json(path, rig_to_json(rig))


def rig_to_json(rig: Rig) -> dict[str, Any]:
    """The rig as FORMATS' rig.json value."""
    lights = [dataclasses.asdict(light) for light in rig.lights]
    cameras = []
    for camera in rig.cameras:
        value = {f.name: getattr(camera, f.name) for f in dataclasses.fields(camera)}
        value["cam_from_world"] = camera.cam_from_world.tolist()
        cameras.append(value)
    return {"schema": SCHEMA, "lights": lights, "cameras": cameras}


def rig_from_json(value: Any, where: str | Path) -> Rig:
    """Build a rig from the value of rig.json; unknown fields are ignored."""
    problems: list[LightstageError] = []
    lights, cameras = [], []
    for index, entry in enumerate(_entries(value, "lights", where)):
        try:
            lights.append(_light(entry))
        except (KeyError, TypeError, ValueError) as error:
            problems.append(_malformed(where, f"lights[{index}]", error))
    for index, entry in enumerate(_entries(value, "cameras", where)):
        try:
            cameras.append(_camera(entry))
        except (KeyError, TypeError, ValueError) as error:
            problems.append(_malformed(where, f"cameras[{index}]", error))
    rig = Rig(tuple(lights), tuple(cameras))
    problems += _faults(rig, where)
    if problems:
        raise one_error(problems)
    return rig


def _entries(value: Any, key: str, where: str | Path) -> list[Any]:
    entries = value.get(key) if isinstance(value, dict) else None
    if not isinstance(entries, list) or not entries:
        raise RigError(where, field=key, found=type(entries).__name__, expected="a non-empty list")
    return entries


def _malformed(where: str | Path, field: str, error: Exception) -> FormatError:
    said = f"no {error}" if isinstance(error, KeyError) else str(error)
    return RigError(where, field=field, found=said, expected="the fields of FORMATS' rig.json")


def _light(entry: dict[str, Any]) -> Light:
    x, y, z = (float(c) for c in entry["position_mm"])
    r, g, b = (float(c) for c in entry.get("rgb_gain", (1, 1, 1)))
    return Light(int(entry["id"]), str(entry["name"]), (x, y, z), str(entry["bank"]), (r, g, b))


def _camera(entry: dict[str, Any]) -> Camera:
    k1, k2, p1, p2, k3 = (float(c) for c in entry.get("dist", (0, 0, 0, 0, 0)))
    return Camera(
        id=str(entry["id"]),
        serial=str(entry["serial"]),
        model=str(entry["model"]),
        width_px=int(entry["width_px"]),
        height_px=int(entry["height_px"]),
        fx_px=float(entry["fx_px"]),
        fy_px=float(entry["fy_px"]),
        cx_px=float(entry["cx_px"]),
        cy_px=float(entry["cy_px"]),
        dist=(k1, k2, p1, p2, k3),
        cam_from_world=np.array(entry["cam_from_world"], float).reshape(3, 4),
    )


def _faults(rig: Rig, where: str | Path) -> list[LightstageError]:
    """What would make a well-formed rig unusable: every fault, not the first."""
    problems: list[LightstageError] = []

    def fault(field: str, found: str, expected: str, hint: str = "") -> None:
        problems.append(RigError(where, field=field, found=found, expected=expected, hint=hint))

    seen: dict[int, str] = {}
    for light in rig.lights:
        field = f"light {light.id} ({light.name})"
        if light.id in seen:
            fault(field, f"an id that {seen[light.id]} has too", "an id of its own")
        seen[light.id] = light.name
        distance = float(np.linalg.norm(light.position_mm))
        if not np.isfinite(distance):
            fault(f"{field}.position_mm", str(light.position_mm), "three finite numbers")
        elif distance < 1.0:
            fault(
                f"{field}.position_mm",
                f"{distance:.3g} mm from the origin",
                "a light on the sphere",
                "Positions are in mm, the origin is the sphere's centre; is it metres?",
            )
        if light.bank not in BANKS:
            fault(f"{field}.bank", repr(light.bank), " or ".join(BANKS))
        if not all(np.isfinite(g) and g >= 0 for g in light.rgb_gain):
            fault(f"{field}.rgb_gain", str(light.rgb_gain), "three numbers of at least 0")
    names: set[str] = set()
    for camera in rig.cameras:
        field = f"camera {camera.id}"
        if camera.id in names:
            fault(field, "the same id twice", "an id of its own")
        names.add(camera.id)
        if min(camera.width_px, camera.height_px) < 1 or not min(camera.fx_px, camera.fy_px) > 0:
            fault(field, "a size or focal length of 0", "positive width, height, fx_px, fy_px")
        rotation = camera.cam_from_world[:, :3]
        orthogonal = np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-4)
        if not orthogonal or np.linalg.det(rotation) < 0:
            fault(f"{field}.cam_from_world", "no rotation", "a right-handed orthonormal 3 x 3")
    return problems
