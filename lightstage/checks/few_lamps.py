"""Light of few lamps, most of all of one: whether it was that lamp's, all of it and no more.

Nothing adds up to such a pattern, but light is linear: it is a share of `full`, and how large a
share in which place a matte ball in the head's place shows [as in `BallModel`]. A head is no ball;
its differences change slowly from a lamp to the next, so a pattern is compared with those
of the session that are near it, once there are enough.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from lightstage.checks.ball import BallModel
from lightstage.checks.config import ChecksConfig
from lightstage.checks.photo_measures import Photo
from lightstage.checks.sums import MIN_CELLS
from lightstage.findings import Finding, two_digits
from lightstage.rig import Rig

FEW_SHARE = 0.1
"""Share of the light of `full` below which a pattern is of few lamps."""
BOUNCE = 0.3
"""Light of a lamp that a ball does not see, as a share of its even part of `full`."""
NEAR_DEG = 40.0
"""Patterns within this angle are neighbours."""
NEIGHBOURS = 4
KNOWN = 8
"""Least number of patterns before a pattern is compared with the others of the session."""
STEP = 1.6
"""Factor of light from neighbour to neighbour that a head can make."""
UNLIT = 0.25
"""Share of the expected light below which a lamp counts as out."""
LEAST_DEG = 8.0
"""Angle between the direction of the light and the right one from which it is reported."""
SURE = 4.0
"""Robust deviations of what the other patterns show."""
AMID_DEG = 8.0
"""The known patterns near a lamp must surround it: their middle is no farther away."""
BEYOND = 1.3
"""Times the angle within which nine of ten other patterns are."""
ONE_WAY = 0.95
"""Length of the mean of the lamps' directions above which a pattern has one direction."""
LIT, ROUNDS = 0.3, 4
"""Surfaces that face a lamp by more than this cosine show its direction; rounds that find them."""
TIE = 2.0
"""Weight of the ball model in the fit of a head's directions, as a number of patterns."""


@dataclasses.dataclass(frozen=True)
class FewLight:
    """What the cameras show of a pattern of few lamps.

    Attributes:
        toward: (3,) unit direction of its lamps, or None where they have no common one.
        seen: mean over cameras, share of full.
        expected: the same of the ball.
        floor: what cannot be distinguished from none, by bounced light and room.
        noise: of `seen`, `SURE` times its deviation.
        room: light of the room that may be in `seen`, as nobody has measured it.
        came_from: (3,) unit direction of the light as a ball would show it, or None.
    """

    toward: np.ndarray | None
    seen: float
    expected: float
    floor: float
    noise: float
    room: float
    came_from: np.ndarray | None

    @property
    def ratio_log(self) -> float:
        """Natural logarithm of seen over expected light."""
        return float(np.log(max(self.seen + self.floor, 1e-9) / (self.expected + self.floor)))


