"""Where lights and cameras stand: Light, Camera, Rig and rig.json.

World: right-handed, mm, origin at the sphere's centre, +y up, +z toward the frontal camera.
Cameras: OpenCV axes (x right, y down, z forward); the top-left pixel's centre is (0.5, 0.5).
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lightstage.counting import counted
from lightstage.errors import LightstageError, RigError, one_error
from lightstage.formats.fields import Fields
from lightstage.formats.files import read_json, write_json
from lightstage.formats.paths import check_name

SCHEMA = "lightstage.rig/1"
BANKS = ("horizontal", "vertical")
COLOUR = re.compile(r"[a-z0-9-]{1,32}")
"""What emitters' colours are called: `--emitters` names them with commas between."""
MEASURED_WITH = "measured_with_rig_sha256"
"""In a rig.json whose cameras were measured from photographs: `rig_sha256` of the rig they were
taken with. It is the same stage."""
UNMEASURED = "unmeasured_cameras"
"""Of the same: ids of cameras that keep the lens and pose they had before."""
UNCHECKED = "unchecked_cameras"
"""Of the same: ids of cameras that saw too few boards for their place to be checked."""
MOST_ID = (1 << 31) - 1
MOST_CHANNEL = 65534
"""The wires count lights with 16 bits."""
CONTROLLER = "main"
"""What a light's controller is called where the rig does not say."""
LEAST_MM = 20.0
"""No head fits into a stage of a smaller radius: its positions are in another unit."""
MOST_PX = 1 << 16
"""No sensor has more pixels a side."""


@dataclasses.dataclass(frozen=True)
class LightAddress:
    """To which wire a light is connected.

    Attributes:
        channel: place on the controller's line, counted from 0.
        controller: name of the device that drives it.
        more: fields that others added in rig.json; they are kept.
    """

    channel: int
    controller: str = CONTROLLER
    more: Mapping[str, Any] = dataclasses.field(default_factory=dict, compare=False)


@dataclasses.dataclass(frozen=True)
class Light:
    """One LED.

    Attributes:
        id: label, unique in the rig.
        name: such as ``arc00/light03``.
        position_mm: world position.
        bank: polarisation, ``horizontal`` or ``vertical``; None where the light is not polarised.
        rgb_gain: measured radiant intensity relative to nominal, per channel.
        colour: name of the emitter's colour, such as ``warm`` or ``red``, where several stand in
            one place; None where all are alike.
        address: wire that drives it; None where its place in the rig's list is its channel.
        more: fields that others added in rig.json; they are kept.
    """

    id: int
    name: str
    position_mm: tuple[float, float, float]
    bank: str | None = None
    rgb_gain: tuple[float, float, float] = (1.0, 1.0, 1.0)
    colour: str | None = None
    address: LightAddress | None = None
    more: Mapping[str, Any] = dataclasses.field(default_factory=dict, compare=False)


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
    more: Mapping[str, Any] = dataclasses.field(default_factory=dict, compare=False)
    """Fields that others added in rig.json; they are kept."""

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
    more: Mapping[str, Any] = dataclasses.field(default_factory=dict, compare=False)
    """Fields that others added in rig.json; they are kept."""

    @functools.cached_property
    def positions_mm(self) -> np.ndarray:
        """(n, 3) light positions."""
        return np.array([light.position_mm for light in self.lights], float).reshape(-1, 3)

    @functools.cached_property
    def colours(self) -> dict[str | None, np.ndarray]:
        """Colour of emitters to (n,) bool which lights are of it, in the rig's order."""
        named = [light.colour for light in self.lights]
        return {
            colour: np.array([each == colour for each in named]) for colour in dict.fromkeys(named)
        }

    @functools.cached_property
    def rgb_gains(self) -> np.ndarray:
        """(n, 3) light gains."""
        return np.array([light.rgb_gain for light in self.lights], float).reshape(-1, 3)

    @functools.cached_property
    def addresses(self) -> tuple[LightAddress, ...]:
        """Each light's address: what the rig says, else its place in the list."""
        return tuple(light.address or LightAddress(i) for i, light in enumerate(self.lights))

    @property
    def addressed(self) -> bool:
        """Whether the rig itself says how its lights are wired."""
        return any(light.address is not None for light in self.lights)

    def camera(self, camera_id: str) -> Camera:
        """The camera of this id; RigError when there is none."""
        for camera in self.cameras:
            if camera.id == camera_id:
                return camera
        known = ", ".join(camera.id for camera in self.cameras)
        raise RigError("rig", field="cameras", found=f"no {camera_id}", expected=f"one of {known}")

    def readdressed(self, addresses: Sequence[LightAddress]) -> Rig:
        """The same rig with another controller and channel of each light.

        Args:
            addresses: of each light, in the rig's order.
        """
        lights = tuple(
            dataclasses.replace(
                light,
                address=LightAddress(new.channel, new.controller, own.more),
            )
            for light, own, new in zip(self.lights, self.addresses, addresses, strict=True)
        )
        return dataclasses.replace(self, lights=lights)

    def scaled(self, factor: float) -> Rig:
        """The same rig with `factor` times as many pixels a side in every camera."""
        more = {key: each for key, each in self.more.items() if key != MEASURED_WITH}
        cameras = tuple(camera.scaled(factor) for camera in self.cameras)
        return dataclasses.replace(self, cameras=cameras, more=more)


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
    """Write rig.json atomically, with the fields that others added; returns `path`."""
    value = rig_to_json(rig)
    entries = [*value["lights"], *value["cameras"]]
    items: list[Light | Camera] = [*rig.lights, *rig.cameras]
    for entry, item in zip(entries, items, strict=True):
        entry.update(item.more)
        if isinstance(item, Light) and item.address is not None:
            entry["address"].update(item.address.more)
    return write_json(path, {**value, **rig.more})


