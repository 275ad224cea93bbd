"""Tiny photographs whose pixels hold which camera took them under which light: labels to verify.

They pass as photographs in every check (a textured ball, lit as the lights are), and carry a code
as faint as noise: differences of neighbours, which no other setting of the camera can hide.
"""

from __future__ import annotations

import dataclasses
import threading
import zlib
from pathlib import Path

import numpy as np
import rawpy

from lightstage.rig import Camera, Rig
from sim.camera.dng import Exif, dng_bytes
from sim.camera.sensor import Sensor, SensorConfig
from sim.errors import SimError

CODE_DN = 12
"""Counts by which a pair of neighbours differs, for a bit."""
CODE_BITS = 72
"""Camera 8, light 32, checksum 32."""
CODE_ROWS = 12
"""Rows on top that hold the code, twice."""
MIN_WIDTH_PX = CODE_BITS * 4 * 2 // CODE_ROWS
"""A bit is four pixels of a row, and is there twice."""
CELL_PX = 4
"""Light and texture are the same over so many pixels a side."""
BRIGHTEST = 0.6
"""Share of the sensor's range that `full` gives where the ball is brightest."""
F_NUMBER = 8.0
EXPOSURE_S = 1 / 60


@dataclasses.dataclass(frozen=True)
class Code:
    """A photograph's own label.

    Attributes:
        camera: its place in the rig.
        light: which state of the lamps it was, counted from 1 by the photographer.
    """

    camera: int
    light: int


class CodedPhotographer:
    """Turns the lamps' state into each camera's next photograph, and remembers every state.

    Args:
        rig: whose cameras take them; at least 48 x 24 pixels each.
        seed: of textures and noise.

    Raises:
        SimError: a camera whose pictures are too small for the code.
    """

    def __init__(self, rig: Rig, seed: int) -> None:
        for camera in rig.cameras:
            if camera.width_px < MIN_WIDTH_PX or camera.height_px < 2 * CODE_ROWS:
                raise SimError(
                    f"camera {camera.id}",
                    found=f"{camera.width_px} x {camera.height_px} pixels",
                    expected=f"at least {MIN_WIDTH_PX} x {2 * CODE_ROWS}",
                )
        self.rig = rig
        self._rng = np.random.default_rng([seed, 0xC0DE])
        self._lock = threading.Lock()
        self.states: list[np.ndarray] = []
        """Levels of each state of the lamps, the first one under the code 1."""
        self._textures = {
            camera.id: _texture(camera, np.random.default_rng([seed, index]))
            for index, camera in enumerate(rig.cameras)
        }

        self._balls = {camera.id: _ball(rig, camera) for camera in rig.cameras}

    def lit(self, levels: np.ndarray) -> int:
        """Remember a state (n,) of the lamps; its code, to be given to `photograph`."""
        with self._lock:
            self.states.append(np.array(levels))
            return len(self.states)

    def photograph(self, camera: Camera, light: int) -> bytes:
        """One camera's DNG under the state of this code."""
        levels = self.states[light - 1]
        shape = (camera.height_px, camera.width_px)
        with self._lock:
            noise = self._rng.normal(0.0, 2.0, shape)
        config = SensorConfig()
        span = BRIGHTEST * (config.white_dn - config.black_dn)
        cells = (self._balls[camera.id] @ levels).reshape(camera.height_px // CELL_PX, -1)
        shading = np.kron(cells, np.ones((CELL_PX, CELL_PX)))
        counts = config.black_dn + noise
        counts[: shading.shape[0], : shading.shape[1]] += span * shading * self._textures[camera.id]
        place = self.rig.cameras.index(camera)
        counts[:CODE_ROWS] += CODE_DN * _signs(place, light, camera.width_px)
        mosaic = np.clip(np.round(counts), 0, config.white_dn).astype(np.uint16)
        exif = Exif(camera.model, camera.serial, F_NUMBER, 85.0)
        return dng_bytes(mosaic, Sensor(config, np.eye(3), EXPOSURE_S), exif)


def read_code(path: Path) -> Code | None:
    """The label in a photograph's pixels; None where nothing that is whole can be read."""
    try:
        with rawpy.imread(str(path)) as raw:
            counts = raw.raw_image_visible.astype(np.float64)
    except (rawpy.LibRawError, OSError):
        return None
    width = counts.shape[1] // 4 * 4
    blocks = counts[:CODE_ROWS, :width].reshape(CODE_ROWS, -1, 4)
    # Neighbours of one colour are two apart.
    apart = (blocks[..., :2] - blocks[..., 2:]).sum(axis=2).reshape(-1)
    half = len(apart) // 2
    total = apart[:half] + apart[half : 2 * half]
    if len(total) < CODE_BITS:
        return None
    data = np.packbits(total[:CODE_BITS] > 0).tobytes()
    if zlib.crc32(data[:5]) != int.from_bytes(data[5:], "big"):
        return None
    return Code(data[0], int.from_bytes(data[1:5], "big"))


def _signs(camera: int, light: int, width_px: int) -> np.ndarray:
    """(CODE_ROWS, width) of +-0.5: the code, twice."""
    data = bytes([camera]) + light.to_bytes(4, "big")
    bits = np.unpackbits(np.frombuffer(data + zlib.crc32(data).to_bytes(4, "big"), np.uint8))
    cells = width_px // 4 * CODE_ROWS // 2
    half = np.resize(bits.astype(float) - 0.5, cells)
    signs = np.concatenate([half, half]).reshape(CODE_ROWS, width_px // 4)
    out = np.zeros((CODE_ROWS, width_px))
    for column, sign in enumerate((1, 1, -1, -1)):
        out[:, column : width_px // 4 * 4 : 4] = sign * signs
    return out


def _texture(camera: Camera, rng: np.random.Generator) -> np.ndarray:
    """(h, w), both whole cells: reflectance 0.5..1, even where the code is."""
    cells = rng.uniform(0.5, 1.0, (camera.height_px // CELL_PX, camera.width_px // CELL_PX))
    cells[: CODE_ROWS // CELL_PX] = 1.0
    return np.kron(cells, np.ones((CELL_PX, CELL_PX)))


def _ball(rig: Rig, camera: Camera) -> np.ndarray:
    """(h // CELL_PX * w // CELL_PX, n) what each light gives to the cells of a picture.

    A white ball before a black wall, in a face's place: `full` reads 1 in its middle at most.
    On top, where the code is, an even card that every light reaches.
    """
    rows, columns = camera.height_px // CELL_PX, camera.width_px // CELL_PX
    top = CODE_ROWS // CELL_PX
    y, x = np.meshgrid(
        (np.arange(rows - top) + 0.5) / (rows - top) * 2 - 1,
        (np.arange(columns) + 0.5) / columns * 2 - 1,
        indexing="ij",
    )
    inside = x**2 + y**2 < 0.95
    depth = np.sqrt(np.maximum(1 - x**2 - y**2, 0.0))
    # Camera axes: x right, y down, z away from the camera.
    normals = np.stack([x, y, -depth], axis=-1) @ camera.cam_from_world[:, :3]
    lights = rig.positions_mm / np.linalg.norm(rig.positions_mm, axis=1, keepdims=True)
    ball = np.maximum(normals @ lights.T, 0.0) * inside[..., None]
    card = np.full((top, columns, len(lights)), 0.3)
    cells = np.concatenate([card, ball / max(ball.sum(axis=2).max(), 1e-9)])
    cells[:top] /= cells[:top].sum(axis=2, keepdims=True) / 0.5
    return cells.reshape(rows * columns, -1)
