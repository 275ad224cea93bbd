"""Where lamps stand, from a mirror ball in two places or more before several cameras.

A highlight's pixel gives a ray, the ball turns it, and the lamp is on it. Lamps, the ball's
places and its radius are solved together: least squares of the highlights' distances in pixels,
with the rig's own positions as a weak prior, since rays that all start on a ball meet at sharp
angles far away.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.spatial import cKDTree

from lightstage.counting import counted
from lightstage.rig import Camera
from processing.calibration.ball import nearest_point, rays_through
from processing.calibration.lights.config import MirrorBallConfig
from processing.calibration.lights.flux import Flux
from processing.calibration.lights.highlights import Highlights, expected_px, mirrored
from processing.errors import ProcessingError

SOLVES, MATCHES = 12, 6
LEAST_SEEN = 8
"""Highlights of a pose, over all cameras, below which it is no picture of the stage's lamps."""
DIRECTION_APART = 0.25
"""How far a highlight's gradients may be from its lamp's levels, as a chord between directions."""
TINY = 1e-12
CONVERGED_MM = 1e-3


@dataclasses.dataclass(frozen=True)
class Seen:
    """Highlights that one camera sees of one pose.

    Attributes:
        pose: which one.
        camera: of the picture.
        found: the highlights.
        lamp: (n,) which lamp each one is where that is known (one light a photograph), else -1.
        toward: (n, 3) how much stronger each is in x+ than in x-, of their sum, so y and z, as
            linear gradients show it; NaN where unknown.
        signature: (L, 3) the same of each lamp's levels.
        level: (L,) of each lamp in the photograph.
        apart_px: highlights nearer to each other than this cannot be distinguished.
    """

    pose: int
    camera: Camera
    found: Highlights
    lamp: np.ndarray
    toward: np.ndarray
    signature: np.ndarray
    level: np.ndarray
    apart_px: float


@dataclasses.dataclass(frozen=True)
class Placed:
    """Lamps' positions.

    Attributes:
        position_mm: (L, 3).
        sigma_mm: (L,) standard deviation along the worst axis.
        residual_px: (L,) root mean square; NaN where no camera saw it.
        sightings: (L,) int, highlights that were used.
        centres_mm: (poses, 3) the ball's places.
        radius_mm: the ball's.
        rms_px: over all highlights used.
        flux: what the highlights give of the lamps' gains, see `Flux`.
    """

    position_mm: np.ndarray
    sigma_mm: np.ndarray
    residual_px: np.ndarray
    sightings: np.ndarray
    centres_mm: np.ndarray
    radius_mm: float
    rms_px: float
    flux: Flux


def solve_lamps(
    seen: list[Seen], nominal_mm: np.ndarray, config: MirrorBallConfig, where: str
) -> Placed:
    """Positions of L lamps.

    Args:
        seen: highlights of every pose in every camera.
        nominal_mm: (L, 3) the rig's positions.
        config: the ball.
        where: what an error names.

    Raises:
        ProcessingError: a pose in which too few lamps are seen, or a ball of another radius.
    """
    poses = 1 + max((each.pose for each in seen), default=-1)
    centres = np.array([_first_place(seen, pose, where) for pose in range(poses)]).reshape(-1, 3)
    state = _State(nominal_mm.astype(float).copy(), centres, config.radius_mm)
    matched = None
    for round_ in range(MATCHES):
        # Far off at first: the nearest highlight is the lamp's own while it is nearer than half
        # way to the next.
        gate = config.gate_px * max(1.0, 3.0 * 0.5**round_) * _finest(seen, config)
        fresh = _match(seen, state, gate, config)
        if matched is not None and np.array_equal(fresh.lamp, matched.lamp):
            break
        matched = fresh
        if len(matched.lamp) < LEAST_SEEN * poses:
            raise ProcessingError(
                where,
                field="mirror",
                found=f"{counted(len(matched.lamp), 'highlight')} at the rig's lamps",
                expected=f"at least {LEAST_SEEN} a pose",
                hint="Is it the rig of this stage, and the mirror ball in its middle?",
            )
        state = _solved(matched, state, nominal_mm, config)
    assert matched is not None
    if abs(state.radius_mm / config.radius_mm - 1) > 0.03:
        raise ProcessingError(
            where,
            field="radius_mm",
            found=f"a mirror ball of {state.radius_mm:.1f} mm radius in the photographs",
            expected=f"{config.radius_mm:g} mm",
            hint="Measure the ball and give its radius.",
        )
    return _placed(matched, state, nominal_mm, config)


