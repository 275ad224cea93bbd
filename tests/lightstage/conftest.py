"""A small stage for tests: a rig, DNG photographs, virtual cameras, an LED device on a pty.

The device decodes the wire by its own hand (the cobs and crc packages), not with
lightstage.leds.wire.
"""

from __future__ import annotations

import dataclasses
import hashlib
import io
import json
import os
import pty
import struct
import threading
import tty
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest
import tifffile
from cobs import cobs
from crc import Calculator, Crc16

from lightstage.rig import Camera, Light, Rig, look_at, save_rig

NOT_REPORTED = [
    *("serial", "mode", "iso", "white_balance", "image_format", "focus"),
    *("owner", "artist", "copyright", "place"),
]
"""What libgphoto2's virtual camera cannot report."""

CRC = Calculator(Crc16.IBM_3740, optimized=True)
BALL_PX = 13.0
CORNERS = [(x, y, z) for x in (-700.0, 700.0) for y in (-700.0, 700.0) for z in (-700.0, 700.0)]


def make_rig(cameras: int = 3) -> Rig:
    """Eight lights at a cube's corners; cameras of 32 x 48 pixels on an arc."""
    lights = tuple(
        Light(i, f"corner{i}", place, "horizontal" if i % 2 else "vertical")
        for i, place in enumerate(CORNERS)
    )
    angles = np.radians(np.arange(cameras) * 20.0 - 20.0)
    places = 1100 * np.stack([np.sin(angles), 0 * angles, np.cos(angles)], axis=1)
    return Rig(
        lights,
        tuple(
            Camera(
                f"cam{i}", f"60{i}", "Nikon DSC D750", 32, 48, 140.0, 140.0, 16.0, 24.0,
                (0.0, 0.0, 0.0, 0.0, 0.0), look_at(place, np.zeros(3)),
            )
            for i, place in enumerate(places)
        ),
    )  # fmt: skip


def make_dng(
    value: int | np.ndarray,
    width: int = 32,
    height: int = 48,
    seed: int = 0,
    tags: Sequence[tuple[object, ...]] = (),
) -> bytes:
    """A DNG that LibRaw reads: counts near `value` (or (height, width)), black 512, white 16383.

    Further `tags` are as tifffile takes them.
    """
    counts = np.broadcast_to(value, (height, width)).astype(np.uint16)
    counts += np.random.default_rng(seed).integers(0, 8, counts.shape).astype(np.uint16)
    matrix = [1, 1, 0, 1, 0, 1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1, 1]
    own = [
        (50706, 1, 4, b"\x01\x04\x00\x00", True),
        (50707, 1, 4, b"\x01\x01\x00\x00", True),
        (50708, 2, 0, "Test camera", True),
        (33421, 3, 2, (2, 2), True),
        (33422, 1, 4, b"\x00\x01\x01\x02", True),
        (50710, 1, 3, b"\x00\x01\x02", True),
        (50711, 3, 1, 1, True),
        (50714, 3, 1, 512, True),
        (50717, 3, 1, 16383, True),
        (50721, 10, 9, matrix, True),
        (50728, 5, 3, [1, 1, 1, 1, 1, 1], True),
        (50778, 3, 1, 21, True),
    ]
    file = io.BytesIO()
    tifffile.imwrite(
        file, counts, photometric=32803, extratags=[*own, *tags], metadata=None, software=None
    )
    return file.getvalue()


