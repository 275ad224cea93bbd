"""Which lamp of the rig each wire lights, from a mirror ball photographed lamp after lamp.

All photographs together show the highlights of all lamps, whatever the wires do. So each camera's
highlights are first placed over those of the rig's lamps as a whole, by a shift, a scale and a
turn, which account for the ball's place and the camera's aim. Then each photograph's highlight
is the nearest lamp's, if it is clearly nearer to that one than to the next, in the median over
cameras.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.spatial import cKDTree

from lightstage.rig import Rig
from processing.calibration.ball import nearest_point, rays_through
from processing.calibration.lights.highlights import expected_px
from processing.calibration.lights.mirror_ball import Seen

GATE_SHARE = 0.05
"""Share of the ball's radius: a highlight farther than this from where a lamp's should be is not
that lamp's. Lamps whose directions differ by 6 degrees are so far apart in the middle of the ball.
"""
CLEAR = 0.5
"""The next lamp's highlight must be farther off than the nearest one's over this."""
LEAST_SEEN = 4
"""Highlights of one camera below which they cannot be placed over the lamps' as a whole."""
ROUNDS, AGAIN = 30, 4
TINY = 1e-12
MOST_OFF_MM = 300.0
"""From the middle of the stage: a ball farther off is a mistake of the cameras' aims."""
SPREAD = (10.0, 90.0)
"""Percentiles between which highlights are compared for a first scale."""
START_STEP, START_STEPS = 1.5, 2
"""Distance of the starts around equal medians, in gates, and how many there are to each side."""
SCALES = (0.8, 1.25)
"""Limits of that scale: a ball elsewhere, a lens that the rig has wrong."""


@dataclasses.dataclass(frozen=True)
class Wiring:
    """What n wires light, of L lamps.

    Attributes:
        lamp: (n,) place of the lamp in the rig's list; -1 where it is not sure.
        off_mm: (n,) distance of the wire's highlights on the ball from that lamp's, or from the
            nearest one's; infinite where no camera saw a highlight.
        maybe: (n,) for a wire that is not sure, the lamps that it may be, nearest first.
        sightings: (n,) highlights that were seen, over cameras and poses.
    """

    lamp: np.ndarray
    off_mm: np.ndarray
    maybe: tuple[tuple[int, ...], ...]
    sightings: np.ndarray


def find_wiring(seen: list[Seen], rig: Rig, radius_mm: float) -> Wiring:
    """Which lamp each wire lights.

    Args:
        seen: highlights of single lights; `Seen.lamp` is which wire was switched on, by the place
            in the rig's list of the light that was meant.
        rig: where the lamps stand.
        radius_mm: of the ball.
    """
    gate_mm = GATE_SHARE * radius_mm
    places = {each.pose: np.zeros(3) for each in seen}
    views = [_view(each, rig, radius_mm, places) for each in seen]
    placed = [_placed_over(view, gate_mm) for view in views]
    found = _decided(views, placed, len(rig.lights), gate_mm)
    for _ in range(AGAIN):
        # A camera whose highlights were placed one lamp aside is corrected by what the others know;
        # and the ball's place changes the highlights of lamps behind it differently.
        places = _ball_places(views, placed, places)
        views = [_view(each, rig, radius_mm, places) for each in seen]
        placed = [_by_known(view, found.lamp) for view in views]
        found = _decided(views, placed, len(rig.lights), gate_mm)
    return found


@dataclasses.dataclass(frozen=True)
class _View:
    """One camera's highlights.

    Attributes:
        seen: as they were found.
        want_px: (L + 1, 2) where the lamps' should be, and last the ball's middle.
        mm_per_px: at the ball.
    """

    seen: Seen
    want_px: np.ndarray
    mm_per_px: float

    @property
    def visible(self) -> np.ndarray:
        """Lamps whose highlights the camera should see."""
        return np.flatnonzero(np.isfinite(self.want_px[:-1]).all(axis=1))


def _view(each: Seen, rig: Rig, radius_mm: float, places: dict[int, np.ndarray]) -> _View:
    camera, place = each.camera, places[each.pose]
    want = expected_px(camera, place, radius_mm, rig.positions_mm)
    middle, depth = camera.project(place[None])
    return _View(each, np.concatenate([want, middle]), float(depth[0]) / camera.fx_px)


def _ball_places(
    views: list[_View], placed: list[np.ndarray | None], before: dict[int, np.ndarray]
) -> dict[int, np.ndarray]:
    """The ball's place in each pose: nearest to the rays through its middle in all pictures."""
    out = {}
    for pose, place in before.items():
        pairs = [
            (view.seen.camera, own[-1])
            for view, own in zip(views, placed, strict=True)
            if own is not None and view.seen.pose == pose
        ]
        out[pose] = place
        if len(pairs) > 1:
            origins = np.array([camera.centre_mm for camera, _ in pairs])
            rays = np.concatenate([rays_through(camera, px[None]) for camera, px in pairs])
            found = nearest_point(origins, rays)
            if np.linalg.norm(found) < MOST_OFF_MM:
                out[pose] = found
    return out