def rig_to_json(rig: Rig) -> dict[str, Any]:
    """The rig as rig.json holds it (docs/formats.md), without the fields that others added.

    Hashes of a rig are taken of this: a note in the file makes it no other rig.
    """
    return {
        "schema": SCHEMA,
        "lights": [
            {
                name: getattr(light, name)
                for name in LIGHT_FIELDS
                if name != "address"
                and (name not in ("bank", "colour") or getattr(light, name) is not None)
            }
            | _address_to_json(light)
            for light in rig.lights
        ],
        "cameras": [
            {name: getattr(camera, name) for name in CAMERA_FIELDS}
            | {"cam_from_world": camera.cam_from_world.tolist()}
            for camera in rig.cameras
        ],
    }


def _address_to_json(light: Light) -> dict[str, Any]:
    """A light's address as a field of its entry; nothing where the rig gives none."""
    if light.address is None:
        return {}
    return {"address": {"controller": light.address.controller, "channel": light.address.channel}}


def rig_sha256(rig: Rig) -> str:
    """SHA-256 of a rig's content, however its file is laid out."""
    text = json.dumps(rig_to_json(rig), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


LIGHT_FIELDS = tuple(field.name for field in dataclasses.fields(Light) if field.name != "more")
ADDRESS_FIELDS = ("controller", "channel")
CAMERA_FIELDS = tuple(field.name for field in dataclasses.fields(Camera) if field.name != "more")


def rig_from_json(value: Any, where: str | Path) -> Rig:
    """Build a rig from the value of rig.json; fields that others added are kept."""
    problems: list[LightstageError] = []
    lights, cameras = [], []
    for index, entry in enumerate(_entries(value, "lights", where)):
        try:
            lights.append(_light(entry, where, f"lights[{index}]"))
        except RigError as error:
            problems.append(error)
    for index, entry in enumerate(_entries(value, "cameras", where)):
        try:
            cameras.append(_camera(entry, where, f"cameras[{index}]"))
        except RigError as error:
            problems.append(error)
    more = {key: each for key, each in value.items() if key not in ("schema", "lights", "cameras")}
    rig = Rig(tuple(lights), tuple(cameras), more)
    problems += _faults(rig, where)
    if problems:
        raise one_error(_folded(problems))
    return rig


def _folded(problems: list[LightstageError]) -> list[LightstageError]:
    """One error for a mistake that many lights or cameras share; it names the first of them."""
    alike: dict[tuple[str, ...], list[LightstageError]] = {}
    for problem in problems:
        kind, _, rest = problem.field.partition("[" if "[" in problem.field else " ")
        item, dot, part = rest.rpartition(".")
        # A light's name may hold dots: only what follows its bracket is the field.
        key = (
            kind,
            part if dot and item.endswith(("]", ")")) else "",
            problem.expected,
            problem.hint,
        )
        alike.setdefault(key, []).append(problem)
    return [
        each[0]
        if len(each) == 1
        else RigError(
            each[0].where,
            field=f"{each[0].field} and {len(each) - 1} more",
            found=each[0].found,
            expected=each[0].expected,
            hint=each[0].hint,
        )
        for each in alike.values()
    ]


def _entries(value: Any, key: str, where: str | Path) -> list[Any]:
    entries = value.get(key) if isinstance(value, dict) else None
    if not isinstance(entries, list) or not entries:
        raise RigError(where, field=key, found=type(entries).__name__, expected="a non-empty list")
    return entries


def _light(entry: Any, where: str | Path, place: str) -> Light:
    fields = Fields(entry, where, place, RigError, LIGHT_FIELDS)
    x, y, z = fields.numbers("position_mm", 3)
    r, g, b = fields.numbers("rgb_gain", 3, (1.0, 1.0, 1.0))
    return Light(
        id=fields.whole("id", 0, MOST_ID),
        name=fields.text("name"),
        position_mm=(x, y, z),
        bank=fields.text("bank") if fields.has("bank") else None,
        rgb_gain=(r, g, b),
        colour=fields.text("colour") if fields.has("colour") else None,
        address=_address(entry["address"], where, f"{place}.address")
        if fields.has("address")
        else None,
        more=fields.rest(),
    )


def _address(value: Any, where: str | Path, place: str) -> LightAddress:
    fields = Fields(value, where, place, RigError, ADDRESS_FIELDS)
    controller = fields.text("controller") if fields.has("controller") else CONTROLLER
    if not controller.strip():
        raise RigError(where, field=f"{place}.controller", found="no name", expected="a name")
    return LightAddress(
        channel=fields.whole("channel", 0, MOST_CHANNEL),
        controller=controller,
        more=fields.rest(),
    )


def _camera(entry: Any, where: str | Path, place: str) -> Camera:
    fields = Fields(entry, where, place, RigError, CAMERA_FIELDS)
    k1, k2, p1, p2, k3 = fields.numbers("dist", 5, (0.0,) * 5)
    return Camera(
        id=check_name(fields.text("id"), where, f"{place}.id", RigError),
        serial=fields.text("serial"),
        model=fields.text("model"),
        width_px=fields.whole("width_px", 1, MOST_PX),
        height_px=fields.whole("height_px", 1, MOST_PX),
        fx_px=fields.number("fx_px"),
        fy_px=fields.number("fy_px"),
        cx_px=fields.number("cx_px"),
        cy_px=fields.number("cy_px"),
        dist=(k1, k2, p1, p2, k3),
        cam_from_world=np.array(fields.rows("cam_from_world", 3, 4)),
        more=fields.rest(),
    )


def _faults(rig: Rig, where: str | Path) -> list[LightstageError]:
    """What would make a well-formed rig unusable: every fault, not the first."""
    problems: list[LightstageError] = []

    def fault(field: str, found: str, expected: str, hint: str = "") -> None:
        problems.append(RigError(where, field=field, found=found, expected=expected, hint=hint))

    seen: dict[int, str] = {}
    radius = float(np.median(np.linalg.norm(rig.positions_mm, axis=1))) if rig.lights else LEAST_MM
    if radius < LEAST_MM:
        fault(
            "lights",
            f"a stage of {radius:.3g} mm radius",
            f"one of at least {LEAST_MM:g} mm: positions are in mm",
            "Are they metres? Then multiply them, and the cameras' translations, by 1000.",
        )
        return problems
    for light in rig.lights:
        field = f"light {light.id} ({light.name})"
        if light.id in seen:
            fault(field, f"an id that {seen[light.id]} has too", "an id of its own")
        seen[light.id] = light.name
        distance = float(np.linalg.norm(light.position_mm))
        if distance < 1.0:
            fault(
                f"{field}.position_mm",
                f"{distance:.3g} mm from the origin",
                "a light on the sphere",
                "Positions are in mm, the origin is the sphere's centre; is it metres?",
            )
        if light.bank is not None and light.bank not in BANKS:
            fault(
                f"{field}.bank",
                repr(light.bank),
                " or ".join(BANKS),
                "Leave it out where the light has no polariser.",
            )
        if light.colour is not None and not COLOUR.fullmatch(light.colour):
            fault(
                f"{field}.colour",
                repr(light.colour),
                "small letters, digits and -",
                "It is the name of an emitter's colour, such as red or warm.",
            )
        if min(light.rgb_gain) < 0:
            fault(f"{field}.rgb_gain", str(light.rgb_gain), "three numbers of at least 0")
    problems += _wiring_faults(rig, where)
    names: set[str] = set()
    for camera in rig.cameras:
        field = f"camera {camera.id}"
        if camera.id in names:
            fault(field, "the same id twice", "an id of its own")
        names.add(camera.id)
        if not min(camera.fx_px, camera.fy_px) > 0:
            fault(field, "a focal length that is not above 0", "positive fx_px and fy_px")
        rotation = camera.cam_from_world[:, :3]
        orthogonal = np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-4)
        if not orthogonal or np.linalg.det(rotation) < 0:
            fault(f"{field}.cam_from_world", "no rotation", "a right-handed orthonormal 3 x 3")
    return problems


def _wiring_faults(rig: Rig, where: str | Path) -> list[LightstageError]:
    """Lights that no wire, or another light's wire, would light."""
    without = [light for light in rig.lights if light.address is None]
    if not rig.addressed:
        return []
    if without:
        return [
            RigError(
                where,
                field=f"light {without[0].id} ({without[0].name}).address",
                found=f"none; {len(without)} of {counted(len(rig.lights), 'light')} have none",
                expected="an address of each light, or of no light",
                hint="Without any, a light's channel is its place in the list, counted from 0.",
            )
        ]
    owner: dict[tuple[str, int], Light] = {}
    problems: list[LightstageError] = []
    for light, address in zip(rig.lights, rig.addresses, strict=True):
        other = owner.setdefault((address.controller, address.channel), light)
        if other is not light:
            problems.append(
                RigError(
                    where,
                    field=f"light {light.id} ({light.name}).address",
                    found=f"channel {address.channel}, which light {other.id} ({other.name}) has",
                    expected="a channel of its own",
                )
            )
    return problems