@dataclasses.dataclass(frozen=True)
class _State:
    lamps_mm: np.ndarray
    centres_mm: np.ndarray
    radius_mm: float


@dataclasses.dataclass(frozen=True)
class _Matched:
    """n sightings: which lamp, pose and photograph; the camera's centre and ray; the flux."""

    lamp: np.ndarray
    pose: np.ndarray
    group: np.ndarray
    origin: np.ndarray
    ray: np.ndarray
    side: np.ndarray  # (2, n, 3) rays half a step to the right and below
    flux: np.ndarray


SIDE_PX = 0.05


def _first_place(seen: list[Seen], pose: int, where: str) -> np.ndarray:
    """The ball's place to begin with: highlights fill its disc evenly to the rim."""
    own = [each for each in seen if each.pose == pose and len(each.found.place_px) >= 4]
    total = sum(len(each.found.place_px) for each in seen if each.pose == pose)
    if len(own) < 2 or total < LEAST_SEEN:
        raise ProcessingError(
            where,
            field=f"mirror, pose {pose + 1}",
            found=f"{counted(total, 'highlight')} in {counted(len(own), 'camera')}",
            expected=f"at least {LEAST_SEEN}, in two cameras",
            hint="Is the mirror ball in the middle of the stage, and the exposure long enough?",
        )
    origins, rays = [], []
    for each in own:
        px = each.found.place_px
        middle = (px.min(axis=0) + px.max(axis=0)) / 2
        origins.append(each.camera.centre_mm)
        rays.append(rays_through(each.camera, middle[None])[0])
    return nearest_point(np.array(origins), np.array(rays))


def _finest(seen: list[Seen], config: MirrorBallConfig) -> float:
    """Pixels of the coarsest picture that a hundredth of the ball's radius covers, at least 1."""
    scale = [s.camera.fx_px / np.linalg.norm(s.camera.centre_mm) for s in seen]
    return max(1.0, 0.01 * config.radius_mm * float(min(scale)))


def _match(seen: list[Seen], state: _State, gate_px: float, config: MirrorBallConfig) -> _Matched:
    rows: list[tuple[np.ndarray, ...]] = []
    for group, each in enumerate(seen):
        camera, centre = each.camera, state.centres_mm[each.pose]
        known = each.lamp >= 0
        want = expected_px(camera, centre, state.radius_mm, state.lamps_mm)
        apart = each.found.place_px[:, None] - want[None]
        far = np.sqrt(np.sum(apart * apart, axis=2))
        chord = np.linalg.norm(each.toward[:, None] - each.signature[None], axis=2)
        lost = (each.level <= 0) | (_crowded(want, each) & (not known.any()))
        far = np.where(np.isnan(far) | (chord > DIRECTION_APART) | lost[None], np.inf, far)
        index = np.arange(len(far))
        far[known] = np.where(
            np.arange(far.shape[1])[None] == each.lamp[known][:, None], far[known], np.inf
        )
        if not far.size:
            continue
        best = far.argmin(axis=1)
        near = far[index, best]
        mutual = far.argmin(axis=0)[best] == index
        # A lamp whose next highlight is as near is nobody's.
        second = (
            np.partition(far, 1, axis=1)[:, 1] if far.shape[1] > 1 else np.full(len(far), np.inf)
        )
        good = mutual & (near < gate_px) & ((near < 0.5 * second) | known)
        ball = camera.project(centre[None])[0][0]
        size = state.radius_mm * camera.fx_px / np.linalg.norm(camera.centre_mm - centre)
        off = np.linalg.norm(each.found.place_px - ball, axis=1)
        good &= off < (1 - config.rim_share) * size
        px = each.found.place_px[good]
        count = len(px)
        side = [rays_through(camera, px + way) for way in ((SIDE_PX, 0.0), (0.0, SIDE_PX))]
        rows.append(
            (
                best[good],
                np.full(count, each.pose),
                np.full(count, group),
                np.broadcast_to(camera.centre_mm, (count, 3)),
                rays_through(camera, px),
                np.stack(side, axis=1),
                each.found.flux[good] / each.level[best[good], None],
            )
        )
    lamp, pose, group_, origin, ray, side_, flux = (
        np.concatenate([row[k] for row in rows]) if rows else np.zeros((0, 3)) for k in range(7)
    )
    return _Matched(
        lamp.astype(int), pose.astype(int), group_.astype(int), origin, ray,
        np.moveaxis(side_, 1, 0) if rows else np.zeros((2, 0, 3)), flux,
    )  # fmt: skip