def _decided(
    views: list[_View], placed: list[np.ndarray | None], count: int, gate_mm: float
) -> Wiring:
    """Which lamp each wire lights, with the lamps' highlights placed over each view's."""
    off: list[list[np.ndarray]] = [[] for _ in range(count)]
    for view, places in zip(views, placed, strict=True):
        if places is None:
            continue
        off_px = view.seen.found.place_px[:, None] - places[None, :-1]
        apart = view.mm_per_px * np.linalg.norm(off_px, axis=2)
        for wire, row in zip(view.seen.lamp, np.where(np.isnan(apart), np.inf, apart), strict=True):
            off[int(wire)].append(row)
    table = np.full((count, count), np.inf)
    for wire, rows in enumerate(off):
        if rows:
            table[wire] = np.median(np.stack(rows), axis=0)
    lamp = sure_lamps(table, gate_mm)
    order = np.argsort(table, axis=1, kind="stable")
    maybe = tuple(
        tuple(int(k) for k in order[wire] if table[wire, k] <= gate_mm) if lamp[wire] < 0 else ()
        for wire in range(count)
    )
    return Wiring(lamp, table.min(axis=1), maybe, np.array([len(rows) for rows in off]))


def sure_lamps(table: np.ndarray, gate_mm: float) -> np.ndarray:
    """(n,) the lamp that each wire lights, -1 where that is not sure.

    Sure is a wire whose nearest lamp is near and clearly nearer than any other that no other wire
    surely lights. Two wires at one lamp are both unsure: one of them shows something else, such
    as a window.

    Args:
        table: (n, L) distances, mm; infinite where unknown.
        gate_mm: what counts as near.
    """
    nearest, rows = table.argmin(axis=1), np.arange(len(table))
    near = table[rows, nearest]
    lamp, claimed_twice = np.full(len(table), -1), np.zeros(table.shape[1], bool)
    while True:
        others = table.copy()
        others[rows, nearest] = np.inf
        others[:, lamp[lamp >= 0]] = np.inf
        sure = (near <= gate_mm) & (near < CLEAR * others.min(axis=1))
        claimed_twice |= np.bincount(nearest[sure], minlength=table.shape[1]) > 1
        fresh = np.where(sure & ~claimed_twice[nearest], nearest, -1)
        if np.array_equal(fresh, lamp):
            return lamp
        lamp = fresh


def _placed_over(view: _View, gate_mm: float) -> np.ndarray | None:
    """`want_px` of a view, moved and scaled as a whole onto the highlights that were found.

    From equal medians and spreads on, and from places around them where some highlights are
    missing, by nearest neighbours, as in iterative closest points [Besl1992]; the start counts
    after which they are nearest. None where there are too few.
    """
    found, want, visible = view.seen.found.place_px, view.want_px, view.visible
    if min(len(visible), len(found)) < LEAST_SEEN:
        return None
    off = want - np.median(want[visible], axis=0)
    wide, own = (
        np.diff(np.percentile(each, SPREAD, axis=0), axis=0).sum() for each in (found, off[visible])
    )
    first = np.clip(wide / max(own, TINY), *SCALES) * off
    gate_px = gate_mm / view.mm_per_px
    middle, step = np.median(found, axis=0), START_STEP * gate_px
    steps = step * np.arange(-START_STEPS, START_STEPS + 1)
    best, least = None, np.inf
    for start in np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2):
        placed = _settled(first + middle + start, want, visible, found, gate_px)
        far = np.asarray(cKDTree(placed[visible]).query(found)[0])
        score = float(np.minimum(far, gate_px).mean())
        if score < least:
            best, least = placed, score
    return best


def _settled(
    placed: np.ndarray, want: np.ndarray, visible: np.ndarray, found: np.ndarray, gate_px: float
) -> np.ndarray:
    """Iterative closest points from where (L, 2) highlights are placed at first."""
    for _ in range(ROUNDS):
        far, index = map(np.asarray, cKDTree(placed[visible]).query(found))
        near = far <= max(gate_px, float(np.median(far)))
        fresh = _moved(want, visible[index[near]], found[near])
        if fresh is None or np.allclose(fresh[visible], placed[visible], atol=1e-6):
            break
        placed = fresh
    return placed


def _by_known(view: _View, lamp: np.ndarray) -> np.ndarray | None:
    """The same by the wires whose lamps (n,) are known; None where there are too few."""
    own = lamp[view.seen.lamp]
    known = np.isin(own, view.visible)
    return _moved(view.want_px, own[known], view.seen.found.place_px[known])


def _moved(want: np.ndarray, which: np.ndarray, at: np.ndarray) -> np.ndarray | None:
    """All of (L, 2) places turned, scaled and shifted as brings some of them nearest to `at`.

    Least squares over complex numbers: a turn and a scale are one factor. None where fewer than
    LEAST_SEEN have it, or where they are in one place.
    """
    own, there = _complex(want[which]), _complex(at)
    if len(own) < LEAST_SEEN:
        return None
    centred = own - own.mean()
    power = float(np.vdot(centred, centred).real)
    if power < TINY:
        return None
    factor = np.vdot(centred, there - there.mean()) / power
    moved = factor * (_complex(want) - own.mean()) + there.mean()
    return np.stack([moved.real, moved.imag], axis=1)


def _complex(places: np.ndarray) -> np.ndarray:
    return np.asarray(places[:, 0] + 1j * places[:, 1])