class FewLamps:
    """All patterns of few lamps of a session.

    What it cannot see: a lamp behind the head whose light reaches no camera's view of it, light
    that leaves the expected by less than `STEP` (one lamp of two that shine), a neighbour nearer
    than `LEAST_DEG` or one shown before the patterns around it, and the first patterns of a
    session beyond `ChecksConfig.max_expected_ratio`.
    `full` must have been photographed before.

    Args:
        rig: the lamps.
        levels: pattern to (n,) levels.
    """

    def __init__(self, rig: Rig, levels: Mapping[str, np.ndarray]) -> None:
        self._rig = rig
        self._levels = levels
        positions = rig.positions_mm
        self._directions = positions / np.linalg.norm(positions, axis=1, keepdims=True)
        self._known: dict[str, FewLight] = {}

    def forget(self, pattern: str) -> None:
        """Its photographs do not count."""
        self._known.pop(pattern, None)

    def findings(
        self,
        pattern: str,
        whole: str,
        photos: Mapping[str, Photo],
        wholes: Mapping[str, Photo],
        darks: Mapping[str, np.ndarray],
        model: BallModel,
        config: ChecksConfig,
    ) -> list[Finding]:
        """Judge a pattern's photographs; nothing where it is not of few lamps.

        Args:
            pattern: their light.
            whole: the brightest pattern.
            photos: camera to its photograph.
            wholes: camera to its photograph under the whole.
            darks: camera to (r, c, 3) light without a lamp, where it is known.
            model: of the rig.
            config: the limits.
        """
        self.forget(pattern)
        own, all_of = self._levels[pattern], self._levels[whole]
        if not 0 < own.sum() <= FEW_SHARE * all_of.sum():
            return []
        few = self._measure(pattern, whole, photos, wholes, darks, model, config)
        if few is None:
            return []
        out = self._amount(pattern, few, config) or self._direction(pattern, few)
        if not out:
            self._known[pattern] = few
        return out

    def _measure(
        self,
        pattern: str,
        whole: str,
        photos: Mapping[str, Photo],
        wholes: Mapping[str, Photo],
        darks: Mapping[str, np.ndarray],
        model: BallModel,
        config: ChecksConfig,
    ) -> FewLight | None:
        seen, lamps, weights, noise = [], [], [], []
        totals, normals = [], []
        known = True
        for camera, photo in photos.items():
            if camera not in wholes or photo.coarse.shape != wholes[camera].coarse.shape:
                continue
            bright = wholes[camera]
            lit, directions = model.normals(camera, bright)
            good = (photo.usable & bright.usable)[lit]
            if good.sum() < MIN_CELLS:
                continue
            dark = darks.get(camera)
            known &= dark is not None and dark.shape == photo.coarse.shape
            base = photo.coarse[..., 1].astype(float)
            if dark is not None and dark.shape == photo.coarse.shape:
                base = base - dark[..., 1]
            full = bright.coarse[..., 1][lit][good].astype(float)
            single = model.single(directions[good])
            total = self._levels[whole] @ single
            totals.append(total)
            normals.append(directions[good])
            seen.append(base[lit][good] / full)
            lamps.append(single / np.maximum(total, 1e-9 + 1e-3 * total.max()))
            weights.append(full / full.sum())
            noise.append(float(np.sqrt((photo.spread[lit][good] ** 2).sum()) / full.sum()))
        if not seen:
            return None
        y, light, w = np.concatenate(seen), np.concatenate(lamps, axis=1), np.concatenate(weights)
        w /= w.sum()
        own = self._levels[pattern]
        even = float(own.sum() / self._levels[whole].sum())
        room = 0.0 if known else config.warn_ambient_share
        toward = own @ self._directions / own.sum()
        length = float(np.linalg.norm(toward))
        return FewLight(
            toward / length if length > ONE_WAY else None,
            float(y @ w),
            float(own @ light @ w),
            BOUNCE * even,
            SURE * float(np.sqrt(np.mean(np.square(noise)) / len(noise))),
            room,
            _origin(y * np.concatenate(totals), np.concatenate(normals), w),
        )

    def _amount(self, pattern: str, few: FewLight, config: ChecksConfig) -> list[Finding]:
        """Too much or too little light."""
        log, limit = few.ratio_log, float(np.log(config.max_expected_ratio))
        sure = few.noise + few.room
        near = self._near(few)
        if near is not None:
            middle, spread = near
            limit = min(max(float(np.log(STEP)), SURE * spread), limit)
            log, sure = log - middle, few.noise  # the neighbours have the same room
        wanted = (few.expected + few.floor) * float(np.exp(few.ratio_log - log)) - few.floor
        if log > limit and few.seen - wanted > sure:
            factor = few.seen / max(wanted, few.floor)
            return [
                _refusal("wrong-light", pattern, f"{two_digits(factor)} times its light", TOO_MUCH)
            ]
        if log < -limit and wanted - few.seen > sure and wanted > few.floor:
            share = max(few.seen, 0.0) / wanted
            code = "not-lit" if share < UNLIT else "light-level"
            return [
                _refusal(code, pattern, f"{two_digits(100 * share)} % of its light", TOO_LITTLE)
            ]
        return []

    def _near(self, few: FewLight) -> tuple[float, float] | None:
        """Middle of the neighbours' `ratio_log`, and how far patterns are from theirs."""
        if few.toward is None:
            return None
        known = [each for each in self._known.values() if each.toward is not None]
        if len(known) < KNOWN:
            return None
        directions = np.stack([each.toward for each in known if each.toward is not None])
        logs = np.array([each.ratio_log for each in known])
        middle = _neighbours(directions, logs, few.toward, None)
        if middle is None:
            return None
        offs = []
        for index, direction in enumerate(directions):
            expected = _neighbours(directions, logs, direction, index)
            if expected is not None:
                offs.append(abs(float(logs[index]) - expected))
        return (middle, 1.48 * float(np.median(offs))) if len(offs) >= KNOWN // 2 else None

    def _direction(self, pattern: str, few: FewLight) -> list[Finding]:
        """Light that comes from another lamp."""
        if few.toward is None or few.came_from is None or few.expected < few.floor:
            return []
        known = [
            (each.toward, each.came_from)
            for each in self._known.values()
            if each.toward is not None and each.came_from is not None
        ]
        if len(known) < KNOWN:
            return []
        true, shown = (np.stack(column) for column in zip(*known, strict=True))
        near = np.exp(-(_degrees(true, few.toward) ** 2) / (2 * NEAR_DEG**2))[:, None]
        around = true[_degrees(true, few.toward) < NEAR_DEG].sum(axis=0)
        if not around.any() or float(_degrees(around, few.toward)[0]) > AMID_DEG:
            return []  # a map that holds on one side proves nothing about the other
        # A smooth map from the ball's directions to this head's, near this lamp.
        normal = (true * near).T @ true + TIE * np.eye(3)
        head = np.linalg.solve(normal, (true * near).T @ shown + TIE * np.eye(3))
        # The map holds around this lamp, and so does what it leaves.
        others = [float(_degrees(t @ head, s)[0]) for t, s in zip(true, shown, strict=True)]
        others = [each for each, share in zip(others, near[:, 0], strict=True) if share > 0.5]
        if len(others) < NEIGHBOURS:
            return []
        off = float(_degrees(few.toward @ head, few.came_from)[0])
        if off <= max(LEAST_DEG, BEYOND * float(np.quantile(others, 0.9))):
            return []
        lamps = _degrees(self._directions @ head, few.came_from)
        best = int(lamps.argmin())
        if lamps[best] > 0.5 * off:
            return []
        light = self._rig.lights[best]
        where = f"light from {off:.0f} degrees beside its lamp, as of lamp {light.id}"
        return [
            _refusal("wrong-light", pattern, f"{where} ({light.name}) or one near it", ELSEWHERE)
        ]


