"""Light that nobody asked for: of the room, or of a lamp that stays on, or one that died.

What is left of a sum, or is in a dark photograph, is fitted over all cameras by the room (the
same from everywhere) and one lamp, each as a matte ball would show it [as in `BallModel`]; the lamp
that explains most is named when it explains much.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import cv2
import numpy as np

from lightstage.checks.ball import BallModel
from lightstage.checks.photo_measures import Photo
from lightstage.checks.sums import MIN_CELLS

MIN_EXPLAINED = 0.3
LEVELS = (0.2, 5.0)
"""A lamp's level as fitted must be between these to be believed: a head is no ball."""


@dataclasses.dataclass(frozen=True)
class Stray:
    """Stray light as it was fitted.

    Attributes:
        share: mean over cameras, of full; negative where light is missing.
        lamp: index of the lamp that explains it, or None where it comes from all around.
        level: of that lamp, 1 is full; negative where it is missing.
        explained: share of the pattern of the stray light that the lamp explains and the room
            does not.
        near: other lamps that explain it nearly as well.
    """

    share: float
    lamp: int | None
    level: float
    explained: float
    near: tuple[int, ...]


def find_stray(
    model: BallModel, left: Mapping[str, np.ndarray], whole: Mapping[str, Photo]
) -> Stray | None:
    """Explain light that is left over.

    Args:
        model: of the rig.
        left: camera to (r, c) light left over, green, share of white.
        whole: camera to its photograph under `full`.

    Returns:
        None where no camera has lit cells.
    """
    seen, single, weight, shares = [], [], [], []
    for camera_id, light in left.items():
        photo = whole[camera_id]
        lit, directions = model.normals(camera_id, photo)
        # At the subject's edge a little motion leaves more light over than any lamp.
        inner = cv2.erode((lit & photo.usable).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        lit, directions = inner, directions[inner[lit]]
        if len(directions) < MIN_CELLS or light.shape != lit.shape:
            continue
        base = model.single(directions)
        total = base.sum(axis=0)
        full = photo.coarse[..., 1][lit].astype(float)
        part = light[lit] / full
        low, high = np.quantile(part, (0.02, 0.98))
        part = np.clip(part, low, high)
        seen.append(part)
        single.append(base / np.maximum(total, 1e-3 * total.max()))
        weight.append(full**2 / (full**2).sum())
        shares.append(float((part * full).sum() / full.sum()))
    if not seen:
        return None
    y, lamps, w = np.concatenate(seen), np.concatenate(single, axis=1), np.concatenate(weight)
    root = np.sqrt(w)
    room = root / np.linalg.norm(root)
    target = y * root
    target = target - room * (room @ target)
    columns = lamps * root
    columns = columns - np.outer(columns @ room, room)
    power = (columns**2).sum(axis=1)
    along = columns @ target
    # What is there beyond the whole can only be light, what is missing only missing light.
    sign = 1.0 if np.mean(shares) > 0 else -1.0
    gain = np.maximum(sign * along, 0.0) ** 2 / np.maximum(power, 1e-30)
    total = float(target @ target)
    best = int(np.argmax(gain))
    explained = float(gain[best] / total) if total > 0 else 0.0
    level = float(along[best] / max(power[best], 1e-30))
    believed = explained > MIN_EXPLAINED and LEVELS[0] < abs(level) < LEVELS[1]
    near = [int(i) for i in np.flatnonzero(gain > 0.85 * gain[best]) if i != best]
    return Stray(float(np.mean(shares)), best if believed else None, level, explained, tuple(near))