class LedDevice:
    """A device on the far end of a pty, as docs/led_wire.md says; answers when told to.

    Attributes:
        url: for --leds.
        states: (n,) counts after every change, oldest first.
        on_state: called with new levels in 0..1 before they are acknowledged.
    """

    def __init__(self, lights: int, on_state: Callable[[np.ndarray], None] | None = None) -> None:
        self._device, self._host = pty.openpty()
        tty.setraw(self._device)
        tty.setraw(self._host)
        self.url = f"pty://{os.ttyname(self._host)}?timeout_s=5"
        self.lights = lights
        self.boot_id = 77
        self.states: list[np.ndarray] = []
        self.kinds: list[int] = []
        self.on_state = on_state
        self.dead_after: int | None = None
        self._counts = np.zeros(lights, "<u2")
        self._last: int | None = None
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    @property
    def dark(self) -> bool:
        """Whether no light is on."""
        return not self._counts.any()

    def close(self) -> None:
        """Unplug it."""
        os.close(self._host)
        os.close(self._device)

    def send(self, kind: int, sequence: int, payload: bytes) -> None:
        """Send one packet."""
        body = struct.pack("<BBH", 1, kind, sequence) + payload
        body += struct.pack("<H", CRC.checksum(body))
        os.write(self._device, cobs.encode(body) + b"\0")

    def _serve(self) -> None:
        pending = b""
        while True:
            try:
                pending += os.read(self._device, 4096)
            except OSError:
                return
            *frames, pending = pending.split(b"\0")
            for frame in filter(None, frames):  # a cut packet is ended by one more zero
                self._answer(cobs.decode(frame))

    def _answer(self, packet: bytes) -> None:
        assert CRC.checksum(packet[:-2]) == struct.unpack("<H", packet[-2:])[0]
        _, kind, sequence = struct.unpack_from("<BBH", packet)
        self.kinds.append(kind)
        if self.dead_after is not None and len(self.kinds) > self.dead_after:
            return
        if kind == 0x01:
            self.send(0x02, sequence, struct.pack("<IH", self.boot_id, self.lights) + b"test 1")
            return
        if kind in (0x10, 0x11) and sequence != self._last:
            counts = np.zeros(self.lights, "<u2")
            if kind == 0x10:
                counts = np.frombuffer(packet[6:-2], "<u2")
            self._counts = counts
            self.states.append(counts)
            if self.on_state is not None:
                self.on_state(counts / 65535)
        self._last = sequence
        self.send(0x20, sequence, hashlib.sha256(self._counts.tobytes()).digest())


@dataclasses.dataclass
class Stage:
    """A rig with its device and virtual cameras, whose seeds follow the lights."""

    rig: Rig
    rig_path: Path
    device: LedDevice
    cameras_path: Path
    seeds: list[Path]

    def shown(self, levels: np.ndarray, camera: int) -> bytes:
        """What a camera must see under these levels: a soft white ball with freckles."""
        noise = int.from_bytes(hashlib.sha256(levels.tobytes()).digest()[:4], "little") + camera
        one = self.rig.cameras[camera]
        x, y = np.meshgrid(np.arange(one.width_px) + 0.5, np.arange(one.height_px) + 0.5)
        u, v = (x - one.width_px / 2) / BALL_PX, (one.height_px / 2 - y) / BALL_PX
        depth = np.sqrt(np.clip(1.0 - u**2 - v**2, 0.0, None))
        inside = u**2 + v**2 < 1.0
        # The camera looks at the origin; its rows are x right, y down, z forward.
        right, down, ahead = one.cam_from_world[:, :3]
        normals = u[..., None] * right - v[..., None] * down - depth[..., None] * ahead
        places = self.rig.positions_mm
        cosines = normals @ (places / np.linalg.norm(places, axis=1)[:, None]).T
        lit = np.clip(cosines + 0.4, 0.0, None) / 1.4  # light wraps a little round a soft thing
        # Freckles larger than a pixel: finer ones would pass for noise.
        freckles = np.random.default_rng(7).random((lit.shape[0] // 4 + 1, lit.shape[1] // 4 + 1))
        skin = 0.6 + 0.4 * np.kron(freckles, np.ones((4, 4)))[: lit.shape[0], : lit.shape[1]]
        return make_dng(512 + 1500 * inside * skin * (lit @ levels), seed=noise)

    def show(self, levels: np.ndarray) -> None:
        """Put the photographs that these levels give into the cameras' folders."""
        for camera, seed in enumerate(self.seeds):
            if seed.exists():
                beside = seed.with_suffix(".tmp")
                beside.write_bytes(self.shown(levels, camera))
                os.replace(beside, seed)


@pytest.fixture
def small_rig() -> Rig:
    return make_rig()


@pytest.fixture
def dng() -> Callable[..., bytes]:
    """make_dng, for tests that cannot import this file."""
    return make_dng


@pytest.fixture
def stage(tmp_path: Path) -> Iterator[Stage]:
    rig = make_rig()
    text = f"allow_unverifiable = {json.dumps(NOT_REPORTED)}\n"
    seeds = []
    for camera in rig.cameras:
        folder = tmp_path / "virtual" / camera.id
        seed = folder / "DCIM" / "100TEST" / "seed.jpg"
        seed.parent.mkdir(parents=True)
        seed.write_bytes(make_dng(512))
        seeds.append(seed)
        text += f'[cameras.{camera.id}]\nport = "usb:001,001"\nvirtual_folder = "{folder}"\n'
    cameras_path = tmp_path / "cameras.toml"
    cameras_path.write_text(text)
    device = LedDevice(len(rig.lights))
    stage = Stage(rig, save_rig(rig, tmp_path / "rig.json"), device, cameras_path, seeds)
    device.on_state = stage.show
    yield stage
    device.close()