TOO_MUCH = "More lamps are on than were set: inspect the stage, retake it."
TOO_LITTLE = "Is the lamp dead, or did it not light? Inspect it, retake the pattern."
ELSEWHERE = "Another lamp shone: check the lamps' order and wiring; are the banks swapped?"


def _refusal(code: str, pattern: str, found: str, hint: str) -> Finding:
    place = f"all cameras, pattern {pattern}"
    expected = "its share of the light of all lamps"
    return Finding("retake", code, place, found, expected, hint, pattern, None)


def _origin(light: np.ndarray, normals: np.ndarray, weight: np.ndarray) -> np.ndarray | None:
    """(3,) direction that (m,) light on surfaces that face (m, 3) directions comes from.

    A matte surface that a far lamp reaches shows the cosine of its angle: least
    squares over what faces the lamp as found so far.
    """
    facing = light > LIT * float(np.quantile(light, 0.95))
    toward: np.ndarray = np.zeros(3)
    for _ in range(ROUNDS):
        if facing.sum() < MIN_CELLS:
            return None
        some = normals[facing]
        normal = (some * weight[facing, None]).T @ some
        normal += 1e-3 * np.trace(normal) * np.eye(3)
        toward = np.linalg.solve(normal, some.T @ (weight[facing] * light[facing]))
        length = float(np.linalg.norm(toward))
        if not length > 0:
            return None
        toward = toward / length
        facing = normals @ toward > LIT
    return toward


def _neighbours(
    directions: np.ndarray, values: np.ndarray, toward: np.ndarray, without: int | None
) -> float | None:
    """Median of the values of the nearest directions; None where too few are near."""
    angles = _degrees(directions, toward)
    if without is not None:
        angles[without] = np.inf
    nearest = np.argsort(angles)[:NEIGHBOURS]
    if len(nearest) < NEIGHBOURS or angles[nearest].max() > NEAR_DEG:
        return None
    return float(np.median(values[nearest]))


def _degrees(directions: np.ndarray, toward: np.ndarray) -> np.ndarray:
    """(n,) angles between (n, 3) or (3,) directions and one, none need be of length 1."""
    rows = np.atleast_2d(directions)
    length = np.linalg.norm(rows, axis=1) * np.linalg.norm(toward)
    return np.asarray(np.degrees(np.arccos(np.clip(rows @ toward / length, -1, 1))))
