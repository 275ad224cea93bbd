"""A rig drawn from before, from above and from its side: lights by bank, cameras with their aim."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from lightstage.patterns.picture import BANK_RGB, EMPTY, FAINT, GROUND, INK
from lightstage.rig import Rig
from lightstage.rig_oddities import odd_lights

SIDE_PX, MARGIN_PX = 560, 46
ODD_RGB = (255, 70, 70)
CAMERA_RGB = (150, 230, 140)
VIEWS = (
    ("from before", 0, -1, "x", "y"),
    ("from above", 0, 2, "x", "z"),
    ("from -x", 2, -1, "z", "y"),
)
"""Title; which axis goes right, which down (-1: y upward), and their names."""


def draw_rig(rig: Rig) -> np.ndarray:
    """(h, w, 3) uint8 picture of three views side by side, on one scale."""
    centres = np.stack([camera.centre_mm for camera in rig.cameras])
    reach = max(float(np.abs(rig.positions_mm).max()), float(np.abs(centres).max()))
    canvas = np.full((SIDE_PX + 2 * MARGIN_PX, 3 * SIDE_PX + 4 * MARGIN_PX, 3), GROUND, np.uint8)
    odd = odd_lights(rig)
    for number, (title, right, down, across, along) in enumerate(VIEWS):
        middle = np.array(
            [MARGIN_PX + number * (SIDE_PX + MARGIN_PX) + SIDE_PX / 2, MARGIN_PX + SIDE_PX / 2]
        )

        def place(
            points: np.ndarray, right: int = right, down: int = down, middle: np.ndarray = middle
        ) -> np.ndarray:
            flat = np.stack(
                [points[..., right], points[..., down] if down > 0 else -points[..., 1]]
            )
            return np.asarray(middle + flat.T * (0.5 * SIDE_PX / reach))

        radius = float(np.median(np.linalg.norm(rig.positions_mm, axis=1)))
        _circle(canvas, middle, radius * 0.5 * SIDE_PX / reach, EMPTY, 1)
        for at, light, strange in zip(place(rig.positions_mm), rig.lights, odd, strict=True):
            _circle(canvas, at, 3.5, BANK_RGB[light.bank], -1)
            if strange:
                _circle(canvas, at, 8, ODD_RGB, 2)
        aim = centres + 0.25 * reach * np.stack([c.cam_from_world[2, :3] for c in rig.cameras])
        for at, to, camera in zip(place(centres), place(aim), rig.cameras, strict=True):
            cv2.line(canvas, _px(at), _px(to), CAMERA_RGB, 1, cv2.LINE_AA)
            cv2.rectangle(canvas, _px(at - 5), _px(at + 5), CAMERA_RGB, -1)
            _text(canvas, camera.id[:12], (at[0] + 8, at[1] - 6), CAMERA_RGB)
        corner = middle - SIDE_PX / 2
        _text(canvas, title, (corner[0], corner[1] - 12), INK)
        up = "up" if down < 0 else "down"
        _text(
            canvas,
            f"{across} to the right, {along} {up}",
            (corner[0], corner[1] + SIDE_PX + 20),
            FAINT,
        )
    _text(
        canvas, f"lamps at {radius:.4g} mm", (middle[0] + 60, middle[1] + SIDE_PX / 2 + 20), FAINT
    )
    return canvas


def _px(place: Sequence[float] | np.ndarray) -> tuple[int, int]:
    x, y = np.rint(np.clip(place, -1e4, 1e4)).astype(int)
    return int(x), int(y)


def _circle(
    canvas: np.ndarray, place: np.ndarray, radius: float, rgb: tuple[int, ...], width: int
) -> None:
    cv2.circle(canvas, _px(place), round(radius), rgb, width, cv2.LINE_AA)


def _text(canvas: np.ndarray, text: str, place: Sequence[float], rgb: tuple[int, ...]) -> None:
    plain = text.encode("ascii", "replace").decode()
    cv2.putText(canvas, plain, _px(place), cv2.FONT_HERSHEY_SIMPLEX, 0.45, rgb, 1, cv2.LINE_AA)