def _crowded(want: np.ndarray, each: Seen) -> np.ndarray:
    """(L,) bool: lamps whose highlights should run into another's, as near the poles of a rig."""
    lit = np.flatnonzero(np.isfinite(want).all(axis=1) & (each.level > 0))
    out = np.zeros(len(want), bool)
    if len(lit) > 1:
        out[lit] = np.asarray(cKDTree(want[lit]).query(want[lit], k=2)[0])[:, 1] < each.apart_px
    return out


@dataclasses.dataclass(frozen=True)
class _Errors:
    """Of n sightings: (n, 2) pixels, (n, 2, 3) pixels per direction, way and distance to lamps."""

    px: np.ndarray
    px_per_turn: np.ndarray
    turn: np.ndarray
    way: np.ndarray
    far: np.ndarray
    good: np.ndarray


def _errors(m: _Matched, state: _State, px_per_turn: np.ndarray | None = None) -> _Errors:
    centre = state.centres_mm[m.pose]
    main = mirrored(centre, state.radius_mm, m.origin, m.ray)
    sides = [mirrored(centre, state.radius_mm, m.origin, ray) for ray in m.side]
    turn = np.stack([(s.directions - main.directions) / SIDE_PX for s in sides], axis=2)
    way = state.lamps_mm[m.lamp] - main.points_mm
    far = np.linalg.norm(way, axis=1)
    way = way / far[:, None]
    if px_per_turn is None:
        square = np.einsum("nki,nkj->nij", turn, turn)
        square += TINY * np.eye(2)
        px_per_turn = np.linalg.solve(square, np.swapaxes(turn, 1, 2))
    px = np.einsum("nik,nk->ni", px_per_turn, way - main.directions)
    good = main.hit & sides[0].hit & sides[1].hit & np.isfinite(px).all(axis=1)
    return _Errors(np.where(good[:, None], px, 0), px_per_turn, turn, way, far, good)


def _solved(m: _Matched, state: _State, nominal: np.ndarray, config: MirrorBallConfig) -> _State:
    for _ in range(SOLVES):
        system = _system(m, state, _errors(m, state), nominal, config)
        lamps, rest = system.step()
        state = _State(
            state.lamps_mm + lamps,
            state.centres_mm + rest[:-1].reshape(-1, 3),
            float(state.radius_mm + rest[-1]),
        )
        if max(np.abs(lamps).max(), np.abs(rest).max()) < CONVERGED_MM:
            break
    return state


def _scale_px(errors: _Errors, config: MirrorBallConfig) -> float:
    """Typical error of a centroid's coordinate."""
    some = np.abs(errors.px[errors.good])
    return max(config.noise_px, 1.4826 * float(np.median(some)) if some.size else 0.0)


@dataclasses.dataclass(frozen=True)
class _System:
    """Normal equations of one Gauss-Newton step: each lamp meets only the places and the radius.

    own (L, 3, 3), shared (L, 3, q), rest (q, q); right sides (L, 3) and (q,).
    """

    own: np.ndarray
    shared: np.ndarray
    rest: np.ndarray
    right_own: np.ndarray
    right_rest: np.ndarray

    def _reduced(self) -> tuple[np.ndarray, np.ndarray]:
        """(L, 3, q) own^-1 shared; (q, q) the system of places and radius alone."""
        through = np.linalg.solve(self.own, self.shared)
        return through, self.rest - np.einsum("lij,lik->jk", self.shared, through)

    def step(self) -> tuple[np.ndarray, np.ndarray]:
        """(L, 3) steps of the lamps, (q,) of places and radius."""
        through, reduced = self._reduced()
        rest = np.linalg.solve(
            reduced, self.right_rest - np.einsum("lij,li->j", through, self.right_own)
        )
        lamps = np.linalg.solve(self.own, self.right_own[:, :, None])[:, :, 0] - through @ rest
        return lamps, rest

    def covariance(self) -> np.ndarray:
        """(L, 3, 3) of each lamp's position."""
        through, reduced = self._reduced()
        shared = through @ np.linalg.inv(reduced) @ np.swapaxes(through, 1, 2)
        return np.asarray(np.linalg.inv(self.own) + shared)


