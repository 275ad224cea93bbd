"""The ChArUco board that a lab has printed: what it photographs, and what its photographs show.

`calibration.json` of a lab's shots holds it as ``target``, one key a field.
"""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np

from lightstage.errors import ConfigError


@dataclasses.dataclass(frozen=True)
class BoardConfig:
    """The ChArUco board as printed and measured [GarridoJurado2014].

    Attributes:
        columns: squares across.
        rows: squares down.
        square_mm: side of a square, measured on the print: all distances hang on it.
        marker_mm: side of a marker.
        dictionary: OpenCV's name of the markers' dictionary.
        legacy: printed with OpenCV before 4.6, an even number of rows.
    """

    columns: int = 8
    rows: int = 11
    square_mm: float = 20.0
    marker_mm: float = 12.0
    dictionary: str = "DICT_4X4_50"
    legacy: bool = False

    @property
    def corners(self) -> int:
        """Inner corners, all that can be found."""
        return (self.columns - 1) * (self.rows - 1)

    def check(self, where: str = "board") -> None:
        """Refuse a board that cannot be.

        Args:
            where: what the error names.

        Raises:
            ConfigError: OpenCV knows no such dictionary, or there is no such board.
        """
        name = self.dictionary
        if not (name.startswith("DICT_") and isinstance(getattr(cv2.aruco, name, None), int)):
            raise ConfigError(
                where,
                field="dictionary",
                found=repr(name),
                expected="OpenCV's name of one, such as DICT_4X4_50",
            )
        if not (min(self.columns, self.rows) >= 3 and self.square_mm > self.marker_mm > 0):
            raise ConfigError(
                where,
                found=f"{self.columns} x {self.rows} squares of {self.square_mm:g} mm, markers of "
                f"{self.marker_mm:g} mm",
                expected="at least 3 x 3 squares, and markers smaller than squares",
            )

    def board(self) -> cv2.aruco.CharucoBoard:
        """OpenCV's board; errors as of `check`."""
        self.check()
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        size = (self.columns, self.rows)
        board = cv2.aruco.CharucoBoard(size, self.square_mm, self.marker_mm, dictionary)
        board.setLegacyPattern(self.legacy)
        return board

    def detector(self) -> cv2.aruco.CharucoDetector:
        """OpenCV's detector of this board; errors as of `check`."""
        return cv2.aruco.CharucoDetector(self.board())

    def corners_mm(self) -> np.ndarray:
        """((columns - 1)(rows - 1), 3) inner corners, by OpenCV's corner id; z = 0."""
        return np.asarray(self.board().getChessboardCorners(), float)
