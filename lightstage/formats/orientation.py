"""How what a sensor read is brought upright: mirrored or not, then turned by quarters."""

from __future__ import annotations

import dataclasses

import numpy as np


@dataclasses.dataclass(frozen=True)
class Orientation:
    """From the sensor's rows and columns to the upright picture.

    Attributes:
        turns: quarter turns against the clock, 0 to 3.
        mirrored: whether columns are put in reverse order before the turns.
    """

    turns: int = 0
    mirrored: bool = False

    def upright(self, picture: np.ndarray) -> np.ndarray:
        """A view of (h, w, ...) turned upright."""
        return np.rot90(picture[:, ::-1] if self.mirrored else picture, self.turns)

    def as_read(self, picture: np.ndarray) -> np.ndarray:
        """A view of an upright picture (h, w, ...) in the sensor's rows and columns."""
        turned = np.rot90(picture, -self.turns)
        return turned[:, ::-1] if self.mirrored else turned

    def shape(self, size: tuple[int, int]) -> tuple[int, int]:
        """Rows and columns of the upright picture of (rows, columns) that the sensor reads."""
        return (size[1], size[0]) if self.turns % 2 else size

    def place_as_read(
        self, x_px: float, y_px: float, width_px: int, height_px: int
    ) -> tuple[float, float]:
        """Where a place of the upright picture is in what the sensor reads, pixels.

        Args:
            x_px: from the upright picture's left side.
            y_px: from its top.
            width_px: of the upright picture.
            height_px: of the upright picture.
        """
        width, height = width_px, height_px
        for _ in range(self.turns % 4):
            # A quarter turn with the clock: the left side becomes the top.
            x_px, y_px = height - y_px, x_px
            width, height = height, width
        return (width - x_px if self.mirrored else x_px), y_px


UNTURNED = Orientation()
OF_TIFF = {
    1: UNTURNED,
    2: Orientation(0, True),
    3: Orientation(2),
    4: Orientation(2, True),
    5: Orientation(1, True),
    6: Orientation(3),
    7: Orientation(3, True),
    8: Orientation(1),
}
"""By the tag Orientation of TIFF and EXIF [TIFF1992]."""
_OF_FLIP = {0: 1, 1: 2, 2: 4, 3: 3, 4: 5, 5: 8, 6: 6, 7: 7}


def of_libraw(flip: int) -> Orientation:
    """What LibRaw's `flip` asks for: bit 0 reverses columns, bit 1 rows, bit 2 swaps the two."""
    return OF_TIFF[_OF_FLIP[flip & 7]]