def _system(
    m: _Matched, state: _State, errors: _Errors, nominal: np.ndarray, config: MirrorBallConfig
) -> _System:
    count, places = len(nominal), state.centres_mm.size
    sigma = _scale_px(errors, config)
    length = np.linalg.norm(errors.px, axis=1)
    weight = np.where(errors.good, 1 / sigma**2 / (1 + (length / (3 * sigma)) ** 2), 0)
    across = np.eye(3) - errors.way[:, :, None] * errors.way[:, None, :]
    to_lamp = np.einsum("nik,nkj->nij", errors.px_per_turn, across) / errors.far[:, None, None]
    to_rest = np.zeros((len(m.lamp), 2, places + 1))
    index = np.arange(len(m.lamp))
    for k in range(3):
        to_rest[index, :, 3 * m.pose + k] = _moved(m, state, errors, k)
    to_rest[:, :, -1] = _moved(m, state, errors, 3)
    own = np.tile(np.eye(3) / config.position_sigma_mm**2, (count, 1, 1))
    shared = np.zeros((count, 3, places + 1))
    right = (nominal - state.lamps_mm) / config.position_sigma_mm**2
    weighed = weight[:, None, None] * to_lamp
    np.add.at(own, m.lamp, np.einsum("nij,nik->njk", weighed, to_lamp))
    np.add.at(shared, m.lamp, np.einsum("nij,nik->njk", weighed, to_rest))
    np.add.at(right, m.lamp, -np.einsum("nij,ni->nj", weighed, errors.px))
    prior = np.full(places + 1, config.place_sigma_mm**-2)
    prior[-1] = config.radius_sigma_mm**-2
    off = np.append(state.centres_mm.ravel(), state.radius_mm - config.radius_mm)
    heavy = weight[:, None, None] * to_rest
    rest = np.einsum("nij,nik->jk", heavy, to_rest) + np.diag(prior)
    right_rest = -np.einsum("nij,ni->j", heavy, errors.px) - prior * off
    return _System(own, shared, rest, right, right_rest)


def _moved(m: _Matched, state: _State, errors: _Errors, axis: int) -> np.ndarray:
    """(n, 2) how errors change when the ball moves along an axis; of axis 3, when it grows."""
    step = 1e-3
    centres, radius = state.centres_mm.copy(), state.radius_mm
    if axis < 3:
        centres[:, axis] += step
    else:
        radius += step
    after = _errors(m, _State(state.lamps_mm, centres, radius), errors.px_per_turn)
    return np.where((errors.good & after.good)[:, None], (after.px - errors.px) / step, 0)


def _placed(m: _Matched, state: _State, nominal: np.ndarray, config: MirrorBallConfig) -> Placed:
    errors = _errors(m, state)
    own = _system(m, state, errors, nominal, config).covariance()
    count = len(nominal)
    square = np.sum(errors.px**2, axis=1)
    near = errors.good & (square < (6 * _scale_px(errors, config)) ** 2)
    seen = np.bincount(m.lamp[near], minlength=count)
    total = np.bincount(m.lamp[near], square[near], minlength=count)
    with np.errstate(invalid="ignore"):
        residual = np.sqrt(total / np.where(seen > 0, seen, np.nan))
    # A pixel of the highlight shows this much of the lamp's disc: flux over it is radiance.
    turned = np.einsum("nki,nkj->nij", errors.turn, errors.turn)
    patch = np.sqrt(np.maximum(np.linalg.det(turned), 0)) * errors.far**2
    flux = Flux(m.lamp[near], m.group[near], m.flux[near] * patch[near, None])
    return Placed(
        position_mm=state.lamps_mm,
        sigma_mm=np.sqrt(np.linalg.eigvalsh(own)[:, -1]),
        residual_px=residual,
        sightings=seen,
        centres_mm=state.centres_mm,
        radius_mm=state.radius_mm,
        rms_px=float(np.sqrt(square[near].mean())) if near.any() else float("nan"),
        flux=flux,
    )
