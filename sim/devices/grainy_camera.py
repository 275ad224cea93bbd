"""A simulated camera whose photographs never repeat to the byte, as a sensor's noise never does.

``sim.devices.grainy_camera:GrainyCamera`` in a cameras file. Taken twice under one light, a
photograph of `SimulatedCamera` is twice the same; this one's differ in their faintest bits.
"""

from __future__ import annotations

from sim.devices.camera_body import CameraBody
from sim.devices.simulated_camera import DRIVER as PLAIN
from sim.devices.simulated_camera import SimulatedCamera

DRIVER = "sim.devices.grainy_camera:GrainyCamera"
GRAIN_BITS = 32


class GrainyBody(CameraBody):
    """A body that adds grain to each shot's counts; a stale picture keeps its own."""

    def _raw(self, light: bytes, stale: bool) -> bytes:
        data = super()._raw(light, stale)
        if stale and self._raws():
            return data
        return with_grain(data, int(self._state()["shots"]))


class GrainyCamera(SimulatedCamera):
    """The driver of such a body."""

    make_body = GrainyBody


def with_grain(dng: bytes, shot: int) -> bytes:
    """The same photograph, its last pixels' faintest bits turned as the shot's number says.

    Args:
        dng: a little-endian DNG that ends with its uncompressed 16-bit counts.
        shot: 0 to 2^32 - 1; each gives other bytes.
    """
    data = bytearray(dng)
    for bit in range(GRAIN_BITS):
        data[len(data) - 2 - 2 * bit] ^= shot >> bit & 1
    return bytes(data)


def grainy(cameras_file: str) -> str:
    """A cameras file of simulated cameras, with this driver in the place of theirs."""
    return cameras_file.replace(PLAIN, DRIVER)
